"""Simulate a wall, read its account, save picture and log."""

from pathlib import Path

import canhaptic

CONFIGS = Path(__file__).resolve().parents[1] / "configs"

result = canhaptic.simulate(CONFIGS / "demo.yaml", {"environment.stiffness": "500 N/m"}, duration=3.0)
account = result.account["handle"]
result.plot().savefig("wall.png")
