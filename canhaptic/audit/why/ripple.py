"""What trembles in a log: frequency, amplitudes, share of the torque, and the phase between torque and motion.

A log is cut into windows of a quarter of a second that overlap by half. From each a cubic is subtracted, which is the
hand's own motion; what is left is the ripple. Windows in contact and out of contact are judged apart, each by the
median, so that the moments of touching and leaving do not count.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from canhaptic.control.balance import OUT_OF_CONTACT, Branch

if TYPE_CHECKING:
    from canhaptic.logs.energy_reader import EnergyLog

Array = NDArray[Any]

WINDOW: Final = 0.25  # [s]
FELT: Final = 0.05
"""Rms force from which a ripple counts as felt at a handle [N]; at a knob `FELT` times `KNOB`."""
KNOB: Final = 0.06  # [m] of handle per radian
_OF_TORQUE: Final = 0.01
"""Least share of the torque that counts as a ripple."""
_ANSWER: Final = ("sync_to_last_tpdo", "compute", "send")
"""Durations of a cycle from its SYNC until the torques are handed to the bus."""
_LONGEST: Final = 0.006
"""Time over which the acceleration is taken from positions [s]."""
_LEAST: Final = 3.0  # [Hz]
_SETTLING: Final = 3
"""Windows after a touch, or after the handle left the wall, in which what swings may die away."""
_BRIEF: Final = 0.3
"""Quantile of the windows that counts where no contact lasts longer: a touch alone is no ripple."""
_IN_CONTACT: Final = 0.1
"""Share of a window from which it counts as in contact."""
_FEWEST: Final = 16
"""Rows of a window below which nothing can be said."""
_OF_HANDS: Final = 12.0
"""Frequency below which lines may be the rest of the hand's own motion, and count the less the lower they are [Hz]."""
_NARROW: Final = 0.15
"""Half width of a line in the spectrum, as a fraction of its frequency."""


@dataclass(frozen=True, slots=True)
class Motion:
    """What a log tells of one axis: rows at equal times, of shape (n_rows,). Missing signals are None."""

    period: float  # [s]
    position: Array  # [m or rad]
    torque: Array | None  # applied in the hold that ended [N or N*m]
    command: Array | None = None  # sent for a later hold [N or N*m]
    touches: Array | None = None  # whether in contact
    gaps: Array | None = None  # lengths of the holds [sample times]
    is_rotary: bool = False
    lost: float = 0.0  # share of the SYNCs without a new position
    answer: float = 0.0  # mean time from a SYNC until its torque was handed to the bus [s]

    @property
    def count(self) -> float:
        """Smallest change of the position [m or rad]; 0 where nothing moves."""
        return least_step(self.position)

    @property
    def felt(self) -> float:
        """Least ripple that is felt [N or N*m, rms]."""
        return FELT * KNOB if self.is_rotary else FELT

    def part(self, rows: slice) -> "Motion":
        """Return some rows."""
        torque, command, touches, gaps = (
            None if of is None else of[rows] for of in (self.torque, self.command, self.touches, self.gaps)
        )
        return Motion(
            self.period, self.position[rows], torque, command, touches, gaps, self.is_rotary, self.lost, self.answer
        )


class Buzz(NamedTuple):
    """A ripple that was found."""

    frequency: float  # of its largest line [Hz]
    amplitude: float  # of the position, peak to peak [m or rad]
    torque: float  # peak to peak [N or N*m]; 0: not known
    share: float  # of the torque, rms over rms
    ripple: float  # way of the torque to and fro over that without the ripple
    impedance: complex  # torque over position at that frequency [N/m or N*m/rad]; 0: not known
    purity: float  # share of the ripple's power in the line and its multiples
    chatter: float  # contacts per second
    windows: Array  # first rows of the windows that tremble
    size: int  # rows of a window
    in_contact: bool

    @property
    def phase(self) -> float:
        """Phase by which the torque is ahead of minus the motion [rad]; below 0 it feeds the motion."""
        return float(np.angle(-self.impedance)) if self.impedance else 0.0


