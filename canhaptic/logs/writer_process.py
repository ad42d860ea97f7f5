"""The control side of the logs: records go into a ring in shared memory, and a process writes them to a file.

The writer process is started, awaited, and replaced when it is killed.
"""

import json
import os
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import IO, Any, Final, Literal, Protocol, cast

from canhaptic.control.balance import EnergyBalance
from canhaptic.errors import LogStoppedError, LogWriteError, ParameterError
from canhaptic.files import CONVERTIBLE
from canhaptic.logs.bus_sink import FRAME_RING
from canhaptic.logs.columns import EVENT_RING, EVENT_TEXT_SIZES, Attribute, LogSchema, PortDescription
from canhaptic.logs.ring import Record, Recorder, Ring, RingShape, SharedArea, allocate, size_of
from canhaptic.logs.writer import FAILED
from canhaptic.signals import CycleTiming, FarRow, Measured, Sample, Truth

_MOST_BUSES: Final = 256  # one byte in each record
_RING_ROWS: Final = 16_384  # 16 s at 1 kHz, longer than a disk stalls
_FLUSH_TIME_NS: Final = 200_000_000  # a chunk holds this much of the run, at real pace
_FREE_CHUNK: Final = 4096  # rows; without a wall clock only throughput counts
_RESTARTS: Final = 5  # a writer that is killed more often than this has a reason
_PATIENCE: Final = 30.0  # [s] that opening a file may take
_LAST_WAIT: Final = 1.0  # [s] for the end of a process that was killed
_PACKAGES: Final = Path(__file__).resolve().parents[2]
_PROGRAM: Final = """
import sys
sys.path.insert(0, sys.argv.pop(1))
import canhaptic
del sys.path[0]
from {} import main
main()
"""
_WAIT: Final = 0.001  # [s] between two looks at a full ring, at free pace


def isolated_program(
    module: str, arguments: Iterable[object], descriptors: Sequence[int], **options: Any
) -> "subprocess.Popen[str]":
    """Start `main` of a module in an interpreter that knows neither the working folder nor PYTHONPATH.

    It imports canhaptic from the same place as this process. Its standard input is a pipe.

    Args:
        module: Name of the module.
        arguments: `sys.argv` from the second word on.
        descriptors: Open files that it inherits.
        options: Further arguments of `Popen`.
    """
    words = [sys.executable, "-I", "-c", _PROGRAM.format(module), str(_PACKAGES), *map(str, arguments)]
    return subprocess.Popen(
        words,
        stdin=subprocess.PIPE,
        pass_fds=descriptors,
        start_new_session=True,  # Ctrl-C in the terminal is for the controller, which then ends in order
        text=True,
        **options,
    )


