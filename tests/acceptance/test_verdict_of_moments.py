"""First time at which the net energy of a port fell below zero: in the account, the log and a failed check."""

import json

import numpy as np
import pytest

from canhaptic import simulate
from canhaptic.cli.main import main
from canhaptic.logs.energy_reader import EnergyLog


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::canhaptic.errors.OverrideWarning")  # keys of guarded are dropped
def test_the_first_moment_below_zero_is_the_same_in_run_log_check_and_python(tmp_path, capsys) -> None:
    log, rattles = tmp_path / "a.h5", {"passivity.algorithm": "unprotected"}
    words = ["run", "stiff_wall", "--set", "passivity.algorithm=unprotected", "--duration", "0.6", "--log", str(log)]
    assert main([*words, "--json"]) == 0
    first = json.loads(capsys.readouterr().out)["ports"]["handle"]["first_active"]
    with EnergyLog.open(log) as logged:
        net = np.cumsum(logged.ports["handle"]["h_i"])
        assert first == logged.time[int((net < -1e-6).argmax())]
    assert main(["inspect", str(log), "--check", "passive"]) == 1
    shown = " ".join(capsys.readouterr().out.split())
    assert f"first below zero at {first:.4g} s (contact 1)" in shown
    assert f"no, first below zero at {first:.4g} s FAILS" in shown
    assert simulate("stiff_wall", rattles, duration=0.6).account["handle"].first_active == first
    assert simulate("stiff_wall", duration=0.6).account["handle"].first_active is None
