"""The account of a run as plain values, as `canhaptic run --json` prints it; every table and comparison reads it.

    {status, config_hash, cycles, verdict, passive, ports: {NAME: {verdict, passive, ...}}, truth: {NAME: {...}},
     timing, link, method}

`passive` is the account's verdict from frames alone: whether the energy received at the motor stayed above zero
(eq. 3). `passive_at_handle`, present if damping of the device is declared, adds the energy that the device dissipated.
`plant_passive` and `plant_passive_at_handle` are the same verdicts from the energy of the simulated plant. `verdict`
is the headline word: the plant's verdict if there is one, else the account's.

A port is an axis or a group of axes. An axis in a group has only `group` and its own energy in and out; account and
verdict are those of the group, which has `axes`. Energies in [J], times in [s].
"""

from collections.abc import Mapping, Sequence
from math import inf
from typing import Final, NotRequired, TypedDict, cast

from canhaptic.control import verdict as verdicts
from canhaptic.control.balance import Certificate
from canhaptic.control.verdict import WORST_LAST, Headline, PortResult, Verdict
from canhaptic.cycle import Cycle
from canhaptic.meters import PortFigures, Promise, promise_of
from canhaptic.quantities import with_old_names


class TruthResult(TypedDict):
    """Energies of a simulated port, computed from the plant [J]."""

    interaction: float
    least_interaction: float
    least_at_handle: float
    accounted_error: float


class Verdicts(TypedDict):
    """The worst verdict of each kind over all accounts; a kind that no account has is left out."""

    verdict: Headline
    passive: Verdict
    passive_at_handle: NotRequired[Verdict]
    plant_passive: NotRequired[Verdict]
    dry_run: NotRequired[bool]  # no torque was sent


class RunResult(Verdicts):
    """The account of a run as `run --json` prints it; see the module docstring."""

    status: str
    config_hash: str
    cycles: int
    duration: float  # [s]
    ports: dict[str, PortResult]
    truth: dict[str, TruthResult]
    timing: Mapping[str, Mapping[str, float] | float | str]
    link: Mapping[str, float]
    method: str
    plants: NotRequired[dict[str, dict[str, int]]]
    bus_effects: NotRequired[Mapping[str, object]]
    own_code: NotRequired[Mapping[str, int | str]]  # place; of a process: holds without an answer, most in a row
    logs: NotRequired[dict[str, int]]
    far: NotRequired[Mapping[str, float]]  # what the link to a far side has done: `canhaptic.far.side.LinkSummary`
    energy_log: NotRequired[str]  # why it ends before the run, and where
    unrestored: NotRequired[dict[str, list[str]]]  # axis -> objects that the start wrote and the stop did not put back
    remarks: NotRequired[dict[str, list[str]]]  # axis -> what the start saw in its drive and did not refuse
    error: NotRequired[Mapping[str, object]]


_OF_AN_AXIS: Final = (
    *("unit", "in", "out", "peak_torque", "limited_cycles", "read_back", "read_back_bound"),
    *("dry_run", "withheld_torque", "hold", "mass"),
)
"""Keys that the account of an axis in a group keeps."""
_HEADLINES: Final[tuple[Headline, ...]] = ("no contact", "dry run", "yes", "in doubt", "nothing rendered", "no")
"""Headline words, worst last; "no contact" is first, so that one untouched handle never decides the overall verdict."""


def overall(ports: Mapping[str, PortResult]) -> Verdicts:
    """Return the worst verdicts over all accounts; "in doubt" if there are none."""
    accounts = [account for account in ports.values() if "passive" in account]
    found: Verdicts = {
        "verdict": max((of.get("verdict", of["passive"]) for of in accounts), key=_HEADLINES.index, default="in doubt"),
        "passive": max((account["passive"] for account in accounts), key=WORST_LAST.index, default="in doubt"),
    }
    if any("dry_run" in account for account in accounts):
        found["dry_run"] = True
    for key in ("passive_at_handle", "plant_passive"):
        if any(key in account for account in accounts):
            found[key] = max((of[key] for of in accounts if key in of), key=WORST_LAST.index)
    return found


