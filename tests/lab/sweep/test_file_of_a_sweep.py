"""Nothing that was finished is lost: kill -9, Ctrl-C, a full disk, two sweeps at one file; and no file is mixed up."""

import errno
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from canhaptic.cli.main import main
from canhaptic.errors import InputError, LogFormatError, LogWriteError
from canhaptic.lab.studies.sweep import sweep
from canhaptic.lab.studies.sweep.chunk import ChunkResult
from canhaptic.lab.studies.sweep.sweep_table import SweepTable
from canhaptic.scene.load import load_scene
from tests.lab.sweep.conftest_sweep import DEMO, VARY

LONG = [
    "sweep", DEMO, "--vary", "environment.stiffness=1e2:1e4:log:6", "--vary", "simulation.seed=0:4:lin:5",
    "--cycles", "100", "--chunk", "1", "--engine", "python",
]  # fmt: skip
CHUNKS = 30
ONE: dict[str, Any] = {"cycles": 20, "metrics": ["travel"], "controllers": ["unprotected"]}


def begin(path, *options):
    command = [sys.executable, "-m", "canhaptic", *LONG]
    return subprocess.Popen([*command, "--out", str(path), *options], stderr=subprocess.PIPE, stdout=subprocess.DEVNULL,
                            text=True, start_new_session=True)  # fmt: skip


def finished(path):
    try:
        with SweepTable(path) as table:
            return int(table.done().sum())
    except LogFormatError:
        return 0


