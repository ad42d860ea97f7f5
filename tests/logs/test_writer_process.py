"""The writer takes nothing from the cycle: neither its processor nor its priority."""

import os
from pathlib import Path
from typing import Literal

import pytest

from canhaptic.logs.bus_log import BusLogWriter

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
    assert os.sched_getaffinity(log.writer_pid) >= allowed
    log.close()


@pytest.mark.parametrize(("pace", "behind"), [("real", 10), ("free", 0)])
def test_a_writer_gives_way_to_others_beside_a_cycle_in_real_time(
    tmp_path: Path, pace: Literal["real", "free"], behind: int
) -> None:
    log = BusLogWriter(tmp_path / "a.log", "can0", pace=pace)
    assert os.getpriority(os.PRIO_PROCESS, log.writer_pid) == min(19, os.nice(0) + behind)
    assert os.sched_getscheduler(log.writer_pid) == os.SCHED_OTHER
    log.close()


def test_ctrl_c_in_the_terminal_is_not_for_the_writer(tmp_path: Path) -> None:
    log = BusLogWriter(tmp_path / "a.log", "can0")
    assert os.getpgid(log.writer_pid) != os.getpgid(0)
    log.close()
