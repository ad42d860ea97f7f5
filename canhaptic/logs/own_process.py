"""Reads a damaged file in a copy of this process: HDF5 follows damaged addresses, and may crash or never end."""

import ctypes
import faulthandler
import os
import pickle
import signal
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Final, TypeVar

from canhaptic.errors import LogFormatError
from canhaptic.logs.log_file import log_file

_Result = TypeVar("_Result")
_SECONDS: Final = 2
"""CPU time that a copy may take, and for each so many bytes of the file one more [s]."""
_BYTES_A_SECOND: Final = 1_000_000
_PR_SET_PDEATHSIG: Final = 1  # of Linux's prctl


def in_own_process(path: Path, work: Callable[[], _Result]) -> _Result:
    """Result of `work`, computed in a copy of this process where the system supports it (Linux, macOS).

    Args:
        path: The file that is read, for the error.
        work: Returns or raises something that can be pickled; its changes in memory are lost.

    Raises:
        LogFormatError: There is no file, or the copy crashed or took more CPU time than any log of this size needs.
        Exception: The exception of `work`.
    """
    if sys.platform == "win32":
        return work()
    seconds, parent = _SECONDS + log_file(path).stat().st_size // _BYTES_A_SECOND, os.getpid()
    reader, writer = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of forks with other threads: h5py guards its own lock
        child = os.fork()
    if child == 0:
        os.close(reader)
        _answer(writer, work, seconds, parent)
    os.close(writer)
    content = b""
    try:
        with os.fdopen(reader, "rb") as pipe:
            content = pipe.read()
    finally:
        if not content:
            os.kill(child, signal.SIGKILL)  # after an interrupt; of one that has crashed nothing is left to end
        _, status = os.waitpid(child, 0)
    if not content and _exit(status) == signal.SIGXCPU.name:
        raise LogFormatError(f"{path}: too damaged: the HDF5 library does not finish reading it (for {seconds} s)")
    if not content:
        raise LogFormatError(f"{path}: too damaged: the HDF5 library crashes on it (exit status {_exit(status)})")
    result, error = pickle.loads(content)
    if error is not None:
        raise error
    answer: _Result = result
    return answer


def _exit(status: int) -> str:
    return (
        signal.Signals(os.WTERMSIG(status)).name if os.WIFSIGNALED(status) else str(os.waitstatus_to_exitcode(status))
    )


def _answer(writer: int, work: Callable[[], object], seconds: int, parent: int) -> None:
    """Send the result or the error of `work` and ends the copy; nothing of the first process is flushed or closed."""
    import resource

    try:
        if sys.platform == "linux":
            ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it died before it could be watched
            return
        signal.signal(signal.SIGXCPU, signal.SIG_DFL)
        _, most = resource.getrlimit(resource.RLIMIT_CPU)
        if most == resource.RLIM_INFINITY or seconds < most:
            resource.setrlimit(resource.RLIMIT_CPU, (seconds, most))
        signal.set_wakeup_fd(-1)  # the first process is sent its signals itself
        faulthandler.disable()
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        try:
            content = pickle.dumps((work(), None))
        except Exception as error:
            content = pickle.dumps((None, error))
        with os.fdopen(writer, "wb") as pipe:
            pipe.write(content)
    finally:
        os._exit(0)
