"""Simulate a wall, read its account, save picture and log."""

from pathlib import Path

import canhaptic

CONFIGS = Path(__file__).resolve().parents[1] / "configs"

result = canhaptic.simulate(CONFIGS / "demo.yaml", {"environment.stiffness": "500 N/m"}, duration=3.0)
account = result.account["handle"]
print(f"in {account.energy_in:.4f} J, out {account.energy_out:.4f} J, dissipated {account.dissipated:.4f} J")
print(f"passive: {account.passive}, torque bounded by: {account.certificate}")
result.plot().savefig("wall.png")
print("log:", result.save("wall.h5"))
