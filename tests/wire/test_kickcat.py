"""A second foreign master, KickCAT, accepts the simulated drive."""

import subprocess
import sys
from typing import Final

import pytest

from tests.wire.veth import FarEnd, require, veth

KICKCAT: Final = """
import os, sys, kickcat
from datetime import timedelta
os.sched_setaffinity(0, {0})
os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(20))
second = timedelta(seconds=1)
bus = kickcat.Bus(kickcat.create_link(sys.argv[1], ""))
bus.init(second)
bus.create_mapping(256)
bus.request_state(kickcat.State.SAFE_OP)
bus.wait_for_state(kickcat.State.SAFE_OP, second)
for _ in range(5):
    bus.process_data_no_check()
bus.request_state(kickcat.State.OPERATIONAL)
bus.wait_for_state(kickcat.State.OPERATIONAL, second, lambda: bus.process_data_no_check())
"""
"""Takes the drives of an interface to OP."""


@pytest.mark.slow
def test_kickcat_brings_the_drive_to_op() -> None:
    require("kickcat")
    for _ in range(10):  # its waits of milliseconds are too short where other programs run
        with veth() as ends, FarEnd(ends[1]) as far:
            words = [sys.executable, "-c", KICKCAT, ends[0]]
            done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
            if not done.returncode:
                assert far.ask()[0]["al_state"] in (4, 8)  # its watchdog may have come since
                return
    pytest.fail(done.stderr)
