"""One run writes a log: a lock file next to it, held by the writer process and released with it, however it ends."""

import os
from pathlib import Path

from canhaptic.errors import LogWriteError


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
        self._path.unlink(missing_ok=True)
        os.close(self._descriptor)
