"""PortResult: what is known of a port after a run. Verdicts: whether the port was passive by it."""

from math import inf
from typing import Final, Literal, TypedDict

Verdict = Literal["yes", "no", "in doubt"]
"""Whether a port was passive; "in doubt" where energy that is not known for certain decides."""

PASSIVE_TOLERANCE: Final = 1e-6
"""Energy below zero that still counts as zero, for counts of the encoder, where its resolution is not known [J]."""
_ROUNDING: Final = 1e-9
"""The same where the resolution of the energy is known [J]."""
_LARGEST_DOUBT: Final = 0.1
"""Resolution over the energy that came in beyond which nothing is said of a port without certificates."""


class Extremes(TypedDict):
    """The least and the most that was seen."""

    least: float
    most: float


class SurplusEnergy(TypedDict):
    """Surplus energy [J]."""

    end: float
    max: float


class LeastMargin(TypedDict):
    """The least margin (eq. 4) and where it was reached."""

    value: float  # [J]
    cycle: int  # index of the SYNC
    time: float  # [s]


class ContactHolds(TypedDict):
    """Holds in contact."""

    holds: int
    without_torque: int


class RenderedShares(TypedDict):
    """Part of the environment that was rendered in contact; None: none asked."""

    stiffness: float | None
    damping: float | None


_Flows = TypedDict("_Flows", {"in": float, "out": float}, total=False)


class PortResult(_Flows, total=False):
    """What is known of one port, an axis or a group of axes, by the names of `run --json`. Energies in [J].

    Which keys there are depends on the port and on where the account comes from.
    """

    unit: str
    state_unit: str
    stored: float
    dissipated: float
    generated: float
    surplus: SurplusEnergy
    recovered: float
    leaked: float
    paid: float
    deficit: float
    margin: LeastMargin
    least_interaction: float
    certificate: str
    certificates: list[str]
    branches: dict[str, int]
    damping_rendered: Extremes
    open_hold: bool
    energy_resolution: float
    least_at_handle: float
    device_dissipated: float
    contact: ContactHolds
    longest_hold: int
    uncommanded_cycles: int
    max_consecutive_losses: int
    energy_allowance: float
    friction_excess: float
    rendered: RenderedShares
    read_back: str
    read_back_bound: float | None
    peak_torque: float
    limited_cycles: int
    supplied: float
    unsure: float
    limits: dict[str, int]
    group: str
    axes: list[str]
    passive: Verdict
    passive_at_handle: Verdict
    passive_at_sensor: Verdict  # of an admittance display while it is touched


def passive_verdict(
    least: float, resolution: float = 0.0, *, energy_in: float = inf, is_promised: bool = False,
    has_open_hold: bool = False,
) -> Verdict:  # fmt: skip
    """Returns whether a sum of energy stayed at zero or above.

    Without certificates it may have fallen to minus the resolution: "yes" only where that is small.

    Args:
        least: Its least value after any hold, as booked [J].
        resolution: Largest difference of that from the true one [J].
        energy_in: That came in, all in all [J].
        is_promised: Whether certificates held in every hold that rule out less than zero.
        has_open_hold: Whether the run ended in holds that are not booked, because no position came any more. What is
            promised is promised of them too: a torque that acts for longer than its certificate covers loses it.
    """
    if least + resolution < -_ROUNDING:
        return "no"
    is_small = resolution <= max(PASSIVE_TOLERANCE, _LARGEST_DOUBT * energy_in)
    is_sure = is_promised or (least >= -_ROUNDING and is_small and not has_open_hold)
    return "yes" if is_sure else "in doubt"


def is_certified(account: PortResult) -> bool:
    """Returns whether every torque of a port had a certificate that promises no less than zero."""
    names = account.get("certificates", [account["certificate"]])
    return bool(names) and "none" not in names and not account.get("energy_allowance", 0.0)


def account_verdict(account: PortResult) -> Verdict:
    """Returns whether a port was passive at the motor (eq. 3): the sum of what came in with the motor's torque.

    Where a damping of the device is declared, certificates promise the sum at the handle and not this one.

    Args:
        account: As `LedgerSummary.as_json` has it, with what is known in addition.
    """
    least, resolution = account["least_interaction"], account.get("energy_resolution")
    if resolution is None:  # of an older log, which does not hold it
        least, resolution = least + PASSIVE_TOLERANCE, account.get("unsure", 0.0)
    promised = is_certified(account) and account.get("least_at_handle") is None
    return _verdict_of(account, least, resolution, promised)


def handle_verdict(account: PortResult) -> Verdict | None:
    """Returns whether a port was passive at the handle: with what the device itself dissipated for certain.

    None where no damping of the device is declared. It may have dissipated more, so that a sum below zero is a doubt.

    Args:
        account: As for `account_verdict`.
    """
    least = account.get("least_at_handle")
    if least is None:
        return None
    found = _verdict_of(account, least, account["energy_resolution"], is_certified(account))
    return "in doubt" if found == "no" else found


def _verdict_of(account: PortResult, least: float, resolution: float, is_promised: bool) -> Verdict:
    open_hold = account.get("open_hold", False)
    found = passive_verdict(
        least, resolution, energy_in=account["in"], is_promised=is_promised, has_open_hold=open_hold
    )
    is_other = account.get("uncommanded_cycles", 0) > 0  # what is read back may be of another hold than is declared
    return "in doubt" if is_other and found == "yes" else found
