"""Energy balance of one controller step, and sums of many balances without drift.

Every algorithm keeps this identity in every step, to 1e-12 of the largest term; a group of axes keeps it as a whole:

    h_s - h_s_before + h_r - h_i - gen + h_pas - deficit + leak = 0
    h_dis - h_dis_before = gen + deficit - h_pas - paid
    paid = min(leak, max(0, h_dis_before + gen + deficit - h_pas))
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Final, NamedTuple


@dataclass(slots=True)
class RunningSum:
    """A sum and, separately, the sum of its rounding errors (two-sum, Knuth): no drift over any number of terms."""

    total: float = 0.0
    error: float = 0.0

    @property
    def value(self) -> float:
        """Value of the sum."""
        return self.total + self.error


def add(running: RunningSum, term: float) -> float:
    """Add a term and return the value of the sum."""
    before = running.total
    total = before + term
    part = total - before
    running.error += (before - (total - part)) + (term - part)
    running.total = total
    return total + running.error


def along(effort: float, torque: float) -> float:
    """Return a motor's torque [N or N*m], positive if it renders the effort (torque = -effort); 0 without effort."""
    if effort == 0.0:
        return 0.0
    return -torque if effort > 0.0 else torque


class Branch(IntEnum):
    """Case of the energy account by which a hold was booked."""

    FREE = 0  # no contact, nothing stored, no torque
    START = 1  # contact begins
    EXACT = 2  # eq. 8 solved, energy flows in or out
    STICKY = 3  # eq. 8 solved by the other root: moving out while injecting
    FALLBACK = 4  # no exact solution; dissipation of the last velocity (eq. 18)
    DEPLETED = 5  # the store is empty and more was taken: deficit
    EXIT = 6  # contact ended; the remaining store is leaked
    HELD = 7  # no position arrived: the command is repeated, and the hold is booked with the next
    GROUP = 8  # of an axis in a group: h_i is its part, and the account is the group's


class Certificate(IntEnum):
    """Proof of passivity (certificate) that bounded the torque of the next hold, by its number in the logs."""

    EXACT = 0  # no bound was active
    DEVICE_DAMPING = 1  # by what the device dissipates, in dry friction too: for every hand
    HAND_FORCE = 2
    HAND_SPEED = 3
    NONE = 4  # the algorithm gives no bound
    VELOCITY_LOOP = 5  # of an admittance display: the drive's own velocity loop
    LARGEST_HAND_FORCE = 6  # of an admittance display: the hand never pushes or pulls harder than declared
    DEVICE_FRICTION = 7  # no larger than the dry friction of the device: for every hand
    DECLARED_HAND = 8  # of an admittance display: the hand is a spring, a damper and a mass as declared

    @staticmethod
    def of(bits: int) -> "tuple[Certificate, ...]":
        """Return the certificates in a bit set, weakest last."""
        return tuple(certificate for certificate in WEAKEST_LAST if bits & 1 << certificate)


WEAKEST_LAST: Final = (
    *(Certificate.EXACT, Certificate.DEVICE_DAMPING, Certificate.DEVICE_FRICTION),
    *(Certificate.HAND_FORCE, Certificate.HAND_SPEED, Certificate.VELOCITY_LOOP),
    *(Certificate.LARGEST_HAND_FORCE, Certificate.DECLARED_HAND, Certificate.NONE),
)
"""The certificates in order of the strength of their promise, the weakest last."""
RANKS: Final = tuple(WEAKEST_LAST.index(certificate) for certificate in Certificate)
"""Place of each certificate in `WEAKEST_LAST`."""


class EnergyBalance(NamedTuple):
    """One step of a controller: the torque to apply next and the account of the hold that ended. Energies in [J].

    Energy INTO the virtual environment is positive (eq. 1), h_i = -torque * displacement. The torque is the one that
    the actuator applies to the user, so a wall that resists motion in -q has a positive torque and receives energy.
    """

    torque: float  # command for the next free hold [N*m or N]
    h_i: float  # interaction: energy that came in with the whole applied torque (eq. 2), and what was `supplied`
    h_pas: float  # part of h_i taken in by the modulated damper (eq. 19), signed
    h_m: float  # h_i - h_pas: what the model received
    h_r: float  # dissipated by the model's damper, >= 0
    h_s: float  # stored after this step, from the state, never accumulated
    h_dis: float  # surplus still to be dissipated after this step
    gen: float  # created by a first-order start (or by an unprotected algorithm)
    deficit: float  # taken out beyond the store
    leak: float  # stored energy removed
    paid: float  # part of leak that pays surplus
    branch: int  # Branch
    damping_rendered: float  # damping of model plus modulated damper inside the command [N*s/m or N*m*s/rad]
    certificate: int  # Certificate
    state: float  # displacement of the storage after this step [m or rad]
    supplied: float = 0.0  # part of h_i that no motor of the port received, less what was given away, signed


OUT_OF_CONTACT: Final = (Branch.FREE.value, Branch.EXIT.value, Branch.HELD.value, Branch.GROUP.value)
"""Values of `Branch` that do not count as contact; a prolonged hold (HELD) is booked and counted with the next."""

AT_REST: Final = EnergyBalance(*(0.0,) * 11, Branch.FREE.value, 0.0, Certificate.EXACT.value, 0.0, 0.0)
"""The balance of the first call after a reset: nothing held, nothing stored."""


class GroupBalance(NamedTuple):
    """One step of a group: the torques to apply next, and the account of the hold that ended. Energies in [J].

    `account` keeps the identity of this module for the whole group. Its `h_i` is
    sum(interactions) + supplied - uncertainty, with `supplied` from the mover of a moving wall; its `torque` is the
    Euclidean norm of `torques`, for plots only; its `state` is the first state of the network.
    """

    torques: tuple[float, ...]  # command for the next free hold, one per motor axis [N*m or N]
    account: EnergyBalance  # of the whole group
    interactions: tuple[float, ...]  # h_i of each motor axis
    uncertainty: float = 0.0  # uncertainty due to lost samples, subtracted from h_i
    limit: int = 0  # `kinematics.Limit`: reason for zero torques


def group_at_rest(axes: int) -> GroupBalance:
    """Return the balance of the first call after a reset: nothing held, nothing stored."""
    zeros = (0.0,) * axes
    return GroupBalance(zeros, AT_REST, zeros)


def residual(balance: EnergyBalance, stored_before: float) -> float:
    """Return the error of one step in the identity of the stored energy [J], 0 but for rounding; see the module."""
    flows_out = (balance.h_s - stored_before) + balance.h_r - balance.h_i - balance.gen + balance.h_pas
    return flows_out - balance.deficit + balance.leak


def held(last: EnergyBalance, torque: float) -> EnergyBalance:
    """Return the balance of a SYNC without a sample: nothing is booked, and the state is as it was."""
    return last._replace(
        torque=torque,
        branch=Branch.HELD.value,
        h_i=0.0,
        h_pas=0.0,
        h_m=0.0,
        h_r=0.0,
        gen=0.0,
        deficit=0.0,
        leak=0.0,
        paid=0.0,
        supplied=0.0,
    )
