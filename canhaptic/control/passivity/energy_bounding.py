"""`energy_bounding`: the torque is bounded by what the device is certain to dissipate (ref. [5]).

Device damping b takes at least (b / T) dx^2 out of every hold. With the account E_n = E_(n-1) + (b/T) dx^2 - F dx the
next hold ends with E_n + (b/T) dx^2 - F dx >= 0 for EVERY motion dx exactly when F^2 <= 4 E_n b / T. A torque f that is
already under way may cost up to f^2 T / 4b first, so with delay its square is taken off. This is the device-damping
certificate; what it renders is limited to a stiffness of about 2 b / T.
"""

import math
from typing import ClassVar

from canhaptic.control.balance import AT_REST, Certificate, CompensatedSum, EnergyBalance
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.hold_account import HoldAccount
from canhaptic.control.passivity.sampled_model import SampledModel
from canhaptic.control.velocity import DamperVelocity
from canhaptic.errors import ParameterError
from canhaptic.units import Parameters


class EnergyBoundingParameters(DamperVelocity):
    """Nothing to choose but the velocity of the damper: the device damping is a property of the loop."""


class EnergyBounding:
    """The sampled environment, its torque bounded by certain device damping."""

    parameters_type: ClassVar[type[Parameters]] = EnergyBoundingParameters

    def __init__(self, environment: Environment, parameters: EnergyBoundingParameters, loop: LoopProperties) -> None:
        if not loop.device_damping:
            raise ParameterError(
                f"energy_bounding: got device_damping {loop.device_damping!r}, expected > 0; it renders nothing "
                "without certain damping: measure it and give passivity.device_damping, or choose another algorithm"
            )
        self._damping = environment.damping
        self._device_damping = loop.device_damping
        self._sample_time = loop.sample_time
        self._model = SampledModel(environment)
        self._books = HoldAccount(
            delay=loop.delay,
            sample_time=loop.sample_time,
            largest=loop.torque_limit,
            estimator=parameters.estimator(loop.sample_time, loop.encoder_count),
            certificate=Certificate.DEVICE_DAMPING.value,
        )
        self.reset()

    def reset(self) -> None:
        """Forgets everything: no energy, no torque in flight, no last position."""
        self._model.reset()
        self._books.reset()
        self._energy = CompensatedSum()

    def hold(self) -> EnergyBalance:
        """Repeats the last command for want of a position; see `Controller.hold`."""
        return self._books.repeat()

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        """Accounts for the hold that ended; see `Controller.step`."""
        hold = self._books.open(position, torque_applied)
        model = self._model
        if hold is None:
            model.begin(position)
            self._energy = CompensatedSum()
            return AT_REST
        energy = self._energy.add(hold.h_i + self._device_damping * hold.displacement**2 / hold.elapsed)
        branch, h_r, contact, spring, damper = model.advance(position, hold)
        share = self._share(energy, abs(spring + damper))
        gen, leak = model.settle(share, hold.h_i, h_r)
        efforts = spring * share, damper * share, 0.0
        rendered = self._damping * share if contact else 0.0
        return self._books.send(hold, (branch, h_r, gen, 0.0, leak), efforts, rendered, model.state, model.h_s)

    def _share(self, energy: float, wanted: float) -> float:
        """Returns the part of a wanted torque [N or N*m] that is within the bound, 0..1."""
        square = 4.0 * self._device_damping / self._sample_time * energy
        for torque in self._books.torques_in_flight:
            square -= torque * torque
        if wanted * wanted <= square:
            return 1.0
        return math.sqrt(square) / wanted if square > 0.0 else 0.0
