"""`windowed_observer`: a passivity observer that forgets old dissipation.

An observer that sums from the start accumulates the energy that the environment dissipates, and reacts only after as
much was drawn. Here energy received more than `window` holds ago is subtracted from the sum, if the sum stays above
zero without it. The equations are those of `computePOPCForce` in `src/POPCBilateralTeleoperation.cpp` of
github.com/manips-sai-org/sai-primitives, which was read; the passivity controller is that of Hannaford and Ryu 2002,
doi:10.1109/70.988969.

Departures: one port instead of the two of a teleoperator; the energy is that of the torque applied, exact for each
hold, so that the energy of the damper is booked when it is dissipated; energy that cannot be subtracted when it leaves
the window is never subtracted, whereas the source lengthens its queue. It promises nothing.
"""

from dataclasses import dataclass
from functools import partial
from typing import Annotated

from canhaptic.control.passivity import passivity_observer
from canhaptic.control.passivity.passivity_observer import controlling_damping, observer_settings
from canhaptic.control.passivity.stepped import Hold, SteppedController
from canhaptic.control.passivity.unprotected import Asked, Reply, SampledRun, SampledState, sampled_kernel
from canhaptic.kernels import Buffer, new
from canhaptic.units import quantity


class WindowedObserverParameters(passivity_observer.PassivityObserverParameters):
    """Limits of the passivity controller, and the number of holds over which energy is observed."""

    window: Annotated[int, quantity("count", ge=1, le=100_000)] = 30
    """Number of holds over which energy is observed; the default is that of the source."""


@dataclass(slots=True)
class _WindowedObserverState(SampledState):
    """State kept from SYNC to SYNC; a ring buffer holds the energy of each hold in the window [J]."""

    energy: float = 0.0  # that is remembered [J]
    place: int = 0  # of the oldest hold in the window


_settings_of = partial(observer_settings, "windowed_observer")


def respond(run: SampledRun[WindowedObserverParameters, _WindowedObserverState], hold: Hold, asked: Asked) -> Reply:
    """Add damping to the next command while more energy was drawn than received within the window."""
    remember(run.state, run.memory.own, hold.h_i)
    extra = controlling_damping(run.settings.limit, run.state.energy, hold) if asked.touches else 0.0
    effort = extra * hold.displacement / hold.elapsed
    return new(Reply, (1.0, asked.spring, asked.damper, effort, asked.damping + extra))


def remember(state: _WindowedObserverState, recent: Buffer, h_i: float) -> None:
    """Add the energy of a hold to the observed energy [J], and subtract that of the hold that leaves the window."""
    place = state.place
    leaving, recent[place] = recent[place], h_i
    state.place = place + 1 if place + 1 < len(recent) else 0
    energy = state.energy + h_i
    if 0.0 < leaving < energy:
        energy -= leaving
    state.energy = energy


class WindowedObserver(SteppedController):
    """Controller that renders the environment with time-domain passivity control over a window of holds."""

    parameters_type = WindowedObserverParameters
    kernel = sampled_kernel(respond, _WindowedObserverState, _settings_of, lambda settings: settings.given.window)
