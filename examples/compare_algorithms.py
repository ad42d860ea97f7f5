"""Every algorithm on one stiff wall, by figures."""

from pathlib import Path

import canhaptic

CONFIGS = Path(__file__).resolve().parents[1] / "configs"

scene = canhaptic.load_scene(CONFIGS / "hard" / "stiff_wall.yaml")
comparison = canhaptic.compare(scene, duration=1.0, repeats=0)
for _name, found in comparison.result["axes"]["handle"]["algorithms"].items():
    if found["status"] == "completed":
        gave = max(0.0, -found["least_interaction"])
