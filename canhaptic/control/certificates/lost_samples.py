"""What may have come in over several holds of which only the whole displacement is known.

After n - 1 lost samples the displacement D of n holds is known, the torque f_n of the last one, read back, and for each
hold before it the torques that may have acted. Booked is -f_n D; true is -sum f_j D_j; too much by

    sum over j < n and axes of (f_j - f_n) D_j = sum of delta_j D_j.

**Hand force.** Only the side of D_j that makes it large counts; on that side the declared force holds the hand. With
s the farthest that torques and hand move the axis beyond the hold before (`bound`), for delta_j > 0 (else all mirrored)

    f_j > 0:   D_j <= D_0 + j s + friction,                         the hand pulls along f_j with F_h at most;
    else f_n < f_j <= 0, and the hand is held along -: D_m >= D_j - (m - j) s - friction for m > j, and
               D_k >= D_0 - k s - friction for k < j; their sum is D, so that
               (n - j + 1) D_j <= D - (j - 1) D_0 + s (j (j - 1) + (n - j)(n - j + 1)) / 2 + friction

(with friction, 1 + a + a^2 + ... in place of n - j + 1 where D_j > 0, a the share that a hold keeps of the one before).

**Hand speed.** |D_j| <= v_max T.

**Device damping** alone, for every hand: sum((b/T) D_j^2 - delta_j D_j) over displacements of sum D is least at
D_j = D/n + (T/2b)(delta_j - mean), where it is (b/T) D^2 / n - mean D - (T/4b) sum((delta_j - mean)^2). The first term
is dissipated for certain, the others are in doubt.
"""

from typing import NamedTuple


class Gap(NamedTuple):
    """Several holds of one axis, with what is known of the one before them."""

    holds: int
    moved: float  # in all of them [m or rad]
    start: float  # in the hold before [m or rad]
    error: float  # by which `moved` is unsure [m or rad]
    blur: float  # by which `start` is [m or rad]
    step: float  # how far a hold may go beyond the hold before [m or rad]
    lost: float  # largest share of a motion that friction takes from the next hold


def _mirrored(gap: Gap) -> Gap:
    """Returns the same seen from the other side."""
    return gap._replace(moved=-gap.moved, start=-gap.start)


def _farthest(gap: Gap, hold: int, *, along: bool) -> float:
    """Returns the largest displacement of one hold, counted positive [m or rad].

    Args:
        gap: Of the axis.
        hold: 1 for the first one; the last is not asked for.
        along: Whether a positive torque acts in it; else a negative one acts in the last.
    """
    first = gap.start + gap.blur
    if along:
        return first + hold * (gap.step + gap.lost * (-first if first < 0.0 else 0.0))
    later = gap.holds - hold
    least = gap.start - gap.blur
    pairs = hold * (hold - 1) + later * (later + 1)
    total = gap.moved + gap.error - (hold - 1) * least + 0.5 * pairs * gap.step
    total += 0.5 * hold * (hold - 1) * gap.lost * (least if least > 0.0 else 0.0)
    if total <= 0.0:
        return total / (later + 1)  # nothing that friction could take
    kept = 1.0 - gap.lost
    return total / sum([kept**more for more in range(later + 1)])


def worst(gap: Gap, last: float, candidates: list[list[float]]) -> float:
    """Returns how much less than booked may have come in by one axis [J]; below 0 where more has for certain.

    Args:
        gap: Of the axis.
        last: Torque of the last hold [N or N*m].
        candidates: Torques that may have acted, for each hold but the last.
    """
    total, other = 0.0, _mirrored(gap)
    for index, torques in enumerate(candidates):
        most = None
        for torque in torques:
            more = torque - last
            if more > 0.0:
                doubt = more * _farthest(gap, index + 1, along=torque > 0.0)
            elif more < 0.0:
                doubt = -more * _farthest(other, index + 1, along=torque < 0.0)
            else:
                doubt = 0.0
            if most is None or doubt > most:
                most = doubt
        total += most or 0.0
    return total


def worst_of_path(path: float, last: float, candidates: list[list[float]]) -> float:
    """Returns `worst` for an axis that moves no further than `path` [m or rad] in each hold [J]."""
    return sum(max(abs(torque - last) for torque in torques) for torques in candidates) * path


def worst_damped(gap: Gap, last: float, candidates: list[list[float]], damping: float) -> float:
    """Returns `worst` for every hand, of an axis that dissipates at least damping * D_j^2 in each hold [J].

    Args:
        gap: Of the axis.
        last: Torque of the last hold [N or N*m].
        candidates: Torques that may have acted, for each hold but the last.
        damping: Certain damping over the sample time [N/m or N*m/rad], > 0.
    """
    total = 0.0
    for torques in candidates:
        total += max([(t - last) * gap.moved + abs(t - last) * gap.error for t in torques]) / gap.holds
        total += max([(t - last) ** 2 for t in torques]) / (4.0 * damping)
    return total
