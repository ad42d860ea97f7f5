"""The configurations that come with the package."""

from pathlib import Path

import pytest
import yaml

from canhaptic.scene.load import load_scene
from canhaptic.scene.models import guesses_left
from tests.scene.scene_text import REPOSITORY

PROFILES = REPOSITORY / "configs" / "drives"  # keys of an axis, and no scenes
CONFIGS = sorted(path for path in (REPOSITORY / "configs").rglob("*.yaml") if path.parent != PROFILES)
REAL = [path for path in CONFIGS if "interface: virtual" not in path.read_text(encoding="utf-8")]
"""By their text: to load every scene takes longer than all the tests here."""


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_every_shipped_configuration_is_valid(path: Path) -> None:
    assert (load_scene(path).bus.interface == "virtual") is (path not in REAL)


def test_the_six_configurations_are_there() -> None:
    figures = {"paper_fig4_40hz", "paper_fig5_100hz", "paper_fig7_40hz", "paper_fig8_100hz"}
    assert {"demo", "socketcan_example"} | figures <= {path.stem for path in CONFIGS}


def test_the_real_rig_differs_from_the_demo_in_the_bus_and_the_simulation_only() -> None:
    demo, real = (
        yaml.safe_load((REPOSITORY / "configs" / f"{name}.yaml").read_text()) for name in ("demo", "socketcan_example")
    )
    assert "simulation" not in real
    del demo["simulation"]
    bus, real_bus = demo.pop("bus"), real.pop("bus")
    assert (demo["axes"][0].pop("torque_limit"), real["axes"][0].pop("torque_limit")) == ("20 N", "0.5 N")
    for key in ("device_damping_bound", "device_friction_bound", "sync_jitter", "torque_window", "current_lag"):
        demo["passivity"].pop(key, None)
        del real["passivity"][key]
    assert demo == real
    assert {key for key in bus.keys() | real_bus.keys() if bus.get(key) != real_bus.get(key)} == {
        "interface",
        "channel",
        "bitrate",
    }


@pytest.mark.parametrize("path", REAL, ids=lambda path: path.stem)
def test_a_scene_with_a_real_interface_marks_every_value_that_only_the_rig_knows(path: Path) -> None:
    scene = load_scene(path)
    assert scene.bus.interface != "virtual"
    assert {guess.key for guess in guesses_left(scene)} == {
        *("channel", "bitrate", "node_id", "eds", "counts_per_unit", "rated_torque", "torque_limit", "moving_mass"),
        *("device_damping_bound", "device_friction_bound", "sync_jitter", "torque_window", "current_lag", "hand_push"),
    }
    for axis in scene.axes:
        assert axis.parameters.rated_torque is not None
        assert axis.parameters.torque_limit <= 0.05 * axis.parameters.rated_torque


def test_scenes_with_a_real_interface_are_among_the_shipped_ones() -> None:
    assert {"socketcan_example", "socketcan", "pcan", "kvaser"} <= {path.stem for path in REAL}


@pytest.mark.parametrize(
    ("name", "rate", "damping", "surface", "algorithm", "amplitude"),
    [
        ("paper_fig4_40hz", 40.0, 5.0, 0.0, "a_priori_dissipation", 0.1),
        ("paper_fig5_100hz", 100.0, 5.0, 0.0, "a_priori_dissipation", 0.1),
        ("paper_fig7_40hz", 40.0, 10.0, -0.05, "internal_dissipation", 0.15),
        ("paper_fig8_100hz", 100.0, 10.0, -0.05, "internal_dissipation", 0.15),
        ("paper_fig9_100hz", 100.0, 10.0, -0.05, "internal_dissipation", 0.15),
    ],
)
def test_the_figures_carry_the_parameters_of_the_paper(name, rate, damping, surface, algorithm, amplitude) -> None:
    scene = load_scene(REPOSITORY / "configs" / f"{name}.yaml")
    [axis] = scene.axes
    wall = axis.environment.parameters.model_dump()
    assert (scene.bus.rate, scene.bus.rpdo) == (rate, "event")
    assert (wall["stiffness"], wall["damping"], wall["position"]) == (100.0, damping, surface)
    assert axis.passivity.name == algorithm
    assert axis.simulation is not None
    assert (axis.simulation.plant.mass, axis.simulation.plant.damping) == (0.25, 0.1)
    user = axis.simulation.user
    assert user is not None
    assert (user.stiffness, user.damping) == (60.0, 5.0)
    assert user.motion is not None
    assert (user.motion.amplitude, user.motion.frequency) == (amplitude, 0.5)
