"""The first sweep of a kind of scene: Python runs the first scenes, and the bits are those of compiled ones."""

from dataclasses import replace

import numpy as np
import pytest

from canhaptic.lab.studies.chunk import ENGINES, ChunkResult, run_chunk
from canhaptic.lab.studies.runner import Count
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
@pytest.mark.parametrize("worth", [0.0, float("inf")])
def test_python_runs_the_first_scenes_and_all_where_compiling_takes_longer(demo, first_use, monkeypatch, worth):
    monkeypatch.setattr(first_use, "_COMPILING", worth)
    asked, shown = asked_of(demo), []
    columns, scenes = asked.points.columns(0, len(asked.points)), len(asked.points)
    found = first_use.run_first(Count(scenes, 0, shown.append), asked.recipe, 0, columns)
    expected = run_chunk(replace(asked.recipe, engine="python"), 0, columns)
    for name, values in expected.figures.items():
        assert found.figures[name].tobytes() == values.tobytes()
    python, numba = ENGINES.index("python"), ENGINES.index("numba")
    rest = numba if worth == 0.0 else python
    assert found.engine.tolist() == [python] * 2 + [rest] * (scenes - 2)
    assert [(one.done, one.compiles) for one in shown] == [(0, False), (2, True)][: 2 if rest == numba else 1]
    if rest == numba:
        again = first_use.run_first(Count(scenes, 0, shown.append), asked.recipe, 0, columns)
        assert set(again.engine.tolist()) == {numba}


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_chunk_that_the_first_scenes_fill_is_done_by_python(demo, first_use):
    asked = asked_of(demo)
    found = first_use.run_first(Count(2, 0, lambda _: None), asked.recipe, 0, asked.points.columns(0, 2))
    assert found.engine.tolist() == [ENGINES.index("python")] * 2


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