def run_result(cycle: Cycle, *, status: str, config_hash: str, method: str) -> RunResult:
    """Return the account of a run; energies in [J], times in [s].

    Args:
        cycle: Cycle after the run has ended.
        status: "completed", "stopped" or the reason of a stop.
        config_hash: Hash of the configuration in effect.
        method: One line on how the rig was simulated; "" with real drives.
    """
    truth = _truth(cycle)
    accounts = _accounts(cycle, truth)
    result = cast(
        "RunResult",
        {
            "status": status,
            "config_hash": config_hash,
            "cycles": cycle.cycles,
            "duration": (cycle.cycles + cycle.rig.skipped_syncs) * cycle.rig.bus.sample_time,
            **overall(accounts),
            "ports": accounts,
            "truth": truth,
            "timing": {name: histogram.summary() for name, histogram in cycle.timing.items()},
            "link": cycle.rig.link_statistics(),
            "method": method,
        },
    )
    if unrestored := {drive.axis.name: drive.unrestored for drive in cycle.rig.drives if drive.unrestored}:
        result["unrestored"] = unrestored
    if remarks := {drive.axis.name: drive.remarks for drive in cycle.rig.drives if drive.remarks}:
        result["remarks"] = remarks
    return result


def _accounts(cycle: Cycle, truth: Mapping[str, TruthResult]) -> dict[str, PortResult]:
    """Return the account of each row: of each axis, then of each port of several axes."""
    axes, ports = [drive.axis for drive in cycle.rig.drives], cycle.all_ports
    alone, known, sample_time = ports.alone, cycle.meters.ports, cycle.rig.bus.sample_time
    accounts: dict[str, PortResult] = {}
    found = cycle.found_holds()
    for axis, drive in enumerate(cycle.rig.drives):
        promise, name = promise_of(alone.get(axis)), drive.axis.name
        accounts[name] = {
            "unit": drive.axis.unit,
            **port_account(known[axis], cycle.ledgers[axis].summary().as_json(sample_time), promise, sample_time),
            "read_back": drive.read_back,
            "read_back_bound": drive.read_back_bound,
        }
        if hold := found.get(axis, drive.hold):
            accounts[name]["hold"] = hold
        if cycle.rig.dry_run:
            accounts[name]["withheld_torque"] = drive.withheld
    for port in ports.several:
        sums = cycle.ledgers[port.row].summary().as_json(sample_time)
        account: PortResult = {
            "unit": axes[port.axes[0]].unit,
            **port_account(known[port.row], sums, promise_of(port.controller), sample_time),
            "supplied": cycle.ledgers[port.row].supplied,
            "uncertainty": port.uncertainty,
            "limits": dict(port.limits),
        }
        accounts[port.name] = with_old_names(account)
    for account, (_, of) in zip(accounts.values(), ports.axes_of_rows, strict=True):
        if left := [cycle.unbooked[axis] for axis in of if axis in cycle.unbooked]:
            verdicts.leave_open(account, is_confirmed=all(left))
    for account in accounts.values() if cycle.rig.dry_run else ():
        verdicts.claim_nothing(account)
    return with_groups(accounts, {port.name: [axes[axis].name for axis in port.axes] for port in ports.several}, truth)


_UNANSWERED: Final = 0.05
"""Fraction of the requested effort that falls after the last torque; above it, the account gives that time."""
_UNKNOWN: Final[PortResult] = {"dissipated": None, "damping_rendered": {"least": None, "most": None}}
"""Sums that are unknown if a program, or user code in a separate process, requests the port's torques."""


def port_account(port: PortFigures, sums: PortResult, promise: Promise, sample_time: float) -> PortResult:
    """Return the account of a port without verdicts.

    Args:
        port: Figures of the port that are not in its ledger.
        sums: Sums of its ledger, with the keys of `run --json`.
        promise: Lost cycles, energy allowance and hand force for which its certificates hold.
        sample_time: Sample time [s].
    """
    measured = port.measured()
    account: PortResult = {
        **sums,
        **(_UNKNOWN if port.is_requested else {}),
        "energy_resolution": measured.energy_resolution,
        "least_certain": port.least_certain,
        "contact": {"holds": port.contacts, "without_torque": port.silent},
        "longest_hold": measured.longest_hold,
        "uncommanded_cycles": measured.uncommanded,
        "max_consecutive_losses": promise.max_consecutive_losses,
        "energy_allowance": promise.energy_allowance,
        **({} if promise.hand_force is None else {"hand_force": promise.hand_force}),
    }
    if port.least_at_handle is not None:
        account["least_at_handle"], account["device_dissipated"] = port.least_at_handle, measured.device_dissipated
        account["least_certain_at_handle"] = port.least_certain_at_handle
    if not port.contacts and not port.books_least and port.reach[0] <= port.reach[1]:
        account["reach"] = list(port.reach)
    if port.damping_asked is not None:
        account["contact"] |= {"requested": port.sizes_asked, "sent": port.sizes_sent}
        account["contact"]["beyond_limit"] = port.beyond_limit
        account["contact"] = with_old_names(account["contact"])
        _add_end_of_torque(account["contact"], port, sample_time)
        damping = port.damping_asked * port.contacts
        stiffness = max(0.0, port.rendered / port.asked) if port.asked else None
        account["rendered"] = {"stiffness": stiffness, "damping": port.damping / damping if damping else None}
    if (felt := port.felt) is not None:
        asked, mass = felt.asked.mass, felt.mass
        share = None if mass is None else mass / asked
        account["mass"] = with_old_names({"requested": asked, "felt": mass, "share": share})
    if (excess := port.friction_excess) is not None:
        account["friction_excess"] = excess
    if port.books_least:
        account["books_least"] = True
    _add_activity(account, port, sample_time)
    withdraw_certificates(account, longest_gap=port.longest_gap)
    return account


