"""Nothing that was finished is lost: kill -9, Ctrl-C, a full disk, two sweeps at one file; and no file is mixed up."""

import errno
import os
import resource
import signal
import subprocess
import sys
import time
from typing import Any

import numpy as np
import pytest

from canhaptic.cli.main import main
from canhaptic.errors import InputError, LogFormatError, LogWriteError
from canhaptic.lab.batch import without_numba
from canhaptic.lab.studies.chunk import ChunkResult
from canhaptic.lab.studies.store import SweepTable
from canhaptic.lab.studies.sweep import sweep
from canhaptic.scene.load import load_scene
from tests.lab.sweep.conftest_sweep import DEMO, REPOSITORY, VARY, content

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
    path = tmp_path_factory.mktemp("whole") / "whole"
    assert main([*LONG, "--out", str(path)]) == 0
    return content(path)


@pytest.mark.slow
@pytest.mark.parametrize("workers", ["1", "2"])
def test_after_kill_9_every_finished_chunk_is_there_and_the_rest_is_run(tmp_path, whole, workers):
    path = tmp_path / "killed"
    process = begin(path, "--workers", workers)
    wait_until(lambda: finished(path) >= 3)
    process.kill()
    process.communicate()
    before = finished(path)
    assert 3 <= before < CHUNKS
    with SweepTable(path) as killed:
        rows = np.flatnonzero(killed.done())  # a chunk is one scene
        kept = killed.figure("handle", "travel")[rows]
        assert np.isin(killed.status()[rows], (1, 4)).all()  # completed, with and without a contact
        assert np.isfinite(kept).all()
    wait_until(lambda: not group_lives(process.pid))  # no worker outlives it
    assert main([*LONG, "--out", str(path), "--resume"]) == 0
    assert content(path) == whole
    with SweepTable(path) as table:
        assert table.figure("handle", "travel")[rows].tobytes() == kept.tobytes()


def group_lives(group):
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.slow
def test_without_numba_a_long_sweep_says_so_and_its_chunks_take_seconds_in_python(demo, tmp_path, monkeypatch):
    monkeypatch.setattr("canhaptic.lab.batch.find_spec", lambda _: None)
    said: list[str] = []
    options: dict[str, Any] = {"note": said.append, "stop_requested": lambda: True}
    vary, path = ["environment.stiffness=100:1000:2000"], tmp_path / "many"
    sweep(demo, vary, path, cycles=2000, **options)
    assert said == [without_numba()]
    assert "about 100 times slower; pip install" in said[0]
    with SweepTable(path) as table:
        assert table.span(0) == (0, 50)
    sweep(demo, vary, tmp_path / "few", cycles=100, **options)
    sweep(demo, vary, tmp_path / "python", cycles=2000, engine="python", **options)
    display = load_scene(REPOSITORY / "configs/admittance/virtual_mass.yaml")  # Python runs it with numba, too
    sweep(display, ["environment.mass=2,3"], tmp_path / "display", cycles=1000000, **options)
    assert len(said) == 1


@pytest.mark.slow
def test_a_sweep_that_goes_on_says_how_many_scenes_were_there(tmp_path, capsys):
    words = ["sweep", DEMO, "--vary", "environment.stiffness=100,200", "--cycles", "20", "--out", str(tmp_path / "a")]
    assert main(words) == 0
    assert "kept from" not in capsys.readouterr().out
    assert main([*words, "--resume"]) == 0
    assert "(2 kept from an earlier run)" in capsys.readouterr().out


LEAVES = """
import multiprocessing, sys
from canhaptic.cli import main
def run(words, name):
    lock = multiprocessing.get_context("spawn").Lock()
    while True:
        try:
            print("here", flush=True)
            __import__("time").sleep(30)
        except KeyboardInterrupt:
            pass
main._run = run
main.main(["sweep"])
"""


