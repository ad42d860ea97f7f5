"""Two axes with one account: a room on an X-Y stage."""

from pathlib import Path

import canhaptic

CONFIGS = Path(__file__).resolve().parents[1] / "configs"

result = canhaptic.simulate(CONFIGS / "xy_box.yaml", duration=2.0)
stage = result.account["stage"]
for name in ("x", "y"):
    port = result.account[name]
result.plot().savefig("room.png")