def least_step(values: Array) -> float:
    """Return the smallest change of a signal that is larger than rounding; 0 for a constant one."""
    steps = np.abs(np.diff(values))
    steps = steps[steps > 1e-9 * max(float(np.abs(values).max(initial=0.0)), 1e-12)]
    return float(steps.min()) if len(steps) else 0.0


def variation(values: Array, start: float | None = None) -> float:
    """Return the way of a signal to and fro, in its unit; of several signals, one a row, the sum.

    Args:
        values: The signal.
        start: Value before the first one; None: the first one.
    """
    steps = np.diff(values) if start is None else np.diff(values, prepend=start)
    return float(np.abs(steps).sum())


def to_and_fro(values: Array) -> float:
    """Return the largest less the smallest value over the size of the mean; infinite around zero."""
    mean = abs(float(values.mean()))
    return float(np.ptp(values)) / mean if mean > 0.0 else float("inf")


def residues(values: Array, starts: Array, size: int) -> Array:
    """Return windows of a signal without their cubic parts, shape (n_windows, size)."""
    parts = values[starts[:, None] + np.arange(size)]
    basis = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, size), 4))[0]
    return np.asarray(parts - (parts @ basis) @ basis.T)


def motion_of(log: "EnergyLog", name: str, rows: slice | None = None) -> Motion:
    """Return the motion of an axis in a log; SYNCs that were skipped are filled with cubics."""
    port, rows = log.ports[name], rows or slice(0, log.rows)

    def column(key: str) -> Array:
        return port.read(key, rows.start, rows.stop)

    deadlines, branch = log.deadlines(rows.start, rows.stop), column("branch")
    gaps = np.diff(deadlines, prepend=deadlines[0] - 1 if len(deadlines) else 0)
    position, command = column("position"), column("torque_command")
    torque = command * np.nan if log.dry_run else column("torque_applied")
    touches = ~np.isin(branch, (*OUT_OF_CONTACT, Branch.FREE))
    if len(deadlines) and (gaps > 1).any():
        time = np.arange(deadlines[0], deadlines[-1] + 1)
        held = np.searchsorted(deadlines, time)
        position = _filled(time, deadlines, position)
        command, torque, touches = command[held], torque[held], touches[held]
    is_rotary = port.unit("position") == "rad"
    lost = 1.0 - float(column("fresh").mean()) if len(gaps) else 0.0
    spent = sum(float(log.timing.read(of, rows.start, rows.stop).mean()) for of in _ANSWER) if len(gaps) else 0.0
    return Motion(
        log.sample_time,
        position,
        None if log.dry_run else torque,
        command,
        touches,
        gaps,
        is_rotary,
        lost,
        spent * 1e-9,
    )


def _filled(time: Array, known: Array, values: Array) -> Array:
    """Return values at whole times between known ones, by cubics whose slopes are those through the neighbours."""
    known, rows = np.unique(known, return_index=True)  # a line whose host has slipped counts a hold twice
    values = values[rows]
    slopes = np.gradient(values, known)
    place = np.clip(np.searchsorted(known, time, "right") - 1, 0, len(known) - 2)
    width = (known[place + 1] - known[place]).astype(float)
    part = (time - known[place]) / width
    rest = 1.0 - part
    first, last = values[place], values[place + 1]
    ends = first * rest**2 * (1.0 + 2.0 * part) + last * part**2 * (3.0 - 2.0 * part)
    return np.asarray(ends + width * part * rest * (slopes[place] * rest - slopes[place + 1] * part))


def _accelerations(motion: Motion, span: int) -> tuple[Array, float]:
    """Return the smoothed acceleration at every row, and its noise by the encoder [m/s^2 or rad/s^2, rms]."""
    smooth = np.convolve(motion.position, np.full(span, 1.0 / span), "same")
    found = np.zeros_like(smooth)
    time = span * motion.period
    found[2 * span : -2 * span] = _second(smooth, span) / time**2
    return found, 0.7 * motion.count / time**2


