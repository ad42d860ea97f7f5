"""The environment sampled as it is: state and velocity straight from the position, no protection.

`direct` is this and nothing else; `passivity_observer` and `energy_bounding` act on its torque. What sampling creates
is booked as `gen`, what it loses as `leak`, so that the account closes like every other.
"""

from typing import NamedTuple

from canhaptic.haptics.balance import Branch
from canhaptic.haptics.environments.protocol import Environment

_FREE, _START, _EXACT, _EXIT = Branch.FREE.value, Branch.START.value, Branch.EXACT.value, Branch.EXIT.value


class ModelStep(NamedTuple):
    """What one hold did to the sampled environment; energies in [J], efforts in [N or N*m]."""

    branch: int
    h_r: float
    h_s: float
    gen: float
    leak: float
    spring: float  # effort of the storage for the next hold
    damper: float  # effort of the damper for the next hold


class SampledModel:
    """Follows the true state of an environment and books what that costs."""

    __slots__ = ("_environment", "_h_s", "_rendered", "_sample_time", "_state", "_zone")

    def __init__(self, environment: Environment, sample_time: float) -> None:
        self._environment = environment
        self._sample_time = sample_time
        self.reset()

    def reset(self) -> None:
        """Out of contact, nothing stored."""
        self._zone = 0
        self._state = self._rendered = self._h_s = 0.0

    @property
    def state(self) -> float:
        """Displacement of the storage that is rendered [m or rad]."""
        return self._rendered

    def begin(self, position: float) -> None:
        """Takes the first position; a state that is already displaced there stores energy nobody put in."""
        self.reset()
        self._zone = self._environment.contact(position)

    def advance(self, position: float, displacement: float, damper: float, h_m: float) -> ModelStep:
        """Returns the account of the hold that ended and the efforts for the next.

        Args:
            position: At the end of the hold [m or rad].
            displacement: During the hold [m or rad].
            damper: Effort of the model's damper inside the torque that was applied [N or N*m].
            h_m: Energy that the model received [J].
        """
        environment = self._environment
        zone = environment.contact(position)
        if zone == 0:
            return self._out_of_contact(h_m, damper)
        before = self._state if zone == self._zone else 0.0
        state = environment.true_state(position, displacement, before)
        h_r = max(0.0, damper * (state - before))
        if environment.relaxes:
            strained = environment.stored_energy(state)
            state = environment.relaxed(state, self._sample_time)
            h_r += strained - environment.stored_energy(state)
        h_s = environment.stored_energy(state)
        rest = self._h_s + h_m - h_r - h_s
        branch = _EXACT if zone == self._zone else _START
        self._zone, self._state, self._rendered, self._h_s = zone, state, state, h_s
        velocity = displacement / self._sample_time
        gen, leak = max(0.0, -rest), max(0.0, rest)
        return ModelStep(branch, h_r, h_s, gen, leak, environment.effort(state), environment.damping * velocity)

    def _out_of_contact(self, h_m: float, damper: float) -> ModelStep:
        branch = _FREE if self._zone == 0 and h_m == 0.0 and self._h_s == 0.0 else _EXIT
        h_r = max(0.0, -damper * self._state) if self._zone else 0.0
        rest = self._h_s + h_m - h_r
        self.reset()
        return ModelStep(branch, h_r, 0.0, max(0.0, -rest), max(0.0, rest), 0.0, 0.0)
