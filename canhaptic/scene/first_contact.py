"""Check of whether a wall is felt: the scene's own algorithm, with a handle that enters the wall at constant speed.

A handle at constant speed brings in the most energy possible at that speed, so that the algorithm limits the torque
least. Positions are encoder readings, and torques act in the declared hold; plant and bus are not simulated.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import copysign, inf, sin, tau
from random import Random
from typing import Any, Final, NamedTuple, cast

from canhaptic.axis_units import damping_unit, effort_unit
from canhaptic.control.environments import Environment
from canhaptic.errors import ParameterError
from canhaptic.scene.hints import LARGEST_ADVISED, LEAN, advised_allowance
from canhaptic.scene.models import AxisScene
from canhaptic.scene.parts import build_axis_controller, loop_as_known

FELT: Final = 0.5
"""Fraction of a wall's effort from which the wall counts as felt."""
_OUTSIDE: Final = 30
"""Number of holds before the contact."""
_MOST: Final = 600
"""Largest number of holds of one contact."""
_PRESS: Final = 1.0
"""Duration of a press on the wall with lost frames [s]."""
_MET: Final = 0.03
"""Speed at which a leaning hand meets the wall, as a fraction of the largest."""
_LEANS: Final = 1000
"""Number of holds for which the simulated hand leans on the wall when its stiffness is judged."""
_TREMOR: Final = 0.1
"""Tremor of a leaning hand, as a share of its force."""
_TREMBLES: Final = 8.0
"""Times that it does so meanwhile."""
_LOST: Final = (0.001, 0.003, 0.01, 0.03, 0.1)
"""Fractions of lost frames that are tried."""
_PHASE: Final = 0.37
"""Position between two encoder counts, as a fraction of a count."""
_SPEEDS: Final = tuple(3.0**-power for power in range(9))
"""Speeds that are tried, as fractions of the largest speed of the axis."""
_MANY_SKIPPED: Final = 0.01
"""Skipped SYNCs per cycle above which they count as the reason why nothing was rendered."""
_PARTS: Final = (1.0, 0.5, 0.25, 0.125)
"""Fractions of a handle's largest speed at which the rendered share of a wall is judged."""
_STEPS: Final = 6
"""Number of bisections of a speed or a value."""
_TO_BLAME: Final = ("current_lag", "torque_window", "hand_force", "device_friction_bound", "device_damping_bound")
"""Declarations that may keep a wall from being rendered; smaller values render more."""
ALLOWANCES: Final = tuple(10.0**power for power in range(-9, -2))
"""Values of `energy_allowance` that are tried [J]."""
_KEPT: Final = 128
"""Number of contacts that are kept, of at most `_MOST` holds each."""


@dataclass(frozen=True, slots=True)
class _Trial:
    """An axis that meets its wall; equal to each other one whose `parts` are equal, so that its contact is known."""

    axis: AxisScene = field(compare=False)
    speed: float
    parts: tuple[object, ...]


def _trial(axis: AxisScene, speed: float) -> _Trial:
    if axis.is_own:  # code of a user may do anything, and another thing the second time
        return _Trial(axis, speed, (object(),))
    known, loop = axis.parameters, loop_as_known(axis)
    parts = (axis.environment, axis.passivity, axis.guard, loop, axis.loop, known.torque_limit, known.hold_dither)
    return _Trial(axis, speed, parts)


class Remedy(NamedTuple):
    """A declaration that prevents a wall from being rendered, and a value that would allow it."""

    key: str
    value: float  # as declared
    enough: float  # value with which the wall is felt, all else unchanged
    unit: str

    @property
    def text(self) -> str:
        """Declaration and remedy in words."""
        enough = f"{self.enough:.1e}"
        if float(enough) > self.enough:  # rounded up, perhaps to the declared value
            step = 10.0 ** (int(enough.partition("e")[2]) - 1)
            enough = f"{float(enough) - step:.1e}"
        return f"{self.key} {self.value:.3g} {self.unit} prevents it, {float(enough):.2g} {self.unit} would not"


def can_be_tried(axis: AxisScene) -> bool:
    """Whether a contact can be computed: one impedance axis, fully read, with a wall that has an outside."""
    is_known = axis.is_read and hasattr(axis.environment.parameters, "contact")
    return is_known and _inward(_environment(axis)) is not None


