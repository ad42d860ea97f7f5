"""Stability hints: what the rate, the delay and the device allow, beside what the scene asks for."""

from typing import NamedTuple

from canhaptic.haptics.passivity.certificates import (
    reach,
    renderable_by_device_damping,
    renderable_by_hand_force,
    renderable_by_hand_speed,
    start_speed,
)
from canhaptic.haptics.recovery import largest_stable_damping, least_oscillating_damping
from canhaptic.scene.models import AxisScene

_LINEAR_ROTARY = {"stiffness": ("N/m", "N*m/rad"), "damping": ("N*s/m", "N*m*s/rad"), "speed": ("m/s", "rad/s")}


class Hint(NamedTuple):
    """One limit of an axis."""

    axis: str
    what: str  # the limit, in words
    limit: float | None  # None when it is not known
    asked: float | None  # by the scene; None where there is nothing to compare
    unit: str
    text: str  # where the limit comes from, or what to give so that it is known

    @property
    def exceeded(self) -> bool:
        """Whether the scene asks for more than the limit."""
        return self.limit is not None and self.asked is not None and self.asked > self.limit


def stability_hints(axis: AxisScene) -> list[Hint]:
    """Returns the limits of one axis; none of them is enforced here, the passivity algorithm is what protects."""
    return [*_stiffness_hints(axis), *_damping_hints(axis), *_certificate_hints(axis)]


def _hint(axis: AxisScene, what: str, quantity: str, limit: float | None, asked: float | None, text: str) -> Hint:
    unit = _LINEAR_ROTARY[quantity][axis.parameters.unit == "rad"]
    return Hint(axis.parameters.name, what, limit, asked, unit, text)


def _known(axis: AxisScene, key: str, of_plant: str) -> tuple[float | None, str]:
    """Returns a property of the device and where it comes from: declared, else that of the simulated plant."""
    declared = getattr(axis.loop, key)
    if declared is not None:
        return float(declared), f"{key} declared"
    if axis.simulation is not None:
        return float(getattr(axis.simulation.plant, of_plant)), f"{of_plant} of the simulated plant"
    return None, f"give passivity.{key}"


def _asked(axis: AxisScene, name: str) -> float | None:
    value = getattr(axis.environment.parameters, name, None)
    return float(value) if isinstance(value, int | float) else None


def _stiffness_hints(axis: AxisScene) -> list[Hint]:
    damping, source = _known(axis, "device_damping", "damping")
    stiffness, period, delay = _asked(axis, "stiffness"), axis.loop.sample_time, axis.loop.delay
    bound = None if damping is None else renderable_by_device_damping(damping, period, 0)
    what = "stiffness, Colgate's bound 2 b / T"
    hints = [_hint(axis, what, "stiffness", bound, stiffness, f"a plain wall is passive below; {source}")]
    if delay and damping is not None:
        bound = renderable_by_device_damping(damping, period, delay)
        what = f"stiffness at delay {delay}, 2 b / {1 + delay} T"
        hints.append(_hint(axis, what, "stiffness", bound, stiffness, f"held by the device's damping; {source}"))
    return hints


def _damping_hints(axis: AxisScene) -> list[Hint]:
    mass, source = _known(axis, "moving_mass", "mass")
    damping, period, delay = _asked(axis, "damping"), axis.loop.sample_time, axis.loop.delay
    ripples = None if mass is None else least_oscillating_damping(delay, mass, period)
    diverges = None if mass is None else largest_stable_damping(delay, mass, period)
    return [
        _hint(axis, "damping, no ripple", "damping", ripples, damping, f"delay {delay}; {source}"),
        _hint(axis, "damping, stable", "damping", diverges, damping, f"delay {delay}; {source}"),
    ]


def _certificate_hints(axis: AxisScene) -> list[Hint]:
    """Returns what the certificates declared for `guarded` can hold at the torque limit."""
    parameters, loop = axis.passivity.parameters, axis.loop
    stiffness, torque = _asked(axis, "stiffness"), axis.parameters.torque_limit
    hints = []
    hand_force = getattr(parameters, "hand_force", None)
    if hand_force is not None and loop.moving_mass is not None:
        least, most = loop.device_damping or 0.0, loop.device_damping_bound or 0.0
        response = reach(loop.sample_time, loop.moving_mass, hand_force, least, most)
        text = f"at the torque limit, hand force up to {hand_force:g}"
        limit = renderable_by_hand_force(response, loop.delay, torque)
        hints.append(_hint(axis, "stiffness, certified by hand force", "stiffness", limit, stiffness, text))
        limit = start_speed(response, loop.sample_time, loop.delay)
        text = "a contact from zero energy begins above this inward speed"
        hints.append(_hint(axis, "inward speed of a start", "speed", limit, None, text))
    hand_speed = getattr(parameters, "hand_speed", None)
    if hand_speed is not None:
        limit = renderable_by_hand_speed(hand_speed, loop.sample_time, loop.delay, torque)
        text = f"at the torque limit, hand speed up to {hand_speed:g}"
        hints.append(_hint(axis, "stiffness, certified by hand speed", "stiffness", limit, stiffness, text))
    return hints
