"""The share of a group's torques permitted in the next hold: the certificates of one axis, for all motor axes at once.

Let W be the requested torques (motor coordinates) and l W, 0 <= l <= 1, those sent. The energy that they take out in
their hold is l W . D, D the displacement in it, and the reasoning of `certificates.scalar_bounds` bounds W . D as it
bounds a displacement along one axis: with D_0 the displacement of the hold that ended and f_0, f_1, ... the torques
before,

    W . D <= W . D_0 + sum of the responses of W . D to f_0, f_1, ..., to l W, and to the hand,

so that l W . D <= l base + l^2 gain, and l follows as the torque of one axis does (`hand_force_bound`). For one axis it
is the same number. What the axes share is only the energy: motion across the torques costs nothing.

**Inertia.** The true inertia M may couple the axes; all that is known is M >= diag(m_i), the declared under-estimates.
For symmetric 0 <= M^-1 <= P the largest value of W' M^-1 f is (W'Pf + |W|_P |f|_P) / 2: never more than the product of
the norms, and 0 for opposed torques. For one axis it is max(0, W f) / m.

**Hand.** W' M^-1 u <= F_h |W|_P |1|_P, u the torque of the hand at the motors, for the torques W of the hold and of the
1 + delay holds after it. Every hand that pulls each motor axis with F_h or less is covered, however fast the torque
turns and for every M. A hand may push harder against the torque (into a wall) where M does not couple the axes; a
harder push ACROSS the torque is covered as long as the torque does not turn, and the axes are equal and not coupled.
Forces that come from an inertia changing with the pose (Coriolis, centrifugal) count with the hand's.

**Friction** of an axis raises an inward displacement, by no more than e^(-bT/m) in every hold; that is counted axis by
axis. What it lowers counts only for one axis alone: where M couples them, friction on one axis pushes the others, and
counts with the hand's force.

**Mover.** A wall that moves by w in a hold gives the energy that its force takes over w: with u the motion of the
motors that would go with it, W . u, so that D - u replaces D where it is multiplied by a torque. u is known in advance.

**Device damping.** Each axis dissipates at least (b_i/T) D_i^2, so sum(F_i^2 T / 4 b_i) <= E_d serves every user.

**Hand speed.** sum |F_i| v_max T <= E.

**Holds that jitter, torques that come late** (`certificates.hold_timing`, of which (1) holds for every axis by itself).
D_1 = r D_0 + responses with one r of all axes, 1 / growth <= r <= growth, so that W . D_0 counts with that; friction
and responses are taken for the longest hold. A motor that still has an older torque adds a change of it on its own
axis, a force d p(t) along e_i with p as in (1). Its response is never below zero for either sign of d,

    W' M^-1 e_i d <= d W_i / 2 m_i + |d| |W|_P / 2 m_i^(1/2),

so that it counts as in (1) as min(1, 2 theta / T) of its largest value held throughout, and adds to that of the
torques of the hold. Of one axis this is max(0, g - f) / m. The energy of older torques is in `group_account`.
"""

import math
from typing import NamedTuple

from canhaptic.control.certificates.scalar_bounds import NO_RESPONSE, displacement_response
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.kernels import Buffer, Matrix


class GroupTiming(NamedTuple):
    """Declared timing of the holds of a group; see `hold_timing`. Shapes (axes,)."""

    is_ideal: bool  # whether every hold is exact, and no torque late
    growth: float  # longest hold over the shortest
    share: Buffer  # theta over the shortest hold
    counted: Buffer  # part of it for which an older torque counts as held throughout
    left: Buffer  # c: share of older torques that is left after a hold
    roots: Buffer  # T m^(-1/2): a force of norm 1 in `before` + `during` moves an axis so far, without damping
    hand: float  # F_h |1|, in the norm of `roots`
    swing: Buffer  # factor by which friction lengthens the way back inside a hold
    tail: Buffer  # theta / (T + theta)
    tail_path: float  # v_max theta [m or rad]


def timing_of(loops: tuple[LoopProperties, ...], by_hand: bool, pull: float, speed: float) -> GroupTiming:
    """Declared timing of the holds of a group.

    Args:
        loops: Loop of each axis.
        by_hand: Whether the moving mass of every axis is known.
        pull: F_h with friction [N or N*m].
        speed: v_max [m/s or rad/s]; 0: not declared.
    """
    timings = [loop.timing for loop in loops]
    longest = max([timing.longest for timing in timings])
    shortest = min([timing.shortest for timing in timings])
    bounds = [max(loop.device_damping or 0.0, loop.device_damping_bound or 0.0) for loop in loops]
    masses = [(loop.moving_mass or 1.0) if by_hand else 1.0 for loop in loops]
    fading = [bound * longest / mass for bound, mass in zip(bounds, masses, strict=True)]
    late = [timing.late for timing in timings]
    return GroupTiming(
        is_ideal=not any(late) and longest == shortest,
        growth=longest / shortest,
        share=[theta / shortest for theta in late],
        counted=[min(1.0, 2.0 * theta / shortest) for theta in late],
        left=[timing.left for timing in timings],
        roots=[longest / math.sqrt(mass) for mass in masses],
        hand=pull * longest * math.sqrt(sum(1.0 / mass for mass in masses)),
        swing=[y / -math.expm1(-y) if y > 0.0 else 1.0 for y in fading],
        tail=[theta / (longest + theta) for theta in late],
        tail_path=speed * max(late),
    )


