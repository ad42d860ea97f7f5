"""Drive profiles: laid under an axis, each brought up whole with its twin, and on every vendor dictionary."""

import json
from pathlib import Path
from typing import Any

import pytest

from canhaptic.cli.main import main
from canhaptic.cycle import run
from canhaptic.drive.profile.quirks import _QUIRKS
from canhaptic.errors import SceneError
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import Scene
from canhaptic.scene.profiles import _PROFILES, _profile_names, profile_of_vendor, profile_values
from tests.scene.scene_text import REPOSITORY, faults, scene_file

DEMO = REPOSITORY / "configs" / "demo.yaml"
AXIS = "    unit: m\n    counts_per_unit"
VENDOR_FILES = {
    "elmo_gold.dcf": "elmo_gold",
    "kollmorgen_rgm.eds": "kollmorgen_rgm",
    "maxon_epos4.dcf": "epos4",
    "zeroerr_erob.eds": "zeroerr_erob",
}


def with_drive(folder: Path, drive: str, *lines: str) -> Scene:
    text = "".join(f"    {line}\n" for line in (f"drive: {drive}", *lines))
    return load_scene(scene_file(folder, (AXIS, f"{text}{AXIS}")))


def test_there_is_a_profile_for_every_drive_of_the_list() -> None:
    names = "copley elmo_gold epos4 generic ingenia_everest kollmorgen_rgm nanotec_cl4e zeroerr_erob"
    assert _profile_names() == names.split()


@pytest.mark.parametrize("name", _profile_names())
def test_every_profile_states_what_is_verified_and_what_is_not(name: str) -> None:
    text = (_PROFILES / f"{name}.yaml").read_text(encoding="utf-8")
    comments = [line for line in text.splitlines() if line.startswith("#")]
    for words in ("# verified against a dictionary", "# verified against a manual", "# not verified:"):
        assert sum(line.startswith(words) for line in comments) == 1, words
    assert set(profile_values(name)["quirks"]) <= set(_QUIRKS)


@pytest.mark.slow_but("generic")
@pytest.mark.parametrize("name", _profile_names())
def test_every_profile_runs_whole_with_its_twin_on_our_dictionary(name: str) -> None:
    """The twin shows the vendor ID of the profile, as the real drive does; ours has none."""
    vendor_id = profile_values(name).get("vendor_id", 0)
    objects = f"simulation.drive.objects={{0x6502: 0x200, 0x1018.1: {vendor_id}}}"
    scene = load_scene(DEMO, [f"axes.0.drive={name}", "environment.side=above", objects])
    with build(scene) as experiment:
        run(experiment.cycle, cycles=600)
        assert experiment.far_side is not None
        [ledger] = experiment.cycle.ledgers
        assert ledger.summary().energy_in > 1e-3


