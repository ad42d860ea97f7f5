"""The hold in which a torque acts: its dead time, separated from its lag.

A torque that begins late by d and rises with a lag tau moves a mass after a step of the torque by

    (A / m) (t^2 / 2 - (d + tau) t + d^2 / 2 + d tau + tau^2 - tau^2 e^(-(t - d) / tau)),    t > d:

d + tau, the lateness, shows in the speed; d, separated from tau, in a lasting displacement of (A / m) tau^2 / 2.
Reversals of many lengths and sizes are timed against the commands: both are fitted to windows around each reversal in
which the axis moves one way. The unknowns of a window (initial position and speed, constant load, friction) are a
polynomial; a shaft or belt adds a resonance, with a motion of its own in each window. Where the mean of the residuals
is above their noise, the model does not describe the rig, and nothing is concluded.

The torque that the drive reports is compared with the commands separately: a drive that acts a hold early
and one that reports its torque a hold early look the same in the torques alone.
"""

import math
from collections.abc import Iterable
from itertools import product
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from canhaptic.commission.session import OpenLoop, Session, StepVerdict
from canhaptic.drive.can.bus_budget import torque_latency
from canhaptic.drive.can.servo_drive import ServoDrive
from canhaptic.drive.profile.quirks import quirks_of

_Array = NDArray[np.floating[Any]]

_FEWEST: Final = 8  # windows
_BEFORE: Final = 8  # sample times before a window in which a change of torque still counts
_UNEXPLAINED: Final = 2.0  # of the noise of a mean: more is not noise
_DELAYS: Final = np.arange(-13, 29) * 0.1  # [sample times]
_NARROW: Final = 0.6  # [sample times] from which on no better model is tried
_MARGIN: Final = 0.05  # [sample times]
_LATEST: Final = 2  # SYNCs late
_CLEAR: Final = 0.3  # [sample times] a range this narrow names one hold; the torque narrows it by its root
_GOLDEN: Final = 0.382


class TorqueDelay(NamedTuple):
    """Onset of a torque relative to its declared hold [sample times]."""

    delay: float
    low: float
    high: float
    lag: float
    is_explained: bool  # whether the motion is that of the model

    def hold(self, reaction: float) -> int | None:
        """Return the hold in which the torque acts, counted from the declared one; None: unclear.

        Args:
            reaction: Longest time from a SYNC to the arrival of its RPDO [sample times].
        """
        if not self.is_explained or self.high - self.low > 0.95:
            return None
        begins = {-1: min(reaction, 1.0), **dict.fromkeys(range(_LATEST + 1), 0.2)}  # the drive's processing
        begun = {hold for hold, after in begins.items() if self.low <= hold + after + _MARGIN}
        within = {hold for hold in begun if self.high >= hold - _MARGIN}
        within = within or {math.floor(end + _MARGIN) for end in (self.low, self.high)}
        return next(iter(within)) if len(within) == 1 else None


class _Windows(NamedTuple):
    """Products of displacements and torque changes, summed over all windows; their means, signed by the reversal."""

    number: int
    half: int
    moved: _Array
    both: _Array
    pushed: _Array
    mean_moved: _Array
    mean_pushed: _Array


class _Model(NamedTuple):
    """Projection that removes the unknowns of a window, and the resonance (rad / sample time, damping) of a shaft."""

    rest: _Array
    mode: tuple[float, float] | None
    freedom: int  # of a window


def estimate_delay(positions: _Array, torques: _Array, sample_time: float, half_base: int) -> TorqueDelay | None:
    """Estimate when the torques begin to act; None where the axis moved too little.

    Args:
        positions: Position at each SYNC, shape (n,) [m or rad].
        torques: Torque of the hold that ended at each SYNC, as declared, shape (n,) [N or N*m].
        sample_time: Sample time [s].
        half_base: Half the length of a window [sample times].
    """
    windows = _windows(positions, torques, half_base)
    if windows is None:
        return None
    most = 1.5e-3 / sample_time  # slowest current loop
    found, score = _profile(windows, _model(half_base, None), most)
    if score <= _UNEXPLAINED and found.high - found.low <= _NARROW:
        return found
    other, other_score = _profile(windows, _resonant(windows, most), most)
    if max(score, other_score) > _UNEXPLAINED:
        return other if other_score < score else found
    return other if other.high - other.low < found.high - found.low else found


