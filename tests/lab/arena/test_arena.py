"""`canhaptic arena`: a subset runs, goes on where it was, takes an own entry by file, and gives one page."""

import json
from pathlib import Path
from typing import Any

import pytest

from canhaptic.cli.main import main
from canhaptic.lab.studies.arena import (
    COLUMNS,
    ArenaPlan,
    ArenaStore,
    figures_of_part,
    given_out,
    ranking,
    ranks,
    run_arena,
    scenes_named,
)
from canhaptic.lab.studies.runner import Progress
from canhaptic.quantities import STANDING
from tools.bench.arena import result_rows

SUBSET = [
    "--scenes",
    "slot",
    "--rates",
    "100",
    "--delays",
    "0,1",
    "--duration",
    "0.4",
    "--walls",
    "0",
    "--workers",
    "1",
]
OWN = """
from pathlib import Path

from canhaptic.control.passivity.unprotected import Unprotected

Path(__file__).with_name("ran").write_text("")


class Mine(Unprotected):
    pass
"""


def arena(out: Path, *more: str) -> int:
    return main(["arena", *SUBSET, "--out", str(out), *more])


def result(out: Path) -> dict:
    return json.loads((out / "arena.json").read_text())


@pytest.mark.slow
def test_a_subset_gives_one_page_with_every_case(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert arena(tmp_path, "--algorithms", "unprotected,guarded") == 0
    assert "guarded" in capsys.readouterr().out
    found = result(tmp_path)
    assert [(c["delay"], c["algorithm"]) for c in found["cases"]] == [
        (delay, name) for delay in (0, 1) for name in ("unprotected", "guarded")
    ]
    by_name = {row["algorithm"]: row for row in found["standings"]}
    assert by_name["unprotected"]["given_out"] > by_name["guarded"]["given_out"] == 0.0
    assert found["ranks"]["guarded"]["given_out"] == 1
    page = (tmp_path / "arena.html").read_text()
    assert page.count("<svg ") == 1
    assert page.count('<tr><td class="key">slot</td>') == 4
    assert '<td class="key bold">guarded</td>' in page
    assert "addEventListener" in page
    assert 'src="http' not in page


@pytest.mark.slow
def test_an_arena_goes_on_where_it_was_stopped(tmp_path: Path) -> None:
    plan = ArenaPlan(tuple(scenes_named(["slot", "tapping"])), ("unprotected",), (100.0,), (0, 1), 0.3, per_decade=0)
    path, asked = tmp_path / "cases", []

    def stop() -> bool:
        asked.append(1)
        return len(asked) > 1

    def run(**options: Any) -> dict | None:
        arena = ArenaStore(path)
        with arena:
            return run_arena(plan, arena, **options)

    assert run(stop_requested=stop) is None
    first, *others = sorted(path.glob("*[0-9a-f].json"))
    assert 0 < len(others) < 4
    for other in others:
        other.unlink()
    begun: list[Progress] = []
    whole = run(progress=begun.append)
    assert whole is not None
    assert begun[0].begun == 1
    assert begun[-1].done == begun[-1].total == len(whole["cases"]) == 4
    again: list[Progress] = []
    assert run(progress=again.append) == whole
    assert again[0].done == again[0].total
    assert first.exists()
    assert ArenaStore(path, force=True).finished(plan.parts()[0]) == []


@pytest.mark.slow
def test_an_own_entry_runs_where_it_is_allowed_and_counts_as_what_it_is(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(OWN)
    words = ["--algorithms", "unprotected", "--entry", f"{tmp_path / 'mine.py'}:Mine"]
    assert arena(tmp_path / "out", *words) == 2
    assert not (tmp_path / "ran").exists()
    assert arena(tmp_path / "out", *words, "--allow-code") == 0
    known, mine = result(tmp_path / "out")["standings"]
    assert mine.pop("algorithm") == "mine.py:Mine"
    assert known.pop("algorithm") == "unprotected"
    assert mine == known
    (tmp_path / "mine.py").write_text(OWN.replace("pass", "x = 1"))  # another file: its cases run again
    store = ArenaStore(tmp_path / "out" / "cases")
    group = ArenaPlan(tuple(scenes_named(["slot"])), ("unprotected", words[-1]), (100.0,), (0, 1), 0.4, allow_code=True)
    assert {case["algorithm"] for case in store.finished(group)} == {"unprotected"}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--scenes", "nowhere"], "nor one of: beyond_colgate"),
        (["--scenes", "configs/two_handles.yaml"], "is no torque axis by itself"),
        (["--algorithms", "gaurded"], "gaurded"),
        (["--entry", "nowhere.py:Mine", "--allow-code"], "nowhere.py"),
        (["--delays", "2"], "expected 0"),
    ],
)
def test_what_cannot_be_used_is_refused_before_anything_runs(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        status = arena(tmp_path, *words)
    except SystemExit as end:
        status = int(end.code or 0)
    assert status == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "arena.json").exists()


def test_cases_that_are_known_are_left_out() -> None:
    names = ("energy_bounding", "guarded", "unprotected")
    group = ArenaPlan(tuple(scenes_named(["slot"])), names, (100.0,), (0,), 0.1)
    assert [found["algorithm"] for found in figures_of_part(group, [(0, "guarded"), (1, "unprotected")])] == [
        "energy_bounding",
        "unprotected",
    ]
    assert figures_of_part(group, [(0, name) for name in names]) == []


def case(name: str, scene: str = "a", **figures: float) -> dict:
    zeros = ("energy_given_out", "energy_beyond_device", "position_error", "force_variation")
    assert list(COLUMNS) == list(STANDING)
    whole = {column: 0.0 if column in zeros else None for column in (*COLUMNS, *zeros)}
    return {"scene": scene, "algorithm": name, "status": "completed", **whole, **figures}


def test_a_rank_is_one_more_than_how_many_are_better_and_ties_share_it() -> None:
    cases = [case("x", energy_given_out=1.0), case("y"), case("z"), case("y", "b", energy_beyond_device=2e-3)]
    cases.append({"scene": "b", "algorithm": "z", "status": "refused"})
    rows = ranking(["x", "y", "z"], cases)
    places = ranks(rows)
    assert [places[name]["given_out"] for name in "xyz"] == [3, 1, 1]
    assert [places[name]["beyond_device"] for name in "xyz"] == [1, 3, 1]
    assert "rate_hardness" not in places["x"]  # less is not better
    assert "drag" not in places["x"]  # nothing was measured
    assert given_out(["y", "z"], cases)["y"]["b"] == {"cases": 1.0, "most": 2e-3}
    assert "b" not in given_out(["z"], cases)["z"]
    names = [name for name, _, _ in result_rows({"standings": rows, "ranks": places})]
    assert f"x: {STANDING['given_out'].title}" in names
    assert len(names) == len(set(names))
