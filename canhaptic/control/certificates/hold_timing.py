"""Timing of a real hold: the effect of jitter and of a late torque on every certificate.

Declared: every hold lasts T_k with T (1 - j) <= T_k <= T (1 + j); a new torque acts at the latest a time w after its
SYNC (event RPDO, wire time); and the torque of the motor follows the one held with a first-order lag of at most tau.
With theta = w + tau, f_k the torque of hold k and g >= every older torque still felt at its SYNC, the true torque is

    u(t) = f_k (1 - p(t)) + older torques with weights of sum p(t);  1 >= p >= 0, falling, and in the hold
    integral p dt <= theta,   integral p t dt <= theta^2                                                          (1)

for p is 1 until the change and exp(-(t - change) / tau) after it. At the end of the hold at most
c = exp(-(T (1 - j) - w) / tau) of p is left, so that g' = f_k + c max(0, g - f_k): this bounds the tails of ALL earlier
torques.

**Reach.** With damping b and beta = b/m, D_1 = r D_0 + integral of K F, K >= 0, where
r = (1 - e^(-beta T_1)) / (e^(beta T_0) - 1). As 1 - e^-x <= x <= e^x - 1, r <= T_1 / T_0 <= (1 + j) / (1 - j):
`growth`, for D_0 > 0. For D_0 < 0 phi(T) = (1 - e^(-beta T)) / beta is concave and grows, so
r >= e^(-beta T_0) min(1, T_1 / T_0). K grows with T_0 and T_1, so that each response is largest for T (1 + j): the
undamped ones by (1 + j)^2. An older torque g > f adds (g - f) p: K falls in the hold and rises in the one before, so by
(1) it counts as no more than min(1, 2 theta / T) (g - f) held throughout: `late`.

**Energy of the next hold.** Of all motions of the same D_0 the one with the largest force throughout is the fastest at
every time, v <= v* = D_0/T_0 + (growing part). The torques along f give out integral(u v), at most with v* for v. The
older ones lie between l p and g p (l = 0 where one of them has the other sign), so that

    integral(u v) <= f D* + max(0, g - f) X + max(0, f - l) min(r, theta/T) max(0, -D_0)
    X = theta/T max(0, D_0) + (theta T/2m) f_before + (theta^2/m) max(f, g) + (theta (T/2 + theta) / m) F_h       (2)

with X the most that p v can integrate to: `tail_reach`. A torque is certified together with its tail in the hold after
it, g' X', as if no torque followed; a smaller torque than the one before it then has what the larger leaves running.

**Energy of the hold that ended.** Booked is -f D; true is -f D + (f_k - f_(k-1)) X_k + e Y_k, |e| <= the rest of the
older torques, X_k and Y_k integrals of p v. Upwards (2) bounds both. Downwards D_k is known and m x'' + b x' <= A, so x
lies above the solution with equality through the same ends: X >= -s (theta/T max(0, -D_k) + A theta T / 2m), where
s = y / (1 - e^-y), y = beta T (phi(t)/phi(T) <= s t/T, and the solution from 0 to 0 begins with -s A T / 2m at most).
A hand without a limit inwards is covered: only its force along the torque is used. See `doubt_of_late`.

**Hand speed.** |X| <= v_max theta. **Device damping**, for every hand: e = f - u, |e| <= d p, and
integral(e v + b v^2) over motions of sum D is least at e D/T - e^2 / 4b + b D^2 / T, so less than booked by no more
than d |D| theta / T + d^2 theta / 4b; and integral(u^2) <= sum of f_k^2 (T_k + theta), u being a mean of the torques.

**A torque that is measured (0x6077)** is no better bound of any of this, and is not taken for one. A TPDO carries one
value u_n of it at the SYNC that ends the hold, with an error e (`torque_tolerance`: current sensor, filter, cogging).
(i) Of the hold that ended, -f D + (f_k - f_(k-1)) X_k needs p(t) inside the hold: two courses of p, one that falls at
once and one that falls at theta, both allowed by (1), end in the same u_n up to c |f_k - f_(k-1)|, and their energies
differ by the whole of (f_k - f_(k-1)) X_k. So u_n does not reduce the uncertainty of that hold unless c is near 1,
with a lag as long as the hold. (ii) Of the next hold it would bound the older torques still felt, by |u_n - f_k| + e in
place of c |f_(k-1) - f_k|: less only where e < c |f_(k-1) - f_k|. With tau = T / 5 and no window, c is 0.7 %: a sensor
of 1 % of the rated torque is better only for steps beyond 1.5 times that torque; one of 5 % (the default), for steps of
0.7 of it, only with lags above 0.38 T. (iii) Booked with u_n in place of the demand the error of every hold gains
e |D|, whether the torque changes or not. So the demand is read back first (`read_back: auto`).
"""

from dataclasses import dataclass
from math import exp

from canhaptic.errors import ParameterError


@dataclass(frozen=True, slots=True)
class HoldTiming:
    """Declared timing of the holds of one axis."""

    shortest: float  # hold [s]
    longest: float  # hold [s]
    late: float  # theta: window and lag of a new torque together [s]
    left: float  # c: share of the older torques that is felt at the next SYNC at most


def hold_timing(sample_time: float, jitter: float, window: float, lag: float) -> HoldTiming:
    """Timing that holds for every hold.

    Args:
        sample_time: T [s].
        jitter: j, as a part of T.
        window: w [s].
        lag: tau [s].

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
    return HoldTiming(shortest, sample_time * (1.0 + jitter), window + lag, exp(-rest / lag) if lag > 0.0 else 0.0)