def _windows(positions: _Array, torques: _Array, half: int) -> _Windows | None:
    """Collect the windows about each reversal in which the axis moves one way."""
    at, before = np.arange(-half, half + 1), np.arange(-half - _BEFORE, half + 1)
    changes = np.diff(torques, append=torques[-1])
    turns = np.flatnonzero(torques[:-1] * torques[1:] < 0.0)
    turns = turns[(turns >= half + _BEFORE) & (turns < len(positions) - half)]
    if len(turns) < _FEWEST:
        return None
    moved = positions[turns[:, None] + at]
    parts = np.diff(moved[:, :: max(1, half // 2)], axis=1)
    is_one_way = ((parts > 0.0).all(axis=1) | (parts < 0.0).all(axis=1)) & np.isfinite(moved).all(axis=1)
    moved, pushed = moved[is_one_way], changes[turns[is_one_way, None] + before]
    if len(moved) < _FEWEST:
        return None
    moved = moved - moved[:, :1]
    signs = np.sign(pushed[:, half + _BEFORE])[:, None]
    earlier = torques[turns[is_one_way] - half - _BEFORE]
    pushed = np.column_stack([earlier, pushed])
    sums = moved.T @ moved, moved.T @ pushed, pushed.T @ pushed
    return _Windows(len(moved), half, *sums, (moved * signs).mean(axis=0), (pushed * signs).mean(axis=0))


def _model(half: int, mode: tuple[float, float] | None) -> _Model:
    at = np.arange(-half, half + 1)
    columns = [at**0, at / half, (at / half) ** 2]
    if mode is not None:
        fade = np.exp(-mode[0] * mode[1] * at)
        columns += [fade * np.cos(mode[0] * at), fade * np.sin(mode[0] * at)]
    basis = np.linalg.qr(np.column_stack(columns))[0]
    return _Model(np.eye(len(at)) - basis @ basis.T, mode, len(at) - basis.shape[1])


def _response(times: _Array, lag: float, mode: tuple[float, float] | None) -> _Array:
    """Displacement after a step of torque that began at 0 with a lag: of a free mass, or of a resonance."""
    after = np.maximum(times, 0.0)
    lag = max(lag, 1e-9)
    fade = np.expm1(-after / lag)
    if mode is None:
        return 0.5 * after * after - lag * (after + lag * fade)
    root, damping = mode
    pole = complex(-damping * root, root * math.sqrt(1.0 - damping * damping))
    ringing = 2.0 * np.real(np.exp(pole * after) / (pole * (lag * pole + 1.0) * 2j * pole.imag))
    still = lag * lag / (1.0 - 2.0 * damping * root * lag + (root * lag) ** 2)
    response: _Array = 1.0 / root**2 + ringing - still * (fade + 1.0)
    return response


def _left(windows: _Windows, model: _Model, delay: float, lag: float) -> tuple[float, _Array]:
    """Sum of the squared residuals for a delay and a lag, and its mean over the windows."""
    at = np.arange(-windows.half, windows.half + 1)
    times = at[:, None] - np.arange(-windows.half - _BEFORE, windows.half + 1)
    rigid, cubic = _response(times - delay, lag, None), at[:, None] ** 3 / 6.0
    shapes = [np.hstack([0.0 * cubic, rigid]), np.hstack([cubic, np.cumsum(rigid, axis=0)])]  # of torque and damping
    if model.mode is not None:
        shapes.append(np.hstack([0.0 * cubic, _response(times - delay, lag, model.mode)]))
    parts = np.array([model.rest @ shape for shape in shapes])
    parts /= np.sqrt((parts * parts).sum(axis=(1, 2)))[:, None, None]
    matrix = np.einsum("iab,jab->ij", parts @ windows.pushed, parts)
    known = (parts * windows.both).sum(axis=(1, 2))
    shares = np.linalg.lstsq(matrix, known, rcond=1e-10)[0]
    mean = model.rest @ windows.mean_moved - np.tensordot(shares, parts, 1) @ windows.mean_pushed
    return float((model.rest * windows.moved).sum() - known @ shares), mean


def _best_lag(windows: _Windows, model: _Model, delay: float, most: float) -> tuple[float, float]:
    """Return the least squared residual over the lags up to `most`, and that lag."""
    tried = [(_left(windows, model, delay, float(lag))[0], float(lag)) for lag in np.linspace(0.0, most, 6)]
    middle, step = min(tried)[1], most / 5.0
    low, high = max(0.0, middle - step), min(most, middle + step)
    for _ in range(8):
        inner = low + _GOLDEN * (high - low), high - _GOLDEN * (high - low)
        found = [(_left(windows, model, delay, lag)[0], lag) for lag in inner]
        low, high = (low, inner[1]) if found[0] < found[1] else (inner[0], high)
        tried += found
    return min(tried)


def _profile(windows: _Windows, model: _Model, most: float) -> tuple[TorqueDelay, float]:
    """Return the range of possible delays, each with its best lag, and the ratio of the residual to noise."""
    found = [_best_lag(windows, model, float(delay), most) for delay in _DELAYS]
    least, lag = min(found)
    place = found.index((least, lag))
    variance = least / (windows.number * model.freedom - 8)
    mean = _left(windows, model, float(_DELAYS[place]), lag)[1]
    score = max(1.0, windows.number * float(mean @ mean) / (variance * model.freedom))
    possible = _DELAYS[[value - least <= 5.0**2 * variance * score for value, _ in found]]  # five standard deviations
    low, high = float(possible.min()) - _MARGIN, float(possible.max()) + _MARGIN
    is_explained = score <= (_UNEXPLAINED if high - low > _NARROW else 40.0)  # one delay is left, were it noise
    return TorqueDelay(float(_DELAYS[place]), low, high, lag, is_explained), score


def _resonant(windows: _Windows, most: float) -> _Model:
    """Return the model with the resonance that explains the motion best."""
    roots = np.geomspace(0.12, 2.6, 36)  # [rad / sample time]
    models = [_model(windows.half, (float(root), damping)) for root in roots for damping in (0.01, 0.06, 0.2)]
    starts = [(float(delay), lag) for delay in range(-1, _LATEST + 1) for lag in (0.05, 0.4 * most)]
    best, at = _best_of(windows, models, starts)
    for width in (0.03, 0.01, 0.003):
        root, damping = best.mode or (0.0, 0.0)
        around = [root * (1.0 + step * width) for step in (-2, -1, 0, 1, 2)]
        dampings = [min(0.9, damping * factor) for factor in (0.6, 0.8, 1.0, 1.25, 1.6)]
        models = [_model(windows.half, mode) for mode in product(around, dampings)]
        best, at = _best_of(windows, models, [at])
        lags = [(_best_lag(windows, best, at[0] + step, most), at[0] + step) for step in (-0.4, -0.2, 0.0, 0.2, 0.4)]
        (_, lag), delay = min(lags)
        at = delay, lag
    return best


def _best_of(
    windows: _Windows, models: Iterable[_Model], starts: Iterable[tuple[float, float]]
) -> tuple[_Model, tuple[float, float]]:
    return min(product(models, starts), key=lambda tried: _left(windows, tried[0], *tried[1])[0])


_LATE: Final = "acts_a_sync_late"
_MOTION, _SHOWN, _BOOKED = "command to motion", "command to read-back", "read-back to motion"


class HoldTimes(NamedTuple):
    """Times between command, read-back and motion, relative to the declared ones [sample times]; they must add up."""

    motion: TorqueDelay | None  # command to motion; None: too little moved
    shown: int | None  # command to read-back; None: none, or unclear
    booked: TorqueDelay | None  # read-back to motion
    hold: int | None  # in which the torque acts; None: unclear
    is_read_back: bool

    @property
    def is_sure(self) -> bool:
        """Whether one test is enough to determine the hold."""
        return self.hold is not None and self.motion is not None and self.motion.high - self.motion.low <= 0.65

    @property
    def closes(self) -> bool:
        """Whether the three times add up within their uncertainties."""
        if self.motion is None or self.shown is None or self.booked is None:
            return False
        open_end = self.motion.delay - self.shown - self.booked.delay
        return abs(open_end) <= 0.5 * (self.motion.high - self.motion.low + self.booked.high - self.booked.low)


def time_the_hold(session: Session, axis: int, law: OpenLoop, half_base: int) -> HoldTimes:
    """Time motion and read-back of an axis against the commands, and the motion against the read-back.

    Args:
        session: Commissioning session.
        axis: Index of the axis.
        law: Record of reversals.
        half_base: Half the length of a window [sample times].
    """
    drive, period = session.drives[axis], session.sample_time
    positions, booked = law.regular_positions(_BEFORE) / session.encoder_ratios[axis], np.array(law.applied)
    declared = as_declared(session, axis, law)
    motion = estimate_delay(positions, declared, period, half_base)
    hold = None if motion is None else motion.hold(_latency(session, drive) / period)
    if drive.map.read_back == "none":
        return HoldTimes(motion, None, None, hold, is_read_back=False)
    later = session.axes[axis].loop.delay + 1
    shown = _age(np.concatenate([declared[later:], np.zeros(later)]), booked)
    against = estimate_delay(positions, booked, period, half_base)
    return HoldTimes(motion, None if shown is None else shown - later, against, hold, is_read_back=True)


def _latency(session: Session, drive: Any) -> float:
    """Return the longest time from a SYNC until the torque that answers it has arrived [s]; 0 on a line."""
    if not isinstance(drive, ServoDrive):
        return 0.0
    on_can = (other for other in session.drives if isinstance(other, ServoDrive))
    return torque_latency(drive.bus, [other.map for other in on_can if other.link is drive.link])


def as_declared(session: Session, axis: int, law: OpenLoop) -> _Array:
    """Commanded torque that acts in the hold before each SYNC if the declared delay is right, shape (n,) [N or N*m]."""
    ahead = 1 + session.axes[axis].loop.delay
    return np.concatenate([np.zeros(ahead), law.sent])[: len(law.positions)]


def _age(commands: _Array, shown: _Array) -> int | None:
    """Return how many samples after its command a torque is shown; None: unclear."""
    changes, steps = np.diff(commands, prepend=0.0), np.diff(shown, prepend=0.0)
    shifted = [np.concatenate([np.zeros(age), changes])[: len(steps)] for age in range(6)]
    errors = [float(np.abs(steps - older).sum()) for older in shifted]
    is_clear = min(errors) <= 0.25 * float(np.abs(changes).sum())  # the right age explains all but this part
    return errors.index(min(errors)) if is_clear else None


def report_hold(session: Session, axis: int, times: HoldTimes) -> None:
    """Report the times from command to motion, to read-back and between these two; propose the values to declare."""
    begin = session.axes[axis].loop.delay
    _report_motion(session, axis, begin, times)
    if not times.is_read_back:
        return session.found(axis, _SHOWN, "", "none", StepVerdict.UNKNOWN, "no torque is read back")
    if times.shown is None:
        text = "the torque is filtered, noisy or not followed; ask the vendor"
        session.found(axis, _SHOWN, f"{begin} SYNC", "unclear", StepVerdict.UNKNOWN, text)
    else:
        text = "the hold that the drive reports is not the declared one"
        session.judged(axis, _SHOWN, f"{begin} SYNC", f"{begin + times.shown} SYNC", good=not times.shown, text=text)
    _report_booked(session, axis, times)


def _text(begin: int, found: TorqueDelay | None, hold: int | None) -> str:
    """Onset of a torque in SYNCs, with its uncertainty, as text; `begin` is the declared onset."""
    if found is None:
        return "unclear: too little motion"
    within = f"{begin + found.low:.2f} to {begin + found.high:.2f}"
    return f"unclear: {within} SYNC" if hold is None else f"{begin + hold} SYNC ({within})"


def _remedy(found: TorqueDelay | None) -> str:
    """Return why the hold stays unclear, and what to do."""
    until = "until the hold is known, the account of a real drive stays in doubt"
    if found is not None and not found.is_explained:
        cause = "the motion is not that of a mass with friction and one resonance"
        return f"{cause}: let go of the handle, and remove what is coupled to it; {until}"
    wide = 4.0 if found is None else max(2.0, ((found.high - found.low) / _CLEAR) ** 2)
    more = f"raise --torque or torque_limit about {wide:.0f} times, with --travel and --speed"
    return f"the encoder is too coarse for this torque: {more}, or use a finer encoder; {until}"


def _report_motion(session: Session, axis: int, begin: int, times: HoldTimes) -> None:
    """Report in which hold a torque acts; no scene is ready where it cannot declare that hold."""
    parameters, rpdo = session.axes[axis].parameters, session.drives[axis].bus.rpdo
    configured, found, hold = f"{begin} SYNC", _text(begin, times.motion, times.hold), times.hold
    late = quirks_of(parameters.quirks).syncs_late
    if hold is None:
        session.found(axis, _MOTION, configured, found, StepVerdict.UNKNOWN, _remedy(times.motion))
    elif hold == 0:
        session.found(axis, _MOTION, configured, found, StepVerdict.AGREES)
        checked = session.drives[axis].signature()
        session.propose(axis, "hold_checked", checked, comment="of this drive, PDO map and rate")
    elif rpdo == "synchronous" and late + hold in (0, 1):
        names = [name for name in parameters.quirks if name != _LATE] + [_LATE] * (late + hold)
        text = "every hold is booked with its neighbour's torque"
        session.found(axis, _MOTION, configured, found, StepVerdict.DIFFERS, text)
        session.propose(axis, "quirks", f"[{', '.join(names)}]", comment="from motion and commands")
    else:
        early = "acts before its SYNC: declare rpdo: event, and commission again"
        later = "acts later than can be declared: check the drive's own cycle settings"
        later = "waits for a SYNC: declare rpdo: synchronous, and commission again" if rpdo == "event" else later
        session.found(axis, _MOTION, configured, found, StepVerdict.FAILED, early if hold < 0 else later)


def _report_booked(session: Session, axis: int, times: HoldTimes) -> None:
    """Report whether the torque read back belongs to the hold that it is booked with."""
    configured, is_known = session.axes[axis].parameters.demand_reported, times.hold is not None and times.closes
    wrong = (times.hold or 0) - (times.shown or 0)
    found, other = _text(0, times.booked, wrong if is_known else None), {1: "after", -1: "before"}.get(wrong)
    if not is_known:
        text = "the times between command, read-back and motion do not add up" if times.hold is not None else ""
        session.found(axis, _BOOKED, configured, found, StepVerdict.UNKNOWN, text)
    elif not wrong:
        session.found(axis, _BOOKED, configured, found, StepVerdict.AGREES)
        session.propose(axis, "demand_reported", None, comment="from motion and read-back")
    elif other is None or other == configured:
        text = "the reported torque matches no neighbouring hold; use read_back: none, or ask the vendor"
        session.found(axis, _BOOKED, configured, found, StepVerdict.FAILED, text)
    else:
        text = f"every hold is booked with its neighbour's torque: {other}"
        session.found(axis, _BOOKED, configured, found, StepVerdict.DIFFERS, text)
        session.propose(axis, "demand_reported", other, comment="from motion and read-back")