def _second(values: Array, span: int) -> Array:
    """Return second differences over a span, without two spans at each end."""
    return np.asarray(values[3 * span : -span] - 2.0 * values[2 * span : -2 * span] + values[span : -3 * span])


def buzz_of(motion: Motion, mass: float) -> Buzz | None:
    """Return the ripple of a motion; None where nothing is felt, or the log is shorter than a window.

    Args:
        motion: What the log tells of the axis.
        mass: Mass that moves, roughly [kg or kg*m^2].
    """
    starts, size, touching = _cut(motion)
    if not len(starts):
        return None
    forces = _forces(motion, mass, starts, size)
    for chosen in (touching >= _IN_CONTACT, touching < _IN_CONTACT):
        if chosen.sum() < 2:
            continue
        settled = chosen & ~_after_a_change(touching >= _IN_CONTACT)
        lasting = np.median(forces[settled]) if settled.sum() > 1 else np.quantile(forces[chosen], _BRIEF)
        typical = float(lasting)
        if typical >= motion.felt:
            trembling = starts[chosen & (forces >= 0.5 * typical)]
            found = _described(motion, mass, trembling, size, bool(touching[chosen][0] >= _IN_CONTACT))
            if found is not None:
                return found
    return None


def _after_a_change(touching: Array) -> Array:
    """Return which windows are shortly after a contact began or ended that lasted for two windows."""
    is_new = np.zeros(len(touching), bool)
    for row in np.flatnonzero(touching[1:] != touching[:-1]) + 1:
        before = touching[max(0, row - 2) : row]
        if (before == before[0]).all():
            is_new[row : row + _SETTLING] = True
    return is_new | (np.arange(len(touching)) < 2)


def ripple_force(motion: Motion, mass: float) -> float:
    """Return the rms force of the ripple [N or N*m]: the median in contact, or out of it where there is no contact."""
    starts, size, touching = _cut(motion)
    if not len(starts):
        return 0.0
    forces = _forces(motion, mass, starts, size)
    return float(np.median(forces[touching >= _IN_CONTACT] if (touching >= _IN_CONTACT).any() else forces))