class AxisLimits(NamedTuple):
    """Properties of the motor axes that the certificates use; shapes (axes,)."""

    before: Buffer  # response of the displacement to the torque of the hold before [m/N]
    during: Buffer  # and of the hold itself [m/N]
    lost: Buffer  # largest share of an inward displacement that friction takes from the next hold
    hand: float  # F_h |1|_P: displacement by the hand for |W|_P = 1, both in the norm of before + during
    by_hand: bool  # whether the hand-force certificate is declared
    damping: Buffer  # certain damping over the sample time [N/m]; 0 where it is not known
    by_damping: bool
    path: float  # v_max T [m or rad]; 0: the hand-speed certificate is not declared
    counts: Buffer  # encoder counts [m or rad]
    coarse: bool  # whether any of them is above 0
    squares: Buffer  # 4 b / (T + theta): square of a torque over its need of the damping [N^2/J]; 0: not known
    timing: GroupTiming


def axes_of(loops: tuple[LoopProperties, ...], hand_force: float | None, hand_speed: float | None) -> AxisLimits:
    """Properties of the motor axes for the certificates.

    Args:
        loops: Loop of each axis.
        hand_force: F_h of each axis [N or N*m]; None: certificate not used. It needs every moving mass.
        hand_speed: v_max [m/s or rad/s]; None: not used.
    """
    sample_time = max([loop.timing.longest for loop in loops])
    by_hand = hand_force is not None and all(loop.moving_mass is not None for loop in loops)
    alone = len(loops) == 1
    responses = [
        displacement_response(
            sample_time, loop.moving_mass or 1.0, 1.0, (loop.device_damping or 0.0) if alone else 0.0,
            max(loop.device_damping or 0.0, loop.device_damping_bound or 0.0),
        )
        if by_hand
        else NO_RESPONSE
        for loop in loops
    ]  # fmt: skip
    pull = (hand_force or 0.0) + max([loop.device_friction_bound or 0.0 for loop in loops])
    lost = [1.0 - response.retained for response in responses]
    damping = [(loop.device_damping or 0.0) / sample_time for loop in loops]
    timing = timing_of(loops, by_hand, pull, hand_speed or 0.0)
    return AxisLimits(
        before=[response.before for response in responses],
        during=[response.during for response in responses],
        lost=lost,
        hand=pull * math.sqrt(sum(response.hand for response in responses)),
        by_hand=by_hand,
        damping=damping,
        by_damping=all(value > 0.0 for value in damping),
        path=(hand_speed or 0.0) * sample_time + timing.tail_path,
        counts=[loop.encoder_count for loop in loops],
        coarse=any(loop.encoder_count for loop in loops),
        squares=[4.0 * value * (1.0 - tail) for value, tail in zip(damping, timing.tail, strict=True)],
        timing=timing,
    )


def _response_to(torques: Buffer, acting: Buffer, response: Buffer) -> float:
    """Return the largest response of W . D [J] to torques acting, for any inertia not below the declared."""
    product = first = second = 0.0
    for i in range(len(response)):
        gain = response[i]
        product += torques[i] * gain * acting[i]
        first += torques[i] * gain * torques[i]
        second += acting[i] * gain * acting[i]
    largest = 0.5 * (product + math.sqrt(first * second))
    return largest if largest > 0.0 else 0.0


def response_to_late(
    axes: AxisLimits, torques: Buffer, highest: Buffer, lowest: Buffer, held: Buffer, response: Buffer
) -> float:
    """Return the largest response of W . D [J] to older torques in a hold, beyond that to the torques held in it.

    Args:
        axes: Properties of the motor axes.
        torques: W, (axes,).
        highest: Largest of the older torques, (axes,) [N*m or N].
        lowest: Smallest of them, (axes,) [N*m or N].
        held: Torques held in the hold.
        response: `before` or `during`.
    """
    size = total = 0.0
    for i in range(len(response)):
        size += torques[i] * response[i] * torques[i]
    size = math.sqrt(size)
    for i in range(len(response)):
        above, below = highest[i] - held[i], held[i] - lowest[i]  # of which one is above 0
        along, any_way = torques[i] * response[i], size * math.sqrt(response[i])  # |along| <= any_way
        reply = max(above * (any_way + along), below * (any_way - along))
        total += 0.5 * axes.timing.counted[i] * reply
    return total