class WriterProcess:
    """A log that is being written: the writer process and the memory shared with it.

    The constructor returns when the file is open, so that the cycle need not wait. A thread waits for the end of the
    process and starts another one if it was killed, at no cost for the control thread.

    Args:
        job: Job of the writer (`canhaptic.logs.writer.make_sink`).
        shapes: The rings to share.
        on_failure: Called once, from another thread, with the reason when writing ends prematurely; records are then
            dropped and counted at every pace.

    Attributes:
        rings: The rings, in the order of `shapes`.
        dropped: Records lost so far because the ring was full.
        failure: Reason why the log stopped before it was closed; empty while there is none.
        restarts: Writers that were killed and replaced.

    Raises:
        LogWriteError: The file cannot be created.
    """

    def __init__(
        self, job: dict[str, Any], shapes: Iterable[RingShape], on_failure: Callable[[str], None] | None = None
    ) -> None:
        if os.name != "posix":
            raise LogWriteError(
                f"{job['path']}: logs are written by a process that shares memory with the cycle, which needs Linux or "
                "macOS; run without logs, or use Linux (WSL on Windows)"
            )
        shapes = tuple(shapes)
        self._job = {**job, "shapes": shapes, "parent": os.getpid(), "folders": trusted_folders()}
        self._free, self._on_failure = job["pace"] == "free", on_failure
        self.dropped, self.failure, self.restarts = 0, "", 0
        self._is_closed = False
        try:
            self._descriptor = allocate(size_of(shapes))
        except OSError as error:
            raise LogWriteError(f"{job['path']}: {error}") from error
        self._area = SharedArea(self._descriptor, shapes)
        self.rings = self._area.rings
        self._process = self._spawn(restart=False)
        if reason := self._awaited():
            self._let_go()
            raise LogWriteError(f"cannot write the log: {reason}")
        self._supervisor = threading.Thread(target=self._supervise, name="log supervisor", daemon=True)
        self._supervisor.start()

    @property
    def pid(self) -> int:
        """Process ID of the present writer."""
        return self._process.pid

    def insist(self, ring: Ring, record: Record) -> bool:
        """Write one record; if the ring is full, wait for room at free pace, or drop and count the record at real pace.

        Raises:
            LogStoppedError: The writer has failed, the ring is full, and there is no `on_failure` to call.
        """
        pause = threading.Event()
        while self._free and not self.failure:
            if ring.push(record):
                return True
            pause.wait(_WAIT)
        if self._free and self._on_failure is None:
            raise LogStoppedError(self.failure)
        self.dropped += 1
        return False

    def close(self, status: str = "complete") -> None:
        """Have the writer write everything in the rings, and wait for it. A second call does nothing.

        Args:
            status: Status of the run, which an energy log keeps; anything but complete, completed or stopped is a bad
                end, after which a bus log with `last` is written.

        Raises:
            LogStoppedError: The file is not complete.
        """
        if self._is_closed:
            return
        self._is_closed = True
        self._area.set_text("status", status)
        self._area.close_writer()
        self._supervisor.join()
        self._let_go()
        if self.failure:
            raise LogStoppedError(self.failure)

    def _let_go(self) -> None:
        self._area.close()
        os.close(self._descriptor)

    def _spawn(self, restart: bool) -> "subprocess.Popen[str]":
        process = isolated_program(
            "canhaptic.logs.writer",
            [self._descriptor],
            [self._descriptor],
            stdout=subprocess.DEVNULL if restart else subprocess.PIPE,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},  # no matrix is multiplied, and its threads start slowly
        )
        with suppress(BrokenPipeError), cast("IO[str]", process.stdin) as pipe:  # its status says why it has ended
            pipe.write(json.dumps({**self._job, "restart": restart}))
        return process

    def _awaited(self) -> str:
        """Wait until the writer is ready; return the reason if it failed, else an empty text."""
        with cast("IO[str]", self._process.stdout) as output:
            if not select.select([output], [], [], _PATIENCE)[0]:
                self._process.kill()
                with suppress(subprocess.TimeoutExpired):  # a process that waits for a dead mount cannot end
                    self._process.wait(_LAST_WAIT)
                return (
                    f"{self._job['path']}: the file could not be opened within {_PATIENCE:g} s; look for a mount that "
                    "does not answer, or name a file on a local disk"
                )
            if output.readline():
                return ""
        code = self._process.wait()
        return self._area.text("failure") or f"the writer process ended with status {code} before it was ready"

    def _supervise(self) -> None:
        while True:
            code = self._process.wait()
            if code == 0:
                return
            if code == FAILED or self.restarts == _RESTARTS:
                self._fail(self._area.text("failure") or _ending(code))
                return
            self.restarts += 1
            try:
                self._process = self._spawn(restart=True)
            except OSError as error:
                self._fail(f"{_ending(code)} and no other could be started: {error}")
                return

    def _fail(self, reason: str) -> None:
        self.failure = f"log stopped: {reason}"
        if self._on_failure is not None:
            self._on_failure(self.failure)


def trusted_folders() -> list[str]:
    """Return the folders from which this process imports, without the working folder, where others may write."""
    working = Path.cwd().resolve()
    return [folder for folder in sys.path if os.path.isabs(folder) and Path(folder).resolve() != working]


