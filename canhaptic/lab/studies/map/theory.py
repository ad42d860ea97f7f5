"""What theory permits of a wall on a device, in closed form.

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

from canhaptic.errors import ParameterError
from canhaptic.lab.batch import scene_with, spectral_radius
from canhaptic.lab.loop.scenes import viscous_friction
from canhaptic.lab.studies.map.field import MapField
from canhaptic.lab.studies.sweep.chunk import BATCHED
from canhaptic.lab.studies.sweep.places import batch_key
from canhaptic.scene.hints import quantisation_bound, stability_hints
from canhaptic.scene.models import Scene

_ANGLES: Final = 4096
_TRIED: Final = np.geomspace(1.0, 1e8, 801)
"""Stiffnesses of which the loop's eigenvalues are taken [N/m or N*m/rad]."""


def colgate_stiffness(damping: float, wall_damping: float, sample_time: float, delay: int) -> float:
    """Return the largest stiffness [N/m or N*m/rad] that the condition above permits.

    Args:
        damping: b of the device [N*s/m or N*m*s/rad].
        wall_damping: Damping of the wall, on the backward difference of the position [N*s/m or N*m*s/rad].
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


class Theory(NamedTuple):
    """Largest stiffness by each theory [N/m or N*m/rad]; None where it says nothing."""

    colgate: float | None  # passive for every hand
    abbott_okamura: float | None  # the same, of encoder and dry friction
    eigenvalues: float | None  # the plain wall touched all the time, with the hand of the scene, is stable
    certificate: float | None  # the largest that a certificate of the scene's own algorithm holds


def theory_at(field: MapField, values: Mapping[str, float]) -> Theory:
    """Return what theory says at some values of a field's keys.

    Args:
        field: Whose scene and axis are meant.
        values: Key -> value; keys that no formula knows are left out.
    """
    names = {batch_key(key, field.index, field.axis): value for key, value in values.items()}
    return theory_of(scene_with(field.scene, {name: value for name, value in names.items() if name in BATCHED}))


def theory_of(scene: Scene) -> Theory:
    """Return what theory says of the wall of a scene with one simulated axis, for any stiffness."""
    [axis] = scene.axes
    simulation, environment = axis.simulation, axis.environment.parameters
    if simulation is None or not hasattr(environment, "stiffness"):
        return Theory(None, None, None, None)
    delay = scene.bus.delay
    device = simulation.plant.damping + viscous_friction(simulation)
    wall = float(getattr(environment, "damping", 0.0))
    colgate = colgate_stiffness(device, wall, scene.bus.sample_time, delay)
    friction = quantisation_bound(axis)
    friction = friction if friction and math.isfinite(friction) else None
    certified = [hint.limit for hint in stability_hints(axis) if hint.certificate and hint.limit is not None]
    return Theory(
        colgate,
        friction if delay == 0 and wall == 0.0 else None,
        _stable_stiffness(scene),
        max(certified, default=None),
    )


def _stable_stiffness(scene: Scene) -> float | None:
    """Return up to which stiffness the plain wall is stable by its eigenvalues; None where the loop is not linear."""
    try:
        radii = spectral_radius(scene, {"environment.stiffness": _TRIED})
    except (ParameterError, NotImplementedError):
        return None
    count = int(np.logical_and.accumulate(radii < 1.0).sum())
    return float(_TRIED[count - 1]) if count else 0.0