def _add_activity(account: PortResult, port: PortFigures, sample_time: float) -> None:
    """Add the times from which the port was certainly active [s], and whether its resolution is an estimate."""
    activity = port.activity
    if activity.limits.floor == -inf:
        account["resolution_is_estimated"] = True
    if activity.since is not None:
        account["active_since"] = activity.since * sample_time
    if activity.at_handle_since is not None:
        account["active_at_handle_since"] = activity.at_handle_since * sample_time


def _add_end_of_torque(contact: verdicts.ContactHolds, port: PortFigures, sample_time: float) -> None:
    """Add the time of the last torque of an axis [s], if much effort was requested after it."""
    if port.last_torque is not None and port.unanswered > _UNANSWERED * port.sizes_asked:
        contact["no_torque_after"] = int(port.last_torque) * sample_time


def withdraw_certificates(account: PortResult, *, longest_gap: int) -> None:
    """Withdraw the certificates of an account if the run did not meet their assumptions.

    That is: a torque acted longer than covered or was not commanded, a hold was longer or shorter than declared, the
    motion contradicts the declared friction (`motion_checks`), or the port's own energies refute the certificates.

    A certificate covers `max_consecutive_losses` sample times without a new torque, but no skipped SYNC: there the
    queued torque acts for longer, and the next queued one still follows although it was computed for a single hold.

    Args:
        account: Account of a port, changed in place.
        longest_gap: Largest number of sample times between two SYNCs; 1 if no SYNC was skipped.
    """
    covered = account["max_consecutive_losses"] if longest_gap == 1 else 0
    is_broken = account["longest_hold"] > 1 + covered or account.get("uncommanded_cycles", 0)
    is_broken = is_broken or account.get("friction_excess", 0.0) > 0.0
    is_broken = is_broken or Certificate.NONE.name.lower() in account["certificates"]
    if is_broken and account["certificates"]:
        account["certificate"] = Certificate.NONE.name.lower()
        account["certificates"] = [account["certificate"]]
    verdicts.contradict(account)


def with_groups(
    accounts: Mapping[str, PortResult],
    groups: Mapping[str, Sequence[str]],
    truth: Mapping[str, TruthResult] | None = None,
) -> dict[str, PortResult]:
    """Return the accounts of axes and groups with verdicts and with references to each other.

    An axis in a group proves nothing by itself, so its account keeps only its energy in and out.

    Args:
        accounts: Accounts by port name, each computed as for a separate port.
        groups: Names of the axes of each group.
        truth: Energies of the simulated plant by port; None without a simulation.
    """
    found = {name: account.copy() for name, account in accounts.items()}
    for group, axes in groups.items():
        if holds := [found[name]["hold"] for name in axes if "hold" in found[name]]:
            found[group]["hold"] = verdicts.worst_hold(holds)
    for name, account in found.items():
        known = None if truth is None else truth.get(name)
        verdicts.add_verdicts(account, known and (known["least_interaction"], known["least_at_handle"]))
    for group, axes in groups.items():
        found[group] = {"unit": found[group]["unit"], "axes": list(axes), **found[group]}
        for name in axes:
            kept = {key: value for key, value in found[name].items() if key in _OF_AN_AXIS}
            found[name] = cast("PortResult", {"group": group, **kept})
    return found


def _truth(cycle: Cycle) -> dict[str, TruthResult]:
    """Return the energies of the simulated plant for each axis, then for each group; empty with real drives."""
    if (judge := cycle.judge) is None:
        return {}
    sums = zip(judge.interaction, judge.least, judge.least_at_handle, judge.believed_error, strict=True)
    names = (*(drive.axis.name for drive in cycle.rig.drives), *(port.name for port in cycle.all_ports.several))
    keys = TruthResult.__annotations__
    truth = (with_old_names(dict(zip(keys, of, strict=True))) for of in sums)
    return {name: cast("TruthResult", of) for name, of in zip(names, truth, strict=True)}
