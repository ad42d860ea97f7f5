"""Energy that came in over several holds of which only the total displacement is known.

After n - 1 lost samples the displacement D of n holds is known, the torque f_n of the last one, read back, and for each
hold before it the torques that may have acted. Booked is -f_n D; true is -sum f_j D_j; too much by

    sum over j < n and axes of (f_j - f_n) D_j = sum of delta_j D_j.

**Hand force.** Only the side of D_j that makes it large counts; on that side the declared force holds the hand. With s
the farthest that torques and hand move the axis beyond the hold before (`Gap.step`), for delta_j > 0 (else mirrored)

    f_j > 0:   D_j <= D_0 + j s + friction,                         the hand pulls along f_j with F_h at most;
    else f_n < f_j <= 0, and the hand is held along -: D_m >= D_j - (m - j) s - friction for m > j, and
               D_k >= D_0 - k s - friction for k < j; their sum is D, so that
               (n - j + 1) D_j <= D - (j - 1) D_0 + s (j (j - 1) + (n - j)(n - j + 1)) / 2 + friction

(with friction, 1 + a + a^2 + ... in place of n - j + 1 where D_j > 0, a the share that a hold keeps of the one before).

**Hand speed.** |D_j| <= v_max T.

**Device damping** alone, for every hand: sum((b/T) D_j^2 - delta_j D_j) over displacements of sum D is least at
D_j = D/n + (T/2b)(delta_j - mean), where it is (b/T) D^2 / n - mean D - (T/4b) sum((delta_j - mean)^2). The first term
is dissipated for certain, the others are uncertain.
"""

from typing import NamedTuple


class Gap(NamedTuple):
    """Several holds of one axis, and the hold before them."""

    holds: int
    moved: float  # in all of them [m or rad]
    start: float  # in the hold before [m or rad]
    error: float  # uncertainty of `moved` [m or rad]
    blur: float  # uncertainty of `start` [m or rad]
    step: float  # how far a hold may go beyond the hold before [m or rad]
    lost: float  # largest share of a motion that friction takes from the next hold


def farthest(gap: Gap, sign: float, hold: int, along: bool) -> float:
    """Largest displacement of one hold, counted along `sign` [m or rad].

    Args:
        gap: The holds of the axis.
        sign: 1 or -1.
        hold: Index of the hold, 1 for the first; the last is never asked for.
        along: Whether a torque along the sign acts in it; else one against it acts in the last.
    """
    holds, moved, start, error, blur, step, lost = gap
    start, moved = sign * start, sign * moved
    first = start + blur
    if along:
        return first + hold * (step + lost * (-first if first < 0.0 else 0.0))
    later = holds - hold
    least = start - blur
    pairs = hold * (hold - 1) + later * (later + 1)
    total = moved + error - (hold - 1) * least + 0.5 * pairs * step
    total += 0.5 * hold * (hold - 1) * lost * (least if least > 0.0 else 0.0)
    if total <= 0.0:
        return total / (later + 1)  # nothing that friction could take
    kept, power, series = 1.0 - lost, 1.0, 0.0
    for _ in range(later + 1):
        series += power
        power *= kept
    return total / series


def doubt_of(gap: Gap, hold: int, torque: float, last: float) -> float:
    """Largest excess of the booked energy of one hold, if a given torque acted in it [J].

    Args:
        gap: The holds of the axis.
        hold: Index of the hold, 1 for the first; the last is never asked for.
        torque: Torque that may have acted [N or N*m].
        last: Torque of the last hold, with which the energy was booked [N or N*m].
    """
    more = torque - last
    if more > 0.0:
        return more * farthest(gap, 1.0, hold, torque > 0.0)
    if more < 0.0:
        return -more * farthest(gap, -1.0, hold, torque < 0.0)
    return 0.0
