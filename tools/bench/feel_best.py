"""How stiff a wall any law can hold against a push that rises, where no energy was there before the contact.

The law keeps S, the sum of all energy that came in, at or above 0 for every hand that pulls with F_h at most. For any
such law, and though it knew the push u(t) beforehand:

1. From S = 0 no torque acts before the handle moves in faster than v_0 = (1 + delay) F_h T / m, for a hand that pulls
   with F_h from then on turns it within the holds under way, and takes energy out. So the handle flies freely up to the
   time t_1 of that speed, at the depth x_1, with the work of the push W_1 = m v_0^2 / 2.
2. Kinetic energy and S are both at least 0, and their sum is at most the work W of the push. A way out costs u per
   length, which rises with time, and the speed is at most sqrt(2 W / m): no motion is at any depth earlier, or has
   more work left there, than the bounce that turns all of the work around at once at x_1, m x'' = u. Its turning point
   is the least depth that is ever reached again; a way in and out between loses work.
3. At rest under the whole push P the hand may begin to pull: S must be what the holds under way and the next one may
   give out, N = P sum(D_i), which is P^2 / 2k of `renderable_by_hand_force`.

With x_low(t) the depth of the bounce, and from its turning point on the depth of that, W = integral of u dx by parts
is

    N <= W_1 + P x_f - u_1 x_1 - integral of x_low du   from t_1 to the end of the rise:

a least depth x_f at rest, and a largest stiffness (`bound_from_nothing`). Losses only make it smaller.

`best_from_nothing` is closer: in every hold the torque is a part between 0 and 1 of the largest with which S stays at
or above 0 for every hand (at any larger one there is a hand for which it does not), and a search by cross entropy over
all of these parts looks for the least depth. The end of the rise is judged as if nothing were lost from then on. At
100 Hz what it finds is the whole of the largest torque in every hold.
"""

from collections.abc import Iterator
from math import inf, sqrt
from typing import Any, Final

import numpy as np

from canhaptic.control.certificates.scalar_bounds import displacement_response, renderable_by_hand_force
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.studies.design.contact_quality import Leaning
from tools.bench.report import Row

_STEPS: Final = 100_000
_TRIED: Final = 1000
_BEST: Final = 20  # of them, from which the next are drawn
_ROUNDS: Final = 40


def bound_from_nothing(sample_time: float, delay: int, mass: float, hand_force: float, leaning: Leaning) -> float:
    """Returns a stiffness [N/m] that no law holds more than within the tolerance; infinite where there is no bound.

    Args:
        sample_time: [s].
        delay: In holds.
        mass: [kg].
        hand_force: [N].
        leaning: The push.
    """
    response = displacement_response(sample_time, mass, hand_force)
    push, rate = leaning.push, leaning.push / leaning.rise
    fastest = (1 + delay) * response.hand / sample_time
    begins = sqrt(2.0 * mass * fastest / rate)
    depth = rate * begins**3 / (6.0 * mass) - leaning.clearance
    if begins > leaning.rise or depth < 0.0:  # for contacts that begin in the wall while the push rises
        return inf
    work, now = 0.5 * mass * fastest**2, rate * begins
    step, low, speed, area = (leaning.rise - begins) / _STEPS, depth, fastest, 0.0
    for place in range(_STEPS):
        if speed > 0.0:
            slower = (now + rate * (place + 0.5) * step) / mass * step
            low -= (speed - 0.5 * slower) * step
            speed -= slower
        area += low * rate * step
    needed = push * push / (2.0 * renderable_by_hand_force(response, delay, push))
    rest = (needed - work + now * depth + area) / push
    return push / rest / (1.0 - leaning.tolerance)


def best_from_nothing(sample_time: float, delay: int, mass: float, hand_force: float, leaning: Leaning) -> float:
    """Returns the largest stiffness [N/m] that the search finds; arguments of `bound_from_nothing`."""
    holds = round(leaning.rise / sample_time)
    draw, middle, width = np.random.default_rng(0), np.full(holds, 0.8), np.full(holds, 0.4)
    deepest = inf
    for tried in range(_ROUNDS):
        parts = np.clip(middle + width * draw.standard_normal((_TRIED, holds)), 0.0, 1.0)
        parts[0], parts[1] = 1.0, middle
        depths = depths_of(parts, sample_time, delay, mass, hand_force, leaning)
        best = np.argsort(depths)[:_BEST]
        deepest = min(deepest, float(depths[best[0]]))
        middle = 0.3 * middle + 0.7 * parts[best].mean(axis=0)
        width = 0.3 * width + 0.7 * parts[best].std(axis=0) + 0.02 * (1.0 - tried / _ROUNDS)
    return leaning.push / deepest / (1.0 - leaning.tolerance)


def depths_of(parts: Array, sample_time: float, delay: int, mass: float, hand_force: float, leaning: Leaning) -> Array:
    """Returns the depth at rest [m] at best after each sequence of parts of the largest torque, rows of `parts`."""
    count, holds = parts.shape
    half, pull = sample_time**2 / (2.0 * mass), hand_force * sample_time**2 / mass
    depth, speed = np.full(count, -leaning.clearance), np.zeros(count)
    stored, moved, before, waiting = np.zeros(count), np.zeros(count), np.zeros(count), np.zeros(count)
    rate = leaning.push / leaning.rise
    for k in range(holds):
        budget, base = stored, -moved + half * before + pull
        if delay:
            under_way = base + half * waiting
            budget, base = stored - waiting * under_way, under_way + half * waiting + pull
        torque = _largest(budget, base, half) * parts[:, k]
        acting = waiting if delay else torque
        force = rate * k * sample_time - acting
        moved = speed * sample_time + half * force + rate * sample_time**3 / (6.0 * mass)
        speed = speed + force * sample_time / mass + rate * half
        depth, stored, before, waiting = depth + moved, stored + acting * moved, acting, torque
    response = displacement_response(sample_time, mass, hand_force)
    needed = leaning.push**2 / (2.0 * renderable_by_hand_force(response, delay, leaning.push))
    found: Array = depth + (needed - 0.5 * mass * speed**2 - stored) / leaning.push
    return found


def _largest(budget: Array, base: Array, gain: float) -> Array:
    """Returns `hand_force_bound` of each."""
    root = np.sqrt(np.maximum(base * base + 4.0 * gain * budget, 0.0))
    outward = np.where(budget > 0.0, 2.0 * budget / np.maximum(root + base, 1e-300), 0.0)
    found: Array = np.maximum(0.0, np.where(base <= 0.0, (root - base) / (2.0 * gain), outward))
    return found


def rows_of(loops: dict[str, tuple[float, int, float]], hands: Any, mass: float, push: float) -> Iterator[Row]:
    """Both for each loop and hand force."""
    leaning = Leaning(push=push)
    for loop, hand_force in hands:
        rate, delay, _ = loops[loop]
        of = (1.0 / rate, delay, mass, hand_force, leaning)
        name = f"{loop}, F_h {hand_force:g} N, from nothing"
        yield Row(f"no law holds more, {name}", bound_from_nothing(*of), "N/m")
        yield Row(f"best law that knows the push, {name}", best_from_nothing(*of), "N/m")
