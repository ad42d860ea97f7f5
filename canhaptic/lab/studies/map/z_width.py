"""Z-width: the largest stiffness that passes at every value of the other keys, and the largest that is also near."""

from typing import Final, NamedTuple

import numpy as np

from canhaptic.control.verdict import PASSIVE_TOLERANCE
from canhaptic.lab.figures.field_figures import NEAR
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.studies.map.field import MapField, Mask
from canhaptic.lab.studies.sweep.chunk import RADIUS

JUDGEMENTS: Final = {
    "stable": "stable",
    "passive": "true sum(h_i) >= 0",
    "margin": "margin of (4) >= 0",
    "settled": "true sum(h_i) at the end >= 0",
    "covered": "true sum(h_i) + what the device dissipates >= 0",
}
"""Name -> what passing means, in words."""
_ENERGIES: Final = {
    "passive": "least_interaction",
    "margin": "margin",
    "settled": "interaction",
    "covered": "least_covered",
}
SHARE: Final = "stiffness_rendered.share"


class _Border(NamedTuple):
    """The largest value of a key that passes with all below it, or the largest near one of these.

    Arrays have the shape of the other keys of a field.

    NaN where a scene was not run; 0 where not even the least passes, or none is near; `open` where the largest passes.
    """

    value: Array
    open: Mask


def usual_judgement(field: MapField) -> str:
    """Return how an algorithm is judged unless the user says otherwise.

    The plain wall promises nothing of its port: with what the device dissipates it is stable or not, by the eigenvalues
    of the loop; where that is not linear, damping and dry friction of the device must cover at any moment what the port
    gave out, which is what Abbott and Okamura ask. The others are held to what they promise.
    """
    if field.algorithm == "unprotected":
        if field.has(RADIUS) and np.isfinite(field.figure(RADIUS)).any():
            return "stable"
        return next((name for name in ("covered", "settled") if field.has(_ENERGIES[name])), "passive")
    return "passive" if field.has("least_interaction") else "margin"


def _passes(field: MapField, judgement: str) -> Mask:
    """Return which scenes pass, shaped as a figure of the field."""
    if judgement != "stable":
        return np.asarray(field.figure(_ENERGIES[judgement]) >= -PASSIVE_TOLERANCE)
    passed = field.judged()
    if field.has("diverged"):
        passed &= field.figure("diverged") == 0.0
    if field.has(RADIUS) and field.algorithm == "unprotected":
        radius = field.figure(RADIUS)
        passed &= ~(radius >= 1.0)
    return passed


def passing_share(field: MapField, judgement: str) -> float:
    """Return the share of the judged scenes that pass."""
    judged = field.judged()
    return float((_passes(field, judgement) & judged).sum() / max(1, judged.sum()))


def common_judgement(field: MapField) -> str:
    """Return how all algorithms are judged together: as displays, device included, where that is known."""
    return next((name for name in ("covered", "passive") if field.has(_ENERGIES[name])), "margin")


def border_of(field: MapField, key: str, kept: list[str], judgement: str, *, near: bool = False) -> _Border:
    """Return the largest value of a key that passes, the worst over every key that is not kept.

    Args:
        field: A grid.
        key: Whose largest value is asked, as environment.stiffness.
        kept: Keys that the result has as dimensions, in this order.
        judgement: A name of `JUDGEMENTS`.
        near: Whether to return the largest of these values at which the stiffness is rendered within `NEAR`.
    """
    order = [field.keys.index(name) for name in (key, *kept)]
    others = [i for i in range(len(field.keys) + 1) if i not in order]
    passed = _passes(field, judgement).transpose(*order, *others)
    judged = field.judged().transpose(*order, *others)
    folded = tuple(range(1 + len(kept), passed.ndim))
    values = np.sort(field.values[key])
    rank = np.argsort(field.values[key])
    good = np.asarray((passed | ~judged).all(axis=folded))[rank]
    known = np.asarray(np.asarray(judged.any(axis=folded)).all(axis=0))
    below = np.logical_and.accumulate(good, axis=0)
    is_open = known & below[-1]
    if near:
        shares = field.figure(SHARE).transpose(*order, *others)
        below &= np.asarray(((np.abs(shares - 1.0) <= NEAR) | ~judged).all(axis=folded))[rank]
    column = values.reshape(-1, *(1,) * (below.ndim - 1))
    return _Border(np.where(known, np.where(below, column, 0.0).max(axis=0), np.nan), is_open)
