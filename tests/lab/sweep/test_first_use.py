"""The first sweep of a kind of scene: Python runs scenes while their loop is compiled, and the bits are the same."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from canhaptic.lab.studies.chunk import ENGINES, ChunkResult, run_chunk
from canhaptic.lab.studies.runner import begin_worker
from canhaptic.lab.studies.store import MORE, SLOTS, numbered
from canhaptic.lab.studies.sweep import Asked, joined, make_sweep
from tests.lab.sweep.conftest_sweep import VARY


def asked_of(demo) -> Asked:
    metrics = ["travel", "margin", "torque_peak"]
    return make_sweep(demo, VARY, controllers=["unprotected"], cycles=40, metrics=metrics, engine="numba")


@pytest.fixture
def first_use(tmp_path, monkeypatch):
    """The module, where no loop is compiled yet."""
    pytest.importorskip("numba", reason="needs numba (the extra fast)")
    from canhaptic.lab.batch.compiled_loops import compiled_loops
    from canhaptic.lab.studies import sweep as run_sweep

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    compiled_loops.cache_clear()
    yield run_sweep
    compiled_loops.cache_clear()


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_python_runs_scenes_until_their_loop_is_compiled_and_the_bits_are_the_same(demo, first_use):
    asked, reported = asked_of(demo), []
    first: Any
    columns = asked.points.columns(0, len(asked.points))

    def report(scenes):
        reported.append(scenes)
        first._compiling.join()

    first = first_use.FirstUse(report, begin_worker)
    found = first.run(asked.recipe, 0, columns)
    first.close()
    expected = run_chunk(replace(asked.recipe, engine="python"), 0, columns)
    for name, values in expected.figures.items():
        assert found.figures[name].tobytes() == values.tobytes()
    python, numba = ENGINES.index("python"), ENGINES.index("numba")
    assert found.engine.tolist() == [python] * 4 + [numba] * (len(asked.points) - 4)
    assert reported == [4, len(asked.points)]
    again = first_use.FirstUse(pytest.fail, pytest.fail).run(asked.recipe, 0, columns)
    assert set(again.engine.tolist()) == {numba}


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_what_cannot_be_compiled_elsewhere_is_compiled_here(demo, first_use):
    asked = asked_of(demo)
    columns = asked.points.columns(0, len(asked.points))
    first: Any = None

    def report(scenes):
        first._compiling.join()

    first = first_use.FirstUse(report, None)  # the process ends with an error
    found = first.run(asked.recipe, 0, columns)
    assert found.engine.tolist()[4:] == [ENGINES.index("numba")] * (len(asked.points) - 4)


def result(remarks: list[str], of_plant: str = "") -> ChunkResult:
    numbers = np.arange(len(remarks), dtype=np.uint8)
    return ChunkResult(
        {"a/b": 0.5 * np.arange(len(remarks), dtype=float)}, numbers, numbers, np.array(remarks, dtype=object), of_plant
    )


def test_results_of_slices_are_one_with_every_remark_at_its_scene():
    whole = joined([result(["", "y", "x"]), result(["y", "z"], "mass"), result([""])])
    assert whole.remark.tolist() == ["", "y", "x", "y", "z", ""]
    assert whole.figures["a/b"].tolist() == [0.0, 0.5, 1.0, 0.0, 0.5, 0.0]
    assert whole.status.tolist() == whole.engine.tolist() == [0, 1, 2, 0, 1, 0]
    assert whole.of_plant == "mass"


def test_more_remarks_than_a_chunk_keeps_share_the_last_one():
    texts, numbers = numbered(["", *(f"{i}" for i in range(2 * SLOTS)), "0"])
    assert texts == [*(f"{i}" for i in range(SLOTS - 1)), MORE]
    assert numbers == [*range(SLOTS), *[SLOTS] * (SLOTS + 1), 1]
    assert numbered(["b", "", "a", "b"]) == (["b", "a"], [1, 0, 2, 1])
