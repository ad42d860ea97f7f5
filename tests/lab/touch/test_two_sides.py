"""A scene twice in one rig, held by one hand that is moved from outside."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from canhaptic.control.admittance.unprotected_admittance import NothingToChoose
from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters
from canhaptic.cycle import run
from canhaptic.errors import InputError
from canhaptic.lab.touch.two_sides import two_sides
from canhaptic.scene.build import build
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.far_side import build_mechanism
from canhaptic.scene.load import load_scene
from canhaptic.sim.plant.effects.hard_stop import HardStop
from canhaptic.sim.plant.mechanism.five_bar_linkage import pose_at
from canhaptic.sim.plant.mechanism.task_hand import PointerTaskHand, TaskHand
from canhaptic.sim.plant.mechanism.xy_stage import XYStage
from canhaptic.sim.plant.plant import Plant, PlantParameters
from canhaptic.sim.plant.user import PointerHand, UserParameters

CONFIGS = Path(__file__).parents[3] / "configs"


def touched_by_a_sine(name: str, cycles: int, overrides: Sequence[str] = ()) -> dict[str, float]:
    """Least true sum of h_i of every account."""
    touched = two_sides(load_scene(CONFIGS / name, overrides))
    directions = len(touched.shown)
    with build(touched.scene, "free") as experiment:
        assert experiment.far_side is not None
        motors: list[Any] = [drive.servo.motor for drive in experiment.far_side.drives]

        def move(cycle: int) -> None:
            angle = 2.0 * math.pi * cycle * touched.scene.bus.sample_time
            turns = (math.sin(angle), math.cos(angle))[:directions]
            place = [0.5 * (a + b) + 0.3 * (b - a) * t for (a, b), t in zip(touched.shown, turns, strict=True)]
            for number, motor in enumerate(motors):
                if isinstance(motor, Plant):
                    motor.move_hand(place[number % directions])
                else:
                    motor.shared.mechanism.move_hand(*place)

        run(experiment.cycle, cycles, progress=move)
        judge = experiment.cycle.judge
        assert judge is not None
        names = [*(a.parameters.name for a in touched.scene.axes), *(g.name for g in touched.scene.groups)]
        return dict(zip(names, judge.least, strict=True))


def test_both_sides_of_a_scene_on_a_line_are_drives_of_this_line() -> None:
    least = touched_by_a_sine("ethercat.yaml", 150)
    assert list(least) == ["unprotected", "guarded"]
    assert least["guarded"] >= -1e-9


@pytest.mark.slow
def test_a_stiff_wall_gives_energy_out_unprotected_alone() -> None:
    least = touched_by_a_sine("hard/stiff_wall.yaml", 3000)
    assert least["unprotected"] < -0.01
    assert least["guarded"] >= -1e-9


@pytest.mark.slow
def test_a_box_is_touched_in_a_plane() -> None:
    least = touched_by_a_sine("xy_box.yaml", 500)
    assert set(least) == {"unprotected x", "unprotected y", "guarded x", "guarded y", "unprotected", "guarded"}
    assert least["guarded"] >= -1e-9


@pytest.mark.slow
def test_a_five_bar_is_touched_by_its_handle_whose_force_does_the_work_of_the_motors() -> None:
    assert touched_by_a_sine("five_bar_sphere.yaml", 300)["guarded"] >= -1e-9
    touched = two_sides(load_scene(CONFIGS / "five_bar_sphere.yaml"))
    assert (touched.discs, touched.links) == (((0.0, 0.24, 0.03),), (0.05, 0.15))
    mechanism: Any = build_mechanism(touched.scene.mechanisms[1], 1_000_000)
    assert touched.start == mechanism.handle
    rates = mechanism.state.left, mechanism.state.right
    before, after = (
        np.array(pose_at(mechanism.settings.links, rates[0] + side, rates[1] - 0.7 * side).handle)
        for side in (-1e-6, 1e-6)
    )
    work = 0.4 * 2e-6 + 0.9 * -0.7 * 2e-6  # of the torques 0.4 and 0.9 N*m
    assert np.dot(mechanism.force_of((0.4, 0.9)), after - before) == pytest.approx(work, rel=1e-6)


LIGHT = ("bus.rate=250", "environment.mass=1", "simulation.admittance.grip.mass=1")


@pytest.mark.slow
def test_a_light_mass_gives_energy_out_unprotected_alone() -> None:
    least = touched_by_a_sine("admittance/virtual_mass.yaml", 700, LIGHT)
    assert least["unprotected"] < -0.1
    assert least["guarded"] >= -1e-3


@pytest.mark.slow
def test_two_displays_with_one_account_are_touched_in_a_plane() -> None:
    least = touched_by_a_sine("admittance/guided_path.yaml", 250)
    assert set(least) == {"unprotected x", "unprotected y", "guarded x", "guarded y", "unprotected", "guarded"}
    assert least["guarded"] >= -1e-3
    touched = two_sides(load_scene(CONFIGS / "admittance" / "guided_path.yaml"))
    assert touched.path[0] == touched.path[-1] == (-0.05, 0.0)
    assert [slider.key for slider in touched.sliders] == [f"groups.0.network.{name}" for name in ("mass", "damping")]


def test_an_unprotected_display_is_guarded_by_what_its_simulated_drive_says() -> None:
    scene = load_scene(CONFIGS / "admittance" / "wall.yaml")
    axis = replace(scene.axes[0], passivity=ComponentSpec("unprotected", NothingToChoose()))
    known = two_sides(replace(scene, axes=(axis,))).scene.axes[1].passivity.parameters
    assert isinstance(known, GuardedAdmittanceParameters)
    assert (known.drive_mass, known.loop_gain, known.integral_gain) == pytest.approx((2.1, 659.4, 6594.0))


def test_a_display_shows_its_walls() -> None:
    touched = two_sides(load_scene(CONFIGS / "admittance" / "wall.yaml"))
    assert touched.solid == ((touched.shown[0][0], -0.05),)


def test_both_sides_have_one_scene_and_one_hand() -> None:
    scene = load_scene(CONFIGS / "demo.yaml")
    touched = two_sides(scene)
    plain, guarded = touched.scene.axes
    assert (plain.passivity.name, guarded.passivity.name) == ("unprotected", "guarded")
    assert plain.environment == guarded.environment == scene.axes[0].environment
    assert plain.simulation == guarded.simulation
    assert plain.simulation is not None
    assert isinstance(plain.simulation.user, PointerHand)
    assert (plain.simulation.user.stiffness, plain.simulation.user.damping) == (60.0, 5.0)
    [(low, high)] = touched.solid
    assert low == touched.shown[0][0]
    assert high == pytest.approx(-0.05, abs=1e-3)


@pytest.mark.parametrize(
    ("name", "overrides", "said"),
    [
        ("socketcan_example.yaml", [], "must not move a real drive"),
        ("two_buses.yaml", [], "expected one"),
        (
            "five_bar_sphere.yaml",
            ["groups.0.network={type: plane, normal: [0, 1], stiffness: 9}"],
            "renders plane",
        ),
        ("two_handles.yaml", [], "touch shows an axis by itself, or on an xy_stage"),
        ("admittance/two_link_arm.yaml", [], "kinematics planar_2r; touch shows one axis, or two axes"),
    ],
)
def test_what_cannot_be_touched_is_refused(name: str, overrides: list[str], said: str) -> None:
    with pytest.raises(InputError, match=said):
        two_sides(load_scene(CONFIGS / name, overrides))
    with pytest.raises(InputError, match="--axis: got 'left'"):
        two_sides(load_scene(CONFIGS / "demo.yaml"), "left")


def test_a_placed_hand_is_a_hand_at_rest_there() -> None:
    mass = PlantParameters(mass=0.25, damping=0.1)
    placed = Plant(mass, PointerHand(stiffness=300.0, damping=3.0), [], 1_000_000)
    resting = Plant(mass, UserParameters(stiffness=300.0, damping=3.0, rest=0.02), [], 1_000_000)
    placed.begin(0)
    placed.move_hand(0.02)
    torques = np.sin(np.arange(400) / 30.0)
    assert placed.run(torques) == pytest.approx(resting.run(torques), abs=1e-15)
    assert placed.energy() == pytest.approx(resting.energy(), rel=1e-11)
    assert abs(placed.energy().user) > 1e-3
    placed.move_hand(0.0)
    for k in range(6000):
        placed.advance_to((401 + k) * 1_000_000, 0.0)
    assert placed.position == pytest.approx(0.0, abs=1e-9)
    energy = placed.energy()
    assert energy.motor + energy.user - energy.dissipated - energy.stored == pytest.approx(0.0, abs=1e-11)


def test_a_hand_that_is_moved_reaches_a_stop_that_was_far_ahead() -> None:
    mass, stop = PlantParameters(mass=0.25, damping=0.1), HardStop(position=0.01, stiffness=1e5, damping=20.0)
    plant = Plant(mass, PointerHand(stiffness=300.0, damping=3.0), [stop], 1_000_000)
    plant.run(np.zeros(80))
    plant.move_hand(0.05)
    farthest = plant.run(np.zeros(500)).max()
    assert 0.01 < farthest < 0.0115
    energy = plant.energy()
    assert energy.motor + energy.user - energy.dissipated - energy.stored == pytest.approx(0.0, abs=1e-11)


def test_a_placed_hand_in_a_plane_is_a_hand_at_rest_there() -> None:
    stage = XYStage(mass_x=0.5, mass_y=0.25, damping_x=0.2, damping_y=0.1)
    grip = {"stiffness": 150.0, "stiffness_across": 60.0, "damping": 4.0, "angle": 0.5}
    placed = stage.build(PointerTaskHand(**grip), 1_000_000, 1)
    resting = stage.build(TaskHand(**grip, rest=(0.02, -0.01)), 1_000_000, 1)
    placed.move_hand(0.02, -0.01)
    for motion in (placed, resting):
        motion.begin(0)
        for k in range(300):
            motion.advance_to((k + 1) * 1_000_000, (0.3, -0.1))
    assert placed.handle == pytest.approx(resting.handle, abs=1e-15)
    assert placed.energy(0) == pytest.approx(resting.energy(0), rel=1e-11)


def test_a_knob_shows_its_notches_and_its_stops_and_has_a_slider_for_each_value_of_a_part() -> None:
    touched = two_sides(load_scene("knob_with_stops"))
    (_, first_stop), (second_stop, _) = touched.solid
    assert (first_stop, second_stop) == pytest.approx((-math.pi / 4.0, math.pi / 4.0))
    assert touched.notches == pytest.approx((0.0, math.pi / 12.0))
    keys = {slider.key: slider.title for slider in touched.sliders}
    assert keys["environment.0.pitch"] == "detents: pitch"
    assert keys["environment.1.stiffness"] == "two_sided_wall: stiffness"
    assert len(keys) == 6
    for key, value in ((slider.key, slider.value) for slider in touched.sliders):
        load_scene("knob_with_stops", [f"{key}={value}"])


def test_a_path_in_a_box_is_rendered_whole_on_both_sides() -> None:
    touched = two_sides(load_scene("path_in_a_box"))
    assert [group.network.name for group in touched.scene.groups] == ["box + guided_path"] * 2
    assert [group.passivity.name for group in touched.scene.groups] == ["unprotected", "guarded"]
    assert touched.solid == ((-0.03, 0.03), (-0.02, 0.02))
    assert touched.path[1] == touched.start == (0.0, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["knob_with_stops.yaml", "wall_in_water.yaml", "path_in_a_box.yaml"])
def test_a_sum_under_its_guard_gives_no_energy_out(name: str) -> None:
    assert touched_by_a_sine(name, 1500)["guarded"] >= -2.1e-5  # the knob's allowance
