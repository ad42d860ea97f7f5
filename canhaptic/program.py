"""Control of a rig by a user's own loop: one iteration per SYNC, with a torque request for each axis.

    with canhaptic.open_rig("rig.yaml") as rig:
        for sample in rig:                                       # one SYNC per turn
            rig["knob"].torque = -2.0 * sample["knob"].position  # sent at the end of the turn, limited by the guard

Bring-up, limits, link policy, account, logs and verdict are as in `canhaptic run`; the program replaces environment
and algorithm. The drives are enabled only at the first turn, because SYNCs must not pause after that. However the loop
ends, zero torque is sent before the drives are disabled. If no code can react (SIGKILL, `os._exit`, a crash of the
interpreter), each drive's watchdog acts; a rig without watchdogs is refused.
"""

import atexit
import os
import signal
import threading
import weakref
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from math import isfinite
from numbers import Real
from os import PathLike
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, Final, Literal, NamedTuple, Self

from canhaptic.axis_units import effort_unit
from canhaptic.control.balance import Branch, Certificate, EnergyBalance
from canhaptic.cycle import Cycle, running
from canhaptic.drive.clock import WallClock
from canhaptic.drive.safety.link_policy import StopReason
from canhaptic.errors import CanHapticError, InputError, RigError, StartStoppedError, cause_of
from canhaptic.host.stop_signal import SHELL_OFFSET, StopSignal, note
from canhaptic.registry import nearest
from canhaptic.replay import OpenReplay, ReplayOverError, ReplayResult
from canhaptic.scene.build import Experiment, build, experiment_account, logs_elsewhere
from canhaptic.scene.load import for_program, says_none
from canhaptic.scene.models import AxisScene, RunParameters, Scene, require_no_guesses
from canhaptic.signals import Sample
from canhaptic.simulation import Account, load_any, with_checked_holds
from canhaptic.units import shown

_PATIENCE: Final = 1.0  # [s] for a turn of another thread to end at the exit of the interpreter
_ROUNDING: Final = 1e-9
_HELD: Final = Branch.HELD.value
_new: Final = tuple.__new__  # makes a record at half the cost of calling its class
_Guard = Literal["none"] | None
_Pace = Literal["real", "free"] | None


def open_rig(
    scene: str | PathLike[str] | Mapping[str, object] | Scene,
    changes: Mapping[str, object] | None = None,
    *,
    guard: _Guard = None,
    pace: _Pace = None,
    duration: float | None = None,
    energy_log: str | PathLike[str] | None = None,
    bus_log: str | PathLike[str] | None = None,
    force: bool = False,
    no_torque: bool = False,
    replay: str | PathLike[str] | None = None,
    allow_code: bool = False,
) -> "OpenRig":
    """Return a rig to iterate over inside `with`; nothing is sent before the first turn.

    Args:
        scene: A scene file, a mapping with its keys, or a loaded scene. Environment and algorithm are
            ignored.
        changes: Values that replace those of the scene, by path, as for `simulate`. Not for a loaded scene.
        guard: None: the certificates of `guarded` limit each torque. "none": torques are sent as requested; on a real
            rig the scene must say so too, by `guard: none` or `algorithm: unprotected`.
        pace: As for `build`.
        duration: Time after which the loop ends [s]; None: that of the scene, or never.
        energy_log: Energy log (HDF5) to write; by default the scene's.
        bus_log: Bus log (candump text) to write; by default the scene's.
        force: Whether logs may replace files.
        no_torque: Whether the torque sent is always 0: a dry run.
        replay: Bus log of an earlier run: its drives answer instead of real ones, and the frames that the program
            causes are compared with the recorded frames.
        allow_code: As for `simulate`.

    Raises:
        SceneError: The scene is wrong, or has an axis in a group; lists every fault.
        InputError: Only one of scene and call switches the guard of a real rig off, a drive has no watchdog, a log
            already exists, or a value is still to be set.

    Example:
        >>> with canhaptic.open_rig("configs/demo.yaml", guard=None) as rig:  # doctest: +SKIP
        ...     for sample in rig:
        ...         rig["handle"].torque = -5.0 * sample["handle"].velocity
    """
    written = load_any(scene, changes or {}, allow_code)
    chosen = _guard_of(written, guard, is_replay=replay is not None)
    ready = for_program(written, chosen) if isinstance(scene, Scene) else load_any(
        scene, {**(changes or {}), "guard": chosen}, allow_code
    )  # fmt: skip
    length = ready.run.duration if duration is None else RunParameters.validated({"duration": duration}).duration
    cycles = None if length is None else max(1, round(length / ready.bus.sample_time))
    if replay is not None:
        return OpenRig(ready, cycles, pace, (None, None), Path(replay), no_torque=no_torque)
    _require_watchdogs(ready)
    require_no_guesses(ready)
    logs_elsewhere(ready, energy=energy_log is None, bus=bus_log is None)
    logs = (energy_log or ready.log.energy), (bus_log or ready.log.bus)
    for taken in logs:
        if taken and Path(taken).exists() and not force:
            raise InputError(f"{taken} already exists; force=True replaces it, or name another file")
    energy, bus = (None if path is None else Path(path) for path in logs)
    return OpenRig(ready, cycles, pace, (energy, bus), None, no_torque=no_torque)


