"""Users, plants and walls that benches and tests measure alike."""

import random
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, cast

from canhaptic.control.environments import Environment
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import ALGORITHMS, LoopProperties
from canhaptic.lab.batch.cases import BatchCase, many_loops
from canhaptic.lab.batch.scalar import continuous_reference
from canhaptic.lab.loop.axis_loop import Array, LoopCase
from canhaptic.lab.reference import ContinuousReference
from canhaptic.registry import load
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.models import AxisSimulation
from canhaptic.sim.drive import SimulatedDriveParameters
from canhaptic.sim.plant.effects import Effect
from canhaptic.sim.plant.effects.grasp_change import GraspChange
from canhaptic.sim.plant.effects.tremor import Tremor
from canhaptic.sim.plant.plant import Plant, PlantParameters
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from tools.bench.user_laws import USERS, HandPlant

PLANT: Final = PlantParameters(mass=0.25, damping=0.1)
USER_S: Final = UserParameters(stiffness=300.0, damping=3.0, motion=SinusoidMotion(amplitude=0.03, frequency=1.0))
FIGURES_7_9: Final = SpringDamperWall(stiffness=100.0, damping=10.0, position=-0.05)
TREMOR_UNTIL: Final = 9.0  # [s], then the hand only leans on the wall
LEANING: Final = UserParameters(stiffness=300.0, damping=3.0, push=-4.0)
TREMBLING: Final[tuple[Effect, ...]] = (
    Tremor(amplitude=2e-3, frequency=8.0),
    GraspChange(time=TREMOR_UNTIL, stiffness=0.0, damping=0.0),
)


def user_f(amplitude: float) -> UserParameters:
    """Returns user F of the paper's figures, with its amplitude [m]."""
    return UserParameters(stiffness=60.0, damping=5.0, motion=SinusoidMotion(amplitude=amplitude, frequency=0.5))


def standard_case(
    environment: Environment,
    algorithm: str,
    rate: float,
    user: UserParameters | str,
    *,
    delay: int = 0,
    plant: PlantParameters = PLANT,
    effects: tuple[Effect, ...] = (),
    encoder_count: float = 0.0,
    torque_quantum: float = 0.0,
    hand_force: float = 0.0,
    pull: float | None = None,
    declared_damping: float | None = None,
    seed: int = 0,
    **parameters: Any,
) -> LoopCase:
    """Returns a loop with the mass known.

    Args:
        environment: What is rendered.
        algorithm: A name of `ALGORITHMS`.
        rate: SYNCs per second.
        user: A hand, or a name of `USERS` for a force law within `hand_force`.
        delay: Holds.
        plant: Moving mass and bearings.
        effects: Of the plant, with a hand only.
        encoder_count: [m]; 0 for an ideal encoder.
        torque_quantum: Step of the command [N]; 0 for an ideal one.
        hand_force: Declared to `guarded`, and the limit of a force law unless `pull` says another [N].
        pull: Limit of a force law [N].
        declared_damping: Certain damping of the device; None: not declared [N*s/m].
        seed: Of a force law.
        parameters: Of the algorithm.
    """
    sample_time_ns = round(1e9 / rate)
    if algorithm == "guarded":
        parameters["hand_force"] = hand_force
    model = load(ALGORITHMS, algorithm, "passivity algorithm").parameters_type
    known = {"moving_mass": plant.mass, "device_damping": declared_damping, "device_damping_bound": plant.damping}
    steps = {"encoder_count": encoder_count, "torque_quantum": torque_quantum}
    loop = LoopProperties(sample_time=sample_time_ns * 1e-9, delay=delay, **known, **steps)
    limit = hand_force if pull is None else pull
    return LoopCase(
        environment,
        algorithm,
        model(**parameters),
        loop,
        lambda: _plant(user, plant, effects, sample_time_ns, limit, seed),
        sample_time_ns,
        delay,
        counts_per_unit=1.0 / encoder_count if encoder_count else None,
        torque_quantum=torque_quantum or None,
    )


def _plant(
    user: UserParameters | str,
    plant: PlantParameters,
    effects: tuple[Effect, ...],
    sample_time_ns: int,
    limit: float,
    seed: int,
) -> Plant:
    if isinstance(user, UserParameters):
        return Plant(plant, user, effects, sample_time_ns)
    law = USERS[user](random.Random(seed))
    hand = HandPlant(law, sample_time_ns, hand_force=limit, mass=plant.mass, damping=plant.damping)
    return cast(Plant, hand)  # as far as a loop uses it


def standard_reference(
    environment: Environment, user: UserParameters, rate: float, cycles: int, effects: tuple[Effect, ...] = ()
) -> ContinuousReference:
    """Returns the continuous run of `standard_case` with the standard plant."""
    return continuous_reference(environment, simulation_of(PLANT, user, effects), round(1e9 / rate), cycles)


def simulation_of(
    plant: PlantParameters, user: UserParameters | None, effects: Sequence[Effect] = ()
) -> AxisSimulation:
    """Returns a plant without a drive, as a scene would give it."""
    specs = tuple(ComponentSpec(effect.type, effect) for effect in effects)  # type: ignore[arg-type]
    return AxisSimulation(SimulatedDriveParameters(counts_per_unit=1.0), plant, user, specs)


def loop_in_arrays(
    case: LoopCase,
    plant: PlantParameters,
    user: UserParameters,
    numbers: Mapping[str, Array],
    varied: Mapping[str, Array] | None = None,
) -> BatchCase:
    """Returns many loops of a plant without a drive; see `many_loops`."""
    return many_loops(replace(case, simulation=simulation_of(plant, user)), numbers, varied or {})
