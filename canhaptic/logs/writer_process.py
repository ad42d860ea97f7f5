"""The control side of a writer process: starts it, waits until it is ready, and replaces it when it is killed."""

import json
import os
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, Final

from canhaptic.errors import LogStoppedError, LogWriteError
from canhaptic.logs.ring import Record, Ring, RingShape, SharedArea, allocate, size_of
from canhaptic.logs.writer import FAILED

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
    module: str, arguments: Iterable[object], descriptors: Sequence[int], **options: object
) -> "subprocess.Popen[str]":
    """Start `main` of a module in an interpreter that knows neither the working folder nor PYTHONPATH.

    It takes canhaptic from where this process has it, and has a pipe as its standard input.

    Args:
        module: Name of the module.
        arguments: Words of its `sys.argv` from the second on.
        descriptors: Open files that it inherits.
        options: Further arguments of `Popen`.
    """
    words = [sys.executable, "-I", "-c", _PROGRAM.format(module), str(_PACKAGES), *map(str, arguments)]
    given: dict[str, Any] = options
    return subprocess.Popen(
        words,
        stdin=subprocess.PIPE,
        pass_fds=descriptors,
        start_new_session=True,  # Ctrl-C in the terminal is for the controller, which then ends in order
        text=True,
        **given,
    )


class WriterProcess:
    """A log that is written: a running writer and the memory shared with it.

    The constructor returns when the file is open, so that nothing slow is left for the cycle. A thread sleeps in
    `waitpid` and starts another writer if this one is killed; the control thread spends nothing on it.

    Args:
        job: Job of the writer (`canhaptic.logs.writer.make_sink`).
        shapes: The rings to share.
        on_failure: Called once, from another thread, with the reason when writing ends prematurely; records are then
            dropped and counted at any pace.

    Attributes:
        dropped: Records lost so far because the ring was full.
        failure: Reason why the log stopped before it was closed; empty while there is none.
        restarts: Writers that were killed and replaced.

    Raises:
        LogWriteError: The file cannot be created.
    """

    def __init__(
        self, job: dict[str, Any], shapes: Iterable[RingShape], on_failure: Callable[[str], None] | None = None
    ) -> None:
        _require_posix(job["path"])
        shapes = tuple(shapes)
        self._job = {**job, "shapes": shapes, "parent": os.getpid(), "folders": _trusted_folders()}
        self._free, self._on_failure = job["pace"] == "free", on_failure
        self.dropped, self.failure, self.restarts = 0, "", 0
        self._is_closed = False
        self._descriptor = _allocate(size_of(shapes), job["path"])
        self._area = SharedArea(self._descriptor, shapes)
        self._process = self._spawn(restart=False)
        self._await_ready()
        self._supervisor = threading.Thread(target=self._supervise, name="log supervisor", daemon=True)
        self._supervisor.start()

    @property
    def rings(self) -> list[Ring]:
        """The rings, in the order of `shapes`."""
        return self._area.rings

    @property
    def pid(self) -> int:
        """Process ID of the present writer."""
        return self._process.pid

    def insist(self, ring: Ring, record: Record) -> bool:
        """Write one record as soon as the ring has room, at free pace; else count it as dropped and return False.

        Raises:
            LogStoppedError: The writer has failed, the ring is full, and there is no `on_failure` to call.
        """
        if self._free and self._push_patiently(ring, record):
            return True
        self.dropped += 1
        return False

    def _push_patiently(self, ring: Ring, record: Record) -> bool:
        pause = threading.Event()
        while not ring.push(record):
            if self.failure:
                if self._on_failure is None:
                    raise LogStoppedError(self.failure)
                return False
            pause.wait(_WAIT)
        return True

    def close(self, status: str = "complete") -> None:
        """Let the writer finish everything that is in the rings, and wait for it. A second call does nothing.

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
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},  # it multiplies nothing, and a thread a core takes long
        )
        self._give_job(process, restart)
        return process

    def _give_job(self, process: "subprocess.Popen[str]", restart: bool) -> None:
        if process.stdin is not None:
            with suppress(BrokenPipeError):  # it has ended already: its status says why
                process.stdin.write(json.dumps({**self._job, "restart": restart}))
            with suppress(BrokenPipeError):  # buffered output is written now
                process.stdin.close()

    def _await_ready(self) -> None:
        output = self._process.stdout
        if output is None:
            return
        reason = self._wait_for_answer(output)
        output.close()
        if reason:
            self._let_go()
            raise LogWriteError(f"cannot write the log: {reason}")

    def _wait_for_answer(self, output: IO[str]) -> str:
        """Reason why the writer did not become ready; empty when it is."""
        if not select.select([output], [], [], _PATIENCE)[0]:
            self._process.kill()
            with suppress(subprocess.TimeoutExpired):  # a process that waits for a dead mount cannot end
                self._process.wait(_LAST_WAIT)
            return (
                f"{self._job['path']}: the file could not be opened within {_PATIENCE:g} s; look for a mount that does "
                "not answer, or name a file on a local disk"
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


def _trusted_folders() -> list[str]:
    """Return where this process imports from, without the working folder, in which others may write."""
    working = Path.cwd().resolve()
    return [folder for folder in sys.path if os.path.isabs(folder) and Path(folder).resolve() != working]


def _require_posix(path: str | Path) -> None:
    if os.name != "posix":
        raise LogWriteError(
            f"{path}: logs are written by a process that shares memory with the cycle, which needs Linux or macOS; "
            "run without logs, or use Linux (WSL on Windows)"
        )


def _allocate(size: int, path: str | Path) -> int:
    try:
        return allocate(size)
    except OSError as error:
        raise LogWriteError(f"{path}: {error}") from error


def _ending(code: int) -> str:
    how = f"killed by {signal.Signals(-code).name}" if code < 0 else f"ended with status {code}"
    return f"the writer process was {how}"
