"""The writer process (`writer_process` starts it): a descriptor as argument, its job as JSON on standard input.

It takes records out of the shared ring and puts them into a file, in ordinary priority, away from the control thread.
It ends when the producer requests it, or when the producer has ended: then everything still in the ring is written.

One run writes a log: a lock file next to it, held by the writer process and released when that ends in any way.
"""

import json
import os
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from canhaptic.errors import CanHapticError, LogWriteError
from canhaptic.host.output_file import why_not_written
from canhaptic.logs.growing_file import LogSink, cause_of
from canhaptic.logs.ring import RingShape, SharedArea


class LogLock:
    """The lock of one log.

    Args:
        path: The log.

    Raises:
        LogWriteError: Another run holds it.
        OSError: The folder cannot be written.
    """

    def __init__(self, path: Path) -> None:
        import fcntl  # POSIX alone, as the writer is

        self._path = path.with_name(f".{path.name}.lock")
        while True:
            self._descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
            try:
                fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                os.close(self._descriptor)
                raise LogWriteError(
                    f"{path}: another run writes this log; name another file, or wait until that run has ended"
                ) from error
            except OSError:  # a file system without locks
                return
            if self._is_current():
                return
            os.close(self._descriptor)

    def _is_current(self) -> bool:
        """Whether the file locked is still the one of that name: its last owner may have deleted it meanwhile."""
        try:
            return os.path.samestat(os.fstat(self._descriptor), os.stat(self._path, follow_symlinks=False))
        except FileNotFoundError:
            return False

    def release(self) -> None:
        """Delete the lock's file and release it."""
        with suppress(OSError):  # a disk that has become read-only, for one
            self._path.unlink(missing_ok=True)
        os.close(self._descriptor)


FAILED: Final = 74
"""Exit status when the file cannot be written (EX_IOERR of sysexits.h); starting again would not help."""
_NICENESS: Final = 10
_PAUSE: Final = 0.01  # [s] between two looks at the ring
_INTERRUPTED: Final = "interrupted: the controlling process ended without closing the log"


def make_sink(job: dict[str, Any], descriptor: int) -> tuple[SharedArea, LogSink]:
    """Shared area and sink of a job; imports only what it needs."""
    area = SharedArea(descriptor, [RingShape(*shape) for shape in job["shapes"]])
    if job["kind"] == "energy":
        from canhaptic.logs.columns import LogSchema
        from canhaptic.logs.energy_sink import EnergySink

        return area, EnergySink(Path(job["path"]), LogSchema.from_json(job["schema"]), area)
    if job["last_ns"]:
        from canhaptic.logs.fault_sink import FaultSink

        return area, FaultSink(Path(job["path"]), job["channels"], area, job["last_ns"])
    from canhaptic.logs.bus_sink import BusSink

    target = Path(job["convert_to"]) if job["convert_to"] else None
    return area, BusSink(
        Path(job["path"]), job["channels"], area, file_size=job["file_size"], files=job["files"], convert_to=target
    )


def _serve(area: SharedArea, sink: LogSink, parent: int) -> None:
    """Write until the producer closes or is gone.

    A head is acted on one poll after it was first seen: by then the record behind it has reached this processor too, on
    machines that reorder stores as on those that do not.
    """
    pause = threading.Event()
    seen = [ring.tail for ring in area.rings]
    while True:
        gone = os.getppid() != parent
        ending = gone or area.is_closing
        heads = [ring.head for ring in area.rings]
        sink.check()
        sink.drain(seen, final=False)
        if ending and seen == heads:
            break
        seen = heads
        pause.wait(_PAUSE)
    sink.drain(heads, final=True)
    sink.finish(area.text("status") or (_INTERRUPTED if gone else "complete"))


def _become_ordinary(patient: bool) -> None:
    """Give up real-time priority and processor pinning inherited from the controlling process.

    Args:
        patient: Whether to yield to ordinary processes too, as for a cycle at wall-clock pace.
    """
    if hasattr(os, "sched_setscheduler"):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        os.sched_setaffinity(0, range(os.cpu_count() or 1))
    if patient:
        os.nice(_NICENESS)


def _open(job: dict[str, Any], sink: LogSink) -> LogLock:
    """Lock and open the log.

    Raises:
        LogWriteError: Another run writes it, it is no regular file, or it cannot be created.
    """
    path = Path(job["path"])
    for place in (path, Path(job.get("convert_to") or path)):
        if reason := why_not_written(place):
            raise LogWriteError(reason)
    try:
        lock = LogLock(path)
        sink.open(job["restart"])
    except LogWriteError:
        raise
    except OSError as error:
        raise LogWriteError(f"{path}: {error}; choose a folder that exists and may be written") from error
    return lock


def main() -> None:
    """Read the job, report `ready` once the file is open, and serve."""
    job = json.load(sys.stdin)
    sys.path += job["folders"]  # behind the installation: an isolated interpreter has neither of this process's
    _become_ordinary(patient=job["pace"] == "real")
    area, sink = make_sink(job, int(sys.argv[1]))
    lock: LogLock | None = None
    try:
        lock = _open(job, sink)
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        _serve(area, sink, job["parent"])
        lock.release()
    except (CanHapticError, OSError, ValueError, RuntimeError) as error:  # h5py raises the last three for one full disk
        cause = cause_of(error)
        area.set_text("failure", str(error) if isinstance(error, CanHapticError) else f"{job['path']}: {cause}")
        if lock is not None:
            with suppress(OSError):
                sink.fail(cause)
            lock.release()
        os._exit(FAILED)  # the library would try to write again while closing, and can hang on a full disk


if __name__ == "__main__":
    main()
