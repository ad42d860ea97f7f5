"""Verdicts on a port after a run: whether its energy account shows that it was passive.

A is the energy that may be given out (`energy_allowance`), and R the largest error of the booked sum of energy.

**Active: "no".** If booked + R < -A at any time, the true sum certainly fell below -A. R grows in a run and the sum may
recover, so that the values at the end need not show it: a run notes the first such hold of each port, and the verdict
is "no" from then on. At the motor this refutes every certificate, unless damping or friction of the device is declared.
Then the certificates promise the sum at the handle. It is refuted if booked + R + D < -A, with D the most that the
device can have dissipated. An R that is only an estimate refutes nothing.

**Passive: "yes".** "Measured": booked - R >= -A after every hold. So no more energy came out, even if the declarations
of hand and device are false; hold, torque window and current lag must be true. "By certificate": every torque was
certified, nothing refutes the certificates, and R at the end is at most a tenth of the energy received, or A, or 10 uJ,
because a certificate relies on the positions too. For a spring pressed to a depth, R over the energy received is 2
counts over the depth. Both need a hold that a test has found: a torque booked in a neighbouring hold makes any sum.
A simulated drive that is configured as its scene declares needs no test.
An admittance display books no more than came in. If lost samples or commands leave 20 times that in doubt, its account
says nothing of the run.

**Otherwise "in doubt"**, with the reason. A dry run sends no torque and proves nothing about the controller.
"""

from collections.abc import Iterable, Mapping
from math import inf
from typing import Final, Literal, NotRequired, TypedDict

from canhaptic.control.balance import Certificate

Verdict = Literal["yes", "no", "in doubt"]
"""Whether a port was passive; "in doubt" if the uncertain energy decides."""
WORST_LAST: Final[tuple[Verdict, ...]] = ("yes", "in doubt", "no")
Headline = Literal["yes", "no", "in doubt", "nothing rendered", "no contact", "dry run"]
"""Displayed result of a port: the verdict by its simulated plant, else by its account, or why there is no verdict."""

PASSIVE_TOLERANCE: Final = 1e-6
"""Energy below zero that still counts as zero if the resolution is not known: an allowance for encoder counts [J]."""
ROUNDING: Final = 1e-9
"""Energy below zero that still counts as zero if the resolution is known: an allowance for rounding [J]."""
ACTIVE_AT_MOTOR: Final = 1
"""Bit of the log column `active`: the energy received at the motor certainly fell below minus the allowance."""
ACTIVE_AT_HANDLE: Final = 2
"""Bit of the log column `active`: the energy received at the handle certainly fell below minus the allowance."""
NOT_CHECKED: Final = "not checked"
"""Value of `hold` if no hands-off test has found the hold in which the torques act."""
UNDECIDED: Final = "undecided"
"""Value of `hold` if the test during a run has neither found nor refuted the declared hold."""
FOUND: Final = "found by hold_dither"
EARLY: Final = "acts before its SYNC, run canhaptic commission"
LATE: Final = "acts a hold late, run canhaptic commission"
"""Values of `hold` by that test; with the last two no torque of the run has a certificate."""
BY_CONSTRUCTION: Final = "by construction"
"""Value of `hold` of a simulated drive that acts in the hold that its scene declares."""
COUNTS_DISAGREE: Final = "refuted by the counts of held torques"
"""Value of `hold` if host and drive counted different holds without a new torque: no account of the run is true."""
BY_CERTIFICATE: Final = "by certificate"
"""Value of `why` if every torque was certified and nothing refutes the certificates."""
UNBOOKED: Final = "unbooked"
UNCONFIRMED: Final = "unconfirmed"
"""Kinds of events for an axis on which a torque acted when the run ended; the second where its drive then did not
confirm that it is disabled."""
UNCHECKED: Final = frozenset({NOT_CHECKED, UNDECIDED})
"""Values of `hold` with which no port is passive."""
_LARGEST_DOUBT: Final = 0.1
"""Largest energy uncertainty, as a share of the energy received, for a "yes" by certificate."""
_SMALLEST_DOUBT: Final = 1e-5
"""Energy uncertainty that permits a "yes" by certificate however little energy was received [J]."""
_MOST_UNBOOKED: Final = 20.0
"""Energy uncertainty over the energy received, above which the account of a display carries too little for a "yes"."""
_LEAST_RENDERED: Final = 0.1
"""Part of the requested torque in contact below which nothing counts as rendered."""
RESTS_ON: Final[Mapping[str, tuple[str, ...]]] = {
    "hand_force": ("moving_mass", "hand_force"),
    "hand_speed": ("hand_speed",),
    "device_damping": ("device_damping",),
    "device_friction": ("device_friction",),
    "velocity_loop": ("velocity_loop",),
    "largest_hand_force": ("largest_hand_force",),
    "declared_hand": ("hand_stiffness", "hand_mass"),
}
"""Declared properties on which each certificate relies, the likeliest to be wrong first."""
GUARANTEEING: Final = frozenset({"guarded", "energy_bounding"})
"""Algorithms of this package that guarantee to generate no more than the declared energy."""
NO_PULL: Final = "moving mass, hand never pulls"
"""Text for the properties on which the hand-force certificate relies if the declared hand force is 0."""
_OF_EVERY_TORQUE: Final = ("current_lag", "torque_window", "delay")
"""Declared properties on which the energy account itself relies, with any certificate."""


