"""Stability of the linear sampled loop by closed form: one matrix and its eigenvalues for each scene."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from canhaptic.errors import ParameterError
from canhaptic.lab.batch.cases import check_values
from canhaptic.lab.batch.loop_stability import Loops, decay_per_hold
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.loop.scenes import environment_of, viscous_friction
from canhaptic.scene.models import Scene
from canhaptic.sim.plant.user import UserParameters

_IN_IT: Final = ("viscous_friction", "tremor")
"""Effects of a linear loop; tremor moves the hand and has no part in stability."""


def spectral_radius(scene: Scene, varied: Mapping[str, Array]) -> Array:
    """Return the largest |eigenvalue| of one hold of each linear sampled loop, shape (n_scenes,): stable below 1.

    The loop is closed by the environment as if in permanent contact (a wall: on both sides), rendered by
    `unprotected` with the velocity of the last hold, at the delay of the scene, without encoder steps and limits.

    Args:
        scene: Scene with a linear plant and hand, an environment with a linear stiffness, and one axis.
        varied: Key of `BATCH_KEYS` -> value of each scene, shape (n_scenes,), in SI.

    Raises:
        ParameterError: The scene has no linear loop, or a key cannot vary.
    """
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
    if type(simulation.user) not in (UserParameters, type(None)):
        raise ParameterError(f"{scene.source}: spectral radius: the hand is own code; run the scenes instead")
    for effect in simulation.effects:
        if effect.name not in _IN_IT:
            raise ParameterError(f"{scene.source}: spectral radius: effect {effect.name} is not in it; leave it out")
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
    return _by_delay(loops, period, delays)


def _by_delay(loops: Loops, period: Any, delays: Array) -> Array:
    count = len(delays)
    found = np.empty(count)
    for delay in np.unique(delays).tolist():
        rows = np.flatnonzero(delays == delay)
        part = Loops(*(np.broadcast_to(value, (count,))[rows] for value in loops))
        found[rows] = decay_per_hold(part, np.broadcast_to(period, (count,))[rows], int(delay))
    return found