def pass_range(axes: AxisLimits, highest: Buffer, lowest: Buffer, held: Buffer) -> None:
    """Advance the range of the torques to the next SYNC, after a hold of these."""
    for i in range(len(held)):
        torque, left = held[i], axes.timing.left[i]
        highest[i] = torque + left * max(0.0, highest[i] - torque)
        lowest[i] = torque - left * max(0.0, torque - lowest[i])


def _hand_term(axes: AxisLimits, torques: Buffer) -> float:
    """Return how much the hand raises W . D in one hold [J]."""
    total = 0.0
    for i in range(len(axes.before)):
        total += torques[i] * (axes.before[i] + axes.during[i]) * torques[i]
    return axes.hand * math.sqrt(total)


def along_last(axes: AxisLimits, torques: Buffer, displacement: Buffer, position_uncertainty: Buffer) -> float:
    """Largest W . D_0 [J], after friction, of a displacement known up to encoder counts and its uncertainty."""
    total = 0.0
    for i in range(len(axes.counts)):
        along = torques[i] * displacement[i]
        total += along + abs(torques[i]) * (axes.counts[i] + position_uncertainty[i])
    return total


def _raised_by_friction(axes: AxisLimits, torques: Buffer, displacement: Buffer) -> float:
    """Return how much of W . D_0 the inward parts lose by friction in one hold [J], >= 0."""
    total = 0.0
    for i in range(len(axes.lost)):
        along = torques[i] * displacement[i] + abs(torques[i]) * axes.counts[i]
        if along < 0.0:
            total -= axes.lost[i] * along
    return total


class Acting(NamedTuple):
    """The range of the torques that act at a SYNC."""

    highest: Buffer  # at most, (axes,) [N*m or N]
    lowest: Buffer  # at least


def base_of(
    axes: AxisLimits, torques: Buffer, displacement: Buffer, bound: float, last: Buffer, sent: Matrix, first: int,
    under_way: int, range_of: Acting,
) -> float:  # fmt: skip
    """Return the base of l W . D [J] for torques that act after the queued ones.

    In every hold friction acts on what is left of D_0, axis by axis: where one axis moves inward and another outward,
    their sum gives no bound. The responses to forces are bounded without friction.

    Args:
        axes: Properties of the motor axes.
        torques: W, (axes,).
        displacement: Displacement in the hold that ended, (axes,).
        bound: Largest W . D_0 [J].
        last: Torques held in that hold, (axes,).
        sent: Torques by hold, a ring (holds, axes).
        first: Index of the next hold; negative indices wrap.
        under_way: Number of holds before W acts.
        range_of: Range of torques at the SYNC at which the hold that ended began; where torques come late, advanced to
            the SYNC of W.
    """
    hand, friction = _hand_term(axes, torques), _raised_by_friction(axes, torques, displacement)
    is_ideal, growth = axes.timing.is_ideal, axes.timing.growth
    highest, lowest = range_of.highest, range_of.lowest
    friction *= growth
    total = _stretched(bound, growth) + friction
    total += _response_to(torques, last, axes.before) + hand
    if not is_ideal:
        total += response_to_late(axes, torques, highest, lowest, last, axes.before)
        pass_range(axes, highest, lowest, last)
    for place in range(first, first + under_way):
        acting = sent[place]
        total += _response_to(torques, acting, axes.during)
        if not is_ideal:
            total += response_to_late(axes, torques, highest, lowest, acting, axes.during)
        if len(axes.lost) > 1:
            total = _stretched(total, growth) + friction
        elif total < 0.0:
            total -= axes.lost[0] * total
            total = _stretched(total, growth)
        else:
            total *= growth
        total += _response_to(torques, acting, axes.before) + hand
        if not is_ideal:
            total += response_to_late(axes, torques, highest, lowest, acting, axes.before)
            pass_range(axes, highest, lowest, acting)
    return total


def _stretched(total: float, growth: float) -> float:
    """Return the largest that W . D can be in a hold of another length."""
    return total * growth if total > 0.0 else total / growth


def taken_by_mover(torques: Buffer, moved: Buffer) -> float:
    """Return the energy of a mover [J] in a hold; its motion is given in motor coordinates (axes,) [rad or m]."""
    total = 0.0
    for i in range(len(moved)):
        total -= torques[i] * moved[i]
    return total


def gain_of(axes: AxisLimits, torques: Buffer) -> float:
    """Return the gain of l W . D [J] by the torques themselves."""
    total = 0.0
    for i in range(len(axes.during)):
        total += torques[i] * axes.during[i] * torques[i]
    return total


def damping_need(axes: AxisLimits, torques: Buffer) -> float:
    """Return sum(F_i^2 (T + theta_i) / 4 b_i) [J]."""
    total = 0.0
    for i in range(len(axes.damping)):
        total += torques[i] * torques[i] / axes.squares[i]
    return total


def path_need(axes: AxisLimits, torques: Buffer) -> float:
    """Return sum |F_i| v_max (T + theta) [J]."""
    total = 0.0
    for torque in torques:
        total += abs(torque)
    return total * axes.path
