"""What a scene must declare before real drives run, and what is sent while the scale of the torque is not verified."""

from pathlib import Path

import pytest

from canhaptic.errors import InputError
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import refused_values, require_no_guesses, status_text, values_to_set

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
DEMO, DISPLAY = CONFIGS / "demo.yaml", CONFIGS / "admittance" / "virtual_mass.yaml"
REAL = (
    *("bus.interface=socketcan", "bus.channel=can0", "simulation=null", "passivity.sync_jitter=0.02"),
    *("passivity.torque_window=600 us", "passivity.current_lag=50 us", "passivity.device_friction_bound=0.3 N"),
)
VERIFIED = ("axes.0.torque_verified=weight", "axes.0.position_reference=index_home")


def test_a_scene_with_all_that_real_drives_need_is_ready_for_them() -> None:
    scene = load_scene(DEMO, (*REAL, *VERIFIED))
    require_no_guesses(scene)
    assert status_text(scene) == "Simulation: no section `simulation`. Hardware: ready"


@pytest.mark.parametrize("left", range(2))
def test_a_real_drive_is_refused_without_a_verified_torque_or_without_the_origin_of_its_counts(left: int) -> None:
    scene = load_scene(DEMO, (*REAL, VERIFIED[1 - left]))
    key = VERIFIED[left].split("=")[0].replace("axes.0", "handle")
    assert [guess.key for guess in refused_values(scene)] == [key]
    with pytest.raises(InputError, match=rf"the drives are real\. .*Hardware: 1 value to set: missing: {key}\. Set"):
        require_no_guesses(scene)


def test_simulation_asks_for_nothing_and_counts_what_hardware_would_need() -> None:
    scene = load_scene(DEMO)
    assert refused_values(scene) == []
    assert status_text(scene) == f"Simulation: ready. Hardware: {len(values_to_set(scene))} values to set"
    assert load_scene(DEMO, ["axes.0.torque_verified=no"]).axes[0].loop.torque_limit == 20.0


def test_an_unverified_axis_is_certified_and_limited_to_a_hundredth_of_its_limit() -> None:
    scene = load_scene(DEMO, (*REAL, *VERIFIED[1:], "bus.interface=virtual", "axes.0.torque_verified=no"))
    [axis] = scene.axes
    assert (axis.parameters.torque_limit, axis.loop.torque_limit) == (20.0, 0.2)
    with build(scene) as experiment:
        [drive] = experiment.rig.drives
        drive.scaling.reset()
        assert drive.limiter.limit(20.0, 0.0) == 0.2
        assert drive.axis.torque_limit == 0.2  # also what 0x6072 is given


def test_a_real_display_needs_a_verified_torque() -> None:
    """Its drive takes the torque that it needs: the master could not keep it to a hundredth."""
    sets = ["bus.interface=socketcan", "bus.channel=can0", "axes.0.admittance.force.frozen_after=50"]
    sets += ["passivity.sync_jitter=5 %", VERIFIED[1]]
    unverified = load_scene(DISPLAY, [*sets, "axes.0.torque_verified=no"])
    assert [guess.key for guess in refused_values(unverified)] == ["handle.torque_verified"]
    assert refused_values(load_scene(DISPLAY, [*sets, "axes.0.torque_verified=balance"])) == []
