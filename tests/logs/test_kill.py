import contextlib
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from canhaptic.control.balance import EnergyBalance
from canhaptic.errors import LogStoppedError, LogWriteError
from canhaptic.logs.bus_reader import read_bus_log
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.hdf5 import note_length
from canhaptic.logs.repair import require_readable
from canhaptic.logs.writer_process import EnergyLogWriter
from tests.logs.log_rows import PORTS, SAMPLE_TIME_NS, append, balance, sample, timing, truth
from tests.logs.patience import wait_for

CONTROLLER = """
import sys, threading
sys.path.insert(0, {folder!r})
from tests.logs.log_rows import *
writer = EnergyLogWriter({path!r}, PORTS[:1], {{}}, sample_time_ns=SAMPLE_TIME_NS, with_truth=True)
pause = threading.Event()
k = 0
while True:
    append(writer, k)
    sys.stdout.write(f"{{k}}\\n")
    sys.stdout.flush()
    k += 1
    if k % 50 == 0:
        pause.wait(0.005)
"""


def kill(writer: EnergyLogWriter) -> None:
    with contextlib.suppress(ProcessLookupError):  # the last one is dead and the next not yet started
        os.kill(writer.pid, signal.SIGKILL)


def status_of(path: Path) -> str:
    with EnergyLog.open(path) as log:
        return log.status


def assert_rows_are_right(path: Path, at_least: int) -> None:
    with EnergyLog.open(path) as log:
        assert log.rows >= at_least
        assert np.array_equal(log.timing["sync_index"], np.arange(log.rows))
        assert np.array_equal(log.ports["handle"]["h_i"], [balance(k).h_i for k in range(log.rows)])


@pytest.mark.parametrize(
    "seed",
    [1, pytest.param(0, marks=pytest.mark.slow), *(pytest.param(n, marks=pytest.mark.campaign) for n in range(2, 20))],
)
def test_killing_the_controller_at_any_moment_loses_no_row(tmp_path: Path, seed: int) -> None:
    path = tmp_path / "run.h5"
    program = CONTROLLER.format(folder=str(Path(__file__).parents[2]), path=str(path))
    kill_after = random.Random(seed).randrange(1, 3000)
    last = -1
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as controller:
        assert controller.stdout is not None
        for line in controller.stdout:
            last = int(line) if line.endswith("\n") else last
            if last == kill_after:
                controller.kill()
    wait_for(lambda: status_of(path) != "running")
    assert status_of(path).startswith("interrupted")
    assert last >= kill_after
    assert_rows_are_right(path, at_least=last + 1)
    with h5py.File(path) as file:  # plain h5py opens it too
        assert file["timing/sync_index"].shape[0] >= last + 1


@pytest.mark.slow
@pytest.mark.parametrize("seed", [*range(4), *(pytest.param(n, marks=pytest.mark.campaign) for n in range(4, 20))])
def test_killing_the_writer_loses_no_row_because_another_takes_over(tmp_path: Path, seed: int) -> None:
    path = tmp_path / "run.h5"
    generator = random.Random(seed)
    kills = {generator.randrange(0, 20_000) for _ in range(3)}
    writer = EnergyLogWriter(path, PORTS[:1], {}, sample_time_ns=SAMPLE_TIME_NS, with_truth=True, pace="free")
    for k in range(20_000):
        if k in kills:
            kill(writer)
        append(writer, k)
    writer.event(3, "note", "", "still here")
    writer.close()
    assert_rows_are_right(path, at_least=20_000)
    with EnergyLog.open(path) as log:
        assert (log.status, log.rows_lost, len(log.events)) == ("complete", 0, 1)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run.h5"]


def test_a_writer_killed_again_and_again_is_given_up_with_one_message(tmp_path: Path) -> None:
    writer = EnergyLogWriter(tmp_path / "run.h5", PORTS[:1], {}, sample_time_ns=SAMPLE_TIME_NS, with_truth=True)
    while not writer.failure:
        killed = writer.pid
        kill(writer)
        wait_for(lambda seen=killed: writer.failure or writer.pid != seen)  # type: ignore[misc]
    append(writer, 0)  # the cycle goes on
    with pytest.raises(LogWriteError, match="killed by SIGKILL"):
        writer.close()


