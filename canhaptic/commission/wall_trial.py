"""How much of its wall an axis renders with the values that are declared, found by pressing into it.

The axis's own algorithm is given the positions of a handle that moves in at constant speed, as its encoder would show
them. What bounds a measured value from above or below, and what an energy allowance buys, is judged by that.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final, cast

from canhaptic.control.environments.environment import Environment
from canhaptic.errors import ParameterError
from canhaptic.scene.hints import LEAN
from canhaptic.scene.models import AxisScene
from canhaptic.scene.parts import build_axis_controller

SURE: Final = 2.0
"""Standard deviations: what is beyond them is taken to be impossible."""
_KEPT: Final = 0.9
"""Part of the wall that the uncertainty of a measurement must leave."""
_SPEEDS: Final = (1.0, 0.5, 0.25, 0.125)  # of the fastest
_LEAST_ALLOWANCE: Final = 1e-9  # [J]
_DOUBLINGS: Final = 24  # 17 mJ


def share_of_wall(axis: AxisScene, fastest: float, declared: Mapping[str, float]) -> float:
    """Returns the share of the wall's stiffness that is rendered on the way in, the mean of several speeds.

    1 where the axis has no wall: a group or a display, or another environment.

    Args:
        axis: With its environment and algorithm.
        fastest: Speed of the handle [m/s or rad/s].
        declared: Values of `passivity` in place of those of the axis, SI.
    """
    environment = cast(Environment, axis.environment.parameters)
    stiffness = getattr(environment, "stiffness", 0.0) if hasattr(environment, "side") else 0.0
    if not stiffness or axis.passivity.own is not None:
        return 1.0
    of_loop = {key: value for key, value in declared.items() if key in type(axis.loop).model_fields}
    others = {key: value for key, value in declared.items() if key not in of_loop}
    parameters = axis.passivity.parameters.model_copy(update=others)
    trial = replace(
        axis, loop=axis.loop.model_copy(update=of_loop), passivity=axis.passivity._replace(parameters=parameters)
    )
    depth = LEAN * axis.parameters.torque_limit / stiffness
    try:
        return sum(_pressed(trial, environment, depth, part * fastest) for part in _SPEEDS) / len(_SPEEDS)
    except ParameterError:  # a window as long as a hold: nothing could be rendered
        return 0.0


def is_dear(axis: AxisScene, fastest: float, best: Mapping[str, float], ends: Mapping[str, float]) -> bool:
    """Returns whether the ends of measured intervals cost more of the wall than they may, compared with the best."""
    return share_of_wall(axis, fastest, ends) < _KEPT * share_of_wall(axis, fastest, best)


def _pressed(axis: AxisScene, environment: Any, depth: float, speed: float) -> float:
    """Returns the share of one contact."""
    controller, loop = build_axis_controller(axis), axis.loop
    inward = -1.0 if environment.side == "below" else 1.0
    step, count = speed * loop.sample_time, loop.encoder_count
    sent, asked, rendered, way = [0.0] * (1 + loop.delay), 0.0, 0.0, -10.0 * step
    while way < depth:
        position = environment.position + inward * way
        position = round(position / count) * count if count else position
        sent.append(controller.step(position, sent[-1 - loop.delay]).torque)
        if environment.contact(position):
            effort = abs(environment.effort(environment.true_state(position, inward * step, 0.0)))
            asked, rendered = asked + effort, rendered + min(effort, abs(sent[-1]))
        way += step
    return rendered / asked if asked else 1.0


def needed_allowance(
    axis: AxisScene, fastest: float, best: Mapping[str, float], ends: Mapping[str, float]
) -> float | None:
    """Returns the energy allowance [J] with which the ends of measured intervals leave enough of the wall.

    It is twice to four times the least: a contact may begin with some of it given out before. None: there is none.
    """
    for doubled in range(_DOUBLINGS):
        allowance = _LEAST_ALLOWANCE * 2.0**doubled
        if not is_dear(axis, fastest, best, {**ends, "energy_allowance": allowance}):
            return 2.0 * allowance
    return None
