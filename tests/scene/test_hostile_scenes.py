"""Scenes made to do harm: names with markup and control characters, thousands of axes, numbers at the edge."""

from contextlib import suppress
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
import yaml

from canhaptic.cli.main import main
from canhaptic.cycle import run
from canhaptic.errors import CanHapticError, ParameterError, SceneError
from canhaptic.scene.build import build
from canhaptic.scene.hints import stability_hints
from canhaptic.scene.load import load_scene, scene_from_mapping
from canhaptic.sim.drive import SimulatedDriveParameters
from canhaptic.units import Parameters, Quantity
from tests.scene.scene_text import REPOSITORY, SCENE, SHIPPED_EDS, faults, scene_file

CONFIGS = REPOSITORY / "configs"
HOSTILE = ["[/red]x[b]", "a\x1b[31mb", "a\nb", "a/b", "a\0b", "a\u202eb", "a:b", " a", "", "x" * 41]


def refused(values: dict[str, Any]) -> list[str]:
    with pytest.raises(SceneError) as caught:
        scene_from_mapping(values)
    return list(caught.value.faults)


def demo() -> dict[str, Any]:
    values: dict[str, Any] = yaml.safe_load(SCENE)
    values["axes"][0]["eds"] = str(SHIPPED_EDS)
    values["simulation"]["drive"] = {"objects": {0x6502: 0x200}}
    return values


# --- names --------------------------------------------------------------------------------------------------------


@pytest.mark.slow_but("a/b", "a\\x1b*", "")
@pytest.mark.parametrize("name", HOSTILE)
def test_a_name_that_is_more_than_a_name_is_refused_wherever_it_is_given(name: str) -> None:
    values = demo()
    values["axes"][0]["name"] = name
    assert any("axes.0.name: got" in line for line in refused(values))
    several = yaml.safe_load((CONFIGS / "two_buses.yaml").read_text())
    several["bus"][1]["name"] = name
    assert any("bus.1.name: got" in line for line in refused(several))
    grouped = yaml.safe_load((CONFIGS / "two_handles.yaml").read_text())
    grouped["groups"][0]["name"] = name
    assert any("groups.0.name: got" in line for line in refused(grouped))


@pytest.mark.parametrize("name", ["handle", "Griff links", "x-1", "axis_2", "J1 (elbow)", "ось", "1.5+"])
def test_names_in_any_alphabet_are_taken(name: str, tmp_path: Path) -> None:
    [axis] = load_scene(scene_file(tmp_path, ("name: handle", f"name: {name!r}"))).axes
    assert axis.parameters.name == name


@pytest.mark.parametrize("key", ["bus.channel", "bus.interface", "log.energy", "log.bus", "axes.0.eds"])
def test_no_control_character_comes_in_by_a_channel_a_log_or_a_dictionary(key: str, tmp_path: Path) -> None:
    folder = tmp_path / "a\x1b[31mb"
    folder.mkdir()
    (folder / "x.eds").write_bytes(SHIPPED_EDS.read_bytes())
    values = {"axes.0.eds": str(folder / "x.eds")}
    text = yaml.safe_dump(values.get(key, "a\x1b[31mb"), default_flow_style=True, width=10_000).removesuffix("\n...\n")
    lines = faults(tmp_path, overrides=(f"{key}={text}",))
    assert any(f"{key}: got" in line and "without control characters" in line for line in lines), lines
    assert all(line.isprintable() for line in lines)


@pytest.mark.slow
def test_markup_in_what_is_no_name_is_printed_as_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "[/red]x[b]"
    folder.mkdir(parents=True)
    (folder / "x.eds").write_bytes(SHIPPED_EDS.read_bytes())
    path = scene_file(folder, ("cia402_servo.eds", "x.eds"))
    for command in (
        ["check", str(path), "--full"],
        ["run", str(path), "--duration", "0.05"],
        ["check-eds", str(folder / "x.eds")],
    ):
        assert main(command) == 0
        seen = capsys.readouterr()
        assert "Traceback" not in seen.err + seen.out
        assert command[0] == "run" or "[/red]x[b]" in "".join(seen.out.split())  # `run` prints no path


# --- many axes ----------------------------------------------------------------------------------------------------


# --- keys that are numbers ----------------------------------------------------------------------------------------


