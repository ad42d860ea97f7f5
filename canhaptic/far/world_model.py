"""What a program that is slower than the SYNC asks for: a wall, or a spring to a point, at this rig's own rate.

A program says something new now and then, and it may say anything: a wall that appears, jumps over the hand, moves,
turns stiffer or goes. The change of the effort that a new word would make at once is kept as an offset, and the offset
fades: by at most a part of the torque limit in a hold, and towards more effort only as the tank pays. So the effort of
the model changes in a step only where the hand moves. No promise rests on this; the guard bounds what is sent.
"""

from dataclasses import dataclass
from typing import Final

SPRING: Final = 2.0
"""Kind of a spring to a point; 1.0 and -1.0 are walls that a hand presses upward and downward, 0.0 is nothing."""
_AHEAD: Final = 0.05
"""Time for which a wall is believed to move on as the last word said [s]: three turns of a program at 60 Hz."""
_MOST: Final = 1e9
"""Effort beyond which a model is cut, so that it stays a number [N or N*m]."""
LED: Final = 0.02
"""Share of the spare energy by which a wall grows, or comes nearer to its place, in a hold."""


@dataclass(slots=True)
class WorldState:
    """What a program has said, and what is rendered of it."""

    stiffness: float = 0.0  # as said last [N/m or N*m/rad]
    damping: float = 0.0  # as said last [N*s/m or N*m*s/rad]
    told_at: float = 0.0  # newest place that was said [m or rad]
    told_speed: float = 0.0  # [m/s or rad/s]
    age: float = 0.0  # of that word [s]
    kind: float = 0.0  # of what was rendered in the hold before
    at: float = 0.0  # its place, moved on [m or rad]
    speed: float = 0.0
    used_stiffness: float = 0.0
    used_damping: float = 0.0
    offset: float = 0.0  # effort that is still to fade [N or N*m]
    effort: float = 0.0  # of the hold before [N or N*m]
    stored: float = 0.0  # energy of the spring that is rendered [J]


def forget(state: WorldState) -> None:
    """Begin without anything that was said."""
    state.stiffness = state.damping = state.told_at = state.told_speed = state.age = state.kind = state.at = 0.0
    state.speed = state.used_stiffness = state.used_damping = state.offset = state.effort = state.stored = 0.0


def effort_in(state: WorldState, position: float, velocity: float) -> float:
    """Return the effort of the model in use without its offset [N or N*m]."""
    stretch, kind = position - state.at, state.kind
    effort = state.used_stiffness * stretch + state.used_damping * (velocity - state.speed)
    if kind == 0.0 or (kind != SPRING and (kind * stretch <= 0.0 or kind * effort <= 0.0)):
        return 0.0
    return min(max(effort, -_MOST), _MOST)


def take_word(state: WorldState, kind: float, at: float, speed: float, time: float) -> None:
    """Use what was said last, moved on for the time since then."""
    is_new = at != state.told_at or speed != state.told_speed
    state.age = 0.0 if is_new else state.age + time
    state.told_at, state.told_speed = at, speed
    is_moving = state.age < _AHEAD
    state.kind, state.speed = kind, speed if is_moving else 0.0
    state.at = at + speed * min(state.age, _AHEAD)
    state.used_stiffness, state.used_damping = state.stiffness, state.damping


def led_effort(
    state: WorldState, kind: float, at: float, speed: float, position: float, velocity: float, time: float,
    limit: float, slew: float, energy: float,
) -> float:  # fmt: skip
    """Return the effort of what a program asks for [N or N*m], without a step where only its word changed.

    Args:
        state: What was rendered before.
        kind: Kind of the model that was said last.
        at: Its place [m or rad].
        speed: Its speed [m/s or rad/s].
        position: Position of the hand [m or rad].
        velocity: Velocity of the hand [m/s or rad/s].
        time: Sample time [s].
        limit: Largest effort [N or N*m].
        slew: Most by which an offset fades in a hold [N or N*m].
        energy: Energy in the tank [J].
    """
    before = effort_in(state, position, velocity)
    total, pulled = before + state.offset, max(0.0, -state.kind * state.effort)
    if state.kind != SPRING and -state.kind * total > pulled:  # a hand that leaves a wall is not pulled by the offset
        total = -state.kind * pulled
    take_word(state, kind, at, speed, time)
    now, stiffness = effort_in(state, position, velocity), state.used_stiffness
    offset, step = total - now, slew
    if offset * total <= 0.0 and stiffness > 0.0 and now != 0.0:  # it grows
        spare = max(0.0, energy - 0.5 * total * total / stiffness)
        step = min(slew, LED * spare * stiffness / max(abs(total), slew))
    offset = max(0.0, offset - step) if offset > 0.0 else min(0.0, offset + step)
    state.effort = min(max(now + offset, -limit), limit)
    state.offset = state.effort - now
    state.stored = 0.5 * state.effort * state.effort / stiffness if stiffness > 0.0 else 0.0
    return state.effort