@pytest.mark.parametrize(("file", "name"), VENDOR_FILES.items())
def test_every_vendor_drive_runs_whole_with_its_profile(file: str, name: str, vendor_eds: Path, capsys) -> None:
    words = [f"axes.0.eds={vendor_eds / file}", f"axes.0.drive={name}", "environment.side=above"]
    overrides = [word for entry in words for word in ("--set", entry)]
    assert main(["run", str(DEMO), "--duration", "0.5", "--json", *overrides]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["ports"]["handle"]["in"] > 1e-3
    assert result["truth"]["handle"]["accounted_error"] < 1e-3 * result["ports"]["handle"]["in"]


@pytest.mark.parametrize(("file", "name"), VENDOR_FILES.items())
def test_the_make_of_a_dictionary_finds_its_profile(file: str, name: str, vendor_eds: Path, capsys) -> None:
    assert main(["check-eds", str(vendor_eds / file), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["profile"] == name
    assert main(["new", str(vendor_eds / file)]) == 0
    assert f"\n    drive: {name} " in capsys.readouterr().out


def test_a_make_that_nobody_knows_has_no_profile() -> None:
    assert profile_of_vendor(0x000000FB) == "epos4"
    assert profile_of_vendor(0x12345678) is None
    assert profile_of_vendor(None) is None


def test_the_rated_torque_of_an_epos4_is_read_in_micro_newton_metres(tmp_path: Path) -> None:
    scene = with_drive(tmp_path, "epos4", "transmission: 20")
    assert scene.axes[0].parameters.quirks == ("rated_torque_micro",)
    assert scene.axes[0].simulation is not None
    assert scene.axes[0].simulation.drive.rated_torque_resolution == pytest.approx(20e-6)


# --- laid under an axis -------------------------------------------------------------------------------------------


def test_the_keys_of_the_axis_win(tmp_path: Path) -> None:
    parameters = with_drive(tmp_path, "epos4", "vendor_id: 7", "quirks: []").axes[0].parameters
    assert (parameters.vendor_id, parameters.quirks, parameters.read_back) == (7, (), "actual")


def test_an_axis_without_a_profile_has_no_deviation(tmp_path: Path) -> None:
    parameters = load_scene(scene_file(tmp_path)).axes[0].parameters
    assert (parameters.vendor_id, parameters.quirks, parameters.read_back) == (None, (), "auto")


def test_a_profile_of_ones_own_lies_beside_the_scene(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("quirks: [slow_enable]\nspeed_limit: 3 m/s\n")
    parameters = with_drive(tmp_path, "mine.yaml").axes[0].parameters
    assert (parameters.quirks, parameters.speed_limit) == (("slow_enable",), 3.0)


@pytest.mark.parametrize(
    ("drive", "expected"),
    [
        ("epos5", "axes.0.drive: got 'epos5', expected one of: copley, elmo_gold, epos4"),
        ("nowhere.yaml", "axes.0.drive: got 'nowhere.yaml', expected one of"),
        (f"{'x' * 5000}.yaml", "axes.0.drive: got 'xxx"),  # longer than a path may be
        ('"a\\0.yaml"', "axes.0.drive: got 'a\\x00.yaml', expected one of"),
        ("[epos4]", "axes.0.drive: got a list, expected one of: copley"),
        ("../configs/demo", "axes.0.drive: got '../configs/demo', expected one of"),
    ],
)
def test_a_profile_that_is_not_there_is_a_fault_of_the_axis(tmp_path: Path, drive: str, expected: str) -> None:
    [fault] = faults(tmp_path, (AXIS, f"    drive: {drive}\n{AXIS}"))
    assert fault.startswith(f"scene.yaml:7:12: {expected}")


@pytest.mark.parametrize(
    ("profile", "expected"),
    [
        ("quirks: []\nnode_id: 3\n", "mine.yaml:2:1: node_id: unknown key"),
        ("torque_limit: 3 N\n", "mine.yaml:1:1: torque_limit: unknown key"),
        ("quirks: [slow_enabel]\n", "quirks: got 'slow_enabel', expected any of"),
        ("read_back: [", "mine.yaml:1:13: not valid YAML"),
        ("- quirks\n", "mine.yaml:1:1: got a list, expected a mapping"),
        ("sdo_timeout: 3 kg\n", "mine.yaml:1:14: sdo_timeout: got '3 kg'"),
    ],
)
def test_a_fault_in_a_profile_is_shown_with_its_file_and_line(tmp_path: Path, profile: str, expected: str) -> None:
    (tmp_path / "mine.yaml").write_text(profile)
    seen = faults(tmp_path, (AXIS, f"    drive: mine.yaml\n{AXIS}"))
    assert any(expected in fault for fault in seen), seen


def test_a_profile_asked_for_by_name_must_be_one() -> None:
    with pytest.raises(SceneError, match="no such drive profile"):
        profile_values("epos5")


# --- the twin -------------------------------------------------------------------------------------------------------


def simulated(folder: Path, *lines: str, simulation: str = "") -> Any:
    own = "".join(f"    {line}\n" for line in lines)
    pieces = [(AXIS, f"{own}{AXIS}")]
    if simulation:
        pieces.append(("simulation:\n", f"simulation:\n  drive: {simulation}\n"))
    scene = load_scene(scene_file(folder, *pieces), ["bus.rpdo=synchronous"])
    assert scene.axes[0].simulation is not None
    return scene.axes[0].simulation.drive


def test_the_simulated_drive_takes_over_what_its_axis_says_of_the_real_one(tmp_path: Path) -> None:
    drive = simulated(
        tmp_path,
        "quirks: [demand_absent, max_torque_absent, slow_enable]",
        "demand_reported: after",
        "direction: -1",
        "transmission: 5",
    )
    assert set(drive.absent) == {"0x6074", "0x6072"}
    assert (drive.enable_delay, drive.torque_read_back, drive.direction) == (3.0, "after_update", -1)
    assert drive.rated_torque_resolution == pytest.approx(5e-3)


def test_what_the_simulation_says_itself_wins(tmp_path: Path) -> None:
    drive = simulated(
        tmp_path,
        "quirks: [slow_enable]",
        "direction: -1",
        simulation="{enable_delay: 0.1, direction: 1, rated_torque_resolution: 1e-2}",
    )
    assert (drive.enable_delay, drive.direction, drive.rated_torque_resolution) == (0.1, 1, 1e-2)


@pytest.mark.slow_but("after")
@pytest.mark.parametrize("read_back", ["before", "after"])
def test_a_drive_mounted_the_other_way_round_renders_the_same_wall(read_back: str) -> None:
    accounts = []
    for direction in (1, -1):
        overrides = [f"axes.0.direction={direction}", f"axes.0.demand_reported={read_back}", "environment.side=above"]
        with build(load_scene(DEMO, overrides)) as experiment:
            run(experiment.cycle, cycles=500)
            accounts.append(experiment.cycle.ledgers[0].summary().energy_in)
            assert experiment.cycle.judge is not None
            assert experiment.cycle.judge.believed_error[0] < 1e-3 * accounts[-1]
    assert accounts[0] > 1e-3
    assert accounts[1] == pytest.approx(accounts[0], rel=1e-6)
