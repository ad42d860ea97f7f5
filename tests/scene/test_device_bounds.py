"""The upper bounds of damping and dry friction: a simulated plant's where left out, and needed of real drives."""

import pytest

from canhaptic.errors import InputError
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import require_no_guesses
from tests.scene.scene_text import REPOSITORY

DEMO = REPOSITORY / "configs" / "demo.yaml"
STAGE = REPOSITORY / "configs" / "xy_box.yaml"
DRY = (
    "simulation.effects=[{type: viscous_friction, damping: 0.4}, {type: coulomb_friction, kinetic: 0.5, static: 0.7}, "
    "{type: cogging, amplitude: 0.2, pitch: 5 mm}]"
)
LUGRE = (
    "simulation.effects=[{type: lugre_friction, kinetic: 0.3, static: 0.4, viscous: 0.05, stribeck_velocity: 0.1, "
    "bristle_stiffness: 1e4, bristle_damping: 0.1}]"
)
UNKNOWN = ("simulation.plant.damping=0.25", "passivity.device_damping_bound=null")
REAL = (
    *("bus.interface=socketcan", "bus.channel=can0", "simulation=null", "passivity.sync_jitter=0.02"),
    *("passivity.torque_window=600 us", "passivity.current_lag=50 us", "axes.0.torque_limit=0.5 N"),
    *("axes.0.torque_verified=mass", "axes.0.position_reference=absolute"),
)


def loop(path, *overrides):
    return load_scene(path, overrides).axes[0].loop


def test_a_simulated_device_has_the_bounds_of_its_plant():
    found = loop(DEMO, *UNKNOWN, DRY)
    assert found.device_damping_bound == pytest.approx(0.25 + 0.4)
    assert found.device_friction_bound == pytest.approx(0.7 + 0.2)
    found = loop(DEMO, *UNKNOWN, LUGRE)
    assert found.device_damping_bound == pytest.approx(0.25 + 0.05 + 0.1)
    assert found.device_friction_bound == pytest.approx(0.4)


def test_what_is_declared_is_kept_and_without_a_hand_force_nothing_is_needed():
    assert loop(DEMO, DRY, "passivity.device_friction_bound=3").device_friction_bound == 3.0
    found = loop(DEMO, "passivity={algorithm: guarded, hand_force: null, device_damping: 0.1}")
    assert (found.device_damping_bound, found.device_friction_bound) == (None, None)


def test_the_guides_of_a_stage_have_theirs():
    dry = "simulation.mechanisms.0.friction_x={kinetic: 0.4, static: 0.6}"
    axes = load_scene(STAGE, [dry]).axes
    assert [axis.loop.device_friction_bound for axis in axes] == [0.6, 0.0]


def test_no_real_drive_runs_with_a_hand_force_and_unknown_friction():
    declared = load_scene(DEMO, (*REAL, "passivity.device_friction_bound=0.3 N"))
    require_no_guesses(declared)
    with pytest.raises(InputError, match=r"missing: handle\.passivity\.device_friction_bound\. Set"):
        require_no_guesses(load_scene(DEMO, REAL))
    require_no_guesses(load_scene(DEMO, (*REAL, "passivity.hand_force=null", "passivity.device_damping=0.05")))
