"""Serial, threads, process pool and Dask give the same bits, also when a worker dies in the middle."""

import os
import signal
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from canhaptic.errors import InputError, WorkersLostError
from canhaptic.lab.studies.runner import Pool, dask_executor
from canhaptic.lab.studies.sweep import sweep
from canhaptic.scene.load import load_scene
from tests.lab.sweep.conftest_sweep import DEMO, VARY, content
from tests.lab.sweep.dask_cluster import dask_cluster

OPTIONS: dict[str, Any] = {
    "cycles": 40,
    "chunk": 4,
    "controllers": ["unprotected"],
    "engine": "python",
    "metrics": ["travel", "margin", "spectral_radius"],
}
SCENES = 32


@pytest.fixture(scope="module")
def serial(tmp_path_factory):
    path = tmp_path_factory.mktemp("serial") / "serial"
    sweep(load_scene(DEMO), VARY, path, **OPTIONS)
    return content(path)


@pytest.mark.slow
def test_any_executor_of_python_gives_the_same_bits(demo, tmp_path, serial):
    with ThreadPoolExecutor(3) as executor:
        sweep(demo, VARY, tmp_path / "threads", executor, **OPTIONS)
    assert content(tmp_path / "threads") == serial


@pytest.mark.slow
def test_a_pool_goes_on_with_new_processes_after_one_was_killed(demo, tmp_path, serial):
    pool, killed = Pool(2), []

    def kill(state):
        if state.done >= SCENES // 4 and not killed:
            killed.append(next(iter(pool.executor._processes)))
            os.kill(killed[0], signal.SIGKILL)

    try:
        assert sweep(demo, VARY, tmp_path / "pool", pool, progress=kill, **OPTIONS).done == SCENES
    finally:
        pool.shutdown()
    assert killed
    assert content(tmp_path / "pool") == serial


@pytest.mark.slow
def test_workers_that_die_again_and_again_end_the_sweep_with_what_was_finished(demo, tmp_path, serial):
    pool, path = Pool(1), tmp_path / "dying"
    before = dict(os.environ)

    def poison(state):
        if state.done >= SCENES // 4:
            for process in list(pool.executor._processes or ()):
                os.kill(process, signal.SIGKILL)
            os.environ["PYTHONHOME"] = "/nowhere"  # no new worker can start

    try:
        with pytest.raises(WorkersLostError, match=r"3 times in a row.*--resume"):
            sweep(demo, VARY, path, pool, progress=poison, **OPTIONS)
    finally:
        os.environ.clear()
        os.environ.update(before)
        pool.shutdown()
    assert sweep(demo, VARY, path, resume=True, **OPTIONS).begun >= SCENES // 4
    assert content(path) == serial


@pytest.mark.slow  # three processes that each import dask
def test_a_dask_cluster_that_loses_a_worker_gives_the_same_bits(demo, tmp_path, serial):
    pytest.importorskip("distributed")
    killed = []
    with dask_cluster(tmp_path) as cluster:

        def kill(state):
            if state.done >= SCENES // 4 and not killed:
                killed.append(cluster.workers[0].pid)
                cluster.kill_worker()

        cluster.wait_for_workers()
        with dask_executor(cluster.address) as (executor, threads):
            assert threads == 2
            state = sweep(demo, VARY, tmp_path / "dask", executor, progress=kill, **OPTIONS)
            assert cluster.count_workers() == 1
    assert killed
    assert state.done == SCENES
    assert content(tmp_path / "dask") == serial


@pytest.mark.slow
def test_an_address_where_no_scheduler_answers_is_named(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("canhaptic.lab.studies.runner._CONNECT", 0.5)
    with pytest.raises(InputError, match="no scheduler answers"), dask_executor("tcp://127.0.0.1:9"):
        pass


@pytest.mark.slow
def test_a_long_sweep_that_python_runs_gets_a_process_a_core(demo, tmp_path, serial, monkeypatch):
    made = []

    class Watched(Pool):
        def __init__(self, workers):
            made.append(workers)
            super().__init__(workers)

    monkeypatch.setattr("canhaptic.lab.studies.runner.Pool", Watched)
    monkeypatch.setattr("canhaptic.lab.studies.sweep.os.cpu_count", lambda: 2)
    sweep(demo, VARY, tmp_path / "short", processes=True, **OPTIONS)
    assert made == []
    monkeypatch.setattr("canhaptic.lab.studies.sweep._WORTH_A_POOL", 32 * 40.0)
    sweep(demo, VARY, tmp_path / "long", processes=True, **OPTIONS)
    assert made == [2]
    assert content(tmp_path / "long") == serial
