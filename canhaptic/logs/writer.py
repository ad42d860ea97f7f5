"""The writer process (`writer_process` starts it): a descriptor as argument, its job as JSON on standard input.

It moves records from the shared ring into a file, at ordinary priority. When the producer requests it, or has ended,
it writes everything left in the ring and ends. A lock file next to the log, held while this process lives, keeps a
second run from writing the same log.
"""

import json
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, Final

from canhaptic.errors import CanHapticError, LogWriteError
from canhaptic.files import why_not_written
from canhaptic.logs.ring import LogSink, RingShape, SharedArea, cause_of


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold the lock of one log.

    Raises:
        LogWriteError: Another run holds it.
        OSError: The folder cannot be written.
    """
    import fcntl  # POSIX alone, as the writer is

    place, is_current = path.with_name(f".{path.name}.lock"), False
    while not is_current:
        descriptor = os.open(place, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            is_current = os.path.samestat(os.fstat(descriptor), os.stat(place, follow_symlinks=False))
        except BlockingIOError as error:
            os.close(descriptor)
            raise LogWriteError(
                f"{path}: another run writes this log; name another file, or wait until that run has ended"
            ) from error
        except FileNotFoundError:  # its last owner has deleted it meanwhile
            pass
        except OSError:  # a file system without locks
            is_current = True
        if not is_current:
            os.close(descriptor)
    try:
        yield
    finally:
        with suppress(OSError):  # a disk that has become read-only, for one
            place.unlink(missing_ok=True)
        os.close(descriptor)


FAILED: Final = 74
"""Exit status when the file cannot be written (EX_IOERR of sysexits.h); starting again would not help."""
_NICENESS: Final = 10
_PAUSE: Final = 0.01  # [s] between two looks at the ring
_TROUBLE: Final = (CanHapticError, OSError, ValueError, RuntimeError)  # h5py raises the last three for one full disk
_INTERRUPTED: Final = "interrupted: the controlling process ended without closing the log"


def make_sink(job: dict[str, Any], descriptor: int) -> tuple[SharedArea, LogSink]:
    """Return shared area and sink of a job; only their modules are imported."""
    area = SharedArea(descriptor, [RingShape(*shape) for shape in job["shapes"]])
    path = Path(job["path"])
    if job["kind"] == "energy":
        from canhaptic.logs.columns import LogSchema, PortDescription
        from canhaptic.logs.energy_sink import EnergySink

        ports, *rest = job["schema"]
        return area, EnergySink(path, LogSchema(tuple(PortDescription(*port) for port in ports), *rest), area)
    from canhaptic.logs.bus_sink import BusSink, FaultSink

    if job["last_ns"]:
        return area, FaultSink(path, job["channels"], area, job["last_ns"])
    target = Path(job["convert_to"]) if job["convert_to"] else None
    return area, BusSink(path, job["channels"], area, file_size=job["file_size"], files=job["files"], convert_to=target)


def _serve(area: SharedArea, sink: LogSink, parent: int) -> None:
    """Write until the producer closes or has ended.

    Records are read one poll after their head was seen: by then they have reached this processor, even on machines that
    reorder stores.
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


def become_ordinary(patient: bool) -> None:
    """Give up real-time priority and processor pinning inherited from the controlling process.

    Args:
        patient: Whether to have less priority than ordinary processes, as for a cycle at wall-clock pace.
    """
    if hasattr(os, "sched_setscheduler"):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        os.sched_setaffinity(0, range(os.cpu_count() or 1))
    if patient:
        os.nice(_NICENESS)


@contextmanager
def _opened(job: dict[str, Any], sink: LogSink) -> Iterator[None]:
    """Lock and open the log.

    Raises:
        LogWriteError: Another run writes the log, the file is not regular, or it cannot be created.
    """
    path = Path(job["path"])
    for place in (path, Path(job.get("convert_to") or path)):
        if reason := why_not_written(place):
            raise LogWriteError(reason)
    with ExitStack() as stack:
        try:
            stack.enter_context(_locked(path))
            sink.open(job["restart"])
        except LogWriteError:
            raise
        except OSError as error:
            raise LogWriteError(f"{path}: {error}; choose a folder that exists and may be written") from error
        yield


def main() -> None:
    """Read the job, report `ready` once the file is open, and serve."""
    job = json.load(sys.stdin)
    sys.path += job["folders"]  # behind the installation: an isolated interpreter has neither of this process's
    become_ordinary(patient=job["pace"] == "real")
    area, sink = make_sink(job, int(sys.argv[1]))
    try:
        with _opened(job, sink):
            try:
                sys.stdout.write("ready\n")
                sys.stdout.flush()
                _serve(area, sink, job["parent"])
            except _TROUBLE as error:
                with suppress(OSError):
                    sink.fail(cause_of(error))
                raise
    except _TROUBLE as error:
        area.set_text(
            "failure", str(error) if isinstance(error, CanHapticError) else f"{job['path']}: {cause_of(error)}"
        )
        os._exit(FAILED)  # the library would try to write again while closing, and can hang on a full disk


if __name__ == "__main__":
    main()
