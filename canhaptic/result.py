"""The account of a run as plain values: what `canhaptic run --json` prints and every table and comparison reads.

    {status, config_hash, cycles, passive, ports: {NAME: {passive, ...}}, truth: {NAME: {...}}, timing, link, method}

A port is an axis or a group of axes. An axis in a group has `group` and what came in and went out by it; the account,
whether it is passive included, is that of the group, which has `axes`. Energies in [J], times in [s].
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from canhaptic.control.balance import Certificate, Ledger, Verdict, account_verdict
from canhaptic.cycle import Cycle
from canhaptic.drive.can.servo_drive import ServoDrive

_OF_AN_AXIS: Final = ("unit", "in", "out", "peak_torque", "limited_cycles", "read_back", "read_back_bound")


_WORST_LAST: Final[tuple[Verdict, ...]] = ("yes", "in doubt", "no")


def overall(ports: Mapping[str, Mapping[str, Any]]) -> Verdict:
    """Returns the worst verdict of all accounts; "in doubt" where there is none, as of a run without a cycle."""
    found: list[Verdict] = [account["passive"] for account in ports.values() if "passive" in account]
    return max(found, key=_WORST_LAST.index) if found else "in doubt"


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
    accounts = _accounts(cycle, ports, sample_time)
    return {
        "status": status,
        "config_hash": config_hash,
        "cycles": cycle.cycles,
        "duration": cycle.cycles * sample_time,
        "passive": overall(accounts),
        "ports": accounts,
        "truth": _truth(cycle, list(accounts)),
        "timing": {name: histogram.summary() for name, histogram in cycle.timing.items()},
        "link": cycle.rig.link_statistics(),
        "method": method,
    }


def _accounts(cycle: Cycle, ports: Sequence[tuple[str, str]], sample_time: float) -> dict[str, dict[str, Any]]:
    """Returns the account of each axis, then of each group."""
    drives, grouped = cycle.rig.drives, {axis for group in cycle.groups for axis in group.axes}
    alone = iter(cycle.controllers)
    accounts: dict[str, dict[str, Any]] = {}
    for axis, (name, unit) in enumerate(ports):
        drive = drives[axis]
        accounts[name] = {
            "unit": unit,
            **_ledger(cycle.ledgers[axis], sample_time, [drive], None if axis in grouped else next(alone)),
            "read_back": drive.map.read_back,
            "read_back_bound": drive.read_back_bound,
            "energy_resolution": cycle.resolutions[axis].value + drive.read_back_bound,
        }
    for group in cycle.groups:
        accounts[group.name] = {
            "unit": ports[group.axes[0]][1],
            **_ledger(group.ledger, sample_time, [drives[axis] for axis in group.axes], group.controller),
            "supplied": group.supplied,
            "unsure": group.unsure,
            "limits": dict(group.limits),
            "energy_resolution": group.unsure
            + sum(accounts[ports[axis][0]]["energy_resolution"] for axis in group.axes),
        }
    return with_groups(accounts, {group.name: [ports[axis][0] for axis in group.axes] for group in cycle.groups})


def _ledger(ledger: Ledger, sample_time: float, drives: Sequence[ServoDrive], controller: object) -> dict[str, Any]:
    """Returns what a ledger holds, with the longest hold [sample times] of its drives.

    A certificate covers `max_consecutive_losses` sample times without a new torque, of a controller that declares them,
    and none of one that does not. A skipped SYNC is no lost frame: the torque under way acts for longer, and the one
    behind it, which counted on a single hold, acts all the same. Where a torque acted for longer than was covered,
    nothing was certified, whatever each step said; nor where a drive held a torque that was never commanded.
    """
    account = ledger.summary().as_json(sample_time)
    account["longest_hold"] = longest = max(drive.longest_hold for drive in drives)
    covered = getattr(controller, "max_consecutive_losses", 0) if all(drive.longest_gap == 1 for drive in drives) else 0
    account["uncommanded_cycles"] = uncommanded = sum(drive.uncommanded for drive in drives)
    if (longest > 1 + covered or uncommanded) and (account["in"] or account["out"]):
        account["certificate"] = Certificate.NONE.name.lower()
        account["certificates"] = [account["certificate"]]
    return account


def with_groups(accounts: Mapping[str, Mapping[str, Any]], groups: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """Returns the accounts of axes and groups with the verdict of each, and with what each says of the other.

    Args:
        accounts: By name, as if every port were alone.
        groups: Names of the axes of each group. Alone an axis of a group proves nothing: of its account is left what
            came in and went out by it.
    """
    found = {name: dict(account) for name, account in accounts.items()}
    for account in found.values():
        account["passive"] = account_verdict(account)
    for group, axes in groups.items():
        found[group] = {"unit": found[group]["unit"], "axes": list(axes), **found[group]}
        for name in axes:
            kept: dict[str, Any] = {key: found[name][key] for key in _OF_AN_AXIS if key in found[name]}
            found[name] = {"group": group, **kept}
    return found


def _truth(cycle: Cycle, names: Sequence[str]) -> dict[str, dict[str, float]]:
    """Returns what the simulated plant says of each axis, then of each group; nothing with real drives."""
    judge = cycle.judge
    if judge is None:
        return {}
    return {
        name: {
            "interaction": judge.interaction[place],
            "least_interaction": judge.least[place],
            "least_at_handle": judge.least_at_handle[place],
            "believed_error": judge.believed_error[place],
        }
        for place, name in enumerate(names)
    }
