"""How far one axis can move along a torque in a hold, and how large a torque an energy budget therefore permits.

Only the torque of a hold and the displacement in it exchange energy (eq. 2), so every step bounds how far the axis can
move OUT (along the torque) while the torque cannot be changed. All formulas are for a torque in the positive direction,
and displacements are positive along it; for the other direction the caller reverses the signs.

Statements and proofs: `docs/theory/torques_of_an_axis.md`. A1 to A3 are the certificates by the hand's force, the
device's damping and the hand's speed; A6 to A9 the timing of a real hold (`hold_timing`); A11 the energy before a
contact (`start_energy`). Friction that only brakes is T1 to T4 of `docs/theory/dry_friction.md`, and late torques with
two ends L1 of `docs/theory/late_torques.md`.
"""

import math
from dataclasses import dataclass
from math import exp
from typing import Final

from canhaptic.errors import ParameterError


@dataclass(frozen=True, slots=True)
class HoldTiming:
    """Declared timing of the holds of one axis."""

    shortest: float  # hold [s]
    longest: float  # hold [s]
    late: float  # theta: window and lag of a new torque together [s]
    left: float  # c: share of the older torques that is felt at the next SYNC at most
    early: float = 0.0  # least integral of p over a hold [s]


def hold_timing(
    sample_time: float, jitter: float, window: float, lag: float, least: tuple[float, float] = (0.0, 0.0)
) -> HoldTiming:
    """Return the shortest and longest hold, and how long and how much older torques act in a hold.

    Args:
        sample_time: T [s].
        jitter: j, as a fraction of T.
        window: w [s].
        lag: tau [s].
        least: Lower ends of w and tau [s].

    Raises:
        ParameterError: The window is as long as a hold.
    """
    shortest = sample_time * (1.0 - jitter)
    rest = shortest - window
    if rest <= 0.0:
        raise ParameterError(
            f"torque_window: got {window:g} s, expected less than the shortest hold, {shortest:g} s; a torque that "
            "comes later than the next SYNC is a delay: use rpdo: synchronous or a lower bus.rate"
        )
    begin, follow = least
    early = begin + (follow * (1.0 - exp((begin - shortest) / follow)) if follow > 0.0 else 0.0)
    left = exp(-rest / lag) if lag > 0.0 else 0.0
    return HoldTiming(shortest, sample_time * (1.0 + jitter), window + lag, left, early)


@dataclass(frozen=True, slots=True)
class DisplacementResponse:
    """Largest displacement in a hold per torque, hand force and earlier displacement, for one axis (see the module)."""

    retained: float  # least share of an inward displacement that the next hold repeats, e^(-bT/m)
    before: float  # [m/N] per torque in the hold before
    during: float  # [m/N] per torque in the hold itself
    hand: float  # [m] by the hand pulling out with its declared force in both holds
    push: float = 0.0  # [m] the same by the hand pushing in, along a torque that sticks; infinite: not declared
    growth: float = 1.0  # largest share of an outward displacement that the next hold repeats
    late: float = 0.0  # counted part of an older torque's excess over a new one, in the hold of the new one
    share: float = 0.0  # of a hold in which an older torque acts: theta / T
    behind: float = 0.0  # the same of an inward displacement, never more than `retained`
    tail_before: float = 0.0  # [m/N] of `tail_reach`, per torque in the hold before
    tail_during: float = 0.0  # [m/N] per torque in the hold itself
    tail_hand: float = 0.0  # per displacement by the hand
    swing: float = 1.0  # factor by which friction lengthens the way back inside a hold
    brake: float = 0.0  # part of `hand` and `push` that dry friction does not add to a motion outward, or from rest
    shortest: float = 0.0  # hold [s]
    early: float = 0.0  # least integral of p over a hold [s]
    bend: float = 0.0  # s / 2m of L1 [1/kg or 1/(kg*m^2)]
    per_hand: float = 0.0  # force per displacement by the hand [N/m or N*m/rad]


NO_RESPONSE: Final = DisplacementResponse(1.0, 0.0, 0.0, 0.0)
"""Response if the hand-force certificate is not declared."""


