"""The account of a run as plain values: what `canhaptic run --json` prints and every table and comparison reads.

    {status, config_hash, cycles, passive, ports: {NAME: {passive, ...}}, truth: {NAME: {...}}, timing, link, method}

`passive` is a verdict on the sum of what came in with the torque of the motor (eq. 3); `passive_at_handle`, where a
damping of the device is declared, on that sum with what the device has dissipated.

A port is an axis or a group of axes. An axis in a group has `group` and what came in and went out by it; the account,
whether it is passive included, is that of the group, which has `axes`. Energies in [J], times in [s].
"""

from collections.abc import Mapping, Sequence
from typing import Final, NotRequired, TypedDict, cast

from canhaptic.control.balance import Certificate
from canhaptic.control.verdict import PortResult, RenderedShares, Verdict, account_verdict, handle_verdict
from canhaptic.cycle import Cycle
from canhaptic.meters import Promise, RunMeters, promise_of


class TruthResult(TypedDict):
    """True energies of a simulated port [J]."""

    interaction: float
    least_interaction: float
    least_at_handle: float
    believed_error: float


class RunResult(TypedDict):
    """The account of a run, as `run --json` prints it; see the module."""

    status: str
    config_hash: str
    cycles: int
    duration: float  # [s]
    passive: Verdict
    passive_at_handle: NotRequired[Verdict]
    ports: dict[str, PortResult]
    truth: dict[str, TruthResult]
    timing: Mapping[str, Mapping[str, float] | float | str]
    link: Mapping[str, float]
    method: str
    plants: NotRequired[dict[str, dict[str, int]]]
    bus_effects: NotRequired[Mapping[str, object]]
    logs: NotRequired[dict[str, int]]
    error: NotRequired[Mapping[str, object]]


_OF_AN_AXIS: Final = ("unit", "in", "out", "peak_torque", "limited_cycles", "read_back", "read_back_bound")


_WORST_LAST: Final[tuple[Verdict, ...]] = ("yes", "in doubt", "no")


def overall(ports: Mapping[str, PortResult]) -> Verdict:
    """Returns the worst verdict of all accounts; "in doubt" where there is none, as of a run without a cycle."""
    found: list[Verdict] = [account["passive"] for account in ports.values() if "passive" in account]
    return max(found, key=_WORST_LAST.index) if found else "in doubt"


def at_handles(ports: Mapping[str, PortResult]) -> Verdict | None:
    """Returns the worst verdict at the handle; None where no account has one."""
    found = [account["passive_at_handle"] for account in ports.values() if "passive_at_handle" in account]
    return max(found, key=_WORST_LAST.index) if found else None


def run_result(
    cycle: Cycle, ports: Sequence[tuple[str, str]], *, status: str, config_hash: str, sample_time: float, method: str
) -> RunResult:
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
    result: RunResult = {
        "status": status,
        "config_hash": config_hash,
        "cycles": cycle.cycles,
        "duration": (cycle.cycles + cycle.rig.skipped_syncs) * sample_time,
        "passive": overall(accounts),
        "ports": accounts,
        "truth": _truth(cycle, list(accounts)),
        "timing": {name: histogram.summary() for name, histogram in cycle.timing.items()},
        "link": cycle.rig.link_statistics(),
        "method": method,
    }
    at_handle = at_handles(accounts)
    if at_handle is not None:
        result["passive_at_handle"] = at_handle
    return result


def _accounts(cycle: Cycle, ports: Sequence[tuple[str, str]], sample_time: float) -> dict[str, PortResult]:
    """Returns the account of each axis, then of each group."""
    drives, grouped = cycle.rig.drives, {axis for group in cycle.groups for axis in group.axes}
    alone = iter(cycle.controllers)
    accounts: dict[str, PortResult] = {}
    for axis, (name, unit) in enumerate(ports):
        drive, promise = drives[axis], Promise() if axis in grouped else promise_of(next(alone))
        accounts[name] = {
            "unit": unit,
            **cycle.ledgers[axis].summary().as_json(sample_time),
            **_measured(cycle.meters, axis, promise),
            **_compared(cycle.meters, axis),
            "rendered": _rendered(cycle.meters, axis),
            "read_back": drive.map.read_back,
            "read_back_bound": drive.read_back_bound,
        }
    for place, group in enumerate(cycle.groups, len(ports)):
        accounts[group.name] = {
            "unit": ports[group.axes[0]][1],
            **group.ledger.summary().as_json(sample_time),
            **_measured(cycle.meters, place, promise_of(group.controller)),
            "supplied": group.supplied,
            "unsure": group.unsure,
            "limits": dict(group.limits),
        }
    for name, place in zip(accounts, range(len(accounts)), strict=True):
        gap = max(drive.longest_gap for drive in cycle.meters.ports[place].drives)
        withdraw_certificates(accounts[name], longest_gap=gap)
    return with_groups(accounts, {group.name: [ports[axis][0] for axis in group.axes] for group in cycle.groups})


