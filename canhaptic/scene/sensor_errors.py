"""Errors of reported position and torque of a simulated axis, from its effects.

An encoder may be noisy or coarser than its counts, and a motor may give another torque than its demand.
"""

from collections.abc import Mapping
from math import inf
from typing import TYPE_CHECKING, Final

from canhaptic.control.axis_meter import Accuracy
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.scene.models import AxisScene
from canhaptic.units import Parameters

if TYPE_CHECKING:
    from canhaptic.control.friction_watch import FrictionDeclared

_SIGMAS: Final = 6.0
"""Standard deviations of a noise beyond which no sample is expected: 2e-9 of them."""


def loop_as_known(axis: AxisScene) -> LoopProperties:
    """Loop of an axis, its count as wide as the errors of its encoder, and torques that its motor reaches.

    Certificates and account then rely on no better encoder than this one; a torque beyond the motor's reach is cut
    before it is certified.
    """
    effects, loop = _effects(axis), axis.loop
    error, limit = _position_error(effects), _largest_torque(effects)
    changes: dict[str, float] = {}
    if error:
        changes["encoder_count"] = loop.encoder_count + 2.0 * error
    if limit < (inf if loop.torque_limit is None else loop.torque_limit):
        changes["torque_limit"] = limit
    return loop.model_copy(update=changes) if changes else loop


def accuracy_of(axis: AxisScene, algorithm: str) -> Accuracy:
    """Accuracy of the sensors and the device of an axis.

    Args:
        axis: Axis of the scene.
        algorithm: Name of the algorithm that renders on it, or on its group.
    """
    effects, loop = _effects(axis), loop_as_known(axis)
    late = (loop.torque_window or 0.0) + (loop.current_lag or 0.0)  # beyond a hold too, where nothing is certified
    certifies = algorithm == "guarded"
    bounds_motion = certifies and (bool(axis.group) or _bounds_motion(axis, loop))
    return Accuracy(
        sample_time=loop.sample_time * (1.0 + (loop.sync_jitter or 0.0)),
        position=0.5 * loop.encoder_count,
        torque_share=_share(effects),
        torque_offset=0.5 * _value(effects, "torque_quantisation", "quantum", 0.0),
        torque_limit=_largest_torque(effects),
        late=0.0 if bounds_motion else late,
        late_speed=axis.parameters.largest_speed if certifies else None,
        counts_losses=bool(axis.group) or not bounds_motion,
        largest_speed=axis.parameters.largest_speed,
        largest_torque=axis.parameters.torque_limit,
        device_damping=loop.device_damping,
        device_friction=loop.device_friction,
        device_damping_bound=loop.device_damping_bound,
        device_friction_bound=loop.device_friction_bound,
    )


def _bounds_motion(axis: AxisScene, loop: LoopProperties) -> bool:
    """Whether certificates of one axis bound its motion inside a hold: all but dry friction do."""
    force, speed = (getattr(axis.passivity.parameters, key, None) for key in ("hand_force", "hand_speed"))
    return bool(loop.device_damping or speed or (force is not None and loop.moving_mass is not None))


def friction_declared(axis: AxisScene) -> "FrictionDeclared | None":
    """Declared friction and hand for the check of an axis; None where one is undeclared."""
    loop, parameters = loop_as_known(axis), axis.passivity.parameters
    force, push = (getattr(parameters, key, None) for key in ("hand_force", "hand_push"))
    if axis.group or not loop.device_friction or loop.moving_mass is None or force is None:
        return None
    from canhaptic.control.friction_watch import FrictionDeclared

    return FrictionDeclared(
        loop.device_friction,
        loop.moving_mass,
        loop.sample_time,
        hand_force=force,
        hand_push=inf if push is None else push,
        count=loop.encoder_count,
        jitter=loop.sync_jitter or 0.0,
        late=(loop.torque_window or 0.0) + (loop.current_lag or 0.0),
    )


def _effects(axis: AxisScene) -> Mapping[str, Parameters]:
    if axis.simulation is None:
        return {}
    return {effect.name: effect.parameters for effect in axis.simulation.effects}


def _value(effects: Mapping[str, Parameters], name: str, key: str, otherwise: float) -> float:
    return float(getattr(effects[name], key)) if name in effects else otherwise


def _position_error(effects: Mapping[str, Parameters]) -> float:
    count = _value(effects, "encoder_quantisation", "count", 0.0)
    return 0.5 * count + _SIGMAS * _value(effects, "encoder_noise", "deviation", 0.0)


def _largest_torque(effects: Mapping[str, Parameters]) -> float:
    return _value(effects, "torque_saturation", "limit", inf)


def _share(effects: Mapping[str, Parameters]) -> float:
    """Largest relative error of a torque; a hot winding may give none of it."""
    if "thermal_derating" in effects:
        return 1.0
    return _value(effects, "torque_ripple", "amplitude", 0.0)
