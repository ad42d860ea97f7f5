"""The continuous environment at every SYNC and in between: position, force, and variation of the force."""

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np

from canhaptic.control.environments.environment import Environment
from canhaptic.lab.judge.reference_model import Model
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.reference.continuous_wall import continuous_effect
from canhaptic.scene.models import AxisSimulation
from canhaptic.scene.parts import effect_of
from canhaptic.sim.plant.effects import Effect
from canhaptic.sim.plant.plant import Plant, PlantParameters
from canhaptic.sim.plant.user import UserParameters

_FINEST: Final = 200_000
"""Longest time between two readings of the reference [ns]; at least two readings a hold."""
_MOST_READINGS: Final = 400_000
_TOLERANCE: Final = 1e-10
"""Relative, of DOP853."""
REST: Final = 0.02
"""Peak-to-peak motion, as a part of the whole travel, below which the reference counts as being at rest."""


class ContinuousReference(NamedTuple):
    """The continuous run."""

    position: Array  # at SYNC k, shape (n,) [m or rad]
    torque: Array  # mean over the hold that ended at SYNC k, shape (n,) [N or N*m]
    variation: float  # total variation of the force, sampled finely [N or N*m]
    fine_time: Array  # [s]
    fine_torque: Array  # [N or N*m]
    method: str  # how it was computed

    @property
    def travel(self) -> float:
        """Largest less least position [m or rad]."""
        return float(np.ptp(self.position))


def continuous_reference(
    environment: Environment,
    plant: PlantParameters,
    user: UserParameters | None,
    effects: Sequence[Effect],
    sample_time_ns: int,
    cycles: int,
    seed: int = 0,
) -> ContinuousReference:
    """Motion and force that the user would feel from the continuous environment.

    Args:
        environment: Rendered without sampling.
        plant: Moving mass.
        user: The hand.
        effects: Effects of the plant; those of encoder and command are left out.
        sample_time_ns: T [ns], the grid of the result.
        cycles: SYNCs.
        seed: Seed of random effects.

    Raises:
        InputError: There are no equations for the environment or an effect, or they are not piecewise affine and scipy
            is missing.
    """
    readings = readings_per_hold(sample_time_ns, cycles)
    times = [(k * sample_time_ns) // readings for k in range((cycles - 1) * readings + 1)]
    effect = continuous_effect(environment)
    if effect is None:
        from canhaptic.lab.reference.textbook_environment import continuous_run

        run = continuous_run(environment, Model(plant, user, effects), [time * 1e-9 for time in times], _TOLERANCE)
        position, velocity = run.position, run.velocity
        method = "DOP853 with event location, relative tolerance 1e-10"
    else:
        step = sample_time_ns // readings if sample_time_ns % readings == 0 else sample_time_ns
        whole = Plant(plant, user, [*effects, effect], step, seed)
        position, velocity = _march(whole, times)
        method = "exact between events" if whole.is_exact else "exact but for the effects that declare an order"
    torque = _environment_torque(environment, position, velocity, times[1] * 1e-9 if len(times) > 1 else 1.0)
    ends = 0.5 * (torque[1:] + torque[:-1])
    mean = np.concatenate([[0.0], ends.reshape(-1, readings).mean(axis=1)]) if cycles > 1 else torque[:1]
    variation = float(np.abs(np.diff(torque, prepend=0.0)).sum())
    return ContinuousReference(position[::readings], mean, variation, np.array(times) * 1e-9, torque, method)


def _environment_torque(environment: Environment, position: Array, velocity: Array, step: float) -> Array:
    """Return the torque of the continuous environment along a motion [N or N*m], shape (n,).

    Strains that relax are followed over half a step before and half a step after the motion: second order in the step.

    Args:
        environment: Environment in contact.
        position: Shape (n,) [m or rad].
        velocity: Shape (n,) [m/s or rad/s].
        step: Time between two of them [s].
    """
    torque = np.zeros(len(position))
    state = last = 0.0
    zone_before = 0
    damping = environment.damping
    for i, (q, v) in enumerate(zip(position.tolist(), velocity.tolist(), strict=True)):
        zone = environment.contact(q)
        if zone:
            before = environment.relaxed(state, 0.5 * step) if zone == zone_before else 0.0
            state = environment.true_state(q, q - last if i else 0.0, before)
            state = environment.relaxed(state, 0.5 * step)
            torque[i] = -environment.effort(state) - damping * v
        zone_before, last = zone, q
    return torque


def textbook_model(simulation: AxisSimulation, without: Callable[[str], bool] = lambda _name: False) -> Model:
    """Return the plant of an axis as textbook equations.

    Args:
        simulation: Simulation of the axis.
        without: Whether an effect of this name is left out.
    """
    effects = [effect_of(effect) for effect in simulation.effects if not without(effect.name)]
    return Model(simulation.plant, simulation.user, effects)


def readings_per_hold(sample_time_ns: int, cycles: int) -> int:
    """Return how often the reference is read in a hold [ns] of a run of some cycles."""
    least = max(2, -(-sample_time_ns // _FINEST))
    least = min(least, max(2, _MOST_READINGS // max(1, cycles)))
    return next((n for n in range(least, 2 * least + 8) if sample_time_ns % n == 0), least)


def _march(plant: Plant, times: Sequence[int]) -> tuple[Array, Array]:
    position, velocity = np.empty(len(times)), np.empty(len(times))
    plant.begin(0)
    for i, now in enumerate(times):
        plant.advance_to(now, 0.0)
        position[i], velocity[i] = plant.position, plant.velocity
    return position, velocity
