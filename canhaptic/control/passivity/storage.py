"""The storage of an environment as `original` and `internal_dissipation` keep it: a state whose energy is paid for.

What the two share is here: following the contact, the first-order start (eq. 14), the approximate step (eqs. 6, 7, 18)
and the exit. Each rule returns its account of the hold: (branch, h_r, gen, deficit, leak), energies in [J].
"""

from typing import Final

from canhaptic.control.balance import Branch
from canhaptic.control.environments.environment import Environment

Account = tuple[int, float, float, float, float]

_START, _FALLBACK, _DEPLETED = Branch.START.value, Branch.FALLBACK.value, Branch.DEPLETED.value
_EXIT = Branch.EXIT.value
_ROUNDING: Final = 1e-12  # of the energy at hand: below it a rest is rounding, not a leak

UNTOUCHED: Final[Account] = (Branch.FREE.value, 0.0, 0.0, 0.0, 0.0)


def rest_of(available: float, used: float) -> float:
    """Returns what is left over of an energy [J]; rounding is not left over."""
    rest = available - used
    return rest if rest > _ROUNDING * available else 0.0


class Storage:
    """State, velocity and stored energy of one environment, and where the continuous environment would be.

    Attributes:
        state: Displacement of the storage [m or rad].
        velocity: Of the state over the last hold [m/s or rad/s].
        h_s: Energy stored at `state` [J], computed from it.
        true: State of the continuous environment [m or rad].
        zone: Zone of contact, 0 out of contact.
        elapsed: Time of the last hold [s].
    """

    __slots__ = ("_environment", "_relaxes", "elapsed", "h_s", "state", "true", "velocity", "zone")

    def __init__(self, environment: Environment, sample_time: float) -> None:
        self._environment = environment
        self._relaxes = environment.relaxes
        self.elapsed = sample_time
        self.reset()

    def reset(self) -> None:
        """Out of contact, nothing stored."""
        self.zone = 0
        self.true = 0.0
        self.empty()

    def empty(self) -> None:
        """The deadlock: nothing stored, no velocity, no torque until the user pushes inward."""
        self.state = self.velocity = self.h_s = 0.0

    @property
    def deadlocked(self) -> bool:
        """True while no torque can come of what is stored."""
        return self.h_s == 0.0 and self.velocity == 0.0

    def begin(self, position: float) -> None:
        """Takes the first position; in contact there it is a deadlock, for the user has not pushed in."""
        self.empty()
        self.zone = zone = self._environment.contact(position)
        self.true = self._environment.true_state(position, 0.0, 0.0) if zone else 0.0

    def follow(self, position: float, displacement: float, elapsed: float) -> bool:
        """Follows the contact over a hold of given time [s]; returns True when a zone was entered or left in it."""
        environment = self._environment
        self.elapsed = elapsed
        zone = environment.contact(position)
        changed = zone != self.zone
        self.zone = zone
        if zone:
            true = environment.true_state(position, displacement, 0.0 if changed else self.true)
            self.true = environment.relaxed(true, self.elapsed) if self._relaxes else true
        return changed

    def pushed_inward(self, displacement: float) -> bool:
        """Returns True when the motion [m or rad] stores energy, or when there is nothing to store it in."""
        effort = self._environment.effort(self.true)
        return effort * displacement > 0.0 or (effort == 0.0 and displacement != 0.0)

    def entered_by(self, displacement: float) -> float:
        """Returns the part of a motion [m or rad] that was inside the contact."""
        return self.true - self._environment.admissible(self.true - displacement, self.true)

    def start(self, change: float, h_m: float) -> Account:
        """First-order start (eq. 14): the state is the true one, and the energy for it is created.

        Args:
            change: State change from which the velocity is taken [m or rad].
            h_m: Energy received in this hold [J].
        """
        self.velocity = change / self.elapsed
        available = self.h_s + h_m
        self.state = state = self.true
        self.h_s = h_s = self._environment.stored_energy(state)
        return _START, 0.0, max(0.0, h_s - available), 0.0, max(0.0, available - h_s)

    def move(self, change: float, h_r: float, h_m: float, limited: bool) -> tuple[float, float]:
        """Takes a state change found by eq. 8; returns (h_r with what relaxation dissipates, leak) [J].

        Args:
            change: Of the state [m or rad].
            h_r: Energy dissipated with it [J].
            h_m: Energy received [J].
            limited: True when the change takes up less than was received; what is left over leaks.
        """
        before = self.h_s
        moved = self.state + change
        state = self._environment.admissible(moved, self.true)
        limited = limited or state != moved
        h_s = self._environment.stored_energy(state)
        self.velocity = change / self.elapsed
        leak = rest_of(before + h_m, h_r + h_s) if limited else 0.0
        return self._settle(state, h_s, h_r), leak

    def approximate(self, dissipation: float, h_m: float) -> Account:
        """Dissipates a given energy, as far as it is there, and takes the state of what remains (eqs. 6, 7, 18).

        Args:
            dissipation: T d v^2 with the velocity inside the torque of this hold [J].
            h_m: Energy received [J].
        """
        available = self.h_s + h_m
        if available <= 0.0:
            self.empty()
            return _DEPLETED, 0.0, 0.0, -available, 0.0
        h_r = min(dissipation, available)
        before = self.state
        state = self._environment.state_of_energy(available - h_r, before if before else self.true)
        h_s = self._environment.stored_energy(state)
        leak = rest_of(available, h_r + h_s)
        self.velocity = (state - before) / self.elapsed
        return _FALLBACK, self._settle(state, h_s, h_r), 0.0, 0.0, leak

    def _settle(self, state: float, h_s: float, h_r: float) -> float:
        """Takes a state and its energy after one hold of relaxation; returns h_r with what that dissipated [J]."""
        if self._relaxes:
            strained = h_s
            state = self._environment.relaxed(state, self.elapsed)
            h_s = self._environment.stored_energy(state)
            h_r += strained - h_s
        self.state, self.h_s = state, h_s
        return h_r

    def leave(self, account: Account) -> Account:
        """Turns the account of the last hold of a contact into that of an exit: everything left is leaked."""
        _, h_r, gen, deficit, leak = account
        leak += self.h_s
        self.empty()
        return _EXIT, h_r, gen, deficit, leak
