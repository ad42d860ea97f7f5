"""Process that simulates both sides in real time, and `TouchHand`, the page's connection to it.

At an even pace master and drives run in lock-step, and each cycle waits for its time on the wall clock. Late cycles
are caught up and never skipped, because a skipped SYNC, caused here by a busy browser, would make a hold twice as
long without the algorithm noticing. At real pace late SYNCs are skipped, as on a rig.

The pointer's last position is in shared memory, where the process reads it without waiting; if no new one arrives, the
hand stays. The rows of the cycles come back through a pipe; a page that does not read them loses rows, not cycles.
"""

import contextlib
import math
import multiprocessing
import os
import select
import signal
import socket
from collections.abc import Callable, Mapping, MutableSequence
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from operator import attrgetter
from typing import Any, Final, Literal, NamedTuple, cast

import numpy as np

from canhaptic.cycle import run
from canhaptic.drive.clock import DurationHistogram, WallClock
from canhaptic.errors import CanHapticError, InputError
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.studies.runner import end_with_parent
from canhaptic.lab.touch.two_sides import TouchScene, two_sides
from canhaptic.scene.build import Experiment, build
from canhaptic.scene.given import parcel, unpack
from canhaptic.scene.load import scene_from_text
from canhaptic.scene.models import Scene
from canhaptic.sim.plant.plant import Plant

TouchPace = Literal["even", "real"]
X, Y, TOKEN, ARRIVED, RUN = range(5)
"""Indices of the shared array: pointer position x and y, the page's token for it, its arrival time [ns], run number."""


@dataclass(frozen=True, slots=True)
class TouchJob:
    """Description of one run of both sides."""

    number: int  # the run ends as soon as shared memory has another number
    text: str  # of the scene
    source: str  # file of the scene
    overrides: tuple[str, ...]  # values instead of those of the scene
    axis: str | None  # to touch; None: the first
    allow_code: bool  # whether user code that the scene names may run
    pace: TouchPace = "even"
    given: bytes = b""  # what a Python program gave to the scene, from `parcel`

    def touched(self) -> TouchScene:
        """Return the scene of the run, with both handles.

        Raises:
            InputError: The scene is wrong, or cannot be touched.
        """
        unpack(self.given)
        return two_sides(scene_from_text(self.text, self.source, self.overrides, allow_code=self.allow_code), self.axis)


SharedNumbers = MutableSequence[float]
"""Array in shared memory, indexed by the constants above."""


class TouchStatus(NamedTuple):
    """Status of a run; energies in [J], times in [s]."""

    run: int
    cycles: int = 0
    late: int = 0  # number of cycles that began more than a sample time late
    skipped: int = 0  # number of SYNCs skipped, at real pace
    given_up: float = 0.0  # delay that was not caught up, at an even pace
    lateness: tuple[float, float] = (0.0, 0.0)  # of the cycles: median and 99th percentile
    answered: tuple[float, float] = (0.0, 0.0)  # from pointer to the end of the first cycle with it, the same
    least: tuple[float, float] = (0.0, 0.0)  # lowest net energy of each side since the start, from the plant
    ended: str = ""  # why the run ended; "" while it is running


def columns(touched: TouchScene) -> list[str]:
    """Return the column names of a row: time, token, position of the hand, then the columns of each side.

    `force` is the force on the hand; for an admittance display, the force of the hand as its sensor measures it.
    """
    names = ["time", "token", *(f"hand.{d}" for d in touched.directions)]
    parts = ("position", *touched.readings.vectors, *(("angle",) if touched.links else ()))
    for number in range(len(touched.sides)):
        names += [f"{number}.{what}.{d}" for what in parts for d in touched.directions]
        names.append(f"{number}.energy")
    return names