def slowest_felt(axis: AxisScene) -> float | None:
    """Return the slowest approach at which the wall is felt [m/s or rad/s]; infinite if it is felt at none.

    None for an axis whose contact cannot be computed.
    """
    if not can_be_tried(axis):
        return None
    speeds = [part * axis.parameters.largest_speed for part in _SPEEDS]
    last = next((place for place in reversed(range(len(speeds))) if is_felt(axis, speeds[place])), None)
    if last is None:
        return inf
    if last == len(speeds) - 1:
        return speeds[last]
    low, high = speeds[last + 1], speeds[last]
    for _ in range(_STEPS):
        middle = (low * high) ** 0.5
        low, high = (low, middle) if is_felt(axis, middle) else (middle, high)
    return high


def is_felt(axis: AxisScene, speed: float) -> bool:
    """Return whether at least half of a wall is rendered in a contact at a speed [m/s or rad/s]."""
    return rendered_share(axis, speed) >= FELT


def rendered_share(axis: AxisScene, speed: float) -> float:
    """Return the fraction of the wall's effort that is rendered in a contact, 0 to 1.

    Args:
        axis: Axis for which `can_be_tried` is true.
        speed: Speed of the handle into the wall, constant, > 0 [m/s or rad/s].
    """
    asked = sent = 0.0
    try:
        for effort, torque in _contact(_trial(axis, speed)):
            asked += abs(effort)
            sent += min(abs(torque), abs(effort))
    except ParameterError:  # the algorithm refuses the declaration, as a window that is as long as a hold
        return 0.0
    return sent / asked if asked else 0.0


def halves_rendered(axis: AxisScene, speed: float, *, is_spent: bool = False) -> tuple[float, float] | None:
    """Return the rendered fractions of the effort against the motion and along it, 0 to 1.

    None if no effort acts along the motion. Beyond the crest of a detent the effort pulls the handle onward, which is
    felt as its snap.

    Args:
        axis: Axis for which `can_be_tried` is true.
        speed: Speed of the handle, constant, > 0 [m/s or rad/s].
        is_spent: Whether nothing is left of the `energy_allowance`.
    """
    axis = with_declared(axis, {"energy_allowance": 0.0}) if is_spent else axis
    found = _inward(_environment(axis))
    asked, sent = [0.0, 0.0], [0.0, 0.0]
    for effort, torque in _contact(_trial(axis, speed)) if found else ():
        half = int(effort * found[1] < 0.0) if found else 0
        asked[half] += abs(effort)
        sent[half] += min(max(0.0, -torque if effort > 0.0 else torque), abs(effort))
    return (sent[0] / asked[0], sent[1] / asked[1]) if all(asked) else None


def with_declared(axis: AxisScene, declared: Mapping[str, float]) -> AxisScene:
    """Return the axis with other values of keys in its section `passivity`, in SI."""
    of_loop = {key: value for key, value in declared.items() if key in type(axis.loop).model_fields}
    others = {key: value for key, value in declared.items() if key not in of_loop}
    parameters: Any = axis.passivity.parameters
    passivity = axis.passivity._replace(parameters=parameters.model_copy(update=others)) if others else axis.passivity
    return replace(axis, loop=axis.loop.model_copy(update=of_loop), passivity=passivity)