class Extremes(TypedDict):
    """The least and the largest observed value; None: not known."""

    least: float | None
    most: float | None


class SurplusEnergy(TypedDict):
    """Surplus energy [J]."""

    end: float
    max: float


class LeastMargin(TypedDict):
    """The least margin, sum(h_i) - sum(h_r) (eq. 4), and its time."""

    value: float  # [J]
    cycle: int  # index of the SYNC
    time: float  # [s]


class ContactHolds(TypedDict):
    """Number of holds in contact, and the torques in them; the optional keys are for a single axis only."""

    holds: int
    without_torque: int
    requested: NotRequired[float]  # sum of the efforts requested, each at most the torque limit [N or N*m]
    beyond_limit: NotRequired[int]  # holds in which more than the torque limit was requested
    no_torque_after: NotRequired[float]  # time of the last torque, if much was requested after it [s]
    sent: NotRequired[float]  # sum of the sizes of the torques that were sent there [N or N*m]


class RenderedShares(TypedDict):
    """Share of the requested stiffness and damping that was rendered in contact; None: none requested."""

    stiffness: float | None
    damping: float | None


_Flows = TypedDict("_Flows", {"in": float, "out": float}, total=False)


class PortResult(_Flows, total=False):
    """Account of one port, an axis or a group of axes, by the names of `run --json`. Energies in [J].

    The keys depend on the port and on the source of the account.
    """

    unit: str
    state_unit: str
    stored: float
    dissipated: float | None  # None: not known, where a program or user code in its own process requests the torques
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
    hand_force: float  # largest pull of the hand, as declared [N or N*m]
    friction_excess: float
    rendered: RenderedShares
    environment: str  # its type in the scene
    algorithm: str  # its name in the scene
    wall: float  # position at which it begins, where it has one [m or rad]
    in_degrees: bool  # the scene gives angles in degrees; those of the account are in [rad]
    reach: list[float]  # without a contact: lowest and highest position [m or rad]
    mass: dict[str, float | None]  # of an admittance display: requested, felt (None: not known) [kg or kg*m^2], share
    read_back: str
    hold: str  # whether a hands-off test found in which hold the torques of this drive act; of a group the worst
    read_back_bound: float | None
    peak_torque: float
    limited_cycles: int
    supplied: float
    with_far: bool  # what a far side gave and got is in its energies
    uncertainty: float
    limits: dict[str, int]
    dry_run: bool  # one torque alone: nothing is claimed
    withheld_torque: float  # the largest that a dry run did not send [N or N*m]
    group: str
    axes: list[str]
    resolution_is_estimated: bool  # `energy_resolution` is no bound of every error
    first_active: float  # first time at which the booked sum at the motor was below 0 [s]
    first_active_contact: int  # number of the contact in which that was, from 1; of a log alone
    active_since: float  # first time at which the sum at the motor was below the allowance for certain [s]
    active_at_handle_since: float  # the same of the sum at the handle [s]
    active_before: bool  # of a part of a log: that was before the part
    contradicted: list[str]  # certificates that this refutes
    suspects: list[str]  # declarations of which one is then wrong
    passive: Verdict
    passive_at_handle: Verdict
    passive_at_sensor: Verdict  # of an admittance display while it is touched
    plant_passive: Verdict  # by the energy of the simulated plant
    plant_passive_at_handle: Verdict
    books_least: bool  # no more than came in is booked, as of an admittance display
    least_certain: float  # least sum of interaction less its resolution then: no less came in [J]
    least_certain_at_handle: float
    why: str  # grounds of the account's yes at motor or handle, or the reason of its doubt
    verdict: Headline
    advice: str  # where nothing was rendered: the cause and the remedy


