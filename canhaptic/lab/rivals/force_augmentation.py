"""`force_augmentation`: successive force augmentation, a soft spring with a force offset that grows press by press.

The first press renders the stiffness K of the environment. From the first release on, the force is that of a soft
spring k, which sampling leaves passive, plus an offset: force = k x + o. While the hand presses and force / x is below
K, the offset o grows: by `reach` (K - force / x) if more than `coarse` is missing, else by `increment`. Above K it
falls by `increment`. While the hand releases, o is constant. So the hand finally feels K when it presses, and receives
the energy of k when it releases.
Source: H. Singh et al., "Enhancing the rate-hardness of haptic interaction: successive force augmentation approach",
IEEE Trans. Industrial Electronics, 2019, doi:10.1109/TIE.2019.2918500, of which the abstract was read; the equations
are those of `HapticSFA` in `KTBioLabLib.cpp` of the Biorobotics Laboratory of KOREATECH, version 0.1, which was read.

Departures: the contact ends with that of the environment; the force never pulls; the offset stays zero in the first
press, in which the source decrements it; the environment's damper is unchanged. It promises nothing.
"""

from dataclasses import dataclass
from typing import Annotated, Final

from canhaptic.control.balance import Branch
from canhaptic.control.damping import DamperVelocity
from canhaptic.control.passivity.stepped import Hold, SteppedController
from canhaptic.control.passivity.unprotected import Asked, Reply, SampledRun, SampledState, sampled_kernel
from canhaptic.kernels import new
from canhaptic.units import quantity

_START: Final = Branch.START.value


class ForceAugmentationParameters(DamperVelocity):
    """Parameters of the soft spring and of the offset's growth; the defaults come from the source."""

    feedback_stiffness: Annotated[float, quantity("N/m", "N*m/rad", gt=0.0, le=1e9)] = 1200.0
    """Stiffness k of the soft spring."""
    increment: Annotated[float, quantity("N", "N*m", ge=0.0, le=1e3)] = 0.001
    """Change of the force offset per hold, if the rendered stiffness is at most `coarse` below the environment's."""
    reach: Annotated[float, quantity("m", "rad", ge=0.0, le=1.0)] = 1e-5
    """Change of the force offset per hold and per missing stiffness, if more than `coarse` is missing."""
    coarse: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e9)] = 1000.0
    """Missing stiffness above which the offset changes by `reach` instead of `increment`."""


@dataclass(slots=True)
class _ForceAugmentationState(SampledState):
    """State kept from SYNC to SYNC."""

    offset: float = 0.0  # o [N or N*m]
    depth: float = 0.0  # of the last command [m or rad]
    force: float = 0.0  # of its spring [N or N*m]
    released: bool = False  # since the contact began


def respond(run: SampledRun[ForceAugmentationParameters, _ForceAugmentationState], hold: Hold, asked: Asked) -> Reply:
    """Send the force of the soft spring plus its offset; every contact begins without an offset."""
    state, size = run.state, abs(asked.spring)
    if asked.branch == _START or not asked.touches:
        state.offset = state.depth = state.force = 0.0
        state.released = False
    share = augmented_force(run.settings.given, state, abs(state.model.true), size) / size if size > 0.0 else 0.0
    return new(Reply, (1.0, asked.spring * share, asked.damper, 0.0, asked.damping))


def augmented_force(
    given: ForceAugmentationParameters, state: _ForceAugmentationState, depth: float, full: float
) -> float:
    """Return the magnitude of the soft spring's force plus offset for the next command [N or N*m].

    Args:
        given: Parameters of the run.
        state: State of the contact, with the offset; changed.
        depth: Depth in the environment, not below 0 [m or rad].
        full: Magnitude of the environment's force at this depth [N or N*m].
    """
    if depth <= 0.0:
        return full
    stiffness, force = full / depth, state.force
    soft = min(stiffness, given.feedback_stiffness) * depth
    if depth > state.depth:
        if state.released and state.depth > 0.0:
            missing = stiffness - state.force / state.depth
            if missing > given.coarse:
                state.offset += given.reach * missing
            else:
                state.offset += given.increment if missing > 0.0 else -given.increment
        force = max(0.0, soft + state.offset) if state.released else full
    elif depth < state.depth:
        state.released = True
        force = max(0.0, soft + state.offset)
    state.depth, state.force = depth, force
    return force


class ForceAugmentation(SteppedController):
    """Controller that renders the environment's spring by a soft spring and a force offset."""

    parameters_type = ForceAugmentationParameters
    kernel = sampled_kernel(respond, _ForceAugmentationState)
