"""`ultimate_passivity`: a switch between the environment as it is and the same with much damping, by observed energy.

Once the energy that came in has fallen to `lower`, damping `conservative_damping` is added until it has risen to
`upper`; in between the mode stays. So a bounded amount of energy may be drawn before anything is felt. Source: X. Guo,
Z. Liu, V. Crocher, Y. Tan, D. Oetomo, A. H. A. Stienen, "Ultimate passivity: balancing performance and stability in
physical human-robot interaction", IEEE Trans. Robotics 41, 2025, doi:10.1109/TRO.2025.3546856, which was not read; the
rule is that of `M2Admittance2` in `M2AdmittanceStates.cpp` of github.com/xinlianggunimelb/UltimatePassivity, which was.

Departures: an impedance with added damping, where the source is an admittance with another damping; the energy is that
of the torque applied, exact for each hold; by default it is never set back to zero, where the source does so every 1000
samples; the damping has the cap of the loop. It promises nothing.
"""

from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Self

from pydantic import model_validator

from canhaptic.control.balance import AT_REST, EnergyBalance
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.hold_account import (
    Axis,
    AxisMemory,
    HoldAccount,
    close_hold,
    open_hold,
)
from canhaptic.control.passivity.passivity_observer import (
    ObserverSettings,
    PassivityObserverParameters,
    observer_memory,
    observer_settings,
)
from canhaptic.control.passivity.sampled_model import SampledModel, begin_model, follow, settle
from canhaptic.control.passivity.stepped import SteppedController
from canhaptic.kernels import Kernel, new
from canhaptic.units import Parameters, quantity


class UltimatePassivityParameters(PassivityObserverParameters):
    """The two energies, the damping between them, and how long energy is counted."""

    lower: Annotated[float, quantity("J", le=0.0, ge=-1e3)] = -0.01
    """Energy at which the damping is switched on."""
    upper: Annotated[float, quantity("J", ge=-1e3, le=1e3)] = 0.0
    """Energy at which it is switched off; above `lower`."""
    conservative_damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)] = 50.0
    """Damping that is added; `damping_limit` or the cap of the loop bounds it."""
    counted_holds: Annotated[int, quantity("count", ge=0, le=1_000_000_000)] = 0
    """Holds after which the energy counted is set to zero; 0 for never."""

    @model_validator(mode="after")
    def _upper_is_above_lower(self) -> Self:
        if self.upper <= self.lower:
            raise ValueError(f"upper {self.upper} J is not above lower {self.lower} J, expected upper > lower")
        return self


@dataclass(frozen=True, slots=True)
class _UltimatePassivitySettings:
    """Constants of a run."""

    observer: ObserverSettings
    lower: float  # [J]
    upper: float  # [J]
    damping: float  # [N*s/m or N*m*s/rad]
    counted_holds: int


@dataclass(slots=True)
class _UltimatePassivityState:
    """State kept from SYNC to SYNC."""

    axis: Axis = field(default_factory=Axis)
    model: SampledModel = field(default_factory=SampledModel)
    energy: float = 0.0  # counted [J]
    holds: int = 0  # counted
    conservative: bool = False


def settings_of(
    environment: Environment, parameters: UltimatePassivityParameters, loop: LoopProperties
) -> _UltimatePassivitySettings:
    """Returns what is fixed for a run.

    Raises:
        ParameterError: Nothing bounds the damper.
    """
    given, observer = parameters, observer_settings("ultimate_passivity", environment, parameters, loop)
    damping = min(given.conservative_damping, observer.damping_limit)
    return _UltimatePassivitySettings(observer, given.lower, given.upper, damping, given.counted_holds)


def step(
    environment: Environment,
    settings: _UltimatePassivitySettings,
    state: _UltimatePassivityState,
    memory: AxisMemory,
    position: float,
    torque_applied: float,
) -> EnergyBalance:
    """Accounts for the hold that ended; see `Controller.step`."""
    axis, model = state.axis, state.model
    if not axis.started:
        begin_model(environment, axis, model, memory, position)
        return AT_REST
    hold = open_hold(settings.observer.hold, axis, memory, position, torque_applied)
    switch(settings, state, hold.h_i)
    branch, h_r, contact, spring, damper = follow(environment, model, position, hold)
    gen, leak = settle(environment, model, 1.0, hold.h_i - hold.h_pas, h_r)
    extra = settings.damping if contact and state.conservative else 0.0
    efforts = spring, damper, extra * hold.velocity
    account = new(HoldAccount, (branch, h_r, gen, 0.0, leak))
    rendered = environment.damping + extra if contact else 0.0
    return close_hold(settings.observer.hold, axis, memory, hold, account, efforts, rendered, model.state, model.h_s)


def switch(settings: _UltimatePassivitySettings, state: _UltimatePassivityState, h_i: float) -> None:
    """Counts the energy of a hold [J] and chooses the mode of the next."""
    state.energy += h_i
    state.holds += 1
    if state.holds == settings.counted_holds:
        state.energy, state.holds = 0.0, 0
    if state.energy <= settings.lower:
        state.conservative = True
    elif state.energy >= settings.upper:
        state.conservative = False


class UltimatePassivity(SteppedController):
    """The sampled environment, with damping added between two levels of observed energy."""

    parameters_type: ClassVar[type[Parameters]] = UltimatePassivityParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, _UltimatePassivityState, observer_memory, step)
