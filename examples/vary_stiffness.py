"""One scene with several values, in one picture."""

from pathlib import Path

import canhaptic

CONFIGS = Path(__file__).resolve().parents[1] / "configs"

results = [
    canhaptic.simulate(CONFIGS / "demo.yaml", {"environment.stiffness": f"{stiffness} N/m"}, duration=2.0)
    for stiffness in (100, 1000, 10_000)
]
for result in results:
    samples = result.to_numpy()
    depth, force = -0.05 - samples["handle.position"].min(), abs(samples["handle.torque_applied"]).max()
    print(f"{result.scene.overrides[0]}: {1e3 * depth:.1f} mm deep, {force:.1f} N at most, {result.account.passive}")
soft, *stiffer = results
soft.plot(*stiffer).savefig("stiffness.png")
