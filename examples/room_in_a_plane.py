"""Two axes with one account: a room on an X-Y stage."""

from pathlib import Path

import canhaptic

CONFIGS = Path(__file__).resolve().parents[1] / "configs"

result = canhaptic.simulate(CONFIGS / "xy_box.yaml", duration=2.0)
stage = result.account["stage"]
print(
    f"stage: in {stage.energy_in:.4f} J, out {stage.energy_out:.4f} J, passive {stage.passive}, by {stage.certificate}"
)
for name in ("x", "y"):
    port = result.account[name]
    print(f"  {name}: in {port.energy_in:.4f} J, out {port.energy_out:.4f} J; the account is that of {port.group}")
result.plot().savefig("room.png")
