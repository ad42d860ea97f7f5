"""The page's end of the process in which both sides run: places of the pointer go in, rows of both handles come out."""

import multiprocessing
import signal
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Final, NamedTuple

import numpy as np

from canhaptic.drive.clock import WallClock
from canhaptic.errors import InputError
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.touch.hand_process import (
    ARRIVED,
    RUN,
    SHARED,
    TOKEN,
    SharedNumbers,
    TouchJob,
    TouchPace,
    TouchStatus,
    columns,
    no_run,
    work,
)
from canhaptic.lab.touch.touch_scene import TouchScene
from canhaptic.scene.models import Scene

_END: Final = 2.0  # [s] until a process that does not end is ended


class TouchNews(NamedTuple):
    """Rows and status since the last poll."""

    rows: dict[str, Array]  # by `hand_process.columns`, shapes (n,)
    status: TouchStatus | None  # the last one; None where none came


class TouchHand:
    """A hand on both sides of a scene.

    Args:
        scene: Scene as loaded; `changes` apply to every run.
        axis: Axis to touch; None for the first.
        pace: "even": late cycles are caught up; "real": they are skipped, as on a rig.

    Raises:
        InputError: The scene cannot be touched.

    Attributes:
        touched: The scene that runs now.
        changes: Values that replace those of the scene, by key.
    """

    def __init__(self, scene: Scene, axis: str | None = None, pace: TouchPace = "even") -> None:
        self._job = TouchJob(0, scene.text, scene.source, scene.overrides, axis, bool(scene.own_code), pace)
        self._given = scene.overrides
        self.changes: dict[str, str] = {}
        self.touched: TouchScene = self._job.touched()
        self._clock = WallClock()
        context = multiprocessing.get_context("spawn")
        self._shared: SharedNumbers = context.Array("d", SHARED, lock=False)
        self._pipe, far_end = context.Pipe()
        self._process = context.Process(target=work, args=(far_end, self._shared), daemon=True)
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # inherited: Ctrl-C is for the page, not for the process
        try:
            self._process.start()
        finally:
            signal.signal(signal.SIGINT, before)
        far_end.close()

    def begin(self, changes: dict[str, str]) -> None:
        """Begin a run anew with changed values; an error in them leaves the old run as it is.

        Raises:
            InputError: Anything is wrong, or the process has ended.
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
        """Move the pointer to a position [m or rad], kept within the page; `token` comes back with the rows."""
        for direction, (at, (low, high)) in enumerate(zip(place, self.touched.shown, strict=True)):
            self._shared[direction] = min(max(at, low), high)
        self._shared[TOKEN] = token
        self._shared[ARRIVED] = self._clock.now()

    def look(self) -> TouchNews:
        """Rows and status since the last poll, of the present run."""
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
            status = no_run(self._job.number, self._lost())
        table = np.concatenate(parts) if parts else np.empty((0, len(names)))
        return TouchNews(dict(zip(names, table.T, strict=True)), status)

    def _lost(self) -> str:
        return f"the process of both handles ended (exit code {self._process.exitcode}); start canhaptic touch again"

    def close(self) -> None:
        """End the run and the process; a second call does nothing."""
        self._shared[RUN] = -1.0
        self._pipe.close()
        self._process.join(_END)
        if self._process.is_alive():
            self._process.terminate()


def _has_more(pipe: Connection) -> bool:
    try:
        return pipe.poll()
    except (OSError, EOFError):
        return False
