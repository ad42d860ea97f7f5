"""Processes forked from the process of the tests, which has imported the package.

A fresh interpreter spends 0.15 s of CPU on what a log's writer imports and 0.4 s on what a run imports, and the tests
start nearly two hundred. Only the imports are saved: pipes, signals and the end are those of any process. A writer that
replaces a killed one starts afresh, and so do those of tests that ask for the fixture `fresh_writer`.
"""

import inspect
import json
import os
import signal
import subprocess
import sys
import traceback
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import IO, Any, NoReturn, cast

from canhaptic.cli.main import main
from canhaptic.logs import (
    energy_sink,  # noqa: F401 - imported once, here
    writer,
)
from canhaptic.logs.writer_process import WriterProcess

_FRESH = WriterProcess._spawn
_NAMES = tuple(inspect.signature(subprocess.Popen._execute_child).parameters)[1:]  # type: ignore[attr-defined]
_PIPES = ("p2cread", "p2cwrite", "c2pread", "c2pwrite", "errread", "errwrite")


class Forked(subprocess.Popen[str]):
    """A process that does some work, in the place of a program.

    Args:
        work: Returns the exit status.
        options: As for `subprocess.Popen`, of which pipes, `pass_fds` and `start_new_session` count.
    """

    def __init__(self, work: Callable[[], int], **options: Any) -> None:
        self._work = work
        super().__init__(["forked"], text=True, **options)

    def _execute_child(self, *given: Any) -> None:
        options = dict(zip(_NAMES, given, strict=True))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of forks with other threads: h5py guards its own lock
            self.pid = os.fork()
        if self.pid == 0:
            _become(self._work, options)
        self._child_created = True
        self._close_pipe_fds(*(options[name] for name in _PIPES))  # type: ignore[attr-defined]


def _become(work: Callable[[], int], options: dict[str, Any]) -> NoReturn:
    status = 1
    try:
        if options["start_new_session"]:
            os.setsid()
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        for number, end in enumerate(("p2cread", "c2pwrite", "errwrite")):
            if options[end] != -1:
                os.dup2(options[end], number)
        _close_all_but(*options["pass_fds"])
        sys.stdin, sys.stdout, sys.stderr = (open(n, mode, closefd=False) for n, mode in enumerate("rww"))  # noqa: SIM115
        status = work()
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 1
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def _close_all_but(*kept: int) -> None:
    begin = 3
    for end in sorted((*kept, os.sysconf("SC_OPEN_MAX"))):
        os.closerange(begin, end)
        begin = end + 1


def command(*words: str, stdin: int | None = None) -> Forked:
    """Starts `canhaptic` with these words; its output and its messages go into pipes."""
    return Forked(partial(main, list(words)), stdin=stdin, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def fork_writer(process: WriterProcess, restart: bool) -> "subprocess.Popen[str]":
    """Starts the writer of a log, in the place of `WriterProcess._spawn`."""
    if restart:  # by a thread, while others work
        return _FRESH(process, restart)
    descriptor = process._descriptor
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    forked = Forked(partial(_write, descriptor), pass_fds=(descriptor,), start_new_session=True, **pipes)
    with suppress(BrokenPipeError), cast("IO[str]", forked.stdin) as pipe:  # it may have ended already
        pipe.write(json.dumps({**process._job, "restart": restart}))
    return forked


def _write(descriptor: int) -> int:
    sys.argv = ["writer", str(descriptor)]
    writer.main()
    return 0
