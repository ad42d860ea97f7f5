"""Why does it buzz: figures against closed forms, loops against published limits, causes against what was done."""

import json
from dataclasses import replace
from pathlib import Path
from random import Random

import numpy as np
import pytest
import yaml

import canhaptic
from canhaptic.audit.recompute import scene_of
from canhaptic.audit.why.causes import Known, explained, why
from canhaptic.audit.why.frames import why_of_frames
from canhaptic.audit.why.ripple import Buzz, Motion, buzz_of, to_and_fro, variation
from canhaptic.audit.why.sampled_loop import SampledLoop
from canhaptic.cli.main import main
from canhaptic.cli.why import trial
from canhaptic.control.damping import largest_stable_damping
from canhaptic.scene.load import load_scene
from tools import buzzing

_PERIOD, _MASS = 1e-3, 0.25
_NAMES = {
    "encoder": "encoder count x damping", "damping": "damping above its limit",
    "stiffness": "stiffness above its limit",
    "lateness": "delay or late frames", "torque step": "torque step", "skipped SYNCs": "skipped SYNCs",
    "shaft": "compliant shaft", "current loop": "resonance or lag of the drive (0x60F6)",
    "stick-slip": "stick-slip of dry friction", "saturation": "saturated torque", "tremor": "a hand that trembles",
    "second rig": "two rigs in a loop",
}  # fmt: skip


def swinging(frequency: float, amplitude: float, ahead: float, mean: float = 5.0) -> Motion:
    """Return a mass that swings under a torque ahead of minus its motion, each hold with its mean torque."""
    time, omega = np.arange(3000) * _PERIOD, 2.0 * np.pi * frequency
    position = 0.02 * np.sin(np.pi * time) + amplitude * np.sin(omega * time)
    torque = mean - _MASS * omega**2 * amplitude * np.sin(omega * (time - 0.5 * _PERIOD) + ahead)
    return Motion(_PERIOD, position, torque, torque, np.ones(3000, bool), np.ones(3000, int))


def found_in(motion: Motion) -> Buzz:
    """Return the ripple of a motion that has one."""
    found = buzz_of(motion, _MASS)
    assert found is not None
    return found


@pytest.mark.parametrize(("frequency", "ahead"), [(43.0, -0.3), (7.5, 0.8), (180.0, 0.0)])
def test_frequency_amplitudes_and_phase_are_those_of_the_motion(frequency: float, ahead: float) -> None:
    amplitude = 1.0 / (_MASS * (2.0 * np.pi * frequency) ** 2)  # 1 N
    buzz = found_in(swinging(frequency, amplitude, ahead))
    assert buzz.frequency == pytest.approx(frequency, rel=0.02)
    assert buzz.torque == pytest.approx(2.0, rel=0.15)  # a cubic takes a part of a slow swing
    assert buzz.amplitude == pytest.approx(2.0 * amplitude, rel=0.06)
    assert buzz.phase == pytest.approx(ahead, abs=0.06)
    assert buzz.share == pytest.approx(np.sqrt(0.5 / 25.5), rel=0.05)
    assert buzz.purity > 0.9


def test_what_no_hand_feels_is_no_buzz() -> None:
    assert buzz_of(swinging(43.0, 0.05 / (_MASS * (2.0 * np.pi * 43.0) ** 2), 0.0), _MASS) is None
    assert buzz_of(swinging(43.0, 1e-3, 0.0).part(slice(0, 100)), _MASS) is None


def test_way_and_swing_of_a_signal_are_counted() -> None:
    assert variation(np.array([0.0, 2.0, -1.0])) == 5.0
    assert to_and_fro(np.array([1.0, 3.0])) == 1.0


@pytest.mark.parametrize("delay", [0, 1, 2])
def test_a_damper_alone_grows_above_the_published_damping(delay: int) -> None:
    limit = largest_stable_damping(delay, _MASS, _PERIOD)
    loop = SampledLoop(1e-6, 0.99 * limit, float(delay), _MASS, 0.0, _PERIOD)
    assert not loop.grows
    assert replace(loop, damping=1.01 * limit).grows


def test_a_spring_alone_grows_above_colgates_bound() -> None:
    loop = SampledLoop(2.0 * 0.5 / _PERIOD, 0.0, 0.0, _MASS, 0.5, _PERIOD)
    assert not replace(loop, stiffness=0.98 * loop.stiffness).grows
    assert replace(loop, stiffness=1.02 * loop.stiffness).grows


def test_a_wall_that_is_advised_is_calm() -> None:
    loop = SampledLoop(20_000.0, 1.0, 1.0, _MASS, 0.5, _PERIOD)
    assert loop.grows
    assert next(wall for wall in loop.calmer() if wall.calm()).stiffness < 1.5 / (1.5 * _PERIOD)


def test_a_lag_a_step_and_a_hand_are_told_from_motion_and_torque_alone() -> None:
    tremor = swinging(9.0, 1.0 / (_MASS * (2.0 * np.pi * 9.0) ** 2), 0.9)
    known = Known("handle", stiffness=1000.0, damping=5.0, mass=_MASS, lost=5.0, count=1e-7)
    found = explained(known, tremor, found_in(tremor), {})
    assert (found["causes"][0]["cause"], found["kind"]) == ("a hand that trembles", "tremor")
    late = replace(tremor, command=np.roll(np.asarray(tremor.torque), -6))
    causes = explained(known, late, found_in(late), {})["causes"]
    text = next(cause["evidence"] for cause in causes if cause["cause"] == "delay or late frames")
    assert text.startswith("torques act 4 holds later than declared")


