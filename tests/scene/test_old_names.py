"""Logs of earlier releases stay valid, and a tool gives their scenes the names and keys of now.

The logs in `old_logs` were recorded by their release: by the first one for each old name, by 0.2 of a scene of an axis.
"""

import lzma
from pathlib import Path

import pytest

from canhaptic.audit.recompute import OLD_ALGORITHMS, earlier_hash, overrides_now, recompute_all, scene_of
from canhaptic.cli.main import main as canhaptic
from canhaptic.errors import InputError, SceneError
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.replay import replay_bus_log
from canhaptic.scene.load import load_scene, scene_from_text
from tests.scene.scene_text import faults, scene_file
from tools.convert_scene import converted, main

OLD_LOGS = Path(__file__).parent / "old_logs"
NAMES = ("old_guarded", "old_direct", "old_original")
BETTER_SINCE = {"old_guarded"}
"""Algorithms that send other torques today: their logs open, and what differs is named."""


def unpacked(name: str, folder: Path) -> Path:
    path = folder / name
    path.write_bytes(lzma.decompress((OLD_LOGS / f"{name}.xz").read_bytes()))
    return path


def scene_of_now(name: str, folder: Path) -> Path:
    """Returns the scene of an old log after `tools/convert_scene.py`."""
    path = folder / f"{name}.yaml"
    path.write_text(converted((OLD_LOGS / f"{name}.yaml").read_text())[0])
    return path


# --- scenes -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("old", ["lead", "credit", "lost_frames", "prediction_holds", "may_cut"])
def test_an_old_key_is_unknown_and_the_error_lists_those_of_now(tmp_path: Path, old: str) -> None:
    guarded = "passivity: {algorithm: guarded, moving_mass: 0.2, device_damping_bound: 0"
    [fault] = faults(tmp_path, ("passivity: {algorithm: unprotected}", f"{guarded}, {old}: 0}}"))
    assert f"passivity.{old}: unknown key" in fault
    assert "energy_allowance" in fault


def test_a_converted_scene_keeps_comments_and_order_and_says_what_changed() -> None:
    old = """# mine
simulation:
  compiled: true  # quick
  seed: 3
passivity:
  algorithm: guarded  # the default
  lost_frames: 2
  prediction_holds: 0.5
  hand_force: 2 N
axes: [{name: a, passivity: {algorithm: direct}},
   {passivity: {algorithm: guarded, lead: 0}}]
groups: [{passivity: {prediction_holds: 1, algorithm: guarded, credit: 1 mJ, may_cut: true, compiled: false}}]
"""
    new, said = converted(old)
    assert (
        new
        == """# mine
simulation:
  seed: 3
passivity:
  device_damping_bound: 0
  hand_push: 2 N
  algorithm: guarded  # the default
  max_consecutive_losses: 2
  hand_force: 2 N
axes: [{name: a, passivity: {algorithm: unprotected}},
   {passivity: {device_damping_bound: 0, hand_push: 0, algorithm: guarded}}]
groups: [{passivity: {device_damping_bound: 0, algorithm: guarded, energy_allowance: 1 mJ, }}]
"""
    )
    assert "line 8: prediction_holds is gone, left out" in said
    assert converted(new) == (new, [])


def test_the_tool_prints_the_scene_and_what_changed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(OLD_LOGS / "old_guarded.yaml")]) == 0
    printed = capsys.readouterr()
    assert "lead" not in printed.out.partition("\n")[2]
    assert "line 7: lost_frames is now max_consecutive_losses\n" in printed.err


# --- logs ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow_but("old_guarded")
@pytest.mark.parametrize("name", NAMES)
def test_an_old_energy_log_opens_and_its_scene_recomputes_to_the_bit(name: str, tmp_path: Path) -> None:
    with EnergyLog.open(unpacked(f"{name}.h5", tmp_path)) as log:
        stored, path = converted(str(log.attributes["config"]))[0], scene_of_now(name, tmp_path)
        assert scene_from_text(stored, str(path)).config_hash() == scene_of(log, path).config_hash()
        [found] = recompute_all(log, path)
        assert (found["mismatch"] is not None) is (name in BETTER_SINCE)
        assert log.rows == 80