def _cut(motion: Motion) -> tuple[Array, int, Array]:
    """Return first rows and size of the windows, and the share of each that is in contact."""
    size = round(WINDOW / motion.period)
    starts = np.arange(0, len(motion.position) - size + 1, max(1, size // 2)) if size >= _FEWEST else np.arange(0)
    if motion.touches is None or not len(starts):
        return starts, size, np.zeros(len(starts))
    return starts, size, motion.touches[starts[:, None] + np.arange(size)].mean(axis=1)


def _forces(motion: Motion, mass: float, starts: Array, size: int) -> Array:
    """Return the rms force of the ripple in each window [N or N*m], of torque and moved mass."""
    forces = np.zeros(len(starts))
    for span in {1, 2, 4, max(1, round(_LONGEST / motion.period))}:
        moved, noise = _accelerations(motion, span)
        if mass * noise <= motion.felt:
            rest = residues(moved, starts, size)
            forces = np.maximum(forces, mass * np.sqrt(np.maximum(0.0, (rest**2).mean(axis=1) - 4.0 * noise**2)))
    if motion.torque is not None:
        torque = motion.torque[starts[:, None] + np.arange(size)]
        ripple = residues(motion.torque, starts, size).std(axis=1)
        forces = np.maximum(forces, np.where(ripple >= _OF_TORQUE * np.abs(torque).max(axis=1), ripple, 0.0))
    return np.asarray(forces)


def spectrum(period: float, values: Array) -> tuple[Array, Array]:
    """Return frequencies [Hz] and amplitudes of a signal in windows of twice `WINDOW`, the root of the mean square.

    Args:
        period: Time between two values [s].
        values: The signal, shape (n,); shorter than a window: amplitudes of its whole length.
    """
    size = min(len(values), 2 * round(WINDOW / period))
    if size < _FEWEST:
        return np.zeros(0), np.zeros(0)
    rest = residues(values, np.arange(0, len(values) - size + 1, max(1, size // 2)), size)
    taper = np.hanning(size)
    powers = (np.abs(np.fft.rfft(rest * taper)) ** 2).mean(axis=0)
    return np.fft.rfftfreq(size, period), np.asarray(2.0 * np.sqrt(powers) / taper.sum())


def _described(motion: Motion, mass: float, starts: Array, size: int, in_contact: bool) -> Buzz | None:
    """Return the figures of the windows that tremble."""
    size = min(2 * size, len(motion.position))
    starts = np.unique(np.minimum(starts, len(motion.position) - size))
    position = residues(motion.position, starts, size)
    torque = np.zeros_like(position) if motion.torque is None else residues(motion.torque, starts, size)
    taper = np.hanning(size)
    lines, moved, pushed = np.fft.rfftfreq(size, motion.period), *(np.fft.rfft(of * taper) for of in (position, torque))
    omega = 2.0 * np.pi * lines
    inertial = (np.abs(moved) ** 2).mean(axis=0) * (mass * omega**2) ** 2
    powers = (np.abs(pushed) ** 2).mean(axis=0) if np.any(torque) else inertial
    band = lines >= _LEAST
    if not powers[band].any():
        return None
    weighed = np.where(band, powers * np.minimum(lines, _OF_HANDS) ** 2, 0.0)
    place = int(np.argmax(weighed))
    frequency = _peak(lines, powers, place)
    near = np.abs(lines - frequency * np.maximum(1.0, np.round(lines / frequency))) <= max(
        _NARROW * frequency, lines[2]
    )
    cross, own = (pushed * moved.conj())[:, place].mean(), (np.abs(moved[:, place]) ** 2).mean()
    impedance = complex(cross / own * np.exp(0.5j * omega[place] * motion.period)) if own > 0.0 else 0j
    whole = motion.torque[starts[:, None] + np.arange(size)] if motion.torque is not None else torque
    smooth = whole - torque
    return Buzz(
        frequency,
        _swing(moved[:, lines >= 0.5 * frequency], taper),
        float(np.median(np.ptp(torque, axis=1))),
        float(torque.std() / max(float(np.sqrt((whole**2).mean())), 1e-12)),
        _ratio(variation(whole), variation(smooth)),
        impedance,
        float(powers[band & near].sum() / powers[band].sum()),
        _chatter(motion, starts, size),
        starts,
        size,
        in_contact,
    )


def _swing(lines: Array, taper: Array) -> float:
    """Return the way to and fro of a sinusoid with the power of some lines of the spectra, in their median."""
    powers = 2.0 * (np.abs(lines) ** 2).sum(axis=1) / (len(taper) * (taper**2).sum())
    return float(2.0 * np.sqrt(2.0 * np.median(powers)))


def _ratio(first: float, second: float) -> float:
    return float(first / second) if second > 0.0 else 1.0


def _peak(lines: Array, powers: Array, place: int) -> float:
    """Return the frequency of a line, by a parabola through the logarithms of three powers."""
    near = powers[max(0, place - 1) : place + 2]
    if len(near) < 3 or near.min() <= 0.0 or near.max() > powers[place]:
        return float(lines[place])
    left, middle, right = np.log(near)
    bend = left - 2.0 * middle + right
    return float(lines[place] + (0.5 * (left - right) / bend if bend else 0.0) * lines[1])


def _chatter(motion: Motion, starts: Array, size: int) -> float:
    """Return how often a contact begins in some windows [1/s]."""
    if motion.touches is None:
        return 0.0
    begins = np.diff(motion.touches.astype(np.int8), prepend=0)[starts[:, None] + np.arange(size)] > 0
    return float(begins.mean() / motion.period)