def _ending(code: int) -> str:
    how = f"killed by {signal.Signals(-code).name}" if code < 0 else f"ended with status {code}"
    return f"the writer process was {how}"


class BusLogWriter(WriterProcess):
    """Writes frames as candump text. Call it as a recorder: `recorder(timestamp_ns, can_id, data, is_rx)`.

    The same frames give the same bytes. At real pace a full ring drops frames and counts them; at free pace it waits.

    Args:
        path: The file; an existing one is replaced. With the suffix .blf, .trc or .asc the run is recorded as candump
            text next to it (PATH.log), which survives a kill, and converted on closing.
        channel: Name of the bus in every line; one for each bus where there are several.
        pace: "real" or "free".
        file_size: Bytes after which the file is renamed to NAME.00001.log, ...; 0 for one file without limit.
        files: Number of files kept in all when `file_size` is given.
        last: If above 0, nothing is written during a good run; after a bad end, the frames of this final period are
            written [s].
        on_failure: Called once, from another thread, with the reason when the log can no longer be written; frames are
            then dropped and counted at every pace.

    Raises:
        LogWriteError: The file cannot be created.
    """

    def __init__(
        self,
        path: str | Path,
        channel: str | Sequence[str],
        *,
        pace: Literal["real", "free"] = "real",
        file_size: int = 0,
        files: int = 10,
        last: float = 0.0,
        on_failure: Callable[[str], None] | None = None,
    ) -> None:
        self.path = Path(path).absolute()
        convert = self.path.suffix.lower() in CONVERTIBLE
        channels = [channel] if isinstance(channel, str) else list(channel)
        for name in channels:
            if not name or any(letter.isspace() for letter in name):
                raise ParameterError(f"channel {name!r}: expected a name without spaces, since every line repeats it")
        if not 0 < len(channels) <= _MOST_BUSES or len(set(channels)) < len(channels):
            raise ParameterError(f"channels {channels}: expected 1 to {_MOST_BUSES} names, all different")
        if convert and (file_size or last):
            raise ParameterError(f"{path}: a series of files, or the last seconds, must be .log (candump text)")
        job = {
            "kind": "bus",
            "pace": pace,
            "path": f"{self.path}.log" if convert else str(self.path),
            "channels": channels,
            "file_size": file_size,
            "files": files,
            "convert_to": str(self.path) if convert else "",
            "last_ns": round(last * 1e9),
        }
        super().__init__(job, [FRAME_RING], on_failure)
        [self._frames] = self.rings
        self._channels = len(channels)
        self._record = self.on(0)

    def __call__(self, timestamp_ns: int, can_id: int, data: bytes | bytearray, is_rx: bool) -> None:
        """Record one frame of classic CAN (at most 8 bytes of data).

        Raises:
            LogStoppedError: At free pace and without `on_failure` only: the writer has failed and its ring is full.
        """
        self._record(timestamp_ns, can_id, data, is_rx)

    def on(self, bus: int) -> Recorder:
        """Return the recorder of one bus, by its index among the channels; the log itself records the first bus.

        Raises:
            ParameterError: There is no such bus.
        """
        if not 0 <= bus < self._channels:
            raise ParameterError(f"bus {bus}: the log has {self._channels}, counted from 0")
        return self._frames.recorder(bus, partial(self.insist, self._frames))


class FollowedClock(Protocol):
    """The clock of a drive that the cycle follows."""

    error: int
    """Phase of the last frame minus the phase to keep [ns]."""