def _measured(meters: RunMeters, place: int, promise: Promise) -> PortResult:
    """Returns what is known of a port in addition to its ledger."""
    port = meters.ports[place]
    measured, least = port.measured(), port.least_at_handle
    at_handle: PortResult = {}
    if least is not None:
        at_handle = {"least_at_handle": least, "device_dissipated": measured.device_dissipated}
    return {
        "energy_resolution": measured.energy_resolution,
        **at_handle,
        "contact": {"holds": port.contacts, "without_torque": port.silent},
        "longest_hold": measured.longest_hold,
        "uncommanded_cycles": measured.uncommanded,
        "max_consecutive_losses": promise.max_consecutive_losses,
        "energy_allowance": promise.energy_allowance,
    }


def _compared(meters: RunMeters, axis: int) -> PortResult:
    """Returns the force beyond declared friction and hand that an axis showed; empty where it is not watched."""
    watch = meters.axes[axis].watch
    return {} if watch is None else {"friction_excess": watch.excess}


def _rendered(meters: RunMeters, axis: int) -> RenderedShares:
    """Returns how much of what the environment of an axis asked for was rendered."""
    port = meters.of_axes[axis]
    damping = meters.axes[axis].damping_asked * port.contacts
    return rendered_shares(port.asked, port.rendered, damping, port.damping)


def rendered_shares(asked: float, given: float, damping_asked: float, damping: float) -> RenderedShares:
    """Returns how much of effort and damping was rendered in contact, from sums over its holds; None: none asked."""
    return {
        "stiffness": given / asked if asked else None,
        "damping": damping / damping_asked if damping_asked else None,
    }


def withdraw_certificates(account: PortResult, *, longest_gap: int) -> None:
    """Takes the certificates off an account where a torque acted for longer than they covered, or was not commanded.

    The same where one hold had none, being longer or shorter than declared, and where the axis moved as it cannot with
    the friction that is declared (`friction_watch`).

    A certificate covers `max_consecutive_losses` sample times without a new torque. A skipped SYNC is no lost frame:
    the torque under way acts for longer, and the one behind it, which counted on a single hold, acts all the same.

    Args:
        account: Of a port; changed.
        longest_gap: The most sample times between two SYNCs: 1 where none was skipped.
    """
    covered = account["max_consecutive_losses"] if longest_gap == 1 else 0
    is_broken = account["longest_hold"] > 1 + covered or account.get("uncommanded_cycles", 0)
    is_broken = is_broken or account.get("friction_excess", 0.0) > 0.0
    is_broken = is_broken or Certificate.NONE.name.lower() in account["certificates"]
    if is_broken and account["certificates"]:
        account["certificate"] = Certificate.NONE.name.lower()
        account["certificates"] = [account["certificate"]]


def with_groups(accounts: Mapping[str, PortResult], groups: Mapping[str, Sequence[str]]) -> dict[str, PortResult]:
    """Returns the accounts of axes and groups with the verdict of each, and with what each says of the other.

    Args:
        accounts: Accounts by the name of the port, each formed as if the port were alone.
        groups: Names of the axes of each group. An axis of a group alone proves nothing: its account keeps only the
            energy that came in and went out through it.
    """
    found = {name: account.copy() for name, account in accounts.items()}
    for account in found.values():
        account["passive"] = account_verdict(account)
        at_handle = handle_verdict(account)
        if at_handle is not None:
            account["passive_at_handle"] = at_handle
    for group, axes in groups.items():
        found[group] = {"unit": found[group]["unit"], "axes": list(axes), **found[group]}
        for name in axes:
            kept = {key: value for key, value in found[name].items() if key in _OF_AN_AXIS}
            found[name] = cast("PortResult", {"group": group, **kept})
    return found


def _truth(cycle: Cycle, names: Sequence[str]) -> dict[str, TruthResult]:
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