def passive_verdict(
    least: float, resolution: float = 0.0, *, energy_in: float = inf, is_promised: bool = False,
    has_open_hold: bool = False, allowance: float = 0.0, is_estimated: bool = False, certain: float | None = None,
    books_least: bool = False,
) -> tuple[Verdict, str]:  # fmt: skip
    """Return whether a sum of energy received stayed at or above minus the allowance, with the reason.

    Args:
        least: Least value of the sum after any hold, as booked [J].
        resolution: Largest difference between booked and true sum at the end [J].
        energy_in: Total energy received [J].
        is_promised: Whether certificates of every hold exclude a lower value.
        has_open_hold: Whether the run ended in holds that are not booked, because no further position arrived.
            Certificates cover them too: a torque that acts for longer than its certificate covers loses it.
        allowance: Energy that may be given out [J].
        is_estimated: Whether the resolution is an estimate; a sum below it then proves nothing.
        certain: Least value of sum minus resolution after any hold [J]; None: `least` minus the resolution at the end.
        books_least: Whether the booked energy is a lower bound of the energy received.
    """
    floor = -(allowance + ROUNDING)
    if least + resolution < floor and not is_estimated:
        return "no", ""
    if books_least:
        certain = least
    certain = least - resolution if certain is None else certain
    if certain >= floor and not has_open_hold and not is_estimated:
        if books_least and resolution > max(_SMALLEST_DOUBT, allowance, _MOST_UNBOOKED * energy_in):
            return "in doubt", f"{energy_in:.2g} J is certain to have come in, and up to {resolution:.2g} J is not"
        return "yes", "measured"
    is_small = books_least or resolution <= max(_SMALLEST_DOUBT, allowance, _LARGEST_DOUBT * energy_in)
    if is_promised:
        return ("yes", BY_CERTIFICATE) if is_small else ("in doubt", _too_coarse(resolution, energy_in))
    if has_open_hold or is_estimated:
        why = (
            "the run ended in holds without a position"
            if has_open_hold
            else "the resolution of its energy is an estimate"
        )
        return "in doubt", why
    return "in doubt", f"without a certificate, and as low as {certain:.3g} J within its resolution"


def _too_coarse(resolution: float, energy_in: float) -> str:
    """Return why an energy uncertainty [J] is too large for a verdict, as contact depth in encoder counts."""
    deep, needed = 2.0 * energy_in / resolution, 2.0 / _LARGEST_DOUBT
    return f"the contact acts as if {deep:.2g} counts deep, {needed:.0f} needed"


def worst_hold(holds: Iterable[str]) -> str:
    """Return what is known of the hold of several axes, the worst first: refuted, not checked, checked; "" of none."""
    return max(holds, key=lambda hold: (hold == COUNTS_DISAGREE, hold in UNCHECKED), default="")


def is_certified(account: PortResult) -> bool:
    """Return whether every torque of a port had a certificate, none of them withdrawn or refuted."""
    names = account.get("certificates", [account["certificate"]])
    return bool(names) and "none" not in names


def account_verdict(account: PortResult) -> tuple[Verdict, str]:
    """Return whether a port was passive at the motor (eq. 3), by the energy received against its torque, and why.

    If damping or friction of the device is declared, certificates guarantee the sum at the handle, not this one.

    Args:
        account: Sums of `LedgerSummary.as_json`, with the port's other figures.
    """
    if "active_since" in account or account.get("active_before"):
        return "no", ""
    least, resolution = account["least_interaction"], account.get("energy_resolution")
    if resolution is None:  # of an older log, which does not hold it
        least, resolution = least + PASSIVE_TOLERANCE, account.get("uncertainty", 0.0)
    promised = is_certified(account) and account.get("least_at_handle") is None
    return _verdict_of(account, least, resolution, promised, account.get("least_certain"))


def handle_verdict(account: PortResult) -> tuple[Verdict, str] | None:
    """Return whether a port was passive at the handle, including the device's certain dissipation, and why.

    None without declared damping or friction of the device. A booked sum below zero proves nothing here, because the
    device may have dissipated more.

    Args:
        account: Sums of `LedgerSummary.as_json`, with the port's other figures.
    """
    least = account.get("least_at_handle")
    if least is None:
        return None
    if "active_at_handle_since" in account:
        return "no", ""
    if account.get("hold") == COUNTS_DISAGREE:
        return "no", COUNTS_DISAGREE
    certain = account.get("least_certain_at_handle")
    found, why = _verdict_of(account, least, account["energy_resolution"], is_certified(account), certain)
    return ("in doubt", "the device may have dissipated more") if found == "no" else (found, why)


def _verdict_of(
    account: PortResult, least: float, resolution: float, is_promised: bool, certain: float | None
) -> tuple[Verdict, str]:
    found, why = passive_verdict(
        least, resolution, energy_in=account["in"], is_promised=is_promised, certain=certain,
        has_open_hold=account.get("open_hold", False), allowance=account.get("energy_allowance", 0.0),
        is_estimated=account.get("resolution_is_estimated", False), books_least=account.get("books_least", False),
    )  # fmt: skip
    if (hold := account.get("hold")) == COUNTS_DISAGREE:
        return "no", hold
    if found == "yes" and hold in UNCHECKED:
        remedy = "render for longer, or harder" if hold == UNDECIDED else "run canhaptic commission, or set check_hold"
        return "in doubt", f"the hold of its torques was {hold}: {remedy}"
    is_other = account.get("uncommanded_cycles", 0) > 0  # the read-back may be of another hold than declared
    return ("in doubt", "torques were held that were not commanded") if is_other and found == "yes" else (found, why)


