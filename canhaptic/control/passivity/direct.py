"""`direct`: the sampled environment without protection, as most haptic loops run it. Shows what sampling creates."""

from typing import ClassVar

from canhaptic.control.balance import AT_REST, Certificate, EnergyBalance
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.hold_account import HoldAccount
from canhaptic.control.passivity.sampled_model import SampledModel
from canhaptic.control.velocity import DamperVelocity
from canhaptic.units import Parameters


class DirectParameters(DamperVelocity):
    """Nothing to choose but the velocity of the damper."""


class Direct:
    """torque = -effort(x) - d v with x and v straight from the position."""

    parameters_type: ClassVar[type[Parameters]] = DirectParameters

    def __init__(self, environment: Environment, parameters: DirectParameters, loop: LoopProperties) -> None:
        self._model = SampledModel(environment)
        self._damping = environment.damping
        self._books = HoldAccount(
            delay=loop.delay,
            sample_time=loop.sample_time,
            largest=loop.torque_limit,
            estimator=parameters.estimator(loop.sample_time, loop.encoder_count),
            certificate=Certificate.NONE.value,
        )
        self.reset()

    def reset(self) -> None:
        """Forgets everything: no torque in flight, no last position."""
        self._model.reset()
        self._books.reset()

    def hold(self) -> EnergyBalance:
        """Repeats the last command for want of a position; see `Controller.hold`."""
        return self._books.repeat()

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        """Accounts for the hold that ended; see `Controller.step`."""
        hold = self._books.open(position, torque_applied)
        model = self._model
        if hold is None:
            model.begin(position)
            return AT_REST
        branch, h_r, contact, spring, damper = model.advance(position, hold)
        gen, leak = model.settle(1.0, hold.h_i, h_r)
        account = branch, h_r, gen, 0.0, leak
        rendered = self._damping if contact else 0.0
        return self._books.send(hold, account, (spring, damper, 0.0), rendered, model.state, model.h_s)
