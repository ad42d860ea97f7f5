"""The studies as Python calls: each takes the name of a scene, and returns what its command prints."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import canhaptic
from canhaptic.cli.main import main
from canhaptic.errors import InputError, SceneError
from canhaptic.files import shipped
from canhaptic.lab.studies.vary import listed
from canhaptic.scene.load import load_scene


def _printed(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    main([*words, "--json"])
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


@pytest.mark.slow
def test_check_returns_what_the_command_prints(capsys: pytest.CaptureFixture[str]) -> None:
    found, printed = canhaptic.check("demo"), _printed(capsys, "check", "demo")
    assert found["verdict"] == printed["verdict"]
    assert found.keys() == printed.keys()


@pytest.mark.slow
def test_a_change_reaches_the_check() -> None:
    assert (
        canhaptic.check("demo", {"environment.stiffness": "2 kN/m"})["config"]["axes"]["handle"]["environment"][
            "stiffness"
        ]
        == 2000.0
    )


@pytest.mark.slow
def test_compare_takes_a_name_and_changes(capsys: pytest.CaptureFixture[str]) -> None:
    found = canhaptic.compare(
        "hard/stiff_wall", ["unprotected", "guarded"], {"environment.damping": 0.0}, duration=0.6, repeats=0
    )
    least = {row["algorithm"]: row["least_interaction"] for row in found.result["rows"]}
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
    assert printed["rows"][0]["least_interaction"] == least["unprotected"]


@pytest.mark.slow
def test_compare_takes_changes_in_second_place_as_the_other_studies_do() -> None:
    changes, options = {"environment.stiffness": 300.0}, {"duration": 0.3, "repeats": 0}
    found = canhaptic.compare("demo", changes, **options)  # type: ignore[arg-type]
    by_name = canhaptic.compare("demo", ["guarded"], changes, **options)  # type: ignore[arg-type]
    of, [of_names] = ([row for row in one.result["rows"] if row["algorithm"] == "guarded"] for one in (found, by_name))
    assert of == [of_names]
    assert repr(found) == "<Comparison of handle: figures in `result`, runs of single axes in `runs`>"


@pytest.mark.slow
def test_compare_takes_displays() -> None:
    found = canhaptic.compare("admittance/virtual_mass", ["guarded"], duration=0.05)
    assert [row["status"] for row in found.result["rows"]] == ["completed"]


@pytest.mark.slow
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


def test_a_study_of_one_side_of_a_coupling_is_refused_by_name() -> None:
    scene = load_scene(shipped("configs") / "far_wall.yaml")
    for study in (
        lambda: canhaptic.compare(scene),
        lambda: canhaptic.sweep(scene, {"bus.rate": [500.0, 1000.0]}),
        lambda: canhaptic.design(scene),
        lambda: canhaptic.accuracy(scene),
    ):
        with pytest.raises(InputError, match=r"axis handle is coupled with a far side .* canhaptic run runs both"):
            study()


def test_a_scene_that_does_not_exist_is_named() -> None:
    with pytest.raises(SceneError, match=r"demmo.*did you mean 'demo'"):
        canhaptic.sweep("demmo", {"environment.stiffness": [1.0]})


def test_python_takes_the_texts_of_the_command_line() -> None:
    """A text of three digits was three values, and the name of an algorithm was its letters."""
    table = canhaptic.sweep("demo", {"environment.stiffness": "100"}, cycles="5", engine="python", metrics="margin")
    assert list(table["environment.stiffness"]) == [100.0]
    found = canhaptic.compare("demo", "guarded,unprotected", duration="10 ms", repeats=0)
    assert [row["algorithm"] for row in found.result["rows"]] == ["guarded", "unprotected"]


@pytest.mark.parametrize(
    "values",
    ["100 N/m,200 N/m", ["100 N/m", "0.2 kN/m"], (100, 200.0), np.array([100, 200]), "100:200:2", range(100, 201, 100)],
)
def test_values_in_every_form_are_the_same_numbers(values: object) -> None:
    assert listed("environment.stiffness", values).values == (100.0, 200.0)


@pytest.mark.parametrize("values", [[], None, {"a": 1}, [None], [[1]], float("nan"), True, ["1", ""]])
def test_a_wrong_form_is_an_error(values: object) -> None:
    with pytest.raises(InputError, match=r"environment\.stiffness"):
        listed("environment.stiffness", values)


def test_an_unknown_option_of_a_sweep_and_a_wrong_text_are_errors() -> None:
    with pytest.raises(InputError, match="sweep: got sample, expected"):
        canhaptic.sweep("demo", "environment.stiffness=1,2", sample=3)
    with pytest.raises(InputError, match="duration: got '10 N'"):
        canhaptic.compare("demo", "guarded", duration="10 N")


def test_a_missing_log_is_a_missing_file(tmp_path: Path) -> None:
    for read in (canhaptic.EnergyLog, lambda path: canhaptic.replay_bus_log(path, canhaptic.load_scene("demo"))):
        with pytest.raises(FileNotFoundError, match="no such file") as caught:
            read(tmp_path / "none.log")
        assert isinstance(caught.value, InputError)


@pytest.mark.slow
def test_an_account_has_its_ports_as_attributes_and_the_package_its_version() -> None:
    account = canhaptic.simulate("demo", duration="3 ms", progress=False).account
    assert account.handle is account["handle"]
    assert "handle" in dir(account)
    assert not hasattr(account, "elbow")
    assert canhaptic.__version__.count(".") >= 2


@pytest.mark.slow
def test_every_public_object_shows_what_it_is() -> None:
    run = canhaptic.simulate("demo", duration="3 ms", progress=False)
    with run.log() as log, canhaptic.build(run.scene) as experiment:
        for shown in (
            run,
            run.account,
            run.account.handle,
            run.scene,
            log,
            experiment,
            experiment.rig,
            experiment.cycle,
        ):
            assert " object at 0x" not in repr(shown)
            assert 20 < len(repr(shown)) < 120, len(repr(shown))