class EnergyLogWriter(WriterProcess):
    """Writes one energy log (HDF5).

    At real pace `append` never waits: a cycle for which the ring has no room is dropped, and the next row counts it. At
    free pace (lock-step) it waits for the writer, and no row is lost.

    Args:
        path: The file; an existing one is replaced.
        ports: The axes, in the order of samples and balances.
        attributes: Attributes of the run: configuration text and hash, versions, clock base, bit rate, ...
        sample_time_ns: Sample time [ns].
        with_truth: Whether a simulation supplies true values.
        with_phase: Whether the cycle follows the clock of a drive, so that `clock` must be set before the first cycle.
        pace: "real" or "free".
        ring_rows: Capacity of the ring.
        on_failure: Called once, from another thread, with the reason when the log can no longer be written; cycles are
            then dropped and counted at every pace.

    Attributes:
        clock: Clock of a drive that the cycle follows; None without one.

    Raises:
        LogWriteError: The file cannot be created.
    """

    def __init__(
        self,
        path: str | Path,
        ports: Sequence[PortDescription],
        attributes: Mapping[str, Attribute],
        *,
        sample_time_ns: int,
        with_truth: bool = False,
        with_phase: bool = False,
        with_far: bool = False,
        pace: Literal["real", "free"] = "real",
        ring_rows: int = _RING_ROWS,
        on_failure: Callable[[str], None] | None = None,
    ) -> None:
        self._further = tuple(range(1, len(ports)))  # behind the first
        self._nothing = (Measured(0.0, 0.0, 0.0, 1, 0, 0),) * len(ports)
        self.path = Path(path).absolute()
        chunk = _FREE_CHUNK if pace == "free" else max(16, min(_FREE_CHUNK, _FLUSH_TIME_NS // sample_time_ns))
        schema = LogSchema(
            tuple(ports), sample_time_ns, with_truth, min(chunk, ring_rows // 2), pace == "real", dict(attributes),
            has_phase=with_phase, with_far=with_far,
        )  # fmt: skip
        job = {"kind": "energy", "path": str(self.path), "pace": pace, "schema": schema}
        super().__init__(job, [schema.ring(ring_rows), EVENT_RING], on_failure)
        self._rows, self._events = self.rings
        self._push = self._rows.push
        self._unreported = 0
        self.clock: FollowedClock | None = None
        self.far: Callable[[], FarRow] | None = None

    def append(
        self,
        sync_index: int,
        samples: Sequence[Sample],
        balances: Sequence[EnergyBalance],
        timing: CycleTiming,
        truths: Sequence[Truth] | None = None,
        deadline: int | None = None,
        measured: Sequence[Measured] = (),
    ) -> None:
        """Record one cycle.

        Args:
            sync_index: Index k of the SYNC.
            samples: Samples, one per port.
            balances: Balances, one per port.
            timing: Timing of this cycle.
            truths: True values, one per port, for a log with `with_truth`; else empty.
            deadline: Sample times since the first SYNC; None: no SYNC was skipped.
            measured: Figures, one per port; empty if only the balances are known.

        Raises:
            LogStoppedError: At free pace and without `on_failure` only: the writer has failed and its ring is full.
        """
        due = sync_index if deadline is None else deadline
        known = measured or self._nothing
        phase = () if self.clock is None else (self.clock.error,)
        row: list[float] = [self._unreported, sync_index, *timing, due, *phase, *samples[0], *balances[0], *known[0]]
        for port in self._further:
            row += (*samples[port], *balances[port], *known[port])
        if truths is not None:
            for position, energy in truths:
                row += (position, *energy)
        if self.far is not None:
            row += self.far()
        if self._push(row) or self.insist(self._rows, row):
            self._unreported = 0
        else:
            self._unreported += 1

    def event(self, sync_index: int, kind: str, port: str, text: str) -> None:
        """Record an event: a fault, an EMCY, a lost frame, a stop. Long texts are cut.

        Args:
            sync_index: Index k of the SYNC.
            kind: Kind of the event, one word.
            port: Name of the axis; empty for the whole rig.
            text: Description of the event.
        """
        texts = zip((kind, port, text), EVENT_TEXT_SIZES.values(), strict=True)
        self._events.push((sync_index, *(_cut(words, size) for words, size in texts)))


def _cut(text: str, size: int) -> bytes:
    return text.encode()[:size].decode("utf-8", "ignore").encode()
