"""The environment sampled as it is: state and velocity straight from the position, no protection.

`direct` is this and nothing else; `passivity_observer` and `energy_bounding` act on its torque. What sampling creates
is booked as `gen`, what it loses as `leak`, so that the account closes like every other.
"""

from typing import NamedTuple

from canhaptic.control.balance import Branch
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.hold_account import Hold

_FREE, _START, _EXACT, _EXIT = Branch.FREE.value, Branch.START.value, Branch.EXACT.value, Branch.EXIT.value


class ModelStep(NamedTuple):
    """What one hold did to the sampled environment."""

    branch: int
    h_r: float  # [J]
    contact: bool  # whether the next command carries a torque
    spring: float  # effort of the storage for the next hold [N or N*m]
    damper: float  # effort of the damper for the next hold [N or N*m]


class SampledModel:
    """Follows the true state of an environment and books what that costs.

    Attributes:
        state: Displacement of the storage that is rendered [m or rad].
        h_s: Energy stored there [J].
    """

    __slots__ = ("_environment", "_true", "_zone", "h_s", "state")

    def __init__(self, environment: Environment) -> None:
        self._environment = environment
        self.reset()

    def reset(self) -> None:
        """Out of contact, nothing stored."""
        self._zone = 0
        self.state = self._true = self.h_s = 0.0

    def begin(self, position: float) -> None:
        """Takes the first position; a state that is already displaced there stores energy nobody put in."""
        self.reset()
        self._zone = zone = self._environment.contact(position)
        self._true = self._environment.true_state(position, 0.0, 0.0) if zone else 0.0

    def advance(self, position: float, hold: Hold) -> ModelStep:
        """Follows one hold and returns what it dissipated and the efforts for the next; `settle` must follow.

        Args:
            position: At the end of the hold [m or rad].
            hold: As the books opened it.
        """
        environment, before = self._environment, self._true
        displacement, damper = hold.displacement, hold.damper
        zone = environment.contact(position)
        if zone == 0:
            left = self._zone
            h_r = max(0.0, damper * (environment.admissible(before + displacement, before) - before)) if left else 0.0
            self._zone, self._true = 0, 0.0
            return ModelStep(_EXIT if left or hold.h_i or self.h_s else _FREE, h_r, False, 0.0, 0.0)
        entered = zone != self._zone
        state = environment.true_state(position, displacement, 0.0 if entered else before)
        before = environment.admissible(state - displacement if entered else before, state)
        h_r = max(0.0, damper * (state - before))
        if environment.relaxes:
            strained = environment.stored_energy(state)
            state = environment.relaxed(state, hold.elapsed)
            h_r += strained - environment.stored_energy(state)
        self._zone, self._true = zone, state
        return ModelStep(
            _START if entered else _EXACT, h_r, True, environment.effort(state), environment.damping * hold.velocity
        )

    def settle(self, share: float, h_m: float, h_r: float) -> tuple[float, float]:
        """Stores the state that is rendered and closes the account; returns (gen, leak) [J].

        Args:
            share: Part of the model's effort that is rendered in the next hold, 0..1.
            h_m: Energy the model received in this hold [J].
            h_r: Energy dissipated in it [J].
        """
        self.state = self._true if share == 1.0 else share * self._true
        stored_before = self.h_s
        self.h_s = h_s = self._environment.stored_energy(self.state)
        rest = stored_before + h_m - h_r - h_s
        return max(0.0, -rest), max(0.0, rest)