def displacement_response(
    sample_time: float, mass: float, hand_force: float, damping_least: float = 0.0, damping_most: float = 0.0,
    hand_push: float = math.inf, timing: HoldTiming | None = None, friction: tuple[float, float] = (0.0, math.inf),
) -> DisplacementResponse:  # fmt: skip
    """Return the largest displacement in a hold per torque, hand force and previous displacement.

    With y = bT/m: during = (T^2/m) (y - 1 + e^-y) / y^2, before = (T^2/m) (1 - e^-y - y e^-y) / y^2, hand = F_h times
    their sum. `during` and the sum fall with m at fixed b; `before` does so only while every lag is below m/b, beyond
    which its undamped value is used.

    Args:
        sample_time: Sample time [s].
        mass: UNDER-estimate of the inertia rigid with the encoder [kg or kg*m^2].
        hand_force: Largest outward force of the hand [N or N*m].
        damping_least: Certain viscous damping of the device [N*s/m or N*m*s/rad].
        damping_most: Upper bound of that damping.
        hand_push: Largest inward force of the hand [N or N*m]; infinite: no bound is known.
        timing: Timing of the holds; None: exact.
        friction: Part of `hand_force` and `hand_push` that is friction which only brakes [N or N*m], static peak
            included, and its presliding stiffness, by the energy that it gives back [N/m or N*m/rad].
    """
    timing = timing or HoldTiming(sample_time, sample_time, 0.0, 0.0)
    longest, shortest, late = timing.longest, timing.shortest, timing.late
    whole = longest * longest / mass
    y = damping_least * longest / mass
    if y < 1e-3:
        during, before = whole * (0.5 - y / 6.0 + y * y / 24.0), whole * (0.5 - y / 3.0 + y * y / 8.0)
    else:
        fade = math.exp(-y)
        during, before = whole * (y - 1.0 + fade) / (y * y), whole * (1.0 - fade - y * fade) / (y * y)
    both, share = during + before, late / shortest
    fading, (braking, stiffness) = max(damping_most, damping_least) * longest / mass, friction
    given_back = longest / math.sqrt(stiffness * mass)
    retained = math.exp(-fading) * (shortest / longest)
    swing = fading / -math.expm1(-fading) if fading > 0.0 else 1.0
    return DisplacementResponse(
        retained=retained,
        before=0.5 * whole if y > 0.5 else before,
        during=during,
        hand=both * hand_force,
        push=both * max(hand_push, hand_force),
        growth=longest / shortest,
        late=min(1.0, 2.0 * share),
        share=share,
        behind=min(share, retained),
        tail_before=0.5 * late * longest / mass,
        tail_during=late * late / mass,
        tail_hand=late * (0.5 * longest + late) / mass / both,
        swing=swing,
        brake=braking * max(0.0, both - whole / 8.0 - given_back),
        shortest=shortest,
        early=timing.early,
        bend=0.5 * swing / mass,
        per_hand=1.0 / both,
    )


def next_displacement(
    displacement: float, torque_before: float, torque: float, response: DisplacementResponse, hand: float
) -> float:
    """Return the largest outward displacement in a hold, from that in the hold before it and the torques [m or rad].

    Args:
        displacement: Largest outward displacement of the previous hold [m or rad].
        torque_before: Outward torque held in it [N or N*m]; an inward one counts as 0.
        torque: Outward torque of the hold to bound; 0 gives the base of `hand_force_bound`.
        response: Displacement response of the axis.
        hand: Displacement due to the hand's force in both holds [m or rad]: `response.hand`, or `response.push`.
    """
    if displacement < 0.0:
        displacement -= (1.0 - response.retained) * displacement
        if displacement > -response.brake:
            displacement = -response.brake
    else:
        displacement = displacement * response.growth - response.brake
    if torque_before > 0.0:
        displacement += torque_before * response.before
    if torque > 0.0:
        displacement += torque * response.during
    return displacement + hand


def tail_reach(
    displacement: float, torque_before: float, torque: float, response: DisplacementResponse, hand: float
) -> float:
    """Return the largest distance of the next hold over which older, late torques still act [m or rad].

    X of A8; arguments as for `next_displacement`, but `torque` is the largest that acts in the hold.
    """
    reach = response.tail_hand * hand + response.tail_during * torque
    if torque_before > 0.0:
        reach += response.tail_before * torque_before
    return reach + response.share * displacement if displacement > 0.0 else reach


def end_of_late(
    displacement: float, longest: float, late: float, force: float, response: DisplacementResponse
) -> float:
    """Return the least X of L1: how far the axis has moved along while older torques acted [m or rad].

    The largest X is minus the least one of the motion in the other direction.

    Args:
        displacement: Least displacement in the hold [m or rad].
        longest: Longest hold [s].
        late: Largest theta [s].
        force: Largest force along [N or N*m].
        response: Displacement response of the axis.
    """
    mean = displacement / longest if displacement > 0.0 else response.swing * displacement / response.shortest
    bend = response.bend * force
    theta, falls = response.early, bend * longest - mean
    if falls > 2.0 * bend * theta:  # a parabola that opens upwards, least at falls / 2 bend
        theta = late if falls >= 2.0 * bend * late else falls / (2.0 * bend)
    return theta * (mean - bend * (longest - theta))


