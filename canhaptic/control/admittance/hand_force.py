"""Largest certified speed of a drive without an integral, for a hand of bounded force: abs(F) <= f.

With r = 0 such a hand can take from a speed v just

    G(v) = f (M / c) (v - (f / c) ln(1 + c v / f)),        less than M v^2 / 2 and than f v M / c

by braking with f until the handle stops. For commands r, with E' = F v and M v' = c (r - v) + F - friction:

    (E - G)' >= -f abs(r)

Proof. G' = f M v / (f + c v) for v >= 0; for v < 0 turn the signs of v, r and F. Then (E - G)' + f abs(r) is
F v - f v (c (r - v) + F - friction) / (f + c v) + f abs(r). The terms of r are f (abs(r) - r c v / (f + c v)) >= 0.
That of friction is not negative. Those of F are F c v^2 / (f + c v), least at F = -f; the rest, f c v^2 / (f + c v),
makes up for them. At v = 0 both sides have G' = 0. The drive must not reach its torque limit (`may_limit`).

So commands with f T (sum abs(u_i) under way + n abs(u)) <= E - G + allowance keep E >= -allowance for every hand that
never pushes or pulls harder than f. The range of a force sensor is no such promise.
"""

from dataclasses import dataclass
from math import log1p, sqrt

from canhaptic.control.admittance.motion import DisplayMotion
from canhaptic.control.admittance.velocity_loop import VelocityLoopSettings, largest_square
from canhaptic.kernels import Buffer


@dataclass(frozen=True, slots=True)
class HandForceSettings:
    """Declared properties of the hand."""

    force: float  # f, the largest that it pushes or pulls with [N or N*m]; 0: not declared


def held_back(settings: HandForceSettings, loop: VelocityLoopSettings, speed: float) -> float:
    """Return G at a largest speed [J]."""
    force, gain = settings.force, loop.gain_least
    rest = speed - force / gain * log1p(gain * speed / force)
    return force * loop.mass / gain * rest


def lost_to_hand(
    settings: HandForceSettings, loop: VelocityLoopSettings, commands: Buffer, motion: DisplayMotion
) -> float:
    """Return the largest loss of E - G in the hold that ended [J]."""
    square = largest_square(commands, motion, loop.delay, loop.delay + loop.losses)
    return settings.force * loop.sample_time * sqrt(square)


def fastest_for_hand(
    settings: HandForceSettings, loop: VelocityLoopSettings, commands: Buffer, motion: DisplayMotion, budget: float
) -> float:
    """Return the largest speed that may be commanded now [m/s or rad/s].

    In each hold that a lost RPDO may lengthen, the largest command that may act counts: the new one in all of its
    holds where it is the largest of all, else in its last alone, and then it is no larger than the one before.
    """
    left = budget / (settings.force * loop.sample_time)
    for age in range(loop.delay):
        left -= sqrt(largest_square(commands, motion, age, age + loop.losses))
    if left <= 0.0:
        return 0.0
    everywhere = left / (1 + loop.losses)
    if loop.losses == 0 or everywhere >= sqrt(largest_square(commands, motion, 0, loop.losses - 1)):
        return everywhere
    for hold in range(loop.losses):
        left -= sqrt(largest_square(commands, motion, 0, loop.losses - 1 - hold))
    last = abs(commands[motion.newest])
    return max(0.0, min(left, last))


def used_by_hand(
    settings: HandForceSettings, loop: VelocityLoopSettings, commands: Buffer, motion: DisplayMotion
) -> float:
    """Return the largest loss of E - G by the commands that may still act, the newest included [J]."""
    total = 0.0
    for age in range(1, loop.delay + 1):
        total += sqrt(largest_square(commands, motion, age, age + loop.losses))
    for hold in range(loop.losses + 1):
        total += sqrt(largest_square(commands, motion, 0, loop.losses - hold))
    return settings.force * loop.sample_time * total