@pytest.mark.slow
def test_a_file_left_unreadable_is_put_aside_and_its_rows_are_counted_as_lost(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    writer = EnergyLogWriter(
        path, PORTS[:1], {}, sample_time_ns=SAMPLE_TIME_NS, with_truth=True, pace="free", ring_rows=512
    )
    for k in range(700):  # more than the ring holds: some of them are in the file
        append(writer, k)
    os.kill(writer.pid, signal.SIGSTOP)
    path.write_bytes(b"a bad sector")
    kill(writer)
    for k in range(700, 2000):
        append(writer, k)
    writer.close()
    with EnergyLog.open(path) as log:
        assert 188 <= log.rows_lost <= 700
        assert log.rows == 2000 - log.rows_lost
        assert np.array_equal(log.timing["sync_index"], np.arange(log.rows_lost, 2000))
    assert (tmp_path / "run.h5.damaged").read_bytes() == b"a bad sector"


@pytest.mark.slow
def test_a_full_disk_stops_the_log_with_one_message_and_never_the_cycle(tmp_path, limit_files: Callable[[int], None]):
    limit_files(1_000_000)
    noise = np.random.default_rng(1).standard_normal((4096, 11)).tolist()
    writer = EnergyLogWriter(
        tmp_path / "run.h5", PORTS[:1], {}, sample_time_ns=SAMPLE_TIME_NS, with_truth=True, ring_rows=2048
    )
    pause = threading.Event()
    k = 0
    while not writer.failure:
        append_noise(writer, k, noise[k % 4096])
        k += 1
        if k % 1000 == 0:
            pause.wait(0.02)
    for extra in range(3000):
        append_noise(writer, k + extra, noise[extra % 4096])
    assert writer.dropped > 0
    with pytest.raises(LogStoppedError, match=r"run\.h5: no space"):
        writer.close("complete")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["run.h5"]
    with EnergyLog.open(tmp_path / "run.h5") as log:
        assert log.status == f"failed: no space; the log ends at cycle {log.rows}"
        assert log.rows > 1000
        assert np.array_equal(log.timing["sync_index"], np.arange(log.rows) + np.cumsum(log.timing["dropped_before"]))
        assert log.changed_rows() == []


@pytest.mark.slow
def test_a_log_that_fails_while_it_is_packed_keeps_every_row_and_says_so(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    writer = EnergyLogWriter(
        path, PORTS[:1], {}, sample_time_ns=SAMPLE_TIME_NS, with_truth=True, pace="free", ring_rows=512
    )
    for k in range(1024):  # whole chunks
        append(writer, k)
    wait_for(lambda: writer.rings[0].tail == 1024)
    resource.prlimit(writer.pid, resource.RLIMIT_FSIZE, (20_000, 20_000))
    with pytest.raises(LogStoppedError, match=r"run\.h5: no space"):
        writer.close("completed")
    said = "failed: no space while it was packed; all 1024 rows are in it, unpacked"
    assert note_length(path, 1024) == said
    assert [file.name for file in tmp_path.iterdir()] == ["run.h5"]
    assert status_of(path) == said
    assert_rows_are_right(path, at_least=1024)


RUN = """
import sys
sys.path.insert(0, {folder!r})
from canhaptic.cli.main import main
sys.exit(main(["run", "demo", "--duration", "2000", "--pace", "free", "--log", {path!r}, "--bus-log", {bus!r}]))
"""
LOSSES = [pytest.param(number, marks=pytest.mark.campaign if number > 11 else ()) for number in range(50)]


@pytest.mark.slow
@pytest.mark.parametrize("number", LOSSES)
def test_a_lost_power_and_a_full_disk_leave_logs_that_are_readable_to_the_last_flush(tmp_path, number: int) -> None:
    path, bus, chance = tmp_path / "run.h5", tmp_path / "run.log", random.Random(number)
    program = RUN.format(folder=str(Path(__file__).parents[2]), path=str(path), bus=str(bus))
    kind = ("power", "energy log", "bus log")[number % 3]
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as run:
        wait_for(lambda: bus.exists() and bus.stat().st_size > 0)
        wait_for(lambda: {str(path), str(bus)} <= set().union(*writers(run.pid).values()))
        threading.Event().wait(chance.uniform(0.0, 1.5 if number != 1 else 0.2))
        if kind == "power":
            for process in (*writers(run.pid), run.pid):  # none is left that could empty its ring
                os.kill(process, signal.SIGKILL)
        else:
            full = path if kind == "energy log" else bus
            writer = next(pid for pid, files in writers(run.pid).items() if str(full) in files)
            room = full.stat().st_size + chance.randrange(40_000)
            resource.prlimit(writer, resource.RLIMIT_FSIZE, (room, room))
        assert run.stderr is not None
        message = run.stderr.read().decode()
    assert run.returncode == (-signal.SIGKILL if kind == "power" else 3), message
    assert kind == "power" or f"{full}: no space" in message
    statuses = {"power": "running", "energy log": "failed: no space", "bus log": "failed: log stopped"}
    require_readable(path)
    with EnergyLog.open(path) as log:
        assert log.status.startswith(statuses[kind])
        assert np.array_equal(log.timing["sync_index"], np.arange(log.rows))
        assert log.changed_rows() == []
    whole = bus.read_text().rpartition("\n")[0]
    bus.write_text(whole + "\n")
    assert sum(1 for _ in read_bus_log(bus)) == whole.count("\n") + 1


@pytest.mark.slow
@pytest.mark.skipif(
    sys.platform != "linux" or os.geteuid() != 0 or not shutil.which("mkfs.ext4"),
    reason="mounts a file system of its own, which only root may",
)
def test_a_disk_that_becomes_read_only_ends_the_run_and_keeps_what_was_flushed(tmp_path: Path) -> None:
    image, mount = tmp_path / "image", tmp_path / "mount"
    with image.open("wb") as file:
        file.truncate(64 << 20)
    mount.mkdir()
    subprocess.run(["mkfs.ext4", "-q", "-F", image], check=True)
    if subprocess.run(["mount", "-o", "loop", image, mount], check=False).returncode != 0:
        pytest.skip("no loop device")
    try:
        path, bus = mount / "run.h5", mount / "run.log"
        program = RUN.format(folder=str(Path(__file__).parents[2]), path=str(path), bus=str(bus))
        with subprocess.Popen(
            [sys.executable, "-c", program], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        ) as run:
            wait_for(lambda: bus.exists() and bus.stat().st_size > 20_000)
            subprocess.run(["mount", "-o", "remount,abort", mount], check=True)  # as the kernel does after a bad write
            sizes = path.stat().st_size, bus.stat().st_size
            assert run.stderr is not None
            message = run.stderr.read().decode()
        assert run.returncode == 3, message
        assert "Traceback" not in message
        assert message.count("Read-only file system; the run was stopped") == 1
        assert sizes == (path.stat().st_size, bus.stat().st_size)
        with EnergyLog.open(path) as log:
            assert log.status == "running"  # nothing can be written any more, as when power is lost
            assert np.array_equal(log.timing["sync_index"], np.arange(log.rows))
            assert log.changed_rows() == []
    finally:
        subprocess.run(["umount", mount], check=True)


def writers(parent: int) -> dict[int, set[str]]:
    """The children of a process, and the files that each has open."""
    found: dict[int, set[str]] = {}
    for task in Path(f"/proc/{parent}/task").iterdir():
        for word in (task / "children").read_text().split():
            found[int(word)] = {os.readlink(link) for link in Path(f"/proc/{word}/fd").iterdir()}
    return found


def append_noise(writer: EnergyLogWriter, k: int, row: list[Any]) -> None:
    writer.append(k, [sample(k)], [EnergyBalance(*row, 1, 2.0, 0, 3.0)], timing(k), [truth(k)])  # type: ignore[call-arg]


def test_a_vanished_folder_is_reported_when_the_log_is_closed(tmp_path: Path) -> None:
    folder = tmp_path / "stick"
    folder.mkdir()
    writer = EnergyLogWriter(folder / "run.h5", PORTS[:1], {}, sample_time_ns=SAMPLE_TIME_NS, with_truth=True)
    for k in range(500):
        append(writer, k)
    for file in folder.iterdir():
        file.unlink()
    folder.rmdir()
    with pytest.raises(LogWriteError, match=r"run\.h5"):
        writer.close()
