"""Sinks of a run: functions of installed packages that get the rows of its energy log while it is written.

Each runs in a process of its own, which only reads the log. A sink that is slow, that fails or that hangs costs the run
nothing; standard error says so.
"""

import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, Final, cast

from canhaptic.errors import CanHapticError, LogFormatError, cause_of
from canhaptic.logs.energy_reader import RUNNING, EnergyLog
from canhaptic.logs.writer import become_ordinary
from canhaptic.logs.writer_process import isolated_program, trusted_folders
from canhaptic.registry import function_of

_PAUSE: Final = 0.2  # [s] between two looks, about what the writer puts into one chunk
_LAST: Final = 10.0  # [s] that a sink may take for its rows after the end of the run


@contextmanager
def fed(names: Sequence[str], path: Path) -> Iterator[None]:
    """Give the rows of an energy log to sinks while it is written, and those that are left at the end.

    Args:
        names: Names of the entry points.
        path: The log, which a writer has open.
    """
    programs = []
    for name in names:
        job = {"sink": name, "path": str(path.resolve()), "parent": os.getpid(), "folders": trusted_folders()}
        try:
            program = isolated_program("canhaptic.logs.row_sinks", [], (), stdout=sys.__stderr__)
            with cast("IO[str]", program.stdin) as pipe:
                json.dump(job, pipe)
            programs.append(program)
        except OSError as error:
            sys.stderr.write(f"  the sink {name} cannot be started: {cause_of(error)}\n")
    try:
        yield
    finally:
        for program in programs:
            try:
                program.wait(_LAST)
            except subprocess.TimeoutExpired:
                program.kill()
                sys.stderr.write(f"  a sink was ended: it had not taken its rows {_LAST:g} s after the run\n")


def main() -> None:
    """Read the job, and feed its sink until the log is complete or its writer has gone."""
    job = json.load(sys.stdin)
    sys.path += job["folders"]  # behind the installation, as for the writer
    become_ordinary(patient=True)
    try:
        _feed(function_of("sink", job["sink"]), Path(job["path"]), job["parent"])
    except (CanHapticError, OSError) as error:
        sys.stderr.write(f"  {error}\n")
        sys.exit(1)


def _feed(sink: Any, path: Path, parent: int) -> None:
    taken, pause, is_last = 0, threading.Event(), False
    while not is_last:
        is_last = os.getppid() != parent
        try:
            with EnergyLog.open(path) as log:
                is_last = is_last or log.status != RUNNING
                if log.rows > taken:
                    sink(log, taken, log.rows)
                    taken = log.rows
        except LogFormatError:  # between two chunks
            pass
        if not is_last:
            pause.wait(_PAUSE)
