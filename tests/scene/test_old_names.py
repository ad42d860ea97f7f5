"""Names of the first release in scenes, overrides, sweeps and logs still work, and say so; logs of each stay valid.

The logs in `old_logs` were recorded by their release: by the first one for each old name, by 0.2 of a scene of an axis.
"""

import json
import lzma
import warnings
from contextlib import suppress
from pathlib import Path

import pytest

from canhaptic.audit.recompute import recompute_all, scene_of
from canhaptic.cli.main import main
from canhaptic.errors import InputError, OldNameWarning, SceneError
from canhaptic.lab.loop.algorithms import chosen_algorithms
from canhaptic.lab.studies.sweep.vary import parse_vary
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.replay.replayed_run import replay_bus_log
from canhaptic.scene.load import load_scene, scene_from_text
from canhaptic.scene.models import Scene
from canhaptic.scene.old_names import OLD_ALGORITHMS, OLD_KEYS
from tests.scene.scene_text import REPOSITORY, faults, scene_file

OLD_LOGS = Path(__file__).parent / "old_logs"
NAMES = ("old_guarded", "old_direct", "old_original")
BETTER_SINCE = {"old_guarded"}
"""Algorithms that send other torques today: their logs open, and what differs is named."""
VALUES = {"lead": 0.25, "credit": 1e-3, "lost_frames": 1}
GUARDED = "passivity: {algorithm: guarded, moving_mass: 0.2, device_damping_bound: 0, hand_push: 0, hand_force: 0"
DEMO = str(REPOSITORY / "configs" / "demo.yaml")


def unpacked(name: str, folder: Path) -> Path:
    path = folder / name
    path.write_bytes(lzma.decompress((OLD_LOGS / f"{name}.xz").read_bytes()))
    return path


def old_scene(name: str) -> Scene:
    with pytest.warns(OldNameWarning):
        return load_scene(OLD_LOGS / f"{name}.yaml")


# --- scenes -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("old", "new"), OLD_KEYS.items())
def test_an_old_key_means_its_new_one_and_the_warning_names_it(tmp_path: Path, old: str, new: str) -> None:
    plain = "passivity: {algorithm: unprotected}"
    path = scene_file(tmp_path, (plain, f"{GUARDED}, {old}: {VALUES[old]}}}"))
    with pytest.warns(OldNameWarning, match=rf"scene.yaml:15:\d+: passivity.{old}: '{old}' is now called '{new}'"):
        scene = load_scene(path)
    assert getattr(scene.axes[0].passivity.parameters, new) == VALUES[old]
    assert scene.resolved()["axes"]["handle"]["passivity"][new] == VALUES[old]
    today = load_scene(scene_file(tmp_path, (plain, f"{GUARDED}, {new}: {VALUES[old]}}}")))
    assert today.config_hash() == scene.config_hash()


@pytest.mark.parametrize(("old", "new"), OLD_ALGORITHMS.items())
def test_an_old_algorithm_means_its_new_one(tmp_path: Path, old: str, new: str) -> None:
    path = scene_file(tmp_path, ("algorithm: unprotected", f"algorithm: {old}"))
    with pytest.warns(OldNameWarning, match=f"algorithm '{old}' is now called '{new}'"):
        assert load_scene(path).axes[0].passivity.name == new


def test_old_keys_of_an_axis_and_of_a_group_mean_their_new_ones(tmp_path: Path) -> None:
    own = "    passivity: {algorithm: guarded, moving_mass: 0.2, hand_force: 0, lost_frames: 2}\nenvironment:\n"
    path = scene_file(tmp_path, ("environment:\n", own))
    with pytest.warns(OldNameWarning, match="axes.0.passivity.lost_frames"):
        assert load_scene(path).axes[0].passivity.parameters.model_dump()["max_consecutive_losses"] == 2
    text = (REPOSITORY / "configs" / "two_handles.yaml").read_text().replace("max_consecutive_losses", "lost_frames")
    with pytest.warns(OldNameWarning, match="groups.0.passivity.lost_frames"):
        [group] = scene_from_text(text, str(REPOSITORY / "configs" / "x.yaml")).groups
    assert group.passivity.parameters.model_dump()["max_consecutive_losses"] == 2