def remedies(axis: AxisScene, speed: float) -> list[Remedy]:
    """Return the declarations that hide a wall at a speed [m/s or rad/s], the smallest reduction first."""
    units = {"current_lag": "s", "torque_window": "s", "device_damping_bound": f"N*s/{axis.parameters.unit}"}
    found = []
    for key in _TO_BLAME:
        value = getattr(axis.loop, key, None) or getattr(axis.passivity.parameters, key, None)
        if not value or not is_felt(with_declared(axis, {key: 0.0}), speed):
            continue
        low, high = 0.0, 1.0
        for _ in range(_STEPS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if is_felt(with_declared(axis, {key: middle * value}), speed) else (low, middle)
        found.append(Remedy(key, value, low * value, units.get(key, effort_unit(axis.parameters.unit))))
    return sorted(found, key=lambda remedy: -remedy.enough / remedy.value)


def enough_allowance(axis: AxisScene, speed: float) -> float | None:
    """Return the least of `ALLOWANCES` with which the wall is felt at a speed [J]; None if none suffices."""
    if not hasattr(axis.passivity.parameters, "energy_allowance"):
        return None
    tried = ((each, with_declared(axis, {"energy_allowance": each})) for each in ALLOWANCES)
    return next((allowance for allowance, trial in tried if is_felt(trial, speed)), None)


def why_silent(axis: AxisScene, skipped: int, cycles: int) -> str:
    """Return why a run rendered nothing on an axis: skipped SYNCs first, then the declaration that prevents a wall.

    Args:
        axis: Axis of the scene.
        skipped: Number of SYNCs that were skipped in the run.
        cycles: Number of cycles of the run.
    """
    text = f"SYNCs skipped: {skipped}, sent: {cycles}, so no torque was certified for the holds that lasted longer"
    parts = [f"{text}; this host is too busy for the rate"] if skipped > _MANY_SKIPPED * cycles else []
    return "; ".join([*parts, *([advice(axis)] if can_be_tried(axis) else [])])


def advice(axis: AxisScene) -> str:
    """Return which declaration keeps a wall from being felt, and values that help."""
    slowest, unit = slowest_felt(axis) or inf, f"{axis.parameters.unit}/s"
    if slowest <= _SPEEDS[-1] * axis.parameters.largest_speed:
        return f"no declaration prevents it: an approach at {slowest:.3g} {unit} or faster starts this wall"
    begins = "no approach" if slowest == inf else f"an approach slower than {slowest:.3g} {unit}"
    aim = 0.01 * axis.parameters.largest_speed if slowest == inf else slowest / 3.0
    ways = [remedy.text for remedy in remedies(axis, aim)[:1]]
    if (allowance := enough_allowance(axis, aim)) is not None:
        own: Any = axis.passivity.parameters
        losses = int(getattr(own, "max_consecutive_losses", 0))
        least = advised_allowance(axis.loop, getattr(own, "hand_force", None) or 0.0, losses)
        room = float(f"{least:.2g}")
        is_whole = allowance <= room and least < LARGEST_ADVISED  # else it may be less than that wall needs
        covers = " and any wall up to half the certified stiffness" if is_whole else ""
        allowance = max(allowance, room)
        share = rendered_share(with_declared(axis, {"energy_allowance": allowance}), aim)
        ways.append(
            f"energy_allowance: {allowance:g} J starts it{covers}, {100.0 * share:.0f} % of it at {aim:.2g} {unit}"
        )
    if stiffness := getattr(axis.environment.parameters, "stiffness", None):
        needed = 0.5 * stiffness * axis.loop.sample_time * (1 + axis.loop.delay)
        ways.append(f"device_damping of {needed:.2g} {damping_unit(axis.parameters.unit)} holds it for every hand")
    return f"{begins} {'starts' if slowest == inf else 'does not start'} this wall; {'; '.join(ways) or 'see check'}"


def share_of_wall(axis: AxisScene, fastest: float, declared: Mapping[str, float]) -> float:
    """Return the fraction of a wall that is rendered during approach, averaged over several speeds.

    1 for an axis without a wall: in a group, an admittance display, or another environment.

    Args:
        axis: Axis with its environment and algorithm.
        fastest: Largest speed of the handle [m/s or rad/s].
        declared: Values of `passivity` that replace the axis's, SI.
    """
    if not can_be_tried(axis) or axis.passivity.own is not None:
        return 1.0
    trial = with_declared(axis, declared)
    return sum(rendered_share(trial, part * fastest) for part in _PARTS) / len(_PARTS)


def _environment(axis: AxisScene) -> Environment:
    return cast(Environment, axis.environment.parameters)  # every class of ENVIRONMENTS is one


def _inward(environment: Environment) -> tuple[float, float] | None:
    """Return where a contact begins [m or rad] and its direction, 1 or -1; None where none is found."""
    start = float(getattr(environment, "position", 0.0))
    if getattr(environment, "damps_by_place", False) and not getattr(environment, "pitch", 0.0):
        return (start, 1.0 if start == getattr(environment, "high", inf) else -1.0)  # a medium is felt on both sides
    return next(((start, sign) for sign in (1.0, -1.0) if environment.contact(start + sign * 1e-6)), None)


def kept_through_losses(axis: AxisScene, speed: float) -> list[tuple[float, float]]:
    """Return (fraction of lost frames, fraction of the wall that is felt in one second of pressing) for several losses.

    Each lost frame costs the energy that queued torques might have generated unseen (`certified_torque`); late torques,
    friction and a fast hand increase it, and pressing on brings it back. A hand pushes the declared mass, whose damping
    permits the speed; RPDO and TPDO of each cycle are lost at random.

    Args:
        axis: Axis for which `can_be_tried` is true.
        speed: Speed of the approach [m/s or rad/s].
    """
    trial = _trial(axis, speed)
    return [(share, _share_pressed(trial, share)) for share in _LOST]


def felt_stiffness(axis: AxisScene) -> tuple[float, float] | None:
    """Return the stiffness felt by a leaning hand and that of the wall [N/m or N*m/rad]; None without a spring.

    The hand meets the wall at `_MET` of the largest speed and leans on it for `_LEANS`, with up to `LEAN` of the torque
    limit, and not beyond `hand_push`. Mass, friction and counts are those declared.

    Args:
        axis: Axis for which `can_be_tried` is true.
    """
    environment, loop, limit = _environment(axis), axis.loop, axis.parameters.torque_limit
    asked, mass, (start, sign) = environment.linear_stiffness, loop.moving_mass, _inward(environment) or (0.0, 1.0)
    if not asked or mass is None:
        return None
    push = min(LEAN * limit, getattr(axis.passivity.parameters, "hand_push", None) or limit) / (1.0 + _TREMOR)
    controller, step, count = build_axis_controller(axis), loop.sample_time / mass, loop.encoder_count
    queue, velocity = [0.0] * (1 + loop.delay), _MET * sign * axis.parameters.largest_speed
    kept, braked = 1.0 + step * 2.0 * (push * mass * asked) ** 0.25, step * (loop.device_friction or 0.0)
    position, force, area = start - _OUTSIDE * loop.sample_time * velocity, 0.0, 0.0
    for hold in range(-_OUTSIDE, _LEANS):
        seen = count * round(position / count) if count else position
        queue.append(max(-limit, min(limit, controller.step(seen, queue[0]).torque)))
        del queue[0]
        if hold >= 0:
            hand = sign * push * (1.0 + _TREMOR * sin(_TREMBLES * tau * hold / _LEANS))
            velocity = (velocity + step * (queue[0] + hand)) / kept
            velocity = copysign(max(0.0, abs(velocity) - braked), velocity)
        position += velocity * loop.sample_time
        if 2 * hold > _LEANS and (depth := sign * (position - start)) > 0.0:
            force, area = force - sign * queue[0] * depth, area + depth * depth
    return (force / area if area else 0.0), asked


@lru_cache(maxsize=_KEPT)
def _share_pressed(trial: _Trial, lost: float) -> float:
    axis, speed = trial.axis, trial.speed
    environment, loop, limit = _environment(axis), axis.loop, axis.parameters.torque_limit
    start, sign = _inward(environment) or (0.0, 1.0)
    controller, chance, push = build_axis_controller(axis), Random(1), 0.5 * LEAN * limit
    step = loop.sample_time / (loop.moving_mass or 1.0)
    queue, position, velocity, acting = [0.0] * (1 + loop.delay), start, sign * speed, 0.0
    asked = sent = 0.0
    for hold in range(round(_PRESS / loop.sample_time)):
        is_heard = hold == 0 or chance.random() >= lost
        balance = controller.step(position, acting) if is_heard else controller.sample_lost()
        queue.append(max(-limit, min(limit, balance.torque)))
        torque = queue.pop(0)
        acting = torque if chance.random() >= lost else acting
        if environment.contact(position):
            effort = environment.effort(environment.true_state(position, 0.0, 0.0))
            asked, sent = asked + abs(effort), sent + min(abs(acting), abs(effort))
        velocity = (velocity + step * (acting + sign * push)) / (1.0 + step * push / speed)
        position += velocity * loop.sample_time
    return sent / asked if asked else 0.0


@lru_cache(maxsize=_KEPT)
def _contact(trial: _Trial) -> tuple[tuple[float, float], ...]:
    """Return the requested effort and the torque sent in each hold of a contact [N or N*m]."""
    return tuple(_holds(trial.axis, trial.speed))


def _holds(axis: AxisScene, speed: float) -> Iterator[tuple[float, float]]:
    environment, loop, limit = _environment(axis), axis.loop, axis.parameters.torque_limit
    found = _inward(environment)
    if found is None:
        return
    start, sign = found
    controller, step, count = build_axis_controller(axis), sign * speed * loop.sample_time, loop.encoder_count
    queue = [0.0] * (1 + loop.delay)
    for hold in range(-_OUTSIDE, _MOST):
        position = start + hold * step
        if count:
            position = count * (round(position / count) + _PHASE)
        torque = max(-limit, min(limit, controller.step(position, queue.pop(0)).torque))
        queue.append(torque)
        if environment.contact(position):
            effort = environment.effort(environment.true_state(position, 0.0, 0.0))
            yield effort, torque
            if abs(effort) >= LEAN * limit:
                return
