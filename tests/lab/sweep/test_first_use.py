"""In the first sweep of a kind of scene Python runs the first scenes, and their figures are those of compiled ones."""

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


PYTHON, NUMBA = ENGINES.index("python"), ENGINES.index("numba")


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("worth", [0.0, float("inf")])
def test_python_runs_the_first_scenes_and_all_where_compiling_takes_longer(demo, first_use, monkeypatch, worth):
    monkeypatch.setattr(first_use, "_COMPILING", worth)
    asked, shown = asked_of(demo), []
    columns, scenes = asked.points.columns(0, len(asked.points)), len(asked.points)
    found = first_use.FirstUse(Count(scenes, 0, shown.append)).run(asked.recipe, 0, columns)
    expected = run_chunk(replace(asked.recipe, engine="python"), 0, columns)
    for name, values in expected.figures.items():
        assert found.figures[name].tobytes() == values.tobytes()
    rest = NUMBA if worth == 0.0 else PYTHON
    assert found.engine.tolist() == [PYTHON] * 2 + [rest] * (scenes - 2)
    assert [(one.done, one.compiles) for one in shown[:3]] == [(0, False), (0, False), (2, rest == NUMBA)]
    if rest == NUMBA:
        again = first_use.FirstUse(Count(scenes, 0, shown.append)).run(asked.recipe, 0, columns)
        assert set(again.engine.tolist()) == {NUMBA}


class Chunks:
    """In place of `run_chunk` and its clock: Python takes a given time for each scene [s], and compiling none."""

    def __init__(self, monkeypatch, seconds):
        from canhaptic.lab.studies import sweep as module

        self.module, self.seconds, self.time, self.engines = module, seconds, 0.0, []
        monkeypatch.setattr(module, "run_chunk", self.run_chunk)
        monkeypatch.setattr(module, "WallClock", lambda: self)
        monkeypatch.setattr(module, "joined", sum)
        monkeypatch.setattr("canhaptic.kernels.compiler.if_kept", self.if_kept)

    def now(self):
        return self.time * 1e9

    def if_kept(self, run, *arguments):
        return run(*arguments) if "numba" in self.engines else None

    def run_chunk(self, recipe, start, columns):
        scenes = len(columns["a"])
        if recipe.engine == "python":
            self.time += sum(self.seconds(start + i) for i in range(scenes))
        self.engines += [recipe.engine] * scenes
        return scenes

    def run(self, recipe, scenes, chunk):
        count = Count(scenes, 0, lambda _: None)
        first = self.module.FirstUse(count)
        for start in range(0, scenes, chunk):
            assert first.run(recipe, start, {"a": np.zeros(chunk)}) == chunk
            count.add(chunk)
        return self.engines.count("python")


@pytest.mark.slow
def test_small_chunks_are_compiled_too(demo, monkeypatch):
    pytest.importorskip("numba")
    chunks = Chunks(monkeypatch, lambda scene: 1.5)
    assert chunks.run(asked_of(demo).recipe, 32, 2) == 2  # 45 s are left: one slice of Python is enough to see it
    assert Chunks(monkeypatch, lambda scene: 0.01).run(asked_of(demo).recipe, 32, 2) == 32


@pytest.mark.slow
def test_scenes_that_end_at_once_do_not_speak_for_the_others(demo, monkeypatch):
    pytest.importorskip("numba")
    for quick, chunk in ((2, 5000), (100, 100)):
        chunks = Chunks(monkeypatch, lambda scene, quick=quick: 1e-6 if scene < quick else 0.02)
        chunks.run(asked_of(demo).recipe, 5000, chunk)  # 98 s in Python
        assert chunks.time < chunks.module._COMPILING + chunks.module._SLICE


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
