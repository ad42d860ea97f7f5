"""Motion and force in the continuous environment, at every SYNC and in between: the reference for sampled algorithms.

A wall, damper or free space on a linear plant is solved in closed form between events (`closed_loop.follow_hold`); any
other environment or plant is integrated by DOP853 on the textbook plant (`canhaptic.lab.reference`).
"""

from collections.abc import Sequence

import numpy as np

from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.lab import reference
from canhaptic.lab.batch.cases import continuous_modes, many_loops, why_not_continuous
from canhaptic.lab.batch.closed_loop import ReferenceState, begin_reference, follow_hold
from canhaptic.lab.batch.marching import reference_memory_of
from canhaptic.lab.batch.plants import is_linear
from canhaptic.lab.judge.reference_model import Model
from canhaptic.lab.loop.axis_loop import Array, LoopCase
from canhaptic.lab.reference import ContinuousReference
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.far_side import build_plant
from canhaptic.scene.models import AxisSimulation
from canhaptic.sim.drive.drive_parameters import SimulatedDriveParameters
from canhaptic.sim.plant.effects import Effect
from canhaptic.sim.plant.plant import PlantParameters
from canhaptic.sim.plant.user import UserParameters


def continuous_reference(
    environment: Environment,
    plant: PlantParameters,
    user: UserParameters | None,
    effects: Sequence[Effect],
    sample_time_ns: int,
    cycles: int,
) -> ContinuousReference:
    """Return the motion and force that the user would feel from the continuous environment.

    Args:
        environment: Environment to render without sampling.
        plant: Moving mass.
        user: The hand.
        effects: Effects of the plant; effects on encoder and command are left out.
        sample_time_ns: T [ns], the grid of the result.
        cycles: SYNCs.

    Raises:
        InputError: There are no equations for the environment or an effect, or a solver is needed and scipy is missing.
    """
    reference.surfaces(environment)
    readings = reference.readings_per_hold(sample_time_ns, cycles)
    step = sample_time_ns * 1e-9 / readings
    times = np.arange((cycles - 1) * readings + 1, dtype=np.float64) * step
    specs = tuple(ComponentSpec(effect.type, effect) for effect in effects)  # type: ignore[arg-type]
    simulation = AxisSimulation(SimulatedDriveParameters(counts_per_unit=1.0), plant, user, specs, 0)
    found, method = _in_closed_form(environment, simulation, step, len(times)), "closed form between events"
    if found is None:
        run = reference.continuous_run(environment, Model(plant, user, effects), times.tolist(), 1e-10)
        found, method = (run.position, run.velocity), "DOP853 with event location, relative tolerance 1e-10"
    position, velocity = found
    torque = reference.environment_torque(environment, position, velocity, step)
    ends = 0.5 * (torque[1:] + torque[:-1])
    mean = np.concatenate([[0.0], ends.reshape(-1, readings).mean(axis=1)]) if cycles > 1 else torque[:1]
    variation = float(np.abs(np.diff(torque, prepend=0.0)).sum())
    return ContinuousReference(position[::readings], mean, variation, times, torque, method)


def _in_closed_form(
    environment: Environment, simulation: AxisSimulation, step: float, count: int
) -> tuple[Array, Array] | None:
    """Return positions and velocities at every `step` [s]; None where the motion has no closed form."""
    if (simulation.user is not None and not simulation.user.has_equations) or not is_linear(simulation):
        return None
    step_ns = round(step * 1e9)
    case = many_loops(
        LoopCase(
            environment, "unprotected", None, LoopProperties(sample_time=step),
            lambda: build_plant(simulation, step_ns), step_ns, 0, simulation=simulation,
        ), {}, {},
    )  # fmt: skip
    if why_not_continuous(case):
        return None
    modes = continuous_modes(case, 1, count, with_force=False, with_travel=False)
    settings, state, memory = modes.settings[0], ReferenceState(), reference_memory_of(modes, 0)
    if not settings.exists:
        return None
    motion = np.empty((count, 2))
    begin_reference(settings, state, memory)
    for k in range(count):
        if k:
            follow_hold(settings, state, memory)
        motion[k] = memory.state[0], memory.state[1]
    return motion[:, 0], motion[:, 1]
