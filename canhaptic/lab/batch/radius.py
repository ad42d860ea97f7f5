"""Stability of the linear sampled loop in closed form: one matrix and its eigenvalues for each scene.

A wall in permanent contact makes the loop linear. With z = [q, v, previous q, delayed torque] one hold is a matrix; the
loop is stable if all its eigenvalues are inside the unit circle. This maps 10^4 scenes without running one; a scene
with events must be run.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from canhaptic.control.environments import Environment
from canhaptic.errors import ParameterError
from canhaptic.lab.batch.cases import check_values
from canhaptic.lab.loop.axis_loop import environment_of, viscous_friction
from canhaptic.scene.models import AxisSimulation, Scene
from canhaptic.sim.plant.propagator import Array, flow_changes
from canhaptic.sim.plant.user import UserParameters


class Loops(NamedTuple):
    """Parameters of many loops, each one number or of shape (n_loops,)."""

    mass: Array | float  # [kg or kg*m^2]
    damping: Array | float  # of bearings and hand together [N*s/m or N*m*s/rad]
    hand_stiffness: Array | float  # [N/m or N*m/rad]
    wall_stiffness: Array | float  # [N/m or N*m/rad]
    wall_damping: Array | float  # on the backward difference of the position [N*s/m or N*m*s/rad]


def loop_matrices(loops: Loops, sample_time: Array | float, delay: int) -> Array:
    """Return the matrix of one hold of each loop, shape (n_loops, 3 + delay, 3 + delay).

    Args:
        loops: Loops, broadcast against each other.
        sample_time: T, one or of shape (n_loops,) [s].
        delay: Whole holds between the computation of a torque and the hold in which it acts, 0 or 1.

    Raises:
        ParameterError: A mass or sample time is not positive, or the delay is neither 0 nor 1.
    """
    columns = [np.atleast_1d(value) for value in (*loops, sample_time)]
    mass, damping, hand, stiffness, viscosity, period = np.broadcast_arrays(*columns)
    if delay not in (0, 1) or not np.all(period > 0.0) or not np.all(mass > 0.0):
        raise ParameterError(
            f"stability of a loop: got delay {delay}, least sample time {period.min()} s and least mass {mass.min()}, "
            "expected delay 0 or 1, sample time > 0 and mass > 0"
        )
    rates = np.zeros((len(mass), 3, 3))  # of [q, v, held torque]
    rates[:, 0, 1] = 1.0
    rates[:, 1] = np.stack([-hand / mass, -damping / mass, 1.0 / mass], axis=1)
    change = flow_changes(rates * period[:, None, None])
    size = 3 + delay  # [q, v, q before] and, with a delay, the torque that waits
    matrices = np.zeros((len(mass), size, size))
    law = np.zeros((len(mass), size))  # torque computed from the state at a SYNC
    law[:, 0], law[:, 2] = -stiffness - viscosity / period, viscosity / period
    held = law
    if delay:
        held = np.zeros_like(law)
        held[:, 3] = 1.0
        matrices[:, 3] = law
    matrices[:, :2, :2] = np.eye(2) + change[:, :2, :2]
    matrices[:, :2] += change[:, :2, 2:] * held[:, None, :]
    matrices[:, 2, 0] = 1.0
    return matrices


def decay_per_hold(loops: Loops, sample_time: Array | float, delay: int) -> Array:
    """Return the largest absolute eigenvalue of each loop, shape (n_loops,); below 1 it is stable."""
    return np.asarray(np.abs(np.linalg.eigvals(loop_matrices(loops, sample_time, delay))).max(axis=1))


def _linear_loop(scene: Scene, varied: Mapping[str, Array]) -> tuple[AxisSimulation, Environment, float]:
    """Return simulation, environment and stiffness [N/m or N*m/rad] of a scene; refuse a loop that is not linear."""
    if scene.groups:
        raise ParameterError(f"{scene.source}: spectral radius: expected one axis, got a group; run the scenes instead")
    axis = scene.axes[0]
    simulation, environment = axis.simulation, environment_of(axis)
    if simulation is None or len(scene.axes) != 1:
        raise ParameterError(f"{scene.source}: spectral radius: expected one axis, simulated; give it `simulation`")
    stiffness = environment.linear_stiffness
    if stiffness is None or "environment.hardening" in varied:
        raise ParameterError(
            f"{scene.source}: spectral radius: {axis.environment.name} has no linear stiffness; run the scenes instead"
        )
    if simulation.user is not None and not simulation.user.has_equations:
        raise ParameterError(f"{scene.source}: spectral radius: own code or a recording moves the hand; run the scenes")
    for effect in simulation.effects:
        if effect.name not in ("viscous_friction", "tremor"):  # which moves the hand: no part in stability
            raise ParameterError(f"{scene.source}: spectral radius: effect {effect.name} is not modelled; leave it out")
    return simulation, environment, stiffness


def spectral_radius(scene: Scene, varied: Mapping[str, Array]) -> Array:
    """Return the largest |eigenvalue| of one hold of each linear sampled loop, shape (n_scenes,): stable below 1.

    The environment counts as permanently in contact (a wall: on both sides). It is rendered by `unprotected` with the
    velocity of the last hold, at the delay of the scene, without encoder steps and limits.

    Args:
        scene: Scene with one axis, a linear plant and hand, and an environment with a linear stiffness.
        varied: Key of `BATCH_KEYS` -> value of each scene, shape (n_scenes,), in SI.

    Raises:
        ParameterError: The scene has no linear loop, or a key cannot vary.
    """
    simulation, environment, stiffness = _linear_loop(scene, varied)
    count, user = check_values(scene, varied), simulation.user or UserParameters()

    def number(key: str, value: float) -> Any:
        return varied.get(key, value)

    damping = number("simulation.plant.damping", simulation.plant.damping)
    damping = damping + number("simulation.user.damping", user.damping) + viscous_friction(simulation)
    loops = Loops(
        number("simulation.plant.mass", simulation.plant.mass),
        damping,
        number("simulation.user.stiffness", user.stiffness),
        number("environment.stiffness", stiffness),
        number("environment.damping", environment.damping),
    )
    period: Any = scene.bus.sample_time_ns * 1e-9
    if "bus.rate" in varied:
        period = np.rint(1e9 / varied["bus.rate"]) * 1e-9
    delays = np.broadcast_to(varied.get("loop.delay", float(scene.bus.delay)), (count,))
    columns, found = [np.broadcast_to(value, (count,)) for value in (*loops, period)], np.empty(count)
    for delay in np.unique(delays).tolist():
        rows = np.flatnonzero(delays == delay)
        *part, time = (column[rows] for column in columns)
        found[rows] = decay_per_hold(Loops(*part), time, int(delay))
    return found
