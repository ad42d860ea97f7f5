"""`canhaptic compare` and `tools/compare_passivity.py`."""

import json
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

from canhaptic import compare, simulate
from canhaptic.cli.main import main
from canhaptic.lab.figures.figures import ALL, metrics_of
from canhaptic.lab.render.comparison import figure_line
from canhaptic.quantities import QuantityRow

REPOSITORY = Path(__file__).resolve().parents[2]
FIGURE = str(REPOSITORY / "configs" / "paper_fig5_100hz.yaml")


@pytest.mark.slow
def test_the_table_shows_that_the_original_fails_in_fig_5(capsys):
    assert main(["compare", FIGURE, "--algorithms", "a_priori_dissipation,internal_dissipation"]) == 0
    shown = capsys.readouterr().out
    [line] = [line for line in shown.splitlines() if "force ripple" in line]
    original, paper = (float(word) for word in line.split()[-2:])
    assert original > 30.0
    assert paper < 1.5
    assert len(shown.splitlines()) <= 40
    [verdict] = [line.split() for line in shown.splitlines() if line.startswith(" passive, by the plant")]
    assert verdict[-2:] == ["no", "yes"]
    assert "ranking: 1 internal_dissipation, 2 a_priori_dissipation" in shown


@pytest.mark.slow
def test_json_is_one_object_and_the_picture_is_written(capsys, tmp_path):
    picture = tmp_path / "picture.png"
    arguments = ["--duration", "1.3 s", "--algorithms", "unprotected", "--set", "environment.stiffness=200", "--json"]
    assert main(["compare", FIGURE, *arguments, "--png", str(picture), "--rate", "200 Hz"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["rate"], result["cycles"], result["path"]) == (200.0, 260, "direct")
    assert picture.stat().st_size > 10_000


@pytest.mark.slow
def test_over_can_from_the_command_line(capsys):
    assert main(["compare", FIGURE, "--duration", "1.2 s", "--algorithms", "unprotected", "--can", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["path"] == "can"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--algorithms", "best"], "unknown passivity algorithm 'best'"),
        (["--can", "--rate", "50"], "without a bus"),
        (["--png", "/no/such/folder/a.png"], "no such folder"),
        (["--png", "picture.bmp"], "expected a name that ends in"),
    ],
)
def test_bad_arguments_end_with_2_before_anything_runs(capsys, arguments, message):
    assert main(["compare", FIGURE, *arguments]) == 2
    assert message in capsys.readouterr().err


def test_the_tool_is_the_same_command(capsys, monkeypatch):
    tool = str(REPOSITORY / "tools/compare_passivity.py")
    monkeypatch.setattr(sys, "argv", [tool, FIGURE, "--algorithms", "nothing"])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(tool, run_name="__main__")
    assert ended.value.code == 2
    assert "unknown passivity algorithm" in capsys.readouterr().err


def test_a_figure_that_says_which_value_is_better_is_a_row_of_the_table_and_needs_no_other_file():
    line = figure_line("interaction", QuantityRow("J", "energy left", better="not negative"))
    assert (line.label, line.key, line.is_bounded) == ("energy left", "interaction", True)
    assert line.kind == "J"
    part = figure_line("error.rms", QuantityRow("m", "error", better="less"))
    assert (part.better, part.key, part.kind) == (abs, "error.rms", "m")
    labels = [figure_line(name, figure.row).label for name, figure in ALL.items() if figure.row.better]
    assert len(set(labels)) == len(labels) >= 10


@pytest.mark.slow
def test_of_detents_a_comparison_shows_the_share_of_the_run_and_a_force_against_them_is_no_share() -> None:
    rows = compare("rotary_knob", duration=1.0).result["rows"]
    [port] = simulate("rotary_knob", duration=1.0).account.raw["ports"].values()
    shares = {row["algorithm"]: row["stiffness_rendered.share"] for row in rows}
    assert shares["guarded"] == pytest.approx(port["rendered"]["stiffness"], abs=2e-3)
    assert all(0.0 <= share <= 1.01 for share in shares.values())
    sums = {"rendered": np.array([-1.0, 1.0, 0.0]), "asked": np.array([2.0, 2.0, 0.0])}
    [found] = metrics_of(["stiffness_rendered.share"], sums).values()
    assert found.tolist() == pytest.approx([0.0, 0.5, float("nan")], nan_ok=True)