def hand_force_bound(budget: float, base: float, gain: float) -> float:
    """Return the largest torque F >= 0 [N or N*m] with F (base + gain F) <= budget; infinite if all satisfy it.

    If no torque does (the budget is too far below zero), the result is the torque that brings in most energy.
    For a group the torques are l W: base and gain belong to W, in [J], and the result is the share l.

    Args:
        budget: Energy budget [J].
        base: Largest outward displacement in the hold without F [m or rad]; negative while moving inward.
        gain: Displacement per torque [m/N or rad/(N*m)], >= 0.
    """
    square = base * base + 4.0 * gain * budget
    root = math.sqrt(square) if square > 0.0 else 0.0
    if base <= 0.0:
        return (root - base) / (2.0 * gain) if gain > 0.0 else math.inf
    return 2.0 * budget / (root + base) if budget > 0.0 else 0.0  # the form without cancellation


def renderable_by_hand_force(response: DisplacementResponse, delay: int, torque: float) -> float:
    """Return the largest stiffness at which the hand-force certificate permits a torque at rest [N/m or N*m/rad].

    At rest every hold has the same torque F, and the stored energy F^2 / 2k must cover sum(F D_i) over the queued holds
    and the next one. Undamped: k <= (m / 2T^2) F / (F + F_h) at delay 0 and (m / 6T^2) F / (F + F_h) at delay 1.
    """
    extracted = given_out(response, delay, torque)
    return torque * torque / (2.0 * extracted) if extracted > 0.0 else math.inf


def renderable_by_device_damping(damping: float, sample_time: float, delay: int) -> float:
    """Return the largest stiffness at which the device-damping certificate permits a torque at rest [N/m or N*m/rad].

    It is 2b / T (1 + delay): at rest F^2 (1 + delay) <= 4 b E / T with E = F^2 / 2k. Colgate's bound is the value for
    delay 0.
    """
    return 2.0 * damping / (sample_time * (1 + delay))


def renderable_by_hand_speed(speed: float, sample_time: float, delay: int, torque: float) -> float:
    """Return the largest stiffness at which the hand-speed certificate permits a torque at rest [N/m or N*m/rad]."""
    return torque / (2.0 * speed * sample_time * (1 + delay))


def sustained_by_friction(friction: float, count: float) -> float:
    """Return the stiffness up to which dry friction dissipates what encoder quantization generates [N/m or N*m/rad].

    It is f_c / count; 0 with an ideal encoder, which has no quantization. See `certified_torque`.
    """
    return friction / count if count > 0.0 else 0.0


WINDOW: Final = 32
"""Number of past holds used to bound the outward speed with a coarse encoder."""


def start_speed(response: DisplacementResponse, sample_time: float, delay: int, count: float = 0.0) -> float:
    """Return the speed into a wall above which a contact needs no energy stored beforehand [m/s or rad/s].

    It is (1 + delay) F_h T / m with an ideal encoder. Over j holds one count leaves the speed uncertain by
    count / (j T), and the hand can have added F_h T (j - 1) / 2m; at high rates the best j gives sqrt(2 count F_h / m)
    in total, independent of the rate. A slower start needs an energy allowance or certain device damping.
    """
    uncertainty = min(count / holds + 0.5 * (holds - 1) * response.hand for holds in range(1, WINDOW + 1))
    kept = sample_time * response.retained ** (1 + delay)
    return ((1 + delay) * response.hand + uncertainty) / kept if kept > 0.0 else math.inf


_FIRST: Final = 1e-3  # [N or N*m]


def start_energy(response: DisplacementResponse, delay: int, stiffness: float) -> float:
    """Return the energy that must be stored before a contact, so that the wall is rendered in full at any speed [J].

    It is infinite if the stiffness is too large for any stored energy.

    Args:
        response: Displacement response of the axis, with the force of the hand.
        delay: Delay in whole holds.
        stiffness: Stiffness of the wall [N/m or N*m/rad].
    """
    if response.hand == 0.0:
        return 0.0
    # the sum is a quadratic polynomial in F without a constant: two values give it
    one, two = given_out(response, delay, _FIRST), given_out(response, delay, 2.0 * _FIRST)
    square = (two - 2.0 * one) / (2.0 * _FIRST * _FIRST)
    linear = one / _FIRST - square * _FIRST
    left = 0.5 / stiffness - square
    return linear * linear / (4.0 * left) if left > 0.0 else math.inf


def given_out(response: DisplacementResponse, delay: int, torque: float) -> float:
    """Return the most that a torque from rest gives out in the holds until another one acts [J]."""
    displacement = energy = 0.0
    for _ in range(delay + 1):
        displacement = next_displacement(displacement, torque, torque, response, response.hand)
        energy += torque * displacement
    return energy + torque * tail_reach(displacement, torque, torque, response, response.hand)
