"""Certificates that rest on a declared hand, tried on many hands at once: AD9.

A study of two cases; the controller has one proof for both, `canhaptic.control.admittance.declared_hand`.

Spring first (a): a hand is a spring of at most K_e whose far side retreats at most at w. The drive is a P loop of
lag l = M / c. With x the way to the stop, x = l v + T (sum of u under way + u), and t = (1 + d) T + 3 l,

    E + F x - K_e x^2 / 2 - K_e w t x >= 0,       F taken (1 - K_e t / c) times where it is positive

Rigid mass (b): at most m on the handle, a damper of at most b that moves with it, and the spring; a drive that tracks
a ramp of the velocity, u0 -> u1 in a hold, without delay. The force that was read carries -m a_k, so that after a way x
in a time t, at the speed v, and as long as the handle has not turned

    E1 >= E + x (F - b (u1 - u0)+ - K_e x / 2 - K_e w t) - m ((v^2 - u0^2) / 2 - a_k x)       for m and for 0

as the integral of m a v is m (v^2 - u0^2) / 2. It must hold along the hold and on along the way to a stop, in whole
holds at the largest deceleration: that way is then open at the next SYNC, for every motion of the hand.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_PARTS: Final = 40  # of a hold, of the integration
_ROUNDING: Final = 1e-9  # [J]
_STILL: Final = 1e-9  # [m/s]


@dataclass(frozen=True)
class SpringRig:
    """A rig of (a)."""

    time: float  # T [s]
    delay: int
    mass: float  # [kg]
    gain: float  # c [N*s/m]
    virtual_mass: float  # [kg]
    stiffest: float = 2000.0  # K_e [N/m]
    retreat: float = 1.0  # w [m/s]


SPRING_RIGS: Final = (
    SpringRig(1e-3, 0, 2.0, 628.0, 0.05),
    SpringRig(1e-3, 1, 2.0, 628.0, 0.1),
    SpringRig(1e-3, 1, 2.0, 1257.0, 0.05),
    SpringRig(2e-3, 1, 1.0, 314.0, 0.1),
    SpringRig(4e-3, 0, 2.0, 628.0, 0.2),
    SpringRig(4e-3, 1, 1.0, 314.0, 0.2),
)


def _far_sides(random: np.random.Generator, hands: int, holds: int, fastest: float, time: float) -> Array:
    """Returns speeds of the far sides in each hold [m/s], shape (holds, hands): steps, ramps and sines."""
    kinds = random.integers(0, 3, hands)
    k = np.arange(holds)[:, None] * time
    rate, phase = random.uniform(0.5, 20.0, hands), random.uniform(-np.pi, np.pi, hands)
    wave = np.sin(2.0 * np.pi * rate * k + phase)
    shapes = np.stack([np.sign(wave), wave, np.clip(3.0 * wave, -1.0, 1.0)])
    return np.asarray(fastest * random.uniform(0.3, 1.0, hands) * np.take_along_axis(shapes, kinds[None, None], 0)[0])


def spring_energies(
    rig: SpringRig, hands: int, seed: int, *, simple: bool = False, seconds: float = 1.5
) -> tuple[Array, float]:
    """Returns the least energy of each hand [J], shape (hands,), and the part of the holds in which it moves.

    Args:
        rig: The display.
        hands: How many, springs of up to K_e.
        seed: Of them.
        simple: Whether the way to the stop is taken as that of one hold alone, of a drive that tracks perfectly and a
            far side at rest: the dual of the paper's certificate of a hand speed.
        seconds: Of each run.
    """
    random, holds = np.random.default_rng(seed), round(seconds / rig.time)
    stiffness = rig.stiffest * random.choice([0.1, 0.5, 1.0], hands)
    sides = _far_sides(random, hands, holds, rig.retreat, rig.time)
    lag = rig.mass / rig.gain
    span = (1 + rig.delay) * rig.time + 3.0 * lag
    position, speed, far, energy, least = (np.zeros(hands) for _ in range(5))
    rendered, moved = np.zeros(hands), 0
    queue = [np.zeros(hands) for _ in range(rig.delay)]
    for hold in range(holds):
        force = stiffness * (far - position)
        request = rendered + rig.time * force / rig.virtual_mass
        sign = np.where(request >= 0.0, 1.0, -1.0)
        along = sign * force
        under_way = sign * sum(queue, np.zeros(hands))
        base = np.zeros(hands)
        if not simple:
            along = np.where(along > 0.0, along * (1.0 - rig.stiffest * span / rig.gain), along)
            along = along - rig.stiffest * rig.retreat * span
            base = lag * sign * speed + rig.time * under_way
        inside = along * along + 2.0 * rig.stiffest * np.maximum(energy, 0.0)
        way = (along + np.sqrt(inside)) / rig.stiffest
        most = np.maximum((way - base) / rig.time, 0.0)
        command = sign * np.minimum(np.abs(request), most)
        rendered = command
        moved += int((np.abs(command) > _STILL).sum())
        queue.append(command)
        acting = queue.pop(0)
        position, speed, far, energy, lowest = _follow(
            rig, stiffness, acting, sides[hold], (position, speed, far, energy)
        )
        least = np.minimum(least, lowest)
    return least, moved / (holds * hands)


def _follow(
    rig: SpringRig, stiffness: Array, command: Array, side: Array, state: tuple[Array, ...]
) -> tuple[Array, ...]:
    """Returns position, speed, far side, energy and the least energy after a hold (Runge-Kutta, order 4)."""
    step, y = rig.time / _PARTS, np.stack(state)

    def rates(now: Array) -> Array:
        force = stiffness * (now[2] - now[0])
        return np.stack([now[1], (rig.gain * (command - now[1]) + force) / rig.mass, side, force * now[1]])

    lowest = y[3]
    for _ in range(_PARTS):
        first = rates(y)
        second = rates(y + 0.5 * step * first)
        third = rates(y + 0.5 * step * second)
        y = y + step / 6.0 * (first + 2.0 * second + 2.0 * third + rates(y + step * third))
        lowest = np.minimum(lowest, y[3])
    return y[0], y[1], y[2], y[3], lowest


@dataclass(frozen=True)
class MassRig:
    """A rig of (b)."""

    time: float = 1e-3  # [s]
    ramp: float = 10.0  # largest acceleration [m/s^2]
    virtual_mass: float = 0.5  # [kg]
    stiffest: float = 2000.0  # [N/m]
    retreat: float = 1.0  # [m/s]
    mass: float = 2.0  # m [kg]
    damping: float = 20.0  # b [N*s/m]


def mass_energies(
    rig: MassRig, hands: int, seed: int, *, brakes: bool = True, seconds: float = 0.5
) -> tuple[Array, float]:
    """Returns the least energy of each hand [J] and the part of the holds in which it moves.

    Args:
        rig: The display.
        hands: How many, with masses, dampers and springs of up to what is declared.
        seed: Of them.
        brakes: Whether the way to a stop must fit, and not the next hold alone.
        seconds: Of each run.
    """
    random, holds, time = np.random.default_rng(seed), round(seconds / rig.time), rig.time
    stiffness = rig.stiffest * random.choice([0.1, 0.5, 1.0], hands)
    mass, damping = (
        rig.mass * random.choice([0.0, 0.3, 1.0], hands),
        rig.damping * random.choice([0.0, 0.3, 1.0], hands),
    )
    sides = _far_sides(random, hands, holds, rig.retreat, time)
    position, speed, far, energy, least, rise = (np.zeros(hands) for _ in range(6))
    moving, change = 0, rig.ramp * time
    parts = np.linspace(-1.0, 1.0, 41)[:, None] * change  # changes of the speed that are tried
    for hold in range(holds):
        side = sides[hold]
        force = stiffness * (far - position) - damping * speed - mass * rise
        request = speed + time * force / rig.virtual_mass
        tried = speed + parts
        fits = _fits(rig, energy, force, speed, tried, rise, brakes=brakes)
        off = np.where(fits, np.abs(tried - request), np.inf)
        best = off.argmin(axis=0)
        none = ~np.isfinite(off).any(axis=0)
        towards_rest = speed * (1.0 - 1.0 / np.maximum(np.ceil(np.abs(speed) / change - 1e-9), 1.0))
        after = np.where(none, towards_rest, np.take_along_axis(tried, best[None], 0)[0])
        moving += int((np.abs(after) > _STILL).sum())
        rise = (after - speed) / time
        fine = (np.arange(_PARTS) + 0.5)[:, None] * time / _PARTS
        velocity = speed + rise * fine
        place = position + speed * fine + 0.5 * rise * fine * fine
        through = (stiffness * (far + side * fine - place) - damping * velocity - mass * rise) * velocity
        course = energy + np.cumsum(through, axis=0) * time / _PARTS
        least = np.minimum(least, course.min(axis=0))
        energy = course[-1]
        position, speed, far = position + 0.5 * (speed + after) * time, after, far + side * time
    return least, moving / (holds * hands)


def _fits(
    rig: MassRig, energy: Array, force: Array, speed: Array, tried: Array, rise: Array, *, brakes: bool
) -> NDArray[np.bool_]:
    """Returns which speeds after the next hold keep the energy above zero, shape (tried, hands)."""
    sign = np.where(speed != 0.0, np.sign(speed), np.where(tried >= 0.0, 1.0, -1.0))
    begin, end = np.abs(speed), sign * tried
    found = end >= 0.0  # a hold never turns
    end = np.maximum(end, 0.0)
    along = sign * force - rig.damping * np.maximum(end - begin, 0.0)
    gained, first = sign * rise, 0.5 * (begin + end) * rig.time
    points = [(share, begin + share * (end - begin)) for share in (0.25, 0.5, 0.75, 1.0)]
    course = [(share * rig.time, 0.5 * (begin + v) * share * rig.time, v) for share, v in points]
    if brakes:
        holds = np.ceil(end / (rig.ramp * rig.time) - 1e-9)
        for share in np.linspace(0.125, 1.0, 8):
            v = end * (1.0 - share)
            course.append((rig.time * (1.0 + holds * share), first + 0.5 * (end + v) * holds * share * rig.time, v))
    for elapsed, way, v in course:
        force_part = along * way - 0.5 * rig.stiffest * way * way - rig.stiffest * rig.retreat * elapsed * way
        for mass in (0.0, rig.mass):
            found &= energy + force_part - mass * (0.5 * (v * v - begin * begin) - gained * way) >= 0.0
    return np.asarray(found)


def below(energies: Array) -> int:
    """Returns how many hands got more than they gave."""
    return int((energies < -_ROUNDING).sum())