def _guard_of(scene: Scene, asked: _Guard, *, is_replay: bool) -> str:
    """Return the guard in effect; to switch it off on a real rig, scene and call must agree."""
    if asked not in (None, "none"):
        raise InputError(f"guard: got {shown(asked)}, expected None (the certificates) or 'none'")
    in_scene = says_none(scene)
    if in_scene is not (asked == "none") and not (scene.simulated or is_replay):
        off, other = ("the scene", 'open_rig(guard="none")') if in_scene else ('open_rig(guard="none")', "the scene")
        raise InputError(
            f"{scene.source}: {off} switches the guard off, {other} does not; without it a real drive may give out any "
            'amount of energy, so both must agree: write `guard: none` in the scene and guard="none" in the call, or '
            "in neither (`algorithm: unprotected` also switches it off)"
        )
    return "certificates" if asked is None else "none"


def _require_watchdogs(scene: Scene) -> None:
    for axis in scene.axes:
        if not axis.parameters.watchdog:
            text = f"{scene.source}: {axis.parameters.name}: watchdog: got false, so the torque would stay on after a"
            raise InputError(f"{text} crash of the program; set watchdog: true, with a drive that has one")


class AxisSample(NamedTuple):
    """State of an axis at a SYNC."""

    sync_index: int  # number of the SYNC, counted from 0
    position: float  # [m or rad]
    velocity: float  # estimated from an adaptive window of at most 20 ms [m/s or rad/s]
    torque: float  # applied since the previous SYNC, as the drive reports it [N or N*m]
    fresh: bool  # False: no TPDO arrived, and position and torque are the last known


class ProgramAxis:
    """One axis of an open rig.

    Attributes:
        name: Name of the axis.
        unit: Unit of its position, "m" or "rad".
        granted: Torque that the guard permitted in the last turn [N or N*m].
        limited_by: Why `granted` differs from the request: `start` (first turn), `lost sample`, `torque_limit`, the
            name of the limiting certificate, or `account` (no energy left); "" if it does not differ.
    """

    __slots__ = ("_asked", "_before", "_controller", "_grid", "_limit", "_rig", "_velocity", "granted", "limited_by",
                 "name", "unit")  # fmt: skip

    def __init__(self, rig: "OpenRig", axis: AxisScene, controller: Any) -> None:
        self.name, self.unit = axis.parameters.name, axis.parameters.unit
        self.granted, self.limited_by = 0.0, ""
        self._rig, self._controller = rig, controller
        self._asked = self._velocity = 0.0
        self._limit, self._grid = axis.parameters.torque_limit, axis.loop.torque_quantum + _ROUNDING
        self._before = -1  # sample times to the last report; -1 before the first

    @property
    def torque(self) -> float:
        """Torque requested in this turn [N or N*m]; reset to 0 for every turn.

        Raises:
            InputError: The value set is not a finite number, or no turn is open. Zero torque has been sent by then.
        """
        return self._asked

    @torque.setter
    def torque(self, value: float) -> None:
        if type(value) is not float:
            if not isinstance(value, Real) or isinstance(value, bool):
                raise self._rig.refusal(f"{self.name}: torque: got {value!r:.40}, expected a number")
            value = float(value)
        if not isfinite(value):
            raise self._rig.refusal(f"{self.name}: torque: got {value}, expected a finite number")
        if not self._rig.is_open:
            raise self._rig.refusal(f"{self.name}: torque: got {value:g} {effort_unit(self.unit)} outside a turn")
        self._asked = value

    def begin_turn(self, sample: Sample, now: int) -> AxisSample:
        """Store the sample of the axis at `now` [sample times since the first SYNC]; called by the rig only."""
        index, position, torque, _, fresh = sample
        if fresh:
            periods = now - self._before if self._before >= 0 else 0
            self._velocity, self._before = self._controller.velocity(position, periods), now
        return _new(AxisSample, (index, position, self._velocity, torque, fresh))

    def end_turn(self) -> None:
        """Pass the torque request of this turn to the controller; called by the rig only."""
        self._controller.ask(self._asked)

    def take_answer(self, balance: EnergyBalance, index: int) -> None:
        """Store the torque that the controller granted, and clear the request; called by the rig only."""
        torque, branch, certificate = balance.torque, balance.branch, balance.certificate
        asked, self._asked, self.granted = self._asked, 0.0, torque
        if -self._grid < asked - torque < self._grid:
            self.limited_by = ""
        elif branch == _HELD or index == 0:
            self.limited_by = "lost sample" if branch == _HELD else "start"
        elif abs(torque) > self._limit - self._grid:
            self.limited_by = "torque_limit"
        else:
            self.limited_by = Certificate(certificate).name.lower() if torque else "account"


