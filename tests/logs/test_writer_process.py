"""The writer takes nothing from the cycle: neither its processor nor its priority."""

import os
from pathlib import Path
from typing import Literal

import pytest

from canhaptic.errors import LogWriteError
from canhaptic.logs import writer_process
from canhaptic.logs.columns import PortDescription
from canhaptic.logs.writer_process import BusLogWriter, EnergyLogWriter

pytestmark = [
    pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system pins no process"),
    pytest.mark.usefixtures("fresh_writer"),
]


def test_a_writer_is_not_pinned_where_the_controller_is(tmp_path: Path) -> None:
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(allowed)})
    try:
        log = BusLogWriter(tmp_path / "a.log", "can0")
    finally:
        os.sched_setaffinity(0, allowed)
    assert os.sched_getaffinity(log.pid) >= allowed
    log.close()


@pytest.mark.slow_but("real-10")
@pytest.mark.parametrize(("pace", "behind"), [("real", 10), ("free", 0)])
def test_a_writer_gives_way_to_others_beside_a_cycle_in_real_time(tmp_path, pace: Literal["real", "free"], behind: int):
    log = BusLogWriter(tmp_path / "a.log", "can0", pace=pace)
    assert os.getpriority(os.PRIO_PROCESS, log.pid) == min(19, os.nice(0) + behind)
    assert os.sched_getscheduler(log.pid) == os.SCHED_OTHER
    log.close()


def test_ctrl_c_in_the_terminal_is_not_for_the_writer(tmp_path: Path) -> None:
    log = BusLogWriter(tmp_path / "a.log", "can0")
    assert os.getpgid(log.pid) != os.getpgid(0)
    log.close()


def test_a_writer_that_ends_before_it_reads_is_no_broken_pipe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """More than a pipe holds, to a process that ends: its status is the reason."""
    monkeypatch.setattr(writer_process, "_PROGRAM", "raise SystemExit(3)")
    with pytest.raises(LogWriteError, match="the writer process ended with status 3 before it was ready"):
        EnergyLogWriter(
            tmp_path / "a.h5", [PortDescription("x", "m")], {"note": "x" * 200_000}, sample_time_ns=1_000_000
        )
