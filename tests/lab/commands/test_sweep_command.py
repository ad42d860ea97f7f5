"""`canhaptic sweep`, `canhaptic map`, `canhaptic design` and `tools/sweep.py`."""

import json
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

from canhaptic.cli.main import main
from canhaptic.lab.commands.results import scene_progress
from canhaptic.lab.studies.map import Cells, Chosen, fields_of, panels_of
from canhaptic.lab.studies.runner import Progress
from canhaptic.lab.studies.store import SweepTable

REPOSITORY = Path(__file__).resolve().parents[3]
DEMO = str(REPOSITORY / "configs" / "demo.yaml")
SMALL = ["sweep", DEMO, "--vary", "environment.stiffness=1e2:1e4:log:3", "--cycles", "20"]

Captured = pytest.CaptureFixture[str]


@pytest.mark.slow
def test_json_is_one_object_with_what_computed_each_scene(capsys: Captured, tmp_path: Path) -> None:
    out = tmp_path / "a"
    words = ["--vary", "bus.rate=100,4000", "--controllers", "unprotected,guarded", "--out", str(out), "--json"]
    assert main([*SMALL, *words]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["scenes"] == result["finished"] == 12
    assert result["status"] == {"no contact": 6, "refused": 6}
    assert sum(result["engines"].values()) == 12
    assert set(result["figures"]["handle"]) == {"unprotected", "guarded"}
    assert any("does not fit the bus" in entry["remark"] for entry in result["remarks"])


@pytest.mark.slow
def test_the_table_says_engine_and_reason(capsys: Captured) -> None:
    assert main([*SMALL, "--set", "simulation.effects=[{type: coulomb_friction, static: 0.1 N, kinetic: 0.1 N}]"]) == 0
    shown = capsys.readouterr().out
    assert "computed: 3 one by one" in shown
    assert "3 of 3 scenes" in shown


@pytest.mark.slow
def test_a_scene_without_a_contact_counts_neither_as_passive_nor_as_active(capsys: Captured, tmp_path: Path) -> None:
    words = ["--vary", "environment.position=0.01,-1", "--controllers", "unprotected,guarded"]
    assert main([*SMALL, *words, "--out", str(tmp_path / "a"), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["status"] == {"completed": 3, "no contact": 6, "nothing rendered": 3}  # guarded begins in the wall
    for entry, counts in zip(result["figures"]["handle"].values(), ((3, 3), (0, 3)), strict=True):
        assert (entry["scenes"], entry["no_contact"]) == counts
    assert main(["sweep", "--map", str(tmp_path / "a"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["no_contact"] == {"unprotected": 0.5, "guarded": 0.5}
    with SweepTable(tmp_path / "a") as table:
        field = fields_of(table)[0]
        (panel,) = [one for one in panels_of([field], Chosen(metric="margin"))[0] if isinstance(one, Cells)]
        assert np.array_equal(panel.marked["no contact"], np.isnan(panel.values))
        assert panel.marked["no contact"].mean() == 0.5
    assert main([*SMALL, "--set", "environment.position=-1"]) == 0
    shown = capsys.readouterr().out
    assert "status:    3 no contact" in shown
    assert "100 %" not in shown


@pytest.mark.slow
def test_a_wall_of_which_nothing_is_rendered_is_no_pass_as_a_run_of_the_same_scene_says(
    capsys: Captured, tmp_path: Path
) -> None:
    late = ["--set", "environment.stiffness=1000", "--set", "passivity.current_lag=2 ms"]
    words = ["--controllers", "unprotected,guarded", "--vary", "environment.damping=0,1", "--duration", "1.4", *late]
    assert main(["sweep", DEMO, *words, "--out", str(tmp_path / "a"), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["status"] == {"completed": 2, "nothing rendered": 2}
    assert [entry["scenes"] for entry in result["figures"]["handle"].values()] == [2, 0]
    assert result["figures"]["handle"]["guarded"]["nothing_rendered"] == 2
    assert main(["sweep", "--map", str(tmp_path / "a")]) == 0
    shown = capsys.readouterr().out
    assert " guarded: 0 % of the scenes with a contact pass (judged by: passive; net energy into the plant" in shown
    assert " at the motor, as `run` judges it), 100 % rendered nothing" in shown
    assert main(["compare", DEMO, "--algorithms", "unprotected,guarded", "--duration", "1.4", *late, "--json"]) == 0
    found = {row["algorithm"]: row for row in json.loads(capsys.readouterr().out)["rows"]}
    assert [found[name]["outcome"] for name in ("unprotected", "guarded")] == ["", "nothing rendered"]
    assert found["guarded"]["effort_rendered.share"] < 0.1 < found["unprotected"]["effort_rendered.share"]
    assert found["guarded"]["least_interaction"] >= 0.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--vary", "environment.damping=abc"], "--vary environment.damping=abc: environment.damping: got 'abc'"),
        (["--vary", "environment.stifness=1,2"], "did you mean 'stiffness'"),
        (["--vary", "environment.damping=1:2"], "no number of values"),
        (["--controllers", "best"], "unknown passivity algorithm 'best'"),
        (["--resume"], "name it with --out"),
        (["--out", "/no/such/folder/a"], "/no/such/folder/a"),
        (["--metrics", "beauty"], "unknown metric"),
        pytest.param(["--dask", "nonsense://"], "--dask nonsense://", marks=pytest.mark.slow),  # imports Dask
    ],
)
def test_bad_input_ends_with_2_and_one_clear_error(capsys: Captured, arguments: list[str], message: str) -> None:
    assert main([*SMALL, *arguments]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["--workers", "-1"], ["--duration", "5"]])
def test_bad_options_are_refused_by_the_parser(capsys: Captured, arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as raised:
        main([*SMALL, *arguments])
    assert raised.value.code == 2
    assert f"argument {arguments[0]}: " in capsys.readouterr().err


@pytest.mark.slow
def test_a_map_of_a_sweep(capsys: Captured, tmp_path: Path) -> None:
    out, picture = tmp_path / "a", tmp_path / "map.png"
    words = ["--vary", "bus.rate=100,200", "--controllers", "unprotected", "--set", "environment.damping=0"]
    main([*SMALL, *words, "--out", str(out)])
    capsys.readouterr()
    assert main(["sweep", "--map", str(out), "--png", str(picture)]) == 0
    assert "Colgate" in capsys.readouterr().out
    assert picture.stat().st_size > 10_000
    assert main(["sweep", "--map", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["passing"].keys() == {"unprotected"}
    assert main(["sweep", "--map", DEMO]) == 2
    assert main(["sweep", "--map", str(out), "--png", "map.bmp"]) == 2
    assert main(["sweep", "--map", str(out), "--axis", "elbow"]) == 2


def test_a_design_that_cannot_be_made_says_why(capsys: Captured) -> None:
    assert main(["design", DEMO, "--margin", "-1", "--json"]) == 2
    assert "expected 0 <= margin" in json.loads(capsys.readouterr().out)["faults"][0]


@pytest.mark.parametrize("is_terminal", [True, False])
def test_progress_is_shown_where_somebody_can_see_it(
    capsys: Captured, monkeypatch: pytest.MonkeyPatch, is_terminal: bool
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")  # a terminal to rich
    monkeypatch.setattr(sys.stderr, "isatty", lambda: is_terminal)
    with scene_progress("walls") as show:
        show(Progress(done=3, total=12, begun=0))
    assert ("walls" in (shown := capsys.readouterr().err)) is is_terminal
    assert ("3/12" in shown) is is_terminal


def test_the_tool_is_the_same_command(capsys: Captured, monkeypatch: pytest.MonkeyPatch) -> None:
    tool = str(REPOSITORY / "tools/sweep.py")
    monkeypatch.setattr(sys, "argv", [tool, DEMO, "--vary", "environment.stiffness=-1,1"])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(tool, run_name="__main__")
    assert ended.value.code == 2
    assert "got -1" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.timeout(300)  # compiling, on a busy machine
def test_warm_compiles_what_a_sweep_needs_and_says_what_python_runs(
    capsys: Captured, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pytest.importorskip("numba", reason="needs numba (the extra fast)")
    from canhaptic.kernels.compiler import only_kept
    from canhaptic.lab.batch.compiled_loops import compiled_loops

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    compiled_loops.cache_clear()
    assert main(["sweep", "--warm", DEMO, "--controllers", "unprotected", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["loops"] == {"unprotected": {"engine": "numba", "remark": ""}}
    compiled_loops.cache_clear()
    out = tmp_path / "swept"
    with only_kept():
        words = ["--vary", "environment.stiffness=300:3000:8", "--controllers", "unprotected", "--cycles", "40"]
        assert main(["sweep", DEMO, *words, "--engine", "numba", "--out", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["engines"] == {"numba": 8}
    compiled_loops.cache_clear()


def test_warm_fails_where_python_runs_a_scene(capsys: Captured) -> None:
    pytest.importorskip("numba", reason="needs numba (the extra fast)")
    assert main(["sweep", "--warm", str(REPOSITORY / "configs/admittance/virtual_mass.yaml"), "--json"]) == 1
    assert "not compiled: algorithm of the scene" in capsys.readouterr().out
