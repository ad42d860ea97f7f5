"""A second foreign master, KickCAT, accepts the simulated drive."""

import subprocess
import sys

import pytest

from tests.wire.veth import FarEnd, require, veth
from tools.bench.ethercat_wire import KICKCAT


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
