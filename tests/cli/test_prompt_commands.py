"""How soon a command answers: its help without importing what it does, and Ctrl-C at any time."""

import argparse
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from canhaptic.cli.main import COMMANDS
from canhaptic.cli.options import add_arguments
from canhaptic.commission.session import CommissioningLimits
from canhaptic.drive.clock import WallClock
from canhaptic.lab.studies.accuracy.study import DEFAULT_BUDGET
from canhaptic.lab.studies.design.search import MARGIN, TOLERANCE
from canhaptic.lab.studies.map import JUDGEMENTS

CONFIGS = Path(__file__).parents[2] / "configs"
HEAVY = (
    *("numpy", "pydantic", "rich", "h5py", "can", "canopen", "yaml", "matplotlib"),
    *("canhaptic.scene", "canhaptic.control", "canhaptic.sim"),
)


@pytest.mark.slow
def test_help_imports_nothing_that_a_command_needs_to_work() -> None:
    program = (
        "import sys\nfrom canhaptic.cli.main import main\nfor command in sys.argv[1:]:\n    try:\n"
        "        main([*command.split(), '--help'])\n    except SystemExit:\n"
        f"        print(command, sorted(name for name in {HEAVY!r} if name in sys.modules), file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", program, "", *COMMANDS], capture_output=True, text=True, check=True)
    assert done.stderr.splitlines() == [f"{command} []" for command in ("", *COMMANDS)]
    assert done.stdout.count("usage: canhaptic") == 1 + len(COMMANDS)


def test_defaults_in_the_help_are_those_of_the_code() -> None:
    assert options("accuracy").get_default("budget") == DEFAULT_BUDGET
    assert [options("design").get_default(name) for name in ("margin", "tolerance")] == [MARGIN, TOLERANCE]
    for judgement in JUDGEMENTS:
        options("map").parse_args(["result.h5", "--by", judgement])
    limits, commission = CommissioningLimits(), options("commission")
    for name in ("torque", "travel", "speed"):
        assert commission.get_default(name) == getattr(limits, name)
    assert options("evidence").get_default("travel") == limits.travel


def options(command: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser()
    add_arguments(command, parser)
    return parser


def interrupted(program: str, *words: str) -> tuple[int, str, float]:
    """Exit status, standard error and time [s] of a program after Ctrl-C, sent when it writes its first line."""
    with subprocess.Popen(
        [sys.executable, "-c", program, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        try:
            process.stdout.readline()
            begin = WallClock().now()
            process.send_signal(signal.SIGINT)
            _, written = process.communicate(timeout=30)
            return process.returncode, written, (WallClock().now() - begin) * 1e-9
        finally:
            process.kill()


ENTERED = """
import sys
from canhaptic.cli import main
run = main._run

def entered(words, name):
    print("entered", flush=True)
    return run(words, name)

main._run = entered
sys.exit(main.main(sys.argv[1:]))
"""
"""A signal that comes as `main` is entered, while what the command needs is imported."""

BUSY = """
import ctypes, sys
from canhaptic.cli import main

def busy(arguments):
    print("busy", flush=True)
    ctypes.CDLL(None).sleep(20)  # as a compiler does: one call, no instruction of Python in between
    ctypes.CDLL(None).sleep(20)

import canhaptic.lab.commands.sweep
canhaptic.lab.commands.sweep.execute = busy
sys.exit(main.main(sys.argv[1:]))
"""


@pytest.mark.slow_for("sweep", "accuracy", "inspect")
@pytest.mark.parametrize("command", ["accuracy", "sweep", "run", "inspect"])
def test_ctrl_c_right_after_the_entry_ends_with_130_and_one_line(command: str) -> None:
    words = [command, str(CONFIGS / "demo.yaml")]
    if command == "sweep":
        words += ["--vary", "environment.stiffness=1:9:9"]
    status, written, _ = interrupted(ENTERED, *words)
    assert status == 130
    assert "Traceback" not in written
    assert len(written.splitlines()) == 1


@pytest.mark.slow
def test_ctrl_c_inside_a_library_ends_the_command_before_the_library_returns() -> None:
    status, written, seconds = interrupted(BUSY, "sweep", str(CONFIGS / "demo.yaml"), "--vary", "bus.rate=100,200")
    assert (status, written) == (130, "canhaptic: interrupted\n")
    assert seconds < 10.0  # the library takes 20 s more


@pytest.mark.slow
def test_ctrl_c_while_a_sweep_compiles(tmp_path: Path) -> None:
    pytest.importorskip("numba")
    words = [str(CONFIGS / "demo.yaml"), "--vary", "environment.stiffness=1:900:300000", "--engine", "numba"]
    begin, pause = WallClock(), threading.Event()
    with subprocess.Popen(
        [sys.executable, "-m", "canhaptic", "sweep", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
    ) as process:  # fmt: skip
        pause.wait(2.0)  # the first sweep compiles for some seconds
        start = begin.now()
        process.send_signal(signal.SIGINT)
        _, written = process.communicate(timeout=30)
        assert process.returncode == 130
        assert "Traceback" not in written
        assert (begin.now() - start) * 1e-9 < 10.0  # compiling takes longer than that