def contradict(account: PortResult) -> None:
    """Void the certificates of a port whose own energies prove it active.

    Args:
        account: Account of a port, with `active_since` where it was active; changed.
    """
    key = "active_since" if account.get("least_at_handle") is None else "active_at_handle_since"
    names = [name for name in account.get("certificates", ()) if name not in ("exact", "none")]
    if key not in account or not names:
        return
    account["contradicted"] = names
    account["suspects"] = [*(key for name in names for key in RESTS_ON.get(name, ())), *_OF_EVERY_TORQUE]
    account["certificate"], account["certificates"] = "none", ["none"]


def leave_open(account: PortResult, *, is_confirmed: bool) -> None:
    """Say that a run ended while a torque acted on the axes of a port, so that its last holds are not booked.

    Certificates cover them where the drives have confirmed that they are disabled; else a torque may act for longer.

    Args:
        account: Account of a port without verdicts; changed.
        is_confirmed: Whether every such drive confirmed it.
    """
    account["open_hold"] = True
    if not is_confirmed and account["certificates"]:
        account["certificate"], account["certificates"] = "none", ["none"]


def plant_verdict(least: float, allowance: float) -> Verdict:
    """Return whether the energy of a simulated plant stayed at or above minus the allowance; both in [J]."""
    return "yes" if least >= -(allowance + PASSIVE_TOLERANCE) else "no"


def add_verdicts(account: PortResult, plant: tuple[float, float] | None = None) -> None:
    """Add the verdicts of an account, and the headline word.

    Args:
        account: Account of a port without verdicts; changed.
        plant: Least sums at the motor and at the handle by the energy of a simulated plant [J]; None: unknown.
    """
    (account["passive"], why), at_handle = account_verdict(account), handle_verdict(account)
    if at_handle is not None:
        account["passive_at_handle"], why_there = at_handle
        why = why if account["passive"] == "yes" else why_there
    if why:
        account["why"] = why
    if plant is not None:
        allowance = account.get("energy_allowance", 0.0)
        account["plant_passive"] = plant_verdict(plant[0], allowance)
        if at_handle is not None:
            account["plant_passive_at_handle"] = plant_verdict(plant[1], allowance)
    account["verdict"] = headline(account)


def headline(account: PortResult) -> Headline:
    """Return the headline word of a port, from its verdicts and contacts.

    Passive at the handle counts as passive: a guarantee that includes the device holds there.

    Args:
        account: Account of a port, with its verdicts.
    """
    if account.get("dry_run"):
        return "dry run"
    if account.get("hold") == COUNTS_DISAGREE:
        return "no"
    passive = account.get("plant_passive", account["passive"])
    at_handle = account.get("plant_passive_at_handle", account.get("passive_at_handle"))
    found: Verdict = "yes" if at_handle == "yes" else passive
    contact = account.get("contact")
    if found == "no" or contact is None:
        return found
    if not contact["holds"]:
        return "no contact"
    return "nothing rendered" if _is_silent(account, contact) else found


def _is_silent(account: PortResult, contact: ContactHolds) -> bool:
    """Return whether less than a tenth of the requested efforts was rendered; if none is known, of the damping.

    If both are unknown, as for a group or an admittance display: whether no torque acted at all.
    """
    if contact.get("requested"):
        return contact["sent"] < _LEAST_RENDERED * contact["requested"]
    damping = account["rendered"]["damping"] if "rendered" in account else None
    if damping is not None:
        return damping < _LEAST_RENDERED
    return contact["without_torque"] == contact["holds"]


def claim_nothing(account: PortResult) -> None:
    """Remove certificates and rendered shares from the account of a dry run, which sent no torque to prove them.

    Args:
        account: Account of the port; changed.
    """
    account["dry_run"] = True
    account["certificate"], account["certificates"] = Certificate.NONE.name.lower(), []
    account["damping_rendered"] = {"least": 0.0, "most": 0.0}
    account.pop("mass", None)
    if "contact" in account:
        contact = account["contact"]
        contact["without_torque"] = contact["holds"]
        if "sent" in contact:
            contact["sent"] = 0.0
    if "rendered" in account:
        for share in ("stiffness", "damping"):
            if account["rendered"][share] is not None:
                account["rendered"][share] = 0.0
