"""Lose and delay frames, and see what the account says."""

from pathlib import Path

import canhaptic

CONFIGS = Path(__file__).resolve().parents[1] / "configs"

for bus in ({}, {"drop": 0.02}, {"drop": 0.02, "jitter": "200 us"}):
    changes = {"simulation.bus": bus, "passivity.max_consecutive_losses": 2, "bus.stop_cycles": 200} if bus else {}
    result = canhaptic.simulate(CONFIGS / "demo.yaml", changes, duration=3.0)
    port, link = result.account["handle"], result.account.raw["link"]
    print(f"{bus!s:36} link {100 * link['success_rate']:6.2f} %, passive {port.passive}, by {port.certificate}")
