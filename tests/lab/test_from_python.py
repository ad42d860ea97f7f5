"""The studies as Python calls: each takes the name of a scene, and returns what its command prints."""

import json
from typing import Any

import pytest

import canhaptic
from canhaptic.cli.main import main
from canhaptic.errors import InputError, SceneError


def _printed(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    main([*words, "--json"])
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def test_check_returns_what_the_command_prints(capsys: pytest.CaptureFixture[str]) -> None:
    found, printed = canhaptic.check("demo"), _printed(capsys, "check", "demo")
    assert found["verdict"] == printed["verdict"]
    assert found.keys() == printed.keys()


def test_a_change_reaches_the_check() -> None:
    assert (
        canhaptic.check("demo", {"environment.stiffness": "2 kN/m"})["config"]["axes"]["handle"]["environment"][
            "stiffness"
        ]
        == 2000.0
    )


def test_compare_takes_a_name_and_changes(capsys: pytest.CaptureFixture[str]) -> None:
    found = canhaptic.compare(
        "hard/stiff_wall", ["unprotected", "guarded"], {"environment.damping": 0.0}, duration=0.6, repeats=0
    )
    least = {name: of["least_interaction"] for name, of in found.result["axes"]["handle"]["algorithms"].items()}
    assert least["unprotected"] < -1e-3 < -1e-9 <= least["guarded"]
    printed = _printed(
        capsys,
        "compare",
        "hard/stiff_wall",
        "--set",
        "environment.damping=0",
        "--duration",
        "0.6",
        "--algorithms",
        "unprotected",
    )
    assert printed["axes"]["handle"]["algorithms"]["unprotected"]["least_interaction"] == least["unprotected"]


@pytest.mark.slow
def test_compare_takes_displays() -> None:
    found = canhaptic.compare("admittance/virtual_mass", ["guarded"], duration=0.05)
    assert found.result["axes"]["handle"]["guarded"]["status"] == "completed"


def test_a_sweep_returns_one_value_per_scene_and_keeps_a_file_only_where_asked(tmp_path: Any) -> None:
    vary = {"environment.stiffness": [100.0, 1000.0]}
    found = canhaptic.sweep("demo", vary, duration=0.05, engine="python")
    assert list(found["environment.stiffness"]) == [100.0, 1000.0]
    assert len(found["handle.least_interaction"]) == 2
    kept = canhaptic.sweep("demo", vary, tmp_path / "kept", duration=0.05, engine="python")
    assert list(kept["handle.travel"]) == list(found["handle.travel"])
    with pytest.raises(InputError, match="kept already exists"):
        canhaptic.sweep("demo", vary, tmp_path / "kept", duration=0.05, engine="python")


@pytest.mark.slow
def test_accuracy_and_design_take_a_name() -> None:
    assert canhaptic.accuracy("demo", duration=0.05, budget=0.0)["status"] == "completed"
    assert canhaptic.design("demo", tolerance=0.2)["stiffness"] > 100.0


def test_a_scene_that_does_not_exist_is_named() -> None:
    with pytest.raises(SceneError, match=r"demmo.*did you mean 'demo'"):
        canhaptic.sweep("demmo", {"environment.stiffness": [1.0]})