@pytest.mark.slow_but("old_guarded")
@pytest.mark.parametrize("name", NAMES)
def test_an_old_bus_log_replays_frame_by_frame_from_its_boot_and_from_its_first_sync(name: str, tmp_path, capsys):
    """The start has learnt to read 0x1006, 0x60B2 and what it writes since, and leaves that out here."""
    path, config = unpacked(f"{name}.log", tmp_path), scene_of_now(name, tmp_path)
    scene = load_scene(config)
    result = replay_bus_log(path, scene)
    if name in BETTER_SINCE:
        assert result["status"] == "different"
        return
    assert (result["status"], result["start"]) == ("identical", "boot")
    assert result["reads_left_out"] == ["handle: 0x1006", "handle: 0x60B2", "handle: values before the start"]
    joined = replay_bus_log(path, scene, from_sync=True)
    assert (joined["status"], joined["reads_left_out"]) == ("identical", [])
    assert canhaptic(["replay", "--quick", str(path), "--config", str(config)]) == 0
    assert "as in the recording by an older master: handle: 0x1006, handle: 0x60B2" in capsys.readouterr().out


def test_an_old_bus_log_that_differs_after_the_read_left_out_is_different(tmp_path: Path) -> None:
    path = unpacked("old_guarded.log", tmp_path)
    lines = path.read_text().splitlines(keepends=True)
    place = next(number for number, line in enumerate(lines) if "601#4001140100000000" in line)
    lines[place] = lines[place].replace("#40011401", "#40011402")
    path.write_text("".join(lines))
    difference = replay_bus_log(path, load_scene(scene_of_now("old_guarded", tmp_path)))["difference"]
    assert difference is not None
    assert difference["number"] == place + 1


@pytest.mark.slow_but("old_guarded")
@pytest.mark.parametrize("name", NAMES)
def test_a_converted_scene_is_the_one_of_its_old_log_and_a_changed_one_is_not(name: str, tmp_path: Path) -> None:
    today, other = scene_of_now(name, tmp_path), tmp_path / "other.yaml"
    other.write_text(today.read_text().replace("400 N/m", "401 N/m"))
    with EnergyLog.open(unpacked(f"{name}.h5", tmp_path)) as log:
        assert scene_of(log, today).axes[0].passivity.name in ("guarded", *OLD_ALGORITHMS.values())
        with pytest.raises(InputError, match="is not the scene of"):
            scene_of(log, other)


@pytest.mark.slow
def test_a_log_of_the_second_release_is_of_its_scene_and_recomputes_to_the_bit(tmp_path: Path) -> None:
    """Its configuration had `simulation.compiled`, which is gone."""
    path, other = OLD_LOGS / "axis_of_0_2.yaml", tmp_path / "other.yaml"
    other.write_text(path.read_text().replace("400 N/m", "401 N/m"))
    with EnergyLog.open(unpacked("axis_of_0_2.h5", tmp_path)) as log:
        assert log.attributes["canhaptic_version"] == "0.2.0"
        assert log.attributes["config_hash"] == earlier_hash(load_scene(path), "0.2") != load_scene(path).config_hash()
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
    assert earlier_hash(load_scene(OLD_LOGS / f"{name}.yaml"), "0.2") == recorded


def test_a_log_with_a_key_that_is_gone_is_of_its_scene_at_any_value_of_that_key() -> None:
    scene = load_scene(OLD_LOGS / "group_of_0_2.yaml")
    found = {earlier_hash(scene, "0.2")}
    for key, value in (("prediction_holds", 0.25), ("may_cut", True), ("compiled", True)):
        found.add(earlier_hash(scene, "0.2", {"groups": {"coupling": {"passivity": {key: value}}}}))
    assert len(found) == 4
    logged = {"groups": {"coupling": {"passivity": {"prediction_holds": 0.5, "hand_force": 7.0}}}}
    assert earlier_hash(scene, "0.2", logged) == earlier_hash(scene, "0.2")  # what a scene can say, the scene says
    axis = load_scene(OLD_LOGS / "axis_of_0_2.yaml")
    assert earlier_hash(axis, "0.1", {"axes": {"handle": {"passivity": {"lead": 0.25}}}}) != earlier_hash(axis, "0.1")


def test_overrides_of_an_old_log_take_the_names_of_now() -> None:
    old = ["passivity.lost_frames=3", "axes.0.passivity.algorithm=direct", "passivity.lead=0.5", "bus.rate=500"]
    assert overrides_now([*old, "groups.0.passivity.may_cut=true", "simulation.compiled=true"]) == [
        "passivity.max_consecutive_losses=3", "axes.0.passivity.algorithm=unprotected", "bus.rate=500",
    ]  # fmt: skip


def test_a_scene_with_a_name_that_never_was_is_a_fault(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="unknown passivity algorithm 'dirct'"):
        load_scene(scene_file(tmp_path, ("algorithm: unprotected", "algorithm: dirct")))