class OpenRig:
    """A rig that a program iterates over inside `with`; see `open_rig`.

    Attributes:
        scene: Scene in which the program replaces environment and algorithm.
        is_open: Whether a turn is open; torques may be set only then.
        replayed: After the block of a replay, the outcome of the comparison; else None.
    """

    def __init__(self, scene: Scene, cycles: int | None, pace: _Pace, logs: tuple[Path | None, Path | None],
                 replay: Path | None, *, no_torque: bool) -> None:  # fmt: skip
        self.scene, self.is_open = scene, False
        self.replayed: ReplayResult | None = None
        self._cycles, self._pace, self._logs, self._replay = cycles, pace, logs, replay
        self._no_torque = no_torque
        self._source: Experiment | OpenReplay | None = None
        self._account: Account | None = None
        self._turns: weakref.ref[Any] | None = None  # so that `break` drops the last reference, which closes it
        self._axes: dict[str, ProgramAxis] = {}
        self._signals, self._deferred = StopSignal(take=self._take_signal), list[int]()
        self._numbers = self._signals.numbers
        self._left: CanHapticError | None = None
        self._stack = ExitStack()
        self._is_over = self._is_ending = self._must_end = self._is_complete = False
        self._begin, self._process = 0, 0

    @property
    def account(self) -> Account:
        """Energies of each port; available after the block.

        Raises:
            InputError: The block has not ended.
        """
        if self._account is None:
            raise InputError("open_rig: the account is ready when the block `with ... as rig:` has ended")
        return self._account

    @property
    def sample_time(self) -> float:
        """Time from SYNC to SYNC [s]."""
        return self.scene.bus.sample_time

    def __getitem__(self, name: str) -> ProgramAxis:
        if name not in self._axes:
            known = ", ".join(self._axes) or "none outside `with`"
            raise InputError(f"no axis {name!r}; expected one of: {known}{nearest(name, self._axes)}")
        return self._axes[name]

    def __enter__(self) -> Self:
        if self._source is not None:
            raise InputError("open_rig: this rig was opened before; call open_rig again")
        if threading.current_thread() is threading.main_thread():
            self._stack.enter_context(self._signals)
        try:
            self._open(self.scene)
        except BaseException:
            self._stack.close()
            raise
        return self

    def _open(self, scene: Scene) -> None:
        if self._replay is not None:
            self._source = OpenReplay(self._replay, scene, realtime=self._pace == "real", dry_run=self._no_torque)
        else:
            if not self._no_torque:
                self.scene = scene = with_checked_holds(scene)
            self._source = build(scene, self._pace, *self._logs, no_torque=self._no_torque)
        for axis, port in zip(scene.axes, self._source.cycle.ports, strict=True):
            self._axes[axis.parameters.name] = ProgramAxis(self, axis, port.controller)
        self._begin, self._process = WallClock().now(), os.getpid()
        atexit.register(self._at_exit)
        self._stack.callback(atexit.unregister, self._at_exit)

    def __iter__(self) -> Iterator[Mapping[str, AxisSample]]:
        if self._source is None or self._is_over:
            raise InputError("open_rig: iterate inside the block: with canhaptic.open_rig(...) as rig: for ... in rig:")
        if self._turns is not None:
            raise InputError("open_rig: a rig is iterated once; call open_rig again for another run")
        turns = self._run(self._source.cycle)
        self._turns = weakref.ref(turns)
        return turns

    def _run(self, cycle: Cycle) -> Iterator[Mapping[str, AxisSample]]:
        """Yield the samples of each turn; however it ends, send zero torque and disable the drives."""
        rig, axes, cycles = cycle.rig, tuple(self._axes.values()), self._cycles
        places = tuple(range(len(axes)))
        try:
            with running(cycle):
                while cycles is None or cycle.cycles < cycles:
                    samples = rig.sync()
                    self._end_if_asked()
                    now, turn = rig.deadline_index, {}
                    for place in places:  # faster than `zip` in a loop that runs every millisecond
                        axis = axes[place]
                        turn[axis.name] = axis.begin_turn(samples[place], now)
                    self.is_open = True
                    try:
                        yield turn
                    except GeneratorExit:
                        self._wind_down(samples)
                        raise
                    finally:
                        self.is_open = False
                    for axis in axes:
                        axis.end_turn()
                    balances = cycle.answer(samples)
                    for place in places:
                        axes[place].take_answer(balances[place], rig.sync_index)
                    self._end_if_asked()
                self._is_complete = True
        except ReplayOverError:
            return
        except StartStoppedError:
            self._end_if_asked()
            raise

    def _stop(self, reason: StopReason) -> None:
        """Stop the rig at once, if it was built; an error is kept for `__exit__` to raise."""
        try:
            if self._source is not None:
                self._source.cycle.rig.stop(ramp=False, reason=reason)
        except RigError as error:
            self._left = error

    def _wind_down(self, samples: list[Sample]) -> None:
        """Run the holds of the stop from a SYNC that was not answered; an error is kept for `__exit__` to raise."""
        try:
            if self._source is not None:
                self._source.cycle.wind_down(samples)
        except CanHapticError as error:
            self._left = error
        self._stop(StopReason.OPERATOR)

    def refusal(self, what: str) -> InputError:
        """Send zero torque, stop the rig, and return the error for an invalid request."""
        self._stop(StopReason.CONTROLLER)
        return InputError(f"{what}; torque is zero and the rig has stopped; set finite numbers, and only in the loop")

    def _take_signal(self, number: int, frame: FrameType | None) -> None:
        """Note a signal while the rig works; while the user's code does, end it, or call the user's own handler."""
        if not self._has_own_handler(number):
            note(number)
        if self._is_ending or self._is_at_work or _is_ours(frame):
            if self._has_own_handler(number) or len(self._numbers) == 1:  # one exception is enough
                self._deferred.append(number)
        else:
            self._act_on(number, frame)

    def _deliver(self) -> None:
        """Act on the signals that came while the rig worked."""
        while self._deferred:
            self._act_on(self._deferred.pop(0))

    def _has_own_handler(self, number: int) -> bool:
        return self._signals.before[number] not in (signal.SIG_DFL, signal.default_int_handler)

    def _act_on(self, number: int, frame: FrameType | None = None) -> None:
        handler = self._signals.before[number]
        if not (self._has_own_handler(number) and callable(handler)):
            raise _ending(number)
        handler(number, frame)

    @property
    def _is_at_work(self) -> bool:
        """Whether the rig is working between two turns, in any thread."""
        turns = None if self._turns is None else self._turns()
        return turns is not None and turns.gi_running

    def _end_if_asked(self) -> None:
        if self._deferred or self._numbers:
            self._deliver()
            if self._numbers:  # the user's code has caught its exception, and went on
                raise _ending(self._numbers[0])
        if self._must_end:
            raise SystemExit

    def _at_exit(self) -> None:
        """Stop the rig if the interpreter ends inside the block; do nothing in a forked process."""
        if os.getpid() != self._process or self._source is None:
            return
        self._must_end, clock = True, WallClock()
        end = clock.now() + round(_PATIENCE * 1e9)
        while self._is_at_work and clock.now() < end:
            clock.wait_until(clock.now() + 1_000_000)
        self._end("stopped")

    def _end(self, status: str) -> None:
        """Stop the rig, store the account, close logs and buses; a second call does nothing."""
        if self._is_over or self._source is None:
            return
        self._is_over = True
        source = self._source
        self._stop(StopReason.EXCEPTION)
        try:
            if isinstance(source, OpenReplay):
                self.replayed = source.result((WallClock().now() - self._begin) * 1e-9)
                self._account = Account(self.replayed["account"])
            else:
                elapsed = (WallClock().now() - self._begin) * 1e-9
                self._account = Account(experiment_account(source, status, elapsed))
        finally:
            source.close(status)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        cycle = self._source.cycle if self._source is not None else None
        status, self._is_ending = "stopped", True
        turns = None if self._turns is None else self._turns()
        if turns is not None and not turns.gi_running and not isinstance(error, Exception):
            turns.close()  # as `break` does: the stop of an operator
        if isinstance(error, Exception):
            self._stop(StopReason.EXCEPTION)
            status = f"failed: {cause_of(error)}"
            if cycle is not None and not isinstance(error, RigError):
                cycle.note_fault(error)
        elif error is None and self._is_complete:
            status = "completed"
        try:
            self._end(status)
        finally:
            self._stack.close()
        if error is None:
            if self._left is not None:
                raise self._left
            self._deliver()


def _ending(number: int) -> BaseException:
    return KeyboardInterrupt() if number == signal.SIGINT else SystemExit(SHELL_OFFSET + number)


def _is_ours(frame: FrameType | None) -> bool:
    """Whether this module is at work: in no other way can a signal come between two of its instructions."""
    while frame is not None and frame.f_code.co_filename != __file__:
        frame = frame.f_back
    return frame is not None