def wait_until(is_so, limit=90.0):
    end = time.monotonic() + limit
    while not is_so():
        assert time.monotonic() < end
        time.sleep(0.01)  # noqa: TID251


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The file of a sweep that nothing disturbed."""
    path = tmp_path_factory.mktemp("whole") / "whole.h5"
    assert main([*LONG, "--out", str(path)]) == 0
    return path.read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("workers", ["1", "2"])
def test_after_kill_9_every_finished_chunk_is_there_and_the_rest_is_run(tmp_path, whole, workers):
    path = tmp_path / "killed.h5"
    process = begin(path, "--workers", workers)
    wait_until(lambda: finished(path) >= 3)
    process.kill()
    process.communicate()
    before = finished(path)
    assert 3 <= before < CHUNKS
    with SweepTable(path) as killed:
        rows = np.flatnonzero(killed.done())  # a chunk is one scene
        kept = killed.figure("handle", "travel")[rows]
        assert (killed.status()[rows] == 1).all()
        assert np.isfinite(kept).all()
    wait_until(lambda: not group_lives(process.pid))  # no worker outlives it
    assert main([*LONG, "--out", str(path), "--resume"]) == 0
    assert path.read_bytes() == whole
    with SweepTable(path) as table:
        assert table.figure("handle", "travel")[rows].tobytes() == kept.tobytes()


def group_lives(group):
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.slow
def test_ctrl_c_ends_after_the_chunk_under_way_and_says_how_to_go_on(tmp_path, whole):
    path = tmp_path / "stopped.h5"
    process = begin(path)
    wait_until(lambda: finished(path) >= 2)
    process.send_signal(signal.SIGINT)
    said = process.communicate()[1]
    assert process.returncode == 130
    assert f"--resume goes on with {path}" in said
    assert 2 <= finished(path) < CHUNKS
    assert main([*LONG, "--out", str(path), "--resume"]) == 0
    assert path.read_bytes() == whole


@pytest.mark.slow
def test_a_disk_that_fills_up_costs_the_chunk_under_way_alone(demo, tmp_path, monkeypatch):
    path, undisturbed = tmp_path / "full.h5", tmp_path / "whole.h5"
    sweep(demo, VARY, undisturbed, chunk=4, **ONE)
    flush = os.fsync

    def refuse(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def fill_up(state):
        patch.setattr(os, "fsync", refuse if state.done == 8 else flush)

    with monkeypatch.context() as patch, pytest.raises(LogWriteError, match=r"no room.*--resume"):
        sweep(demo, VARY, path, chunk=4, **ONE, progress=fill_up)
    assert finished(path) == 2
    assert sweep(demo, VARY, path, chunk=4, **ONE, resume=True).done == 32
    assert path.read_bytes() == undisturbed.read_bytes()


def test_a_disk_without_room_for_all_results_is_found_out_before_a_scene_runs(demo, tmp_path):
    path = tmp_path / "large.h5"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, hard))
        with pytest.raises(LogWriteError, match="nothing has been run"):
            sweep(demo, ["environment.stiffness=1:2:5000"], path, cycles=2)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_merge_that_fails_leaves_the_chunks_for_the_next(demo, tmp_path, monkeypatch):
    path, undisturbed = tmp_path / "full.h5", tmp_path / "whole.h5"
    sweep(demo, VARY, undisturbed, chunk=4, **ONE)

    def refuse(self, target):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def fill_up(state):
        if state.done == 32:
            patch.setattr(Path, "replace", refuse)

    with monkeypatch.context() as patch, pytest.raises(LogWriteError, match=r"no room.*--resume"):
        sweep(demo, VARY, path, chunk=4, **ONE, progress=fill_up)
    with SweepTable(path) as table:
        assert table.done().all()
        travel = table.figure("handle", "travel")
    state = sweep(demo, VARY, path, chunk=4, **ONE, resume=True)
    assert (state.begun, state.done) == (32, 32)
    assert path.read_bytes() == undisturbed.read_bytes()
    assert sorted(tmp_path.iterdir()) == [path, undisturbed]
    with SweepTable(path) as table:
        assert table.figure("handle", "travel").tobytes() == travel.tobytes()


def test_chunks_of_an_earlier_sweep_are_not_taken_for_those_of_another(demo, tmp_path):
    path = tmp_path / "a.h5"
    sweep(demo, VARY, path, chunk=4, **ONE, stop_requested=iter([False, False, True, True, True]).__next__)
    with SweepTable(path, writable=True) as table:
        table.write(7, table_result(4))
    path.unlink()
    assert sweep(demo, VARY[:1], path, chunk=4, **ONE).begun == 0
    with SweepTable(path) as table:
        assert np.isfinite(table.figure("handle", "travel")).all()


def table_result(scenes):
    nothing = np.zeros(scenes, dtype=np.uint8)
    return ChunkResult({"handle/travel": np.full(scenes, np.nan)}, nothing + 1, nothing, nothing, ())


def test_a_damaged_chunk_is_named(demo, tmp_path):
    path = tmp_path / "a.h5"
    sweep(demo, VARY, path, chunk=4, **ONE)
    folder = tmp_path / "a.h5.chunks"
    folder.mkdir()
    (folder / "00000003.npz").write_bytes(b"no chunk")
    with SweepTable(path) as table, pytest.raises(LogFormatError, match=r"00000003\.npz"):
        table.status()


def test_a_folder_that_is_not_there_is_named(demo, tmp_path):
    with pytest.raises(LogWriteError, match="nowhere"):
        sweep(demo, VARY, tmp_path / "nowhere" / "a.h5")


@pytest.mark.slow
def test_two_sweeps_cannot_write_one_file(demo, tmp_path):
    path = tmp_path / "a.h5"
    sweep(demo, VARY, path, **ONE)
    code = (
        "from pathlib import Path; from canhaptic.lab.studies.sweep.sweep_table import SweepTable; "
        f"SweepTable(Path({str(path)!r}), writable=True)"
    )
    with SweepTable(path, writable=True):
        found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "another sweep writes it" in found.stderr


def test_a_file_is_neither_overwritten_nor_mixed_with_another_sweep(demo, tmp_path):
    path = tmp_path / "a.h5"
    sweep(demo, VARY, path, **ONE)
    before = path.read_bytes()
    with pytest.raises(InputError, match="--resume continues it, --force replaces it"):
        sweep(demo, VARY, path, **ONE)
    others = [
        (demo, VARY[:1], ONE, "varied"),
        (demo, VARY, ONE | {"cycles": 21}, "cycles"),
        (demo, VARY, ONE | {"samples": 32}, "samples"),
        (demo, VARY, ONE | {"metrics": ["margin"]}, "metrics"),
        (load_scene(DEMO, ["environment.position=0"]), VARY, ONE, "configuration"),
    ]
    for scene, vary, options, what in others:
        with pytest.raises(InputError, match=f"was made with {what}"):
            sweep(scene, vary, path, resume=True, **options)
    assert path.read_bytes() == before
    sweep(demo, VARY[:1], path, force=True, **ONE)
    assert len(path.read_bytes()) < len(before)


def test_a_finished_sweep_is_not_run_again(demo, tmp_path):
    path = tmp_path / "a.h5"
    sweep(demo, VARY, path, **ONE)
    state = sweep(demo, VARY, path, resume=True, **ONE)
    assert (state.done, state.begun) == (32, 32)


@pytest.mark.parametrize("content", [b"", b"no HDF5 at all", None])
def test_a_file_that_is_no_sweep_is_refused(tmp_path, content):
    path = Path(tmp_path / "a.h5")
    if content is None:
        with h5py.File(path, "w") as file:
            file.attrs["format"] = "something else"
    else:
        path.write_bytes(content)
    with pytest.raises(LogFormatError, match=r"a\.h5"):
        SweepTable(path)
    with pytest.raises(LogFormatError, match="no such file"):
        SweepTable(tmp_path / "b.h5")
