"""Limit of the energy that each port of a scene may give out beyond the declared energy, before the rig stops."""

from typing import Final

from canhaptic.control.energy_loss import EnergyLossMeter
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.scene.parts import group_places

DEFAULT_LIMIT: Final = 0.01  # [J]
_PROMISE_PASSIVITY: Final = frozenset({"guarded", "energy_bounding"})
"""Algorithms, of axes and of groups, that give out no more than was declared; the others are studied as they are."""


def build_loss_meters(scene: Scene) -> list[EnergyLossMeter]:
    """Return a meter for each port of a scene that has a limit."""
    meters: list[EnergyLossMeter | None] = []
    for place, axis in enumerate(scene.axes):
        if not axis.group and axis.parameters.admittance is None:
            allowance = getattr(axis.passivity.parameters, "energy_allowance", 0.0)
            meters.append(_meter(scene, axis.parameters.name, axis.passivity.name, (place,), allowance))
    for group, places in zip(scene.groups, group_places(scene), strict=True):
        allowance = getattr(group.passivity.parameters, "energy_allowance", 0.0)
        meters.append(_meter(scene, group.name, group.passivity.name, places, allowance))
    return [meter for meter in meters if meter is not None]


def _meter(
    scene: Scene, name: str, algorithm: str, places: tuple[int, ...], allowance: float
) -> EnergyLossMeter | None:
    axes = [scene.axes[place] for place in places]
    is_on = algorithm in _PROMISE_PASSIVITY or not scene.simulated
    limits = [limit for axis in axes if (limit := _limit(axis, is_on)) is not None]
    if not limits:
        return None
    damping = [axis.loop.device_damping or 0.0 for axis in axes]
    return EnergyLossMeter(name, places, min(limits), allowance, damping, scene.bus.sample_time)


def _limit(axis: AxisScene, is_on: bool) -> float | None:
    given = axis.parameters.energy_loss_limit
    if given == "none":
        return None
    return given if given is not None else DEFAULT_LIMIT if is_on else None
