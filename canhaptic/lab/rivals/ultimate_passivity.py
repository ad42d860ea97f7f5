"""`ultimate_passivity`: the observed energy switches between the plain environment and one with additional damping.

Once the received energy has fallen to `lower`, `conservative_damping` is added until the energy has risen to `upper`;
in between the mode is kept. So bounded energy may be drawn before the damping acts. Source: X. Guo,
Z. Liu, V. Crocher, Y. Tan, D. Oetomo, A. H. A. Stienen, "Ultimate passivity: balancing performance and stability in
physical human-robot interaction", IEEE Trans. Robotics 41, 2025, doi:10.1109/TRO.2025.3546856, which was not read; the
rule is that of `M2Admittance2` in `M2AdmittanceStates.cpp` of github.com/xinlianggunimelb/UltimatePassivity, which was.

Departures: an impedance with added damping, whereas the source switches the damping of an admittance; the energy is
that of the torque applied, exact for each hold; by default it is never reset to zero, whereas the source resets it
every 1000 samples; the damping has the cap of the loop. It promises nothing.
"""

from dataclasses import dataclass
from functools import partial
from typing import Annotated, Self

from pydantic import model_validator

from canhaptic.control.passivity.passivity_observer import PassivityObserverParameters, observer_settings
from canhaptic.control.passivity.stepped import Hold, SteppedController
from canhaptic.control.passivity.unprotected import Asked, Reply, SampledRun, SampledState, sampled_kernel
from canhaptic.kernels import new
from canhaptic.units import quantity


class UltimatePassivityParameters(PassivityObserverParameters):
    """Parameters: the two energy levels, the added damping, and the number of holds over which energy is summed."""

    lower: Annotated[float, quantity("J", le=0.0, ge=-1e3)] = -0.01
    """Observed energy at which the added damping is switched on."""
    upper: Annotated[float, quantity("J", ge=-1e3, le=1e3)] = 0.0
    """Observed energy at which the added damping is switched off; above `lower`."""
    conservative_damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)] = 50.0
    """Added damping; limited by `damping_limit` or, if that is not given, by the cap of the loop."""
    counted_holds: Annotated[int, quantity("count", ge=0, le=1_000_000_000)] = 0
    """Number of holds after which the observed energy is reset to zero; 0: never."""

    @model_validator(mode="after")
    def _upper_is_above_lower(self) -> Self:
        if self.upper <= self.lower:
            raise ValueError(f"upper {self.upper} J is not above lower {self.lower} J, expected upper > lower")
        return self


@dataclass(slots=True)
class _UltimatePassivityState(SampledState):
    """State kept from SYNC to SYNC."""

    energy: float = 0.0  # counted [J]
    holds: int = 0  # counted
    conservative: bool = False


def respond(run: SampledRun[UltimatePassivityParameters, _UltimatePassivityState], hold: Hold, asked: Asked) -> Reply:
    """Add the conservative damping to the next command if it is switched on by the observed energy."""
    settings, extra = run.settings, 0.0
    switch(settings.given, run.state, hold.h_i)
    if asked.touches and run.state.conservative:
        extra = min(settings.given.conservative_damping, settings.limit)
    return new(Reply, (1.0, asked.spring, asked.damper, extra * hold.velocity, asked.damping + extra))


def switch(given: UltimatePassivityParameters, state: _UltimatePassivityState, h_i: float) -> None:
    """Add the energy of a hold to the observed energy [J], and switch the added damping on or off."""
    state.energy += h_i
    state.holds += 1
    if state.holds == given.counted_holds:
        state.energy, state.holds = 0.0, 0
    if state.energy <= given.lower:
        state.conservative = True
    elif state.energy >= given.upper:
        state.conservative = False


class UltimatePassivity(SteppedController):
    """Controller that renders the environment, with damping switched on and off at two levels of observed energy."""

    parameters_type = UltimatePassivityParameters
    kernel = sampled_kernel(respond, _UltimatePassivityState, partial(observer_settings, "ultimate_passivity"))
