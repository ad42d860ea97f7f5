"""How far one axis can move along a torque in a hold, and how large a torque an energy budget therefore permits.

The certificates (proofs that the axis generates no energy) of `certified_torque` use these bounds. Only the torque of a
hold and the displacement in it exchange energy (eq. 2), so every step has to bound how far the axis can move OUT (along
the torque) while the torque cannot be changed. All formulas below are for a torque in the positive direction, and
displacements are positive along it; for the other direction the caller reverses the signs.

**Hand force.** An axis m v' + b v = f(t) + u(t), f held constant in each hold, outward hand force u <= F_h, inward hand
force without limit. With D_i the displacement in hold i and K the response of the displacement to a force,

    D_1 = e^(-bT/m) D_0 + integral over both holds of K(s) (f(s) + u(s)) ds,   K >= 0,

so D_1 grows with u, and u = F_h throughout is the worst user after any motion. The integrals have closed forms
(`DisplacementResponse`); without damping they are T^2/2m for the torque of either hold and T^2/m for the hand.
If b and m are only bounded, every coefficient is taken at its worst end: e^(-bT/m) <= 1 for D_0 > 0; for D_0 < 0
its least value, at the upper bound of b and the under-estimate of m; each response is largest at the under-estimates
of m and b. A torque in the other direction counts as 0, because its help is known only with an over-estimate of m.
D_1 is bounded by a rising function of D_0, so that bounds chain over the holds whose torque is queued (delay), and
the energy taken out, sum(f_i D_i) + F D, is largest if every D_i is: a bound D_1 < 0 therefore certifies energy that
comes IN. The largest F with F (base + gain F) <= budget is the certified torque (`hand_force_bound`).
Dry friction F_c of the device may push out as well as hold: F_h + F_c takes the place of F_h (`device_friction_bound`).

**Friction that only brakes.** Cogging, weight and the wind-up of a gear can pull. Dry friction opposes the motion, so
that it pushes outward only during an inward motion and at a reversal, where its bristles give back no more than an
energy F_c^2 / 2 sigma. F_c is `device_friction_bound` less `device_cogging_bound`, sigma is `presliding_stiffness`. So

    D_1 <= max(D_0, 0) + the terms of both torques and of F_h + F_c (T^2 / 8m + T / sqrt(sigma m))

(docs/theory/dry_friction.md, T1; T2 with unequal holds, T3 with damping), besides the bound above. So friction may be
any part of F_c in either direction; `brake` is the amount by which it lowers the bound of a motion outward or from
rest.

**Device damping.** The device itself dissipates at least (b/T) D^2 in a hold of displacement D (Cauchy-Schwarz). For
every D, -F D + (b/T) D^2 >= -F^2 T / 4b, so F^2 <= 4 b E_d / T, less the squares of the queued torques, keeps
E_d = E + (b/T) sum(D^2) >= 0 for every user.

**Hand speed.** D <= v_max T, so F <= E / (v_max T), E after the worst of the queued torques.

**Timing of a real hold** (`hold_timing`): jitter and late torques affect every certificate. Declared are: every hold
lasts T_k with T (1 - j) <= T_k <= T (1 + j); a new torque acts at the latest a time w after its SYNC (event RPDO, wire
time); and the torque of the motor follows its command with a first-order lag of at most tau.
With theta = w + tau, f_k the torque of hold k and g >= every older torque still felt at its SYNC, the true torque is

    u(t) = f_k (1 - p(t)) + older torques with weights of sum p(t);  1 >= p >= 0, falling, and in the hold
    integral p dt <= theta,   integral p t dt <= theta^2                                                          (1)

because p is 1 until the change and exp(-(t - change) / tau) after it. At the end of the hold at most
c = exp(-(T (1 - j) - w) / tau) of p is left, so that g' = f_k + c max(0, g - f_k): this bounds the tails of ALL earlier
torques.

**Reach.** With damping b and beta = b/m, D_1 = r D_0 + integral of K F, K >= 0, where
r = (1 - e^(-beta T_1)) / (e^(beta T_0) - 1). As 1 - e^-x <= x <= e^x - 1, r <= T_1 / T_0 <= (1 + j) / (1 - j):
`growth`, for D_0 > 0. For D_0 < 0 phi(T) = (1 - e^(-beta T)) / beta is concave and grows, so
r >= e^(-beta T_0) min(1, T_1 / T_0). K grows with T_0 and T_1, so that each response is largest for T (1 + j): the
undamped ones by (1 + j)^2. An older torque g > f adds (g - f) p: K falls in the hold and rises in the one before, so by
(1) it counts as no more than min(1, 2 theta / T) (g - f) held throughout: `late`.

**Energy of the next hold.** Of all motions with the same D_0, the one with the largest force throughout is the fastest
at every time, v <= v* = D_0/T_0 + (growing part). The torques along f give out integral(u v), at most with v* for v.
The older ones lie between l p and g p (l = 0 if one of them has the other sign), so that

    integral(u v) <= f D* + max(0, g - f) X + max(0, f - l) min(r, theta/T) max(0, -D_0)
    X = theta/T max(0, D_0) + (theta T/2m) f_before + (theta^2/m) max(f, g) + (theta (T/2 + theta) / m) F_h       (2)

with X the largest integral of p v (`tail_reach`). A torque is certified together with its tail in the hold after it,
g' X', as if no torque followed; so if a smaller torque follows, the tail of the larger one is already covered.

**Energy of the hold that ended.** Booked is -f D; true is -f D + (f_k - f_(k-1)) X_k + e Y_k, |e| <= the rest of the
older torques, X_k and Y_k integrals of p v. Upwards (2) bounds both. Downwards D_k is known and m x'' + b x' <= A, so x
lies above the solution with equality through the same ends: X >= -s (theta/T max(0, -D_k) + A theta T / 2m), where
s = y / (1 - e^-y), y = beta T (phi(t)/phi(T) <= s t/T, and the solution from 0 to 0 begins with -s A T / 2m at most).
This covers a hand without a limit inward, because only its force along the torque is used. See `doubt_of_late`.

*Two ends.* With lo <= integral p dt = theta <= hi, X is a mean of x over the times of the change, and theta (T - theta)
is concave. So, with the largest forces A_out along the torque and A_in against it (docs/theory/late_torques.md, L1),

    X >= min over theta of theta D/T - s A_out theta (T - theta) / 2m
    X <= max over theta of theta D/T + s A_in theta (T - theta) / 2m                                        (3)

with s D in place of D where that is wider (`ends_of_late`). Without a limit inward only the lower end is a bound.

**Hand speed.** |X| <= v_max theta. **Device damping**, for every hand: e = f - u, |e| <= d p, and
integral(e v + b v^2) over motions of sum D is least at e D/T - e^2 / 4b + b D^2 / T, so less than booked by no more
than d |D| theta / T + d^2 theta / 4b; and integral(u^2) <= sum of f_k^2 (T_k + theta), u being a mean of the torques.

**A measured torque (0x6077)** would not improve these bounds, and is not used for them. A TPDO carries one value u_n of
it at the SYNC that ends the hold, with an error e (`torque_tolerance`: current sensor, filter, cogging).
(i) In the hold that ended, -f D + (f_k - f_(k-1)) X_k needs p(t) inside the hold. If p falls at once, or at theta (both
allowed by (1)), u_n is the same up to c |f_k - f_(k-1)|, but the energies differ by the whole of (f_k - f_(k-1)) X_k.
So u_n does not reduce the uncertainty of that hold unless c is near 1, with a lag as long as the hold. (ii) In the next
hold it would bound the older torques still felt by |u_n - f_k| + e in place of c |f_(k-1) - f_k|: less only if
e < c |f_(k-1) - f_k|. With tau = T / 5 and no window, c is 0.7 %: a sensor of 1 % of the rated torque is better only
for steps beyond 1.5 times that torque; one of 5 % (the default), for steps of 0.7 of it, only with lags above 0.38 T.
(iii) Booked with u_n in place of the demand, the error of every hold grows by e |D|, whether the torque changes or not.
So the demand is read back first (`read_back: auto`).

**Energy before a contact** (`start_energy`), so that the hand-force certificate holds a wall from the first hold on. At
rest at a force F every hold may give out F D_i while the hand pulls with F_h, and the spring of stiffness k has
received F^2 / 2k. The missing energy is largest at some force on the way in,

    E = max over F of (sum of F D_i)(F) - F^2 / 2k,

with D_i of the queued holds and the next one. Undamped the sum is h F (F + F_h), h = T^2 / m at delay 0 and 3 T^2 / m
at delay 1, so that E = (h F_h)^2 / 4 a with a = 1 / 2k - h. A faster contact needs less, because its own inward motion
brings energy in. A drag f earns f times the distance, but only above the speed of `start_speed`: in a slower motion the
hand may turn within the queued holds and pull the drag along.

For a hand of any force, the dissipation of the device permits a torque: with b and f_c certain, a torque F at rest
needs a budget of (1 + delay) (F - f_c)^2 T / 4b (`certified_torque`), of which the wall provides F^2 / 2k and the
friction on the way in f_c F / k. The rest must be stored before the contact; friction earns it over a motion of
rest / f_c, without a drag.
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
    bend: float = 0.0  # s / 2m of (3) [1/kg or 1/(kg*m^2)]
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

    X of equation (2); arguments as for `next_displacement`, but `torque` is the largest that acts in the hold.
    """
    reach = response.tail_hand * hand + response.tail_during * torque
    if torque_before > 0.0:
        reach += response.tail_before * torque_before
    return reach + response.share * displacement if displacement > 0.0 else reach


def end_of_late(
    displacement: float, longest: float, late: float, force: float, response: DisplacementResponse
) -> float:
    """Return the least X of equation (3): how far the axis has moved along while older torques acted [m or rad].

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
    extracted = _given_out(response, delay, torque)
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
    one, two = _given_out(response, delay, _FIRST), _given_out(response, delay, 2.0 * _FIRST)
    square = (two - 2.0 * one) / (2.0 * _FIRST * _FIRST)
    linear = one / _FIRST - square * _FIRST
    left = 0.5 / stiffness - square
    return linear * linear / (4.0 * left) if left > 0.0 else math.inf


def _given_out(response: DisplacementResponse, delay: int, torque: float) -> float:
    displacement = energy = 0.0
    for _ in range(delay + 1):
        displacement = next_displacement(displacement, torque, torque, response, response.hand)
        energy += torque * displacement
    return energy + torque * tail_reach(displacement, torque, torque, response, response.hand)