def work(pipe: Connection, shared: SharedNumbers) -> None:
    """Main function of the process: run the jobs from the pipe, one after the other, until it closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent()
    with contextlib.suppress(OSError), socket.socket(fileno=os.dup(pipe.fileno())) as end:
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 22)
    with contextlib.suppress(EOFError, BrokenPipeError, ConnectionResetError):
        while True:
            _HandRun(pipe.recv(), pipe, shared).run()


_READ: Final[Mapping[str, Callable[[Any], float]]] = {
    "velocity": attrgetter("motor.velocity"),
    "command": attrgetter("torque"),
}
"""Vector other than the force -> its reading from a servo."""


class _HandRun:
    """Simulation of one job."""

    def __init__(self, job: TouchJob, pipe: Connection, shared: SharedNumbers) -> None:
        self._job, self._pipe, self._shared = job, pipe, shared
        self._clock = WallClock(spin_margin=0.0)
        self._rows: list[tuple[float, ...]] = []
        self._late = self._seen = self._given_up = 0
        self._answered, self._lateness = DurationHistogram(), DurationHistogram()

    def run(self) -> None:
        """Run until another run is requested or an error occurs, which is sent to the page."""
        try:
            touched = self._job.touched()
            with build(touched.scene, "free" if self._job.pace == "even" else "real") as experiment:
                self._begin(touched, experiment)
                run(experiment.cycle, None, self._is_over, self._after_cycle)
        except CanHapticError as error:
            self._send(str(error))

    def _is_over(self) -> bool:
        return int(self._shared[RUN]) != self._job.number

    def _begin(self, touched: TouchScene, experiment: Experiment) -> None:
        self._experiment = experiment
        self._period = touched.scene.bus.sample_time
        self._share = 1.0 - math.exp(-self._period / 0.006)  # [s]: pages send some 60 places a second
        self._steps = [10.0 * (high - low) * self._period for low, high in touched.shown]  # a second
        self._place = list(touched.start)
        self._every = max(1, round(0.01 / self._period))
        ports = [axis.parameters.name for axis in touched.scene.axes]
        self._axes = [[ports.index(name) for name in side.axes] for side in touched.sides]
        known = experiment.cycle.ports
        self._accounts = [[port.row for port in known if set(port.axes) <= set(axes)] for axes in self._axes]
        self._start = self._clock.now()
        self._readings, self._has_links = touched.readings, bool(touched.links)
        if experiment.far_side is None:
            raise InputError("touch: got drives outside this process, expected simulated drives")
        self._servos = [[experiment.far_side.drives[axis].servo for axis in axes] for axes in self._axes]
        self._movers = [self._mover([servo.motor for servo in servos]) for servos in self._servos]
        self._least = [0.0] * len(touched.sides)

    def _mover(self, motors: list[Any]) -> Callable[..., None]:
        """Return the function that moves the hand of a side with these motors."""
        if not isinstance(motors[0], Plant):
            return cast("Callable[..., None]", motors[0].shared.mechanism.move_hand)
        plants: list[Plant] = motors

        def move(*place: float) -> None:
            for plant, at in zip(plants, place, strict=True):
                plant.move_hand(at)

        return move

    def _after_cycle(self, cycles: int) -> None:
        """Move both hands towards the pointer and record a row; called once per cycle."""
        place, shared = self._place, self._shared
        for direction, step in enumerate(self._steps):
            gap = (shared[direction] - place[direction]) * self._share
            place[direction] += step if gap > step else -step if gap < -step else gap
        for move in self._movers:
            move(*place)
        arrived = int(shared[ARRIVED])
        if arrived != self._seen:
            self._seen = arrived
            self._answered.add(self._clock.now() - arrived)
        self._take_row(cycles)
        self._keep_time(cycles)
        if cycles % self._every == 0:
            self._send("")

    def _take_row(self, cycles: int) -> None:
        experiment = self._experiment
        rig, judge = experiment.rig, experiment.cycle.judge
        if judge is None:  # a scene without simulation was refused
            return
        samples, row = rig.records[-1].samples, [cycles * self._period, self._shared[TOKEN], *self._place]
        for side, axes in enumerate(self._axes):
            place = [samples[axis].position for axis in axes]
            efforts = [self._readings.sign * samples[axis].torque_applied for axis in axes]
            if self._has_links:
                linkage = cast("Any", self._servos[side][0].motor).shared.mechanism
                row += [*linkage.handle, *linkage.force_of(efforts), *place]
            else:
                row += [*place, *efforts]
            for read in map(_READ.__getitem__, self._readings.vectors[1:]):
                row += [read(servo) for servo in self._servos[side]]
            energy = sum(judge.interaction[place] for place in self._accounts[side])
            self._least[side] = min(self._least[side], energy)
            row.append(energy)
        self._rows.append(tuple(row))

    def _keep_time(self, cycles: int) -> None:
        """Record the lateness of this cycle; at an even pace, first wait until it is due."""
        if self._job.pace == "real":
            late = self._experiment.rig.timing.wakeup_lateness
        else:
            due = self._start + self._given_up + round(cycles * self._period * 1e9)
            self._clock.wait_until(due)
            late = self._clock.now() - due
            if late > 100_000_000:  # [ns]: a longer delay is not caught up
                self._given_up += late
        self._lateness.add(late)
        self._late += late > self._period * 1e9

    def _send(self, ended: str) -> None:
        """Send rows and status; while the pipe is full, keep the newest rows."""
        if not ended and not select.select([], [self._pipe.fileno()], [], 0.0)[1]:
            del self._rows[:-4000]
            return
        self._pipe.send((np.array(self._rows), self._status(ended)))
        self._rows.clear()

    def _status(self, ended: str) -> TouchStatus:
        experiment: Experiment | None = getattr(self, "_experiment", None)
        if experiment is None:
            return TouchStatus(self._job.number, ended=ended)
        cycles, skipped = experiment.cycle.cycles, experiment.rig.skipped_syncs
        lateness, answered = (
            (durations.quantile(0.5), durations.quantile(0.99)) for durations in (self._lateness, self._answered)
        )
        number, given_up, least = self._job.number, self._given_up * 1e-9, (self._least[0], self._least[1])
        return TouchStatus(number, cycles, self._late, skipped, given_up, lateness, answered, least, ended)


class TouchNews(NamedTuple):
    """Rows of the run since the last poll, and its present status."""

    rows: dict[str, Array]  # by column name, see `columns`; shapes (n,)
    status: TouchStatus | None  # newest one; None if none arrived


class TouchHand:
    """Hand that holds both sides of a scene, which run in a process of their own.

    Args:
        scene: Scene as loaded, with its overrides.
        axis: Axis to touch; None for the first.
        pace: "even": late cycles are caught up; "real": they are skipped, as on a rig.

    Raises:
        InputError: The scene cannot be touched.

    Attributes:
        touched: Scene of the present run.
        changes: Values of the page's controls that override the scene, by key.
    """

    def __init__(self, scene: Scene, axis: str | None = None, pace: TouchPace = "even") -> None:
        given = parcel(scene.overrides, "the process of touch")
        self._job = TouchJob(0, scene.text, scene.source, scene.overrides, axis, bool(scene.own_code), pace, given)
        self._given = scene.overrides
        self.changes: dict[str, str] = {}
        self.touched: TouchScene = self._job.touched()
        self._clock = WallClock()
        context = multiprocessing.get_context("spawn")
        self._shared: SharedNumbers = context.Array("d", RUN + 1, lock=False)
        self._pipe, far_end = context.Pipe()
        self._process = context.Process(target=work, args=(far_end, self._shared), daemon=True)
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # inherited: Ctrl-C is for the page, not for the process
        try:
            self._process.start()
        finally:
            signal.signal(signal.SIGINT, before)
        far_end.close()

    def begin(self, changes: dict[str, str]) -> None:
        """Begin a new run with changed values; if they are invalid, the old run continues.

        Raises:
            InputError: A value is invalid, or the process has ended.
        """
        laid = (*self._given, *(f"{key}={value}" for key, value in changes.items()))
        job = replace(self._job, number=self._job.number + 1, overrides=laid)
        self.touched = job.touched()
        self._job, self.changes = job, dict(changes)
        if job.number == 1:
            self._shared[: len(self.touched.start)] = self.touched.start
        self._shared[RUN] = job.number
        try:
            self._pipe.send(job)
        except OSError as error:
            raise InputError(self._lost()) from error

    def move(self, place: tuple[float, ...], token: float = 0.0) -> None:
        """Move the pointer to a position within the page [m or rad]; `token` comes back with the rows."""
        for direction, (at, (low, high)) in enumerate(zip(place, self.touched.shown, strict=True)):
            self._shared[direction] = min(max(at, low), high)
        self._shared[TOKEN] = token
        self._shared[ARRIVED] = self._clock.now()

    def look(self) -> TouchNews:
        """Poll: return the new rows and status of the present run."""
        names, parts, status = columns(self.touched), [], None
        is_alive = self._process.is_alive()  # before the last parcel is read: it may say why the process ended
        while _has_more(self._pipe):
            try:
                rows, latest = self._pipe.recv()
            except (OSError, EOFError):
                break
            if latest.run == self._job.number:
                status = latest
                parts += [rows] if len(rows) else []
        if status is None and not is_alive:
            status = TouchStatus(self._job.number, ended=self._lost())
        table = np.concatenate(parts) if parts else np.empty((0, len(names)))
        return TouchNews(dict(zip(names, table.T, strict=True)), status)

    def _lost(self) -> str:
        return f"the simulating process ended (exit code {self._process.exitcode}); start canhaptic touch again"

    def close(self) -> None:
        """End the run and the process; a second call does nothing."""
        self._shared[RUN] = -1.0
        self._pipe.close()
        self._process.join(2.0)
        if self._process.is_alive():
            self._process.terminate()


def _has_more(pipe: Connection) -> bool:
    try:
        return pipe.poll()
    except (OSError, EOFError):
        return False
