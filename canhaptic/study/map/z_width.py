"""Z-width: the largest stiffness that passes at every value of the other keys, and what theory says of it.

Colgate and Schenkel, "Passivity of a class of sampled-data systems", Journal of Robotic Systems 14, 1997: with the
damping b of the device a sampled wall H(z) is passive for every user if and only if, at every frequency,

    b > T / (2 - 2 cos wT) * Re{(1 - e^-jwT) H(e^jwT)}

For a spring k without delay that is b > k T / 2. Abbott and Okamura (IEEE Trans. Robotics 21, 2005) add the encoder:
the Coulomb friction of the device must cover half a count of the spring, k < 2 f_c / count: for a wall without a damper
and without delay, on a device that has such friction; nothing is said of any other.
"""

import math
from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np

from canhaptic.control.balance import PASSIVE_TOLERANCE
from canhaptic.scene.hints import quantisation_bound
from canhaptic.scene.models import Scene
from canhaptic.study.batch import scene_with
from canhaptic.study.loop import Array
from canhaptic.study.map.field import MapField, Mask
from canhaptic.study.scenes import viscous_friction
from canhaptic.study.sweep.chunk import BATCHED, RADIUS
from canhaptic.study.sweep.places import batch_key

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
_ANGLES: Final = 4096


class _Border(NamedTuple):
    """The largest value of a key that passes, and all below it; shape of the other keys of a field.

    NaN where a scene was not run; 0 where not even the least passes; `open` where the largest does, too.
    """

    value: Array
    open: Mask


def usual_judgement(field: MapField) -> str:
    """Returns how an algorithm is judged unless the user says otherwise.

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
    """Returns which scenes pass, shaped as a figure of the field."""
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
    """Returns the share of the judged scenes that pass."""
    judged = field.judged()
    return float((_passes(field, judgement) & judged).sum() / max(1, judged.sum()))


def border_of(field: MapField, key: str, kept: list[str], judgement: str) -> _Border:
    """Returns the largest value of a key that passes, the worst over every key that is not kept.

    Args:
        field: A grid.
        key: Whose largest value is asked, as environment.stiffness.
        kept: Keys that the result has as dimensions, in this order.
        judgement: A name of `JUDGEMENTS`.
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
    count = np.logical_and.accumulate(good, axis=0).sum(axis=0)
    largest = np.where(count > 0, values[np.maximum(count, 1) - 1], 0.0)
    return _Border(np.where(known, largest, np.nan), known & (count == len(values)))


def colgate_stiffness(damping: float, wall_damping: float, sample_time: float, delay: int) -> float:
    """Returns the largest stiffness [N/m or N*m/rad] that the condition above permits.

    Args:
        damping: b of the device [N*s/m or N*m*s/rad].
        wall_damping: Of the wall, on the backward difference of the position [N*s/m or N*m*s/rad].
        sample_time: T [s].
        delay: Whole holds, inside H.
    """
    angle = np.linspace(math.pi / _ANGLES, math.pi, _ANGLES)
    forward = 1.0 - np.exp(-1j * angle)
    common = forward * np.exp(-1j * delay * angle) / (2.0 * (1.0 - np.cos(angle)))
    of_spring, of_damper = sample_time * common.real, (common * forward).real
    left = damping - wall_damping * of_damper
    if float(left.min()) <= 0.0:
        return 0.0
    asked = of_spring > 0.0
    return float((left[asked] / of_spring[asked]).min())


class _Theory(NamedTuple):
    """What theory permits at one place of a map [N/m or N*m/rad]; None where it says nothing."""

    colgate: float | None
    abbott_okamura: float | None


def theory_at(field: MapField, values: Mapping[str, float]) -> _Theory:
    """Returns the lines of theory for the plain wall at some values of a field's keys.

    Args:
        field: Whose scene and axis are meant.
        values: Key -> value; keys that no formula knows are left out.
    """
    scene = _scene_at(field, values)
    [axis] = scene.axes
    simulation, environment = axis.simulation, axis.environment.parameters
    if simulation is None or not hasattr(environment, "stiffness"):
        return _Theory(None, None)
    delay = scene.bus.delay
    device = simulation.plant.damping + viscous_friction(simulation)
    wall = float(getattr(environment, "damping", 0.0))
    colgate = colgate_stiffness(device, wall, scene.bus.sample_time, delay)
    friction = quantisation_bound(axis)
    friction = friction if friction and math.isfinite(friction) else None
    return _Theory(colgate, friction if delay == 0 and wall == 0.0 else None)


def _scene_at(field: MapField, values: Mapping[str, float]) -> Scene:
    names = {batch_key(key, field.index, field.axis): value for key, value in values.items()}
    return scene_with(field.scene, {name: value for name, value in names.items() if name in BATCHED})