def test_an_old_key_beside_its_new_one_is_one_fault(tmp_path: Path) -> None:
    both = f"{GUARDED}, lead: 0, prediction_holds: 0.5}}"
    assert faults(tmp_path, ("passivity: {algorithm: unprotected}", both)) == [
        "scene.yaml:15:105: passivity.lead: is now called 'prediction_holds', which is given too; leave out 'lead'"
    ]


@pytest.mark.filterwarnings("ignore::canhaptic.errors.OldNameWarning")
def test_a_wrong_value_of_an_old_key_is_a_fault_at_its_place(tmp_path: Path) -> None:
    [fault] = faults(tmp_path, ("passivity: {algorithm: unprotected}", f"{GUARDED}, lead: 2}}"))
    assert fault == "scene.yaml:15:111: passivity.lead: got 2, expected 0 <= prediction_holds <= 1"


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_shipped_scenes_have_no_old_name() -> None:
    loaded = 0
    for path in sorted((REPOSITORY / "configs").rglob("*.yaml")):
        if path.parent.name != "drives":
            with suppress(InputError):  # an interface or library that this machine lacks
                load_scene(path)
                loaded += 1
    assert loaded >= 40


# --- overrides, sweeps, comparisons -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "override",
    ["passivity.lost_frames=3", "passivity={algorithm: guarded, moving_mass: 0.2, hand_force: 0, lost_frames: 3}"],
)
def test_an_override_by_an_old_key_lies_over_the_new_one(override: str) -> None:
    today = "passivity.max_consecutive_losses=1"
    with pytest.warns(OldNameWarning, match="--set passivity.*'lost_frames' is now called 'max_consecutive_losses'"):
        scene = load_scene(DEMO, [today, override])
    assert scene.axes[0].passivity.parameters.model_dump()["max_consecutive_losses"] == 3


def test_a_sweep_takes_old_keys_and_values_as_the_new_ones() -> None:
    with pytest.warns(OldNameWarning, match="--vary passivity.lead=0,1: 'lead' is now called 'prediction_holds'"):
        assert parse_vary("passivity.lead=0,1").key == "passivity.prediction_holds"
    with pytest.warns(OldNameWarning, match="'direct' is now called 'unprotected'"):
        varied = parse_vary("axes.0.passivity.algorithm=direct,guarded")
    assert varied.values == ("unprotected", "guarded")
    assert parse_vary("simulation.lead=0,1").key == "simulation.lead"


def test_a_comparison_takes_old_algorithms_as_the_new_ones() -> None:
    with pytest.warns(OldNameWarning, match="'original' is now called 'a_priori_dissipation'"):
        assert chosen_algorithms(["original", "a_priori_dissipation", "guarded"]) == ["a_priori_dissipation", "guarded"]