def drawn(kind: str, folder: Path) -> tuple[buzzing.Scene, Path]:
    """Return a scene that buzzes by one cause, and the stem of its files."""
    found = buzzing.kept((kind, 4712 if kind == "saturation" else 4711, False), folder)  # 4711 touches a limit once
    path = folder / found["file"]
    return yaml.safe_load(path.with_suffix(".yaml").read_text()), path


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(_NAMES))
def test_the_cause_that_was_added_is_among_the_first_two(kind: str, tmp_path: Path) -> None:
    _, path = drawn(kind, tmp_path)
    with canhaptic.EnergyLog(path.with_suffix(".h5")) as log:
        found = next(iter(why(log, scene_of(log)).values()))
    assert _NAMES[kind] in [cause["cause"] for cause in found["causes"][:2]]
    assert found["causes"][0]["value"] is not None


@pytest.mark.slow
def test_the_advised_value_calms_the_twin_and_json_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, scene = buzzing.pair("damping", Random(3))
    scene["duration"] = 0.6
    buzzing.simulated(scene, tmp_path / "run")
    assert main(["inspect", str(tmp_path / "run.h5"), "--why", "--try", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    cause = result["why"]["handle"]["causes"][0]
    assert (cause["cause"], cause["key"]) == ("damping above its limit", "environment.damping")
    assert result["trials"]["handle"]["changed"] < 0.1 * result["trials"]["handle"]["twin"]


@pytest.mark.slow
def test_a_calm_run_has_no_cause_and_a_run_that_buzzes_a_line(tmp_path, capsys) -> None:
    log = str(tmp_path / "calm.h5")
    assert main(["run", "demo", "--duration", "0.6", "--log", log]) == 0
    assert "buzzes" not in capsys.readouterr().err
    assert main(["inspect", log, "--why"]) == 0
    assert "nothing buzzes" in capsys.readouterr().out


def test_frames_without_times_or_maps_say_which_signals_are_missing(tmp_path: Path) -> None:
    path = tmp_path / "dump.log"
    frames = ["  can0  080   [0]", "  can0  18C   [4]  00 00 00 00", "  can0  08C   [8]  20 82 00 00 00 00 00 00"]
    path.write_text("\n".join(frames * 5))
    found = why_of_frames(path, None)
    assert [text.partition(":")[0] for text in found["missing"]] == [
        "position (0x6064)", "torque (0x6074 or 0x6077)", "target torque (0x6071)",
        "target torques of the master", "times",
    ]  # fmt: skip
    assert "TPDO 0x18C: 5 frames, 100 % of the SYNCs; its bytes never change: nothing moves in it" in found["said"]
    assert any("0x8220" in text and "5 times" in text for text in found["said"])


@pytest.mark.slow
@pytest.mark.parametrize("bus", [{"delay": 1.5e-4, "jitter": 1e-4}, {"delay": 2e-4, "ids": [0x201]}, {"drop": 0.15}])
def test_frames_that_are_late_or_lost_are_the_cause_where_a_stable_loop_grows_with_them(bus, tmp_path):
    scene = buzzing.base(Random(1))
    scene["bus"] |= {"rate": 1000, "rpdo": "event", "loss_limit": 1.0}
    lost = scene["simulation"]["plant"]["damping"] + scene["environment"]["damping"]
    scene["passivity"], scene["environment"]["stiffness"] = {"algorithm": "unprotected"}, 0.9 * lost / 5e-4
    scene["simulation"]["bus"], scene["simulation"]["user"]["damping"] = bus, 1.0
    buzzing.simulated(scene, tmp_path / "run")
    with canhaptic.EnergyLog(tmp_path / "run.h5") as log:
        first = why(log, scene_of(log))["handle"]["causes"][0]
    assert first["cause"] == "delay or late frames"
    assert first["key"].startswith("simulation.bus.")


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "in_model"), [("damping", True), ("current loop", False)])
def test_the_hand_of_a_real_log_is_found_through_the_grip_and_tried_in_a_twin(kind: str, in_model: bool, tmp_path):
    _, scene = buzzing.pair(kind, Random(5))
    scene["duration"] = 1.5
    buzzing.simulated(scene, tmp_path / "run")
    real = {key: of for key, of in scene.items() if key != "simulation"}
    real["bus"] = {**scene["bus"], "interface": "socketcan", "channel": "can0"}
    real["passivity"] = {"algorithm": "unprotected", "moving_mass": scene["simulation"]["plant"]["mass"]}
    (tmp_path / "real.yaml").write_text(yaml.safe_dump(real))
    with canhaptic.EnergyLog(tmp_path / "run.h5") as log:
        value = 0.2 * scene["environment"]["damping"]
        found = trial(log, load_scene(tmp_path / "real.yaml"), "handle", "environment.damping", value)
    assert found["in_model"] == in_model
    assert ("not in the model" in found["text"]) != in_model
    if in_model:
        assert found["changed"] < 0.5 * found["twin"]


def test_a_touch_that_rings_once_is_no_buzz() -> None:
    still = swinging(43.0, 0.0, 0.0)
    time = np.arange(3000) * _PERIOD
    swing = 1e-4 * np.exp(-time / 0.04) * np.sin(2.0 * np.pi * 43.0 * time)
    force = -_MASS * (2.0 * np.pi * 43.0) ** 2 * swing
    touch = replace(still, position=still.position + swing, torque=np.asarray(still.torque) + force)
    assert buzz_of(touch, _MASS) is None
