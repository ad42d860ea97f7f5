"""Cost of a measurement's uncertainty in wall stiffness, and the gain from an energy allowance."""

from collections.abc import Mapping
from typing import Final

from canhaptic.scene.first_contact import ALLOWANCES, can_be_tried, rendered_share, with_declared
from canhaptic.scene.models import AxisScene

SURE: Final = 2.0
"""Standard deviations beyond which a value counts as impossible."""
_KEPT: Final = 0.9
"""Part of the wall that the uncertainty of a measurement must leave."""
_SPEEDS: Final = (1.0, 0.5, 0.25, 0.125)  # of the fastest


def share_of_wall(axis: AxisScene, fastest: float, declared: Mapping[str, float]) -> float:
    """Share of the wall that is rendered during approach, the mean over several speeds.

    1 where the axis has no wall: a group or a display, or another environment.

    Args:
        axis: Axis with its environment and algorithm.
        fastest: Speed of the handle [m/s or rad/s].
        declared: Values of `passivity` in place of those of the axis, SI.
    """
    if not can_be_tried(axis) or axis.passivity.own is not None:
        return 1.0
    trial = with_declared(axis, declared)
    return sum(rendered_share(trial, part * fastest) for part in _SPEEDS) / len(_SPEEDS)


def is_dear(axis: AxisScene, fastest: float, best: Mapping[str, float], ends: Mapping[str, float]) -> bool:
    """Return whether the ends of measured intervals cost more of the wall than they may, compared with the best."""
    return share_of_wall(axis, fastest, ends) < _KEPT * share_of_wall(axis, fastest, best)


def needed_allowance(
    axis: AxisScene, fastest: float, best: Mapping[str, float], ends: Mapping[str, float]
) -> float | None:
    """Return the energy allowance [J] with which the ends of measured intervals leave enough of the wall.

    It is twice the least of `ALLOWANCES`, as a contact may begin with part of it given out. None: none suffices.
    """
    if not hasattr(axis.passivity.parameters, "energy_allowance"):
        return None
    tried = (2.0 * each for each in ALLOWANCES if not is_dear(axis, fastest, best, {**ends, "energy_allowance": each}))
    return next(tried, None)
