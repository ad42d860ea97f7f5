"""`passivity_observer`: PO/PC of ref. [9] in its exact sampled form.

The observer sums the interaction energy (eq. 2), which for a held torque is exact and needs no estimate of velocity.
While the sum is negative - more was drawn than ever put in - the passivity controller adds a damper sized to win the
shortfall back in one hold like the last. It guards eq. 3 and knows nothing of what the model should have dissipated
(eq. 4): a spring and damper that creates energy may feel like a spring alone before it acts, as sec. II of the paper
says.
"""

from typing import Annotated, ClassVar

from canhaptic.control.balance import AT_REST, Certificate, CompensatedSum, EnergyBalance
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.hold_account import Hold, HoldAccount
from canhaptic.control.passivity.sampled_model import SampledModel
from canhaptic.control.recovery import damping_cap
from canhaptic.control.velocity import DamperVelocity
from canhaptic.errors import ParameterError
from canhaptic.units import Parameters, quantity


class PassivityObserverParameters(DamperVelocity):
    """How hard the passivity controller may brake."""

    damping_limit: Annotated[float, quantity("N*s/m", "N*m*s/rad", gt=0.0)] | None = None
    """Of the passivity controller. Without it the cap from moving mass, delay and sample time holds, so one of the
    two must be known: the damper wanted grows without bound as the motion comes to rest."""


class PassivityObserver:
    """Time-domain passivity control around the sampled environment."""

    parameters_type: ClassVar[type[Parameters]] = PassivityObserverParameters

    def __init__(self, environment: Environment, parameters: PassivityObserverParameters, loop: LoopProperties) -> None:
        limit = parameters.damping_limit
        if limit is None and loop.moving_mass is None:
            raise ParameterError(
                "passivity_observer: got neither damping_limit nor moving_mass, expected one of them to bound the "
                "damper; give passivity.damping_limit, or passivity.moving_mass for the cap it implies"
            )
        cap = damping_cap(loop.delay, loop.moving_mass, loop.sample_time)
        self._limit = max(0.0, cap - environment.damping) if limit is None else limit
        self._damping = environment.damping
        self._model = SampledModel(environment)
        self._books = HoldAccount(
            delay=loop.delay,
            sample_time=loop.sample_time,
            largest=loop.torque_limit,
            estimator=parameters.estimator(loop.sample_time, loop.encoder_count),
            certificate=Certificate.NONE.value,
        )
        self.reset()

    def reset(self) -> None:
        """Forgets everything: nothing observed, no torque in flight, no last position."""
        self._model.reset()
        self._books.reset()
        self._observed = CompensatedSum()

    def hold(self) -> EnergyBalance:
        """Repeats the last command for want of a position; see `Controller.hold`."""
        return self._books.repeat()

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        """Accounts for the hold that ended; see `Controller.step`."""
        hold = self._books.open(position, torque_applied)
        model = self._model
        if hold is None:
            model.begin(position)
            self._observed = CompensatedSum()
            return AT_REST
        observed = self._observed.add(hold.h_i)
        branch, h_r, contact, spring, damper = model.advance(position, hold)
        gen, leak = model.settle(1.0, hold.h_i - hold.h_pas, h_r)
        extra = self._controlling_damping(observed, hold) if contact else 0.0
        efforts = spring, damper, extra * hold.displacement / hold.elapsed
        rendered = self._damping + extra if contact else 0.0
        return self._books.send(hold, (branch, h_r, gen, 0.0, leak), efforts, rendered, model.state, model.h_s)

    def _controlling_damping(self, observed: float, hold: Hold) -> float:
        """Returns the damping [N*s/m or N*m*s/rad] that wins back a negative energy [J] in one hold like the last."""
        displacement = hold.displacement
        if observed >= 0.0 or displacement == 0.0:
            return 0.0
        return min(self._limit, -observed * hold.elapsed / displacement / displacement)