def test_ctrl_c_during_a_long_chunk_leaves_no_semaphore_behind():
    with subprocess.Popen([sys.executable, "-c", LEAVES], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        process.send_signal(signal.SIGINT)
        assert process.communicate(timeout=30)[1] == b"canhaptic: interrupted\n"
    assert process.returncode == 130


@pytest.mark.slow
def test_ctrl_c_ends_after_the_chunk_under_way_and_says_how_to_go_on(tmp_path, whole):
    path = tmp_path / "stopped"
    process = begin(path)
    wait_until(lambda: finished(path) >= 2)
    process.send_signal(signal.SIGINT)
    said = process.communicate()[1]
    assert process.returncode == 130
    assert f"--resume goes on with {path}" in said
    assert 2 <= finished(path) < CHUNKS
    assert main([*LONG, "--out", str(path), "--resume"]) == 0
    assert content(path) == whole


@pytest.mark.slow
def test_a_disk_that_fills_up_costs_the_chunk_under_way_alone(demo, tmp_path, monkeypatch):
    path, undisturbed = tmp_path / "full", tmp_path / "whole"
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
    assert content(path) == content(undisturbed)


@pytest.mark.slow
def test_a_disk_without_room_for_all_results_is_found_out_before_a_scene_runs(demo, tmp_path):
    path = tmp_path / "large"
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
def test_chunks_of_an_earlier_sweep_are_not_taken_for_those_of_another(demo, tmp_path):
    path = tmp_path / "a"
    sweep(demo, VARY, path, chunk=4, **ONE, stop_requested=iter([False, False, True, True, True]).__next__)
    with SweepTable(path, writable=True) as table:
        table.store(7, table_result(4))
    (path / "study.json").unlink()
    assert sweep(demo, VARY[:1], path, chunk=4, **ONE).begun == 0
    with SweepTable(path) as table:
        assert np.isfinite(table.figure("handle", "travel")).all()


def table_result(scenes):
    nothing = np.zeros(scenes, dtype=np.uint8)
    return ChunkResult(
        {"handle/travel": np.full(scenes, np.nan)}, nothing + 1, nothing, np.full(scenes, "", dtype=object)
    )


@pytest.mark.slow
def test_a_damaged_chunk_is_named(demo, tmp_path):
    path = tmp_path / "a"
    sweep(demo, VARY, path, chunk=4, **ONE)
    (path / "00000003.npz").write_bytes(b"no chunk")
    with SweepTable(path) as table, pytest.raises(LogFormatError, match=r"00000003\.npz"):
        table.status()


@pytest.mark.slow
def test_a_folder_that_is_not_there_is_named(demo, tmp_path):
    with pytest.raises(LogWriteError, match="nowhere"):
        sweep(demo, VARY, tmp_path / "nowhere" / "a")


@pytest.mark.slow
def test_two_sweeps_cannot_write_one_folder(demo, tmp_path):
    path = tmp_path / "a"
    sweep(demo, VARY, path, **ONE)
    code = (
        "from pathlib import Path; from canhaptic.lab.studies.store import SweepTable; "
        f"SweepTable(Path({str(path)!r}), writable=True)"
    )
    with SweepTable(path, writable=True):
        found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "another study writes it" in found.stderr


@pytest.mark.slow
def test_a_folder_is_neither_overwritten_nor_mixed_with_another_sweep(demo, tmp_path):
    path = tmp_path / "a"
    sweep(demo, VARY, path, **ONE)
    before = content(path)
    with pytest.raises(InputError, match="--resume continues it, --force replaces it"):
        sweep(demo, VARY, path, **ONE)
    others = [
        (demo, VARY[:1], ONE, "varied"),
        (demo, VARY, ONE | {"cycles": 21}, "cycles"),
        (demo, VARY, ONE | {"metrics": ["margin"]}, "metrics"),
        (load_scene(DEMO, ["environment.position=0"]), VARY, ONE, "configuration"),
    ]
    for scene, vary, options, what in others:
        with pytest.raises(InputError, match=f"was made with {what}"):
            sweep(scene, vary, path, resume=True, **options)
    assert content(path) == before
    sweep(demo, VARY[:1], path, force=True, **ONE)
    assert content(path).keys() == {"study.json", "00000000.npz"}
    assert content(path) != before


@pytest.mark.slow
def test_a_finished_sweep_is_not_run_again(demo, tmp_path):
    path = tmp_path / "a"
    sweep(demo, VARY, path, **ONE)
    state = sweep(demo, VARY, path, resume=True, **ONE)
    assert (state.done, state.begun) == (32, 32)


FOREIGN = ["", "no JSON", "[1]", '{"format": "canhaptic arena"}', '{"format": "canhaptic sweep", "format_version": 99}']


@pytest.mark.parametrize("text", [*FOREIGN, None])
def test_a_folder_that_is_no_sweep_is_refused(tmp_path, text):
    path = tmp_path / "a"
    path.mkdir()
    if text is not None:
        (path / "study.json").write_text(text)
    with pytest.raises(LogFormatError, match=r"a: (cannot be read as a sweep|is '.*, expected)"):
        SweepTable(path)


def test_a_file_of_an_earlier_release_is_refused_and_not_replaced(demo, tmp_path):
    path = tmp_path / "old.h5"
    path.write_bytes(b"\x89HDF")
    with pytest.raises(LogFormatError, match="cannot be read as a sweep"):
        SweepTable(path)
    with pytest.raises(InputError, match="is a file, expected a folder"):
        sweep(demo, VARY, path, force=True, **ONE)
    assert path.read_bytes() == b"\x89HDF"


@pytest.mark.slow
def test_a_folder_with_other_files_keeps_them(demo, tmp_path):
    (tmp_path / "mine.npz").write_bytes(b"1")
    (tmp_path / "mine.json").write_bytes(b"2")
    sweep(demo, VARY, tmp_path, **ONE)
    sweep(demo, VARY[:1], tmp_path, force=True, **ONE)
    assert content(tmp_path).keys() == {"mine.npz", "mine.json", "study.json", "00000000.npz"}
