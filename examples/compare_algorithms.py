"""Every algorithm on one stiff wall, by figures."""

from pathlib import Path

import canhaptic

CONFIGS = Path(__file__).resolve().parents[1] / "configs"

scene = canhaptic.load_scene(CONFIGS / "hard" / "stiff_wall.yaml")
comparison = canhaptic.compare(scene, duration=1.0, repeats=0)
print(f"{'algorithm':24} {'error rms':>12} {'gave out':>12}")
for found in comparison.result["rows"]:
    if found["status"] == "completed":
        gave = max(0.0, -found["least_interaction"])
        print(f"{found['algorithm']:24} {1e6 * found['position_error.rms']:9.1f} um {1e3 * gave:9.2f} mJ")
