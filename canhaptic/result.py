"""The account of a run as plain values: what `canhaptic run --json` prints and every table and comparison reads.

    {status, config_hash, cycles, ports: {NAME: {...}}, truth: {NAME: {...}}, timing, link, method}

Energies in [J], times in [s].
"""

from collections.abc import Sequence
from typing import Any

from canhaptic.cycle import Cycle


def run_result(
    cycle: Cycle, ports: Sequence[tuple[str, str]], *, status: str, config_hash: str, sample_time: float, method: str
) -> dict[str, Any]:
    """Returns the account of a run; energies in [J], times in [s].

    Args:
        cycle: What ran, whether to its end or not.
        ports: (name, unit "m" or "rad") of each axis.
        status: "completed", "stopped" or the reason of a stop.
        config_hash: Hash of the configuration in effect.
        sample_time: [s]
        method: One line on how the far side was computed; empty with real drives.
    """
    accounts = {
        name: {"unit": unit, **ledger.summary().as_json(sample_time)}
        for (name, unit), ledger in zip(ports, cycle.ledgers, strict=True)
    }
    return {
        "status": status,
        "config_hash": config_hash,
        "cycles": cycle.cycles,
        "duration": cycle.cycles * sample_time,
        "ports": accounts,
        "truth": _truth(cycle, [name for name, _ in ports]),
        "timing": {name: histogram.summary() for name, histogram in cycle.timing.items()},
        "link": cycle.rig.link_statistics(),
        "method": method,
    }


def _truth(cycle: Cycle, names: Sequence[str]) -> dict[str, dict[str, float]]:
    judge = cycle.judge
    if judge is None:
        return {}
    return {
        name: {
            "interaction": judge.interaction[axis],
            "least_interaction": judge.least[axis],
            "believed_error": judge.believed_error[axis],
        }
        for axis, name in enumerate(names)
    }
