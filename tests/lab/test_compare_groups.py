"""`canhaptic compare` on scenes with groups: every group algorithm, judged by what the plant gave."""

import json
from pathlib import Path
from typing import Any

import pytest

from canhaptic.cli.main import main
from canhaptic.lab.studies import flat

CONFIGS = Path(__file__).parents[2] / "configs"


def printed(capsys: pytest.CaptureFixture[str], *words: str) -> Any:
    assert main([*words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.slow
@pytest.mark.parametrize(("scene", "group"), [("xy_box", "stage"), ("two_handles", "coupling")])
def test_the_account_under_the_scenes_own_algorithm_is_that_of_a_run(
    scene: str, group: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(CONFIGS / f"{scene}.yaml"), "--duration", "1"]
    compared = {row["algorithm"]: row for row in printed(capsys, "compare", *words)["rows"]}
    ran = printed(capsys, "run", *words)
    assert list(compared) == ["guarded", "unprotected", "step_scaling"]
    assert compared["guarded"]["passive"] == ran["ports"][group]["passive"]
    for key in ("in", "out", "dissipated", "margin", "margin.time", "surplus.max"):  # a run has those of its stop too
        expected = flat(ran["ports"][group])[key]
        assert compared["guarded"][key] == pytest.approx(expected, rel=0.02, abs=1e-5)
    booked, expected = compared["guarded"]["account.least_interaction"], ran["ports"][group]["least_interaction"]
    assert booked == pytest.approx(expected, rel=0.02, abs=1e-5)
    assert compared["guarded"]["least_interaction"] >= -1e-9  # as promised
    assert compared["step_scaling"]["in"] != compared["guarded"]["in"]


@pytest.mark.slow
def test_the_table_shows_the_algorithm_that_gives_energy(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", str(CONFIGS / "xy_box.yaml"), "--duration", "2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert next(line for line in lines if "by the plant" in line).split()[-3:] == ["yes", "yes", "no"]
    guarded, _, plain, _, scaled, _ = next(line for line in lines if "net energy (plant)" in line).split()[-6:]
    assert (guarded, plain, scaled[0]) == ("0", "0", "-")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--algorithms", "energy_tank"], "unknown group algorithm 'energy_tank'"),
        (["--rate", "100"], "use --set bus.rate"),
        (["--png", "a.png"], "draw this one with canhaptic run --png"),
    ],
)
def test_what_groups_have_not_is_refused_in_words(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["compare", str(CONFIGS / "xy_box.yaml"), *words]) == 2
    assert message in capsys.readouterr().err
