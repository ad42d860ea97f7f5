"""The writer process of a log forked from the process of the tests, which has imported all that a writer imports.

A fresh interpreter spends 0.15 s of CPU on imports before it writes a row, and the tests start more than a hundred
writers. Only the imports are saved: it is a process of its own that runs `canhaptic.logs.writer.main` with its job on
standard input. A writer that replaces a killed one starts afresh, and so do those of tests that ask for `fresh_writer`.
"""

import json
import os
import signal
import subprocess
import sys
import traceback
import warnings
from typing import NoReturn

from canhaptic.logs import energy_sink, writer  # noqa: F401 - a sink is imported once, here
from canhaptic.logs.writer_process import WriterProcess

FRESH = WriterProcess._spawn


class ForkedWriter:
    """A writer process, with what `WriterProcess` uses of `subprocess.Popen`."""

    def __init__(self, descriptor: int, job: str) -> None:
        job_for_child, job_from_here = os.pipe()
        answer_here, answer_of_child = os.pipe()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of forks with other threads: h5py guards its own lock
            self.pid = os.fork()
        if self.pid == 0:
            _become_writer(descriptor, job_for_child, answer_of_child)
        os.close(job_for_child)
        os.close(answer_of_child)
        with os.fdopen(job_from_here, "w") as stream:
            stream.write(job)
        self.stdout = os.fdopen(answer_here)

    def wait(self, timeout: float | None = None) -> int:
        """Returns the status with which it ended."""
        return os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])

    def kill(self) -> None:
        """Ends it at once."""
        os.kill(self.pid, signal.SIGKILL)


def _become_writer(descriptor: int, job: int, answer: int) -> NoReturn:
    status = 1
    try:
        os.setsid()
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        os.dup2(job, 0)
        os.dup2(answer, 1)
        os.closerange(3, descriptor)
        os.closerange(descriptor + 1, os.sysconf("SC_OPEN_MAX"))
        sys.stdin, sys.stdout = open(0, closefd=False), open(1, "w", closefd=False)  # noqa: SIM115
        sys.argv = ["writer", str(descriptor)]
        writer.main()
        status = 0
    except BaseException:
        traceback.print_exc(file=open(2, "w", closefd=False))  # noqa: SIM115
    finally:
        os._exit(status)


def fork_writer(process: WriterProcess, restart: bool) -> "ForkedWriter | subprocess.Popen[str]":
    """Starts the writer of a `WriterProcess`, in the place of its own `_spawn`."""
    if restart:  # by a thread, while others work
        return FRESH(process, restart)
    return ForkedWriter(process._descriptor, json.dumps({**process._job, "restart": restart}))
