"""The reference of the loop side: the continuous environment of an axis, read on a grid that every rate shares."""

from collections.abc import Callable
from typing import Final, NamedTuple

from canhaptic.lab.loop.scenes import environment_of
from canhaptic.lab.reference.continuous_reference import textbook_model
from canhaptic.lab.reference.textbook_environment import continuous_run
from canhaptic.scene.models import AxisScene
from canhaptic.scene.torque_history import simulation_of
from canhaptic.sim.plant.propagator import Array

_TOLERANCE: Final = 1e-11


class ContinuousLoop(NamedTuple):
    """The continuous axis at every `step_ns`, shapes (steps + 1,)."""

    step_ns: int
    position: Array  # [m or rad]
    impulse: Array  # of the environment's force since the start [N*s or N*m*s]
    interaction: Array  # energy into the environment since the start [J]


def continuous_loop(
    axis: AxisScene, step_ns: int, steps: int, stop: Callable[[], bool] | None = None
) -> ContinuousLoop:
    """Return what the user would feel without sampling.

    Args:
        axis: Its environment, plant, user and effects.
        step_ns: Time between two readings [ns].
        steps: Readings after the first.
        stop: Asked now and then whether to give up.

    Raises:
        InputError: There are no equations for the environment or an effect, scipy is missing, the solver fails, or it
            was stopped.
    """
    times = [k * step_ns * 1e-9 for k in range(steps + 1)]
    run = continuous_run(environment_of(axis), textbook_model(simulation_of(axis)), times, _TOLERANCE, stop)
    return ContinuousLoop(step_ns, run.position, run.impulse, run.interaction)
