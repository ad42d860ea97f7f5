"""Bad values as a new user writes them: one fault each, with its place, what was seen and what is expected."""

from pathlib import Path

import numpy as np
import pytest

from canhaptic import simulate
from canhaptic.cli.main import main
from canhaptic.errors import InputError, SceneError
from canhaptic.scene.load import load_scene, scene_from_text
from canhaptic.scene.models import guesses_left
from tests.scene.scene_text import REPOSITORY

CONFIGS = REPOSITORY / "configs"
BOX, ARM, MASS = "xy_box.yaml", "five_bar_sphere.yaml", "admittance/virtual_mass.yaml"
DEMO = CONFIGS / "demo.yaml"


def fault(config: str, override: str) -> str:
    """Returns the only fault of a shipped scene with one override, without its place in the file."""
    with pytest.raises(SceneError) as caught:
        load_scene(CONFIGS / config, [override])
    [line] = caught.value.faults
    return line.partition(": ")[2] if not line.startswith("--set") else line.removeprefix(f"--set {override}: ")


@pytest.mark.parametrize(
    ("config", "override", "expected"),
    [
        # shapes and mechanisms: finite, in the unit of task space
        (BOX, "groups.0.network.lower=[.nan, 0]", "groups.0.network.lower.0: got nan, expected a finite number for"),
        (BOX, "groups.0.network.lower=[1 N, 0]", "groups.0.network.lower.0: got '1 N', unit 'N' does not fit; exp"),
        (BOX, "groups.0.network.lower=1", "groups.0.network.lower: got 1, expected a list of numbers [m]"),
        (BOX, "groups.0.network.upper=[1e308, 1]", "groups.0.network.upper.0: got 1e+308, expected 0 or a magnitude"),
        (ARM, "groups.0.kinematics.workspace_upper=[.inf, 1]", "groups.0.kinematics.workspace_upper.0: got inf, expe"),
        # a choice inside a network
        (BOX, "groups.0.network={type: general, storages: [{type: sprong}], gain: [[1]]}",
         "groups.0.network.storages.0.type: got 'sprong', expected one of: spring, double_well, mass, quadratic_form"),
        # one value, several types
        ("demo.yaml", "axes.0.energy_loss_limit=lots",
         "axes.0.energy_loss_limit: got 'lots', not a number with an optional unit; expected [J] or 'none'"),
        ("demo.yaml", "axes.0.energy_loss_limit={a: 1}", "axes.0.energy_loss_limit: got a mapping, expected 0 < ener"),
        # one fault, and nothing that only follows from it
        ("demo.yaml", "axes.0.counts_per_unit=0", "axes.0.counts_per_unit: got 0, expected 0 < counts_per_unit [coun"),
        ("demo.yaml", "axes.0.transmission=-2", "axes.0.transmission: got -2, expected 1e-6 <= transmission <= 1e6 [1"),
        ("demo.yaml", "axes.0.quirks=[slow]", "axes.0.quirks: got 'slow', expected any of: abort_disable_voltage"),
        (ARM, "groups.0.axes=[left, rigt]", "groups.0.axes.1: got 'rigt', expected the name of an axis: left, right;"),
        (MASS, "axes.0.admittance.mode=torque", "axes.0.admittance.mode: got 'torque', expected 'velocity' or 'posit"),
        # other words than those of pydantic
        ("demo.yaml", "axes.0.watchdog=maybe", "axes.0.watchdog: got 'maybe', expected true or false"),
        ("demo.yaml", "log.energy=5", "log.energy: got 5, expected a valid path"),
        ("demo.yaml", "bus.realtime.cpus=[1e20]", "bus.realtime.cpus.0: got 1e+20, expected 0 <= cpus <= 4095"),
    ],
)  # fmt: skip
def test_a_bad_value_is_one_fault_at_its_place(config: str, override: str, expected: str) -> None:
    assert fault(config, override).startswith(expected)


def test_a_unit_may_be_written_as_in_a_data_sheet() -> None:
    scene = load_scene(DEMO, ["environment.position=-50 mm", "environment.damping=5 N·s/m", "bus.spin_margin=50 µs"])
    assert scene.bus.spin_margin == pytest.approx(50e-6)
    assert getattr(scene.axes[0].environment.parameters, "damping", None) == 5.0


def test_a_transmission_that_is_a_text_scales_the_simulated_drive_too() -> None:
    one, other = (load_scene(DEMO, [f"axes.0.transmission={ratio}"]).axes[0] for ratio in ("2", "'2'"))
    assert one.simulation == other.simulation


def test_a_mark_behind_a_value_with_a_hash_is_a_guess_all_the_same() -> None:
    text = DEMO.read_text().replace("bus:\n", "bus:\n  channel: 'a #1'  # TO SET: its name\n# TO SET: nothing\n", 1)
    [guess] = guesses_left(scene_from_text(text, str(DEMO)))
    assert guess[1:] == ("channel", "'a #1'", "its name")


def test_an_object_that_the_dictionary_lacks_is_named_with_its_scene_and_drive(capsys) -> None:
    assert main(["check", str(DEMO), "--set", "simulation.drive.objects={0x7777: 1}"]) == 2
    assert "demo.yaml: simulation.drive of handle: objects.0x7777.0: got 1, but" in capsys.readouterr().err


@pytest.mark.parametrize("duration", [float("nan"), -1.0, 1e7, "10 m"])
def test_a_duration_that_is_none_simulates_nothing(duration: float | str) -> None:
    with pytest.raises(InputError, match=r"duration: got .*expected .*\[s\]"):
        simulate(DEMO, duration=duration)


def test_changes_take_what_numpy_and_paths_are_and_refuse_what_no_scene_can_have(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"^--set x=1: x: unknown key[^\n]*$"):  # the only fault
        simulate(DEMO, {"environment.stiffness": np.int64(500), "log.bus": tmp_path / "run.log", "x": 1})
    with pytest.raises(InputError, match=r"changes: duration: got \{1\}, expected a number, a text"):
        simulate(DEMO, {"duration": {1}})


def test_a_name_that_no_file_can_have_is_an_error_and_no_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["new", str(REPOSITORY / "eds" / "cia402_servo.eds"), "--out", "x" * 300], ["inspect", "x" * 300]):
        assert main(words) == 2
        assert capsys.readouterr().err.startswith("canhaptic: error: xxx")


@pytest.mark.parametrize(
    "words",
    [
        ["inspect", "--frames", "x.log", "--from", "nan"],
        ["scope", "run.h5", "--port", "80000"],
        ["sweep", "x.yaml", "--workers", "0"],
        ["sweep", "x.yaml", "--chunk", "0"],
    ],
)
def test_an_option_out_of_range_says_what_is_expected(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(words)
    assert "expected " in capsys.readouterr().err
