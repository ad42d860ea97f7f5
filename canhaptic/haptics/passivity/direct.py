"""`direct`: the sampled environment without protection, as most haptic loops run it. Shows what sampling creates."""

from typing import ClassVar

from canhaptic.haptics.balance import AT_REST, Certificate, EnergyBalance
from canhaptic.haptics.environments.protocol import Environment
from canhaptic.haptics.passivity.in_flight import CommandsInFlight
from canhaptic.haptics.passivity.protocol import LoopProperties
from canhaptic.haptics.passivity.sampled_model import SampledModel
from canhaptic.haptics.passivity.settle import close_account
from canhaptic.haptics.port import interaction_energy
from canhaptic.parameters import Parameters

_NO_BOUND = Certificate.NONE.value


class DirectParameters(Parameters):
    """Nothing to choose."""


class Direct:
    """torque = -effort(x) - d v with x and v straight from the position."""

    parameters_type: ClassVar[type[Parameters]] = DirectParameters

    def __init__(self, environment: Environment, parameters: DirectParameters, loop: LoopProperties) -> None:
        self._damping = environment.damping
        self._model = SampledModel(environment, loop.sample_time)
        self._in_flight = CommandsInFlight(loop.delay)
        self.reset()

    def reset(self) -> None:
        """Forgets everything: no torque in flight, no last position."""
        self._model.reset()
        self._in_flight.reset()
        self._h_dis = 0.0

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        """Books the hold that ended; see `Controller.step`."""
        hold = self._in_flight.ended_hold(position, torque_applied)
        if hold is None:
            self._model.begin(position)
            self._h_dis = 0.0
            return AT_REST
        displacement, damper_applied, _ = hold
        h_i = interaction_energy(torque_applied, displacement)
        branch, h_r, h_s, gen, leak, spring, damper = self._model.advance(position, displacement, damper_applied, h_i)
        torque = -spring - damper
        self._in_flight.send(torque, damper, 0.0)
        balance = close_account(
            torque=torque,
            h_i=h_i,
            h_pas=0.0,
            h_r=h_r,
            h_s=h_s,
            h_dis_before=self._h_dis,
            gen=gen,
            deficit=0.0,
            leak=leak,
            branch=branch,
            damping_rendered=self._damping if branch else 0.0,
            certificate=_NO_BOUND,
            state=self._model.state,
        )
        self._h_dis = balance.h_dis
        return balance