def test_an_object_by_its_number_is_the_object_of_that_number() -> None:
    values = demo()
    values["simulation"]["drive"] = {"objects": {0x6502: 0x200, 4096: 0x20192}}
    [axis] = scene_from_mapping(values).axes
    assert axis.simulation is not None
    assert axis.simulation.drive.object_values() == {(0x6502, 0): 0x200, (0x1000, 0): 0x20192}


def test_a_key_of_decimal_digits_names_no_object_because_it_may_name_two(tmp_path: Path) -> None:
    [line] = faults(tmp_path, ("  plant:", "  drive: {objects: {4096: 1}}\n  plant:"))
    assert "'4096' may be hexadecimal or decimal; write 0x4096 or 0x1000" in line
    with pytest.raises(ParameterError, match=r"write 0x99999$"):
        SimulatedDriveParameters(counts_per_unit=1.0, absent=("99999",))


def test_cob_ids_are_given_by_the_index_as_it_is_written(tmp_path: Path) -> None:
    path = scene_file(tmp_path)
    [axis] = load_scene(path, ["axes.0.pdo_cob_ids={0x1404: 0x205, 5125: 0x305}"]).axes
    assert axis.parameters.pdo_cob_ids == {0x1404: 0x205, 0x1405: 0x305}
    lines = faults(tmp_path, overrides=("axes.0.pdo_cob_ids={0x1404: x, z: 1}",))
    assert "axes.0.pdo_cob_ids.0x1404: got 'x', expected a valid integer" in lines[0]
    assert "axes.0.pdo_cob_ids.z: got " in lines[1]


# --- numbers at the edge ------------------------------------------------------------------------------------------


EDGES = (1e-320, 1e-30, 1e30, 1e308, -1e308, 10**5000)
FIELDS = [
    ("axes.0.transmission", None),
    ("simulation.drive.rated_torque_resolution", None),
    ("simulation.plant.mass", None),
    ("passivity.device_damping", {"algorithm": "guarded", "moving_mass": 0.2, "hand_force": 0.0}),
    ("passivity.device_damping_bound", {"algorithm": "guarded", "moving_mass": 0.2, "hand_force": 0.0}),
    ("passivity.moving_mass", {"algorithm": "guarded", "hand_force": 0.0}),
    ("passivity.sample_time", {"algorithm": "guarded", "moving_mass": 0.2, "hand_force": 0.0}),
    ("simulation.effects.0.pitch", {"type": "cogging", "amplitude": 0.3}),
    ("simulation.effects.0.pitch", {"type": "torque_ripple", "amplitude": 0.3}),
    ("simulation.effects.0.count", {"type": "encoder_quantisation"}),
    ("simulation.effects.0.damping", {"type": "hard_stop", "position": 0.3, "stiffness": 0.3}),
    (
        "simulation.effects.0.bristle_stiffness",
        {"type": "lugre_friction", "kinetic": 0.3, "static": 0.3, "stribeck_velocity": 0.3},
    ),
]


@pytest.mark.slow_but("passivity.sample_time", "passivity.moving_mass", "axes.0.transmission", "simulation.plant.mass")
@pytest.mark.parametrize(("path", "section"), FIELDS, ids=[path for path, _ in FIELDS])
def test_a_number_at_the_edge_of_floats_runs_or_is_a_fault(path: str, section: dict[str, Any] | None) -> None:
    for value in EDGES:
        values = deepcopy(demo())
        if section is not None and path.startswith("passivity"):
            values["passivity"] = dict(section)
        elif section is not None:
            values["simulation"]["effects"] = [dict(section)]
        owner: Any = values
        for part in path.split(".")[:-1]:
            owner = owner[int(part) if part.isdigit() else part]
        owner[path.rpartition(".")[2]] = value
        with suppress(CanHapticError):  # what is wrong is said; anything else ends the test
            scene = scene_from_mapping(values)
            stability_hints(scene.axes[0])
            with build(scene) as experiment:
                run(experiment.cycle, 5)


def test_what_is_beyond_every_quantity_is_refused_by_every_model() -> None:
    for model in _models(Parameters):
        for name, field in model.model_fields.items():
            unit = next((item for item in field.metadata if isinstance(item, Quantity)), None)
            for value in (1e-320, 1e308, 10**5000) if unit is not None else ():
                with pytest.raises(ParameterError, match=rf"{name}: got "):
                    model.validated({name: value})


def _models(base: type[Parameters]) -> list[type[Parameters]]:
    below = [model for each in base.__subclasses__() for model in (each, *_models(each))]
    return [model for model in below if model.__module__.startswith("canhaptic.")]