def test_the_command_line_warns_in_one_line_and_prints_the_new_name(capsys: pytest.CaptureFixture[str]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        assert main(["check", DEMO, "--json", "--set", "passivity={algorithm: direct}"]) == 0
    seen = capsys.readouterr()
    assert seen.err == (
        "canhaptic: warning: --set passivity={algorithm: direct}: passivity.algorithm: algorithm 'direct' is now "
        "called 'unprotected'; the old name works in this release and not in the next\n"
    )
    assert json.loads(seen.out)["config"]["axes"]["handle"]["passivity"]["algorithm"] == "unprotected"


# --- logs ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.filterwarnings("ignore::canhaptic.errors.OldNameWarning")
def test_an_old_energy_log_opens_and_its_scene_recomputes_to_the_bit(name: str, tmp_path: Path) -> None:
    with EnergyLog.open(unpacked(f"{name}.h5", tmp_path)) as log:
        stored = scene_from_text(str(log.attributes["config"]), str(log.attributes["config_source"]))
        assert stored.config_hash() == scene_of(log, OLD_LOGS / f"{name}.yaml").config_hash()
        [found] = recompute_all(log, OLD_LOGS / f"{name}.yaml")
        assert (found["mismatch"] is not None) is (name in BETTER_SINCE)
        assert log.rows == 80


@pytest.mark.parametrize("name", NAMES)
def test_an_old_bus_log_replays_frame_by_frame_from_its_boot_and_from_its_first_sync(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The start has learnt to read 0x1006 since, and leaves it out here."""
    path, scene = unpacked(f"{name}.log", tmp_path), old_scene(name)
    result = replay_bus_log(path, scene)
    if name in BETTER_SINCE:
        assert result["status"] == "different"
        return
    assert (result["status"], result["start"]) == ("identical", "boot")
    assert result["reads_left_out"] == ["handle: 0x1006"]
    joined = replay_bus_log(path, scene, from_sync=True)
    assert (joined["status"], joined["reads_left_out"]) == ("identical", [])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OldNameWarning)
        assert main(["replay", str(path), "--config", str(OLD_LOGS / f"{name}.yaml")]) == 0
    assert "because the recorded master was older: handle: 0x1006" in capsys.readouterr().out


def test_an_old_bus_log_that_differs_after_the_read_left_out_is_different(tmp_path: Path) -> None:
    path = unpacked("old_guarded.log", tmp_path)
    lines = path.read_text().splitlines(keepends=True)
    place = next(number for number, line in enumerate(lines) if "601#4001140100000000" in line)
    lines[place] = lines[place].replace("#40011401", "#40011402")
    path.write_text("".join(lines))
    difference = replay_bus_log(path, old_scene("old_guarded"))["difference"]
    assert difference is not None
    assert difference["number"] == place + 1


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.filterwarnings("ignore::canhaptic.errors.OldNameWarning")
def test_a_scene_that_took_the_new_names_is_still_the_one_of_its_old_log(name: str, tmp_path: Path) -> None:
    text = (OLD_LOGS / f"{name}.yaml").read_text()
    for old, new in (OLD_KEYS | OLD_ALGORITHMS).items():
        text = text.replace(f"{old}: ", f"{new}: ").replace(f"algorithm: {old}", f"algorithm: {new}")
    text = text.replace("hand_force: 0 N", "hand_force: 0 N, hand_push: 0 N, device_damping_bound: 0 N*s/m")
    today, other = tmp_path / "today.yaml", tmp_path / "other.yaml"
    today.write_text(text)
    other.write_text(text.replace("400 N/m", "401 N/m"))
    with EnergyLog.open(unpacked(f"{name}.h5", tmp_path)) as log:
        assert scene_of(log, today).axes[0].passivity.name in ("guarded", *OLD_ALGORITHMS.values())
        with pytest.raises(InputError, match="is not the scene of"):
            scene_of(log, other)


def test_a_log_of_the_second_release_is_of_its_scene_and_recomputes_to_the_bit(tmp_path: Path) -> None:
    """Its configuration had `simulation.compiled`, which is gone."""
    path, other = OLD_LOGS / "axis_of_0_2.yaml", tmp_path / "other.yaml"
    other.write_text(path.read_text().replace("400 N/m", "401 N/m"))
    with EnergyLog.open(unpacked("axis_of_0_2.h5", tmp_path)) as log:
        assert log.attributes["canhaptic_version"] == "0.2.0"
        assert log.attributes["config_hash"] == load_scene(path).config_hash("0.2") != load_scene(path).config_hash()
        [found] = recompute_all(log, path)
        assert (found["mismatch"], log.rows) == (None, 80)
        with pytest.raises(InputError, match="is not the scene of"):
            scene_of(log, other)


@pytest.mark.parametrize(
    ("name", "recorded"),
    [
        ("axis_of_0_2", "8fbd4614581dc696f73fb1608ec3bb0a34e30537c7da9c0d6ce3ea6496b47f99"),
        ("group_of_0_2", "6c8fbfa2ce39dae26eecfc5f35f8beda4ee53df63625172831ce22be84abad03"),
        ("displays_of_0_2", "ce50b088e576376fbcd578592150c8a2fdb7cdf820af689cb394002c5b2c6e12"),
    ],
)
def test_a_scene_has_the_hash_that_release_0_2_gave_it(name: str, recorded: str) -> None:
    """The hashes were computed by that release; groups of impedance displays had a key `compiled`, too."""
    assert load_scene(OLD_LOGS / f"{name}.yaml").config_hash("0.2") == recorded


def test_a_scene_with_a_name_that_never_was_is_a_fault(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="unknown passivity algorithm 'dirct'"):
        load_scene(scene_file(tmp_path, ("algorithm: unprotected", "algorithm: dirct")))
