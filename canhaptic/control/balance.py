"""EnergyBalance: what one step of a controller did with the energy of one hold. Ledger: the sums of a whole run.

Identity of every step, for every algorithm (to 1e-12 of the largest term); for axes in a group, of the group's step:

    h_s - h_s_before + h_r - h_i - gen + h_pas - deficit + leak = 0
    h_dis - h_dis_before = gen + deficit - h_pas - paid
    paid = min(leak, max(0, h_dis_before + gen + deficit - h_pas))
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from math import inf
from typing import Any, Final, Literal, NamedTuple


def interaction_energy(torque: float, displacement: float) -> float:
    """Returns the energy [J] that entered the environment during one hold of constant torque (eq. 2): exact.

    The sign is written here, once: energy INTO the virtual environment is positive (eq. 1). A torque is the one that
    the actuator applies to the user's side, so a wall that pushes back against motion in -q has a positive torque and
    takes energy in.

    Args:
        torque: Held by the actuator during the whole hold [N*m or N].
        displacement: Motion of the same axis from the start to the end of the hold [rad or m].
    """
    return -torque * displacement


class Branch(IntEnum):
    """Which rule booked the hold."""

    FREE = 0  # no contact, nothing stored, no torque
    START = 1  # contact begins
    EXACT = 2  # eq. 8 solved, energy flows in or out
    STICKY = 3  # eq. 8 solved by the other root: moving out while injecting
    FALLBACK = 4  # no exact solution; dissipation of the last velocity (eq. 18)
    DEPLETED = 5  # the store is empty and more was taken: deficit
    EXIT = 6  # contact ended; what was left in the store is leaked
    HELD = 7  # no position arrived: the command is repeated, and the hold is booked with the next
    GROUP = 8  # of an axis in a group: h_i is its part, and the account is the group's


class Certificate(IntEnum):
    """Which promise bounded the torque of the next hold; the numbers are those of the logs, see `WEAKEST_LAST`."""

    EXACT = 0  # no bound was active
    DEVICE_DAMPING = 1  # by what the device dissipates, in dry friction too: for every hand
    HAND_FORCE = 2
    HAND_SPEED = 3
    NONE = 4  # the algorithm gives no bound
    VELOCITY_LOOP = 5  # of an admittance display: the drive's own velocity loop
    LARGEST_HAND_FORCE = 6  # of an admittance display: the hand never pushes or pulls harder than declared
    DEVICE_FRICTION = 7  # no larger than the dry friction of the device: for every hand


WEAKEST_LAST: Final = (
    *(Certificate.EXACT, Certificate.DEVICE_DAMPING, Certificate.DEVICE_FRICTION),
    *(Certificate.HAND_FORCE, Certificate.HAND_SPEED, Certificate.VELOCITY_LOOP),
    *(Certificate.LARGEST_HAND_FORCE, Certificate.NONE),
)
"""The certificates by how much they promise."""
RANKS: Final = tuple(WEAKEST_LAST.index(certificate) for certificate in Certificate)
"""Place of each certificate in `WEAKEST_LAST`."""


class EnergyBalance(NamedTuple):
    """One step of a controller: the torque to apply next and the account of the hold that ended. Energies in [J]."""

    torque: float  # command for the next free hold [N*m or N]
    h_i: float  # interaction: energy that came in with the whole applied torque (eq. 2)
    h_pas: float  # part of h_i taken in by the modulated damper (eq. 19), signed
    h_m: float  # h_i - h_pas: what the model received
    h_r: float  # dissipated by the model's damper, >= 0
    h_s: float  # stored after this step, from the state, never accumulated
    h_dis: float  # surplus still to be dissipated after this step
    gen: float  # created by a first-order start (or by an unprotected algorithm)
    deficit: float  # taken out beyond what was stored
    leak: float  # stored energy removed
    paid: float  # part of leak that pays surplus
    branch: int  # Branch
    damping_rendered: float  # damping of model plus modulated damper inside the command [N*s/m or N*m*s/rad]
    certificate: int  # Certificate
    state: float  # displacement of the storage after this step [m or rad]


Verdict = Literal["yes", "no", "in doubt"]
"""Whether a port was passive; "in doubt" where energy that is not known for certain decides."""

PASSIVE_TOLERANCE: Final = 1e-6
"""Energy below zero that still counts as zero, for counts of the encoder, where its resolution is not known [J]."""
_ROUNDING: Final = 1e-9
"""The same where the resolution of the energy is known [J]."""
_LARGEST_DOUBT: Final = 0.1
"""Resolution over the energy that came in beyond which nothing is said of a port without certificates."""


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


def is_certified(account: Mapping[str, Any]) -> bool:
    """Returns whether every torque of a port had a certificate that promises no less than zero."""
    names = account.get("certificates", [account["certificate"]])
    return bool(names) and "none" not in names and not account.get("energy_allowance", 0.0)


def account_verdict(account: Mapping[str, Any]) -> Verdict:
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


def handle_verdict(account: Mapping[str, Any]) -> Verdict | None:
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


def _verdict_of(account: Mapping[str, Any], least: float, resolution: float, is_promised: bool) -> Verdict:
    open_hold = account.get("open_hold", False)
    found = passive_verdict(
        least, resolution, energy_in=account["in"], is_promised=is_promised, has_open_hold=open_hold
    )
    is_other = account.get("uncommanded_cycles", 0) > 0  # what is read back may be of another hold than is declared
    return "in doubt" if is_other and found == "yes" else found


OUT_OF_CONTACT: Final = (Branch.FREE.value, Branch.EXIT.value, Branch.GROUP.value)
"""Branches of holds without a contact of their own."""

AT_REST: Final = EnergyBalance(
    torque=0.0,
    h_i=0.0,
    h_pas=0.0,
    h_m=0.0,
    h_r=0.0,
    h_s=0.0,
    h_dis=0.0,
    gen=0.0,
    deficit=0.0,
    leak=0.0,
    paid=0.0,
    branch=Branch.FREE.value,
    damping_rendered=0.0,
    certificate=Certificate.EXACT.value,
    state=0.0,
)
"""The balance of the first call after a reset: nothing held, nothing stored."""


def residual(balance: EnergyBalance, stored_before: float) -> float:
    """Returns how far one step is from the identity of this module [J]."""
    return (
        (balance.h_s - stored_before)
        + balance.h_r
        - balance.h_i
        - balance.gen
        + balance.h_pas
        - balance.deficit
        + balance.leak
    )


class LedgerSummary(NamedTuple):
    """The account of one port over a run. Energies in [J]."""

    energy_in: float  # sum of the positive h_i
    energy_out: float  # minus the sum of the negative h_i
    stored: float  # at the end
    dissipated: float  # sum of h_r
    generated: float  # sum of gen
    surplus_end: float  # h_dis at the end
    surplus_max: float
    recovered: float  # sum of h_pas
    leaked: float  # sum of leak, of which `paid` paid surplus
    paid: float
    deficit: float
    margin_value: float  # least value of sum(h_i) - sum(h_r) after any hold (eq. 4)
    margin_cycle: int  # the SYNC at which it was reached
    margin_deadline: int  # and the sample times to it
    least_interaction: float  # least value of sum(h_i) after any hold (eq. 3)
    certificates: tuple[Certificate, ...]  # that bounded a torque, weakest last
    branches: dict[str, int]  # holds booked by each branch
    damping_least: float  # range of the damping rendered in contact [N*s/m or N*m*s/rad]
    damping_most: float
    has_open_hold: bool  # the last position was lost: the energy since the one before is not booked

    @property
    def certificate(self) -> Certificate:
        """The weakest that bounded a torque; EXACT where no torque acted."""
        return self.certificates[-1] if self.certificates else Certificate.EXACT

    def as_json(self, sample_time: float) -> dict[str, Any]:
        """Returns the account of a port as `run --json` prints it.

        Args:
            sample_time: Turns the cycle of the least margin into a time [s].
        """
        return {
            "in": self.energy_in,
            "out": self.energy_out,
            "stored": self.stored,
            "dissipated": self.dissipated,
            "generated": self.generated,
            "surplus": {"end": self.surplus_end, "max": self.surplus_max},
            "recovered": self.recovered,
            "leaked": self.leaked,
            "paid": self.paid,
            "deficit": self.deficit,
            "margin": {
                "value": self.margin_value,
                "cycle": self.margin_cycle,
                "time": self.margin_deadline * sample_time,
            },
            "least_interaction": self.least_interaction,
            "certificate": self.certificate.name.lower(),
            "certificates": [certificate.name.lower() for certificate in self.certificates],
            "branches": dict(self.branches),
            "damping_rendered": {"least": self.damping_least, "most": self.damping_most},
            "open_hold": self.has_open_hold,
        }


@dataclass(slots=True)
class RunningSum:
    """A compensated sum as a kernel keeps it; see `CompensatedSum`."""

    total: float = 0.0
    error: float = 0.0


def add(running: RunningSum, term: float) -> float:
    """Adds a term and returns the value of the sum."""
    before = running.total
    total = before + term
    part = total - before
    running.error += (before - (total - part)) + (term - part)
    running.total = total
    return total + running.error


class CompensatedSum:
    """A sum whose rounding errors are summed separately (two-sum, Knuth): no drift over any number of terms."""

    __slots__ = ("_error", "_total")

    def __init__(self) -> None:
        self._total = 0.0
        self._error = 0.0

    def add(self, term: float) -> float:
        """Adds a term and returns the value of the sum."""
        before = self._total
        total = before + term
        part = total - before
        self._error += (before - (total - part)) + (term - part)
        self._total = total
        return total + self._error

    @property
    def value(self) -> float:
        """The sum."""
        return self._total + self._error


_NONE: Final = Certificate.NONE.value


def certificates_of(bits: int) -> tuple[Certificate, ...]:
    """Returns the certificates of a set in which each is one bit, weakest last."""
    return tuple(certificate for certificate in WEAKEST_LAST if bits >> certificate & 1)


class Ledger:
    """The compensated sums of a run: one `add` per cycle, one `summary` whenever it is wanted.

    Attributes:
        interaction: Sum of h_i so far [J] (eq. 3).
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forgets every hold."""
        self._interaction, self._in, self._dissipated = CompensatedSum(), CompensatedSum(), CompensatedSum()
        self._recovered, self._leaked, self._paid, self._deficit, self._generated = (CompensatedSum() for _ in range(5))
        self._branches = [0] * len(Branch)
        self._last = AT_REST
        self.interaction = self._least_interaction = self._least_margin = self._surplus_max = 0.0
        self._least_margin_cycle = self._least_margin_deadline = 0
        self._certificates = 0  # one bit each
        self._damping_least, self._damping_most = float("inf"), 0.0

    def add(self, balance: EnergyBalance, cycle: int, deadline: int | None = None) -> None:
        """Adds the account of the hold that ended at SYNC `cycle`.

        Args:
            balance: Of the hold.
            cycle: Index of the SYNC.
            deadline: Sample times to it; None: no SYNC was skipped.
        """
        torque, h_i, h_pas, _, h_r, _, surplus, gen, deficit, leak, _, branch, rendered, certificate, _ = balance
        self._branches[branch] += 1
        self._last = balance
        if surplus > self._surplus_max:
            self._surplus_max = surplus
        if torque or (h_i and certificate == _NONE):  # without one nothing was to be bounded
            self._certificates |= 1 << certificate
        if h_i or h_r:
            self._add_flows(h_i, h_r, cycle, cycle if deadline is None else deadline)
        if h_pas or leak or deficit or gen:
            self._add_corrections(balance)
        if branch not in OUT_OF_CONTACT:
            if rendered < self._damping_least:
                self._damping_least = rendered
            if rendered > self._damping_most:
                self._damping_most = rendered

    def _add_corrections(self, balance: EnergyBalance) -> None:
        if balance.h_pas:
            self._recovered.add(balance.h_pas)
        if balance.leak:
            self._leaked.add(balance.leak)
        if balance.paid:
            self._paid.add(balance.paid)
        if balance.deficit:
            self._deficit.add(balance.deficit)
        if balance.gen:
            self._generated.add(balance.gen)

    def _add_flows(self, h_i: float, h_r: float, cycle: int, deadline: int) -> None:
        self.interaction = interaction = self._interaction.add(h_i)
        if h_i > 0.0:
            self._in.add(h_i)
        elif interaction < self._least_interaction:
            self._least_interaction = interaction
        dissipated = self._dissipated.add(h_r) if h_r else self._dissipated.value
        if interaction - dissipated < self._least_margin:
            self._least_margin = interaction - dissipated
            self._least_margin_cycle, self._least_margin_deadline = cycle, deadline

    def summary(self) -> LedgerSummary:
        """Returns the account so far."""
        energy_in = self._in.value
        return LedgerSummary(
            energy_in=energy_in,
            energy_out=energy_in - self._interaction.value,
            stored=self._last.h_s,
            dissipated=self._dissipated.value,
            generated=self._generated.value,
            surplus_end=self._last.h_dis,
            surplus_max=self._surplus_max,
            recovered=self._recovered.value,
            leaked=self._leaked.value,
            paid=self._paid.value,
            deficit=self._deficit.value,
            margin_value=self._least_margin,
            margin_cycle=self._least_margin_cycle,
            margin_deadline=self._least_margin_deadline,
            least_interaction=self._least_interaction,
            certificates=certificates_of(self._certificates),
            branches={branch.name.lower(): self._branches[branch] for branch in Branch},
            damping_least=min(self._damping_least, self._damping_most),
            damping_most=self._damping_most,
            has_open_hold=self._last.branch == Branch.HELD,
        )
