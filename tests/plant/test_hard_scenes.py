"""The scenes `configs/hard/sim_*.yaml`, each against the reference that its heading names."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from canhaptic.lab.loop.axis_loop import loop_case
from canhaptic.scene.build import build
from canhaptic.scene.far_side import build_plant
from canhaptic.scene.load import load_scene
from canhaptic.sim.plant.direct_rig import DirectRig
from canhaptic.sim.plant.plant import Plant
from tests.plant.plant_scenes import largest_flow, residual, run

FOLDER = Path(__file__).resolve().parents[2] / "configs" / "hard"


def loaded(name: str) -> tuple[Plant, int]:
    """The plant of a scene and its number of holds."""
    scene = load_scene(FOLDER / f"sim_{name}.yaml")
    simulation, duration = scene.axes[0].simulation, scene.run.duration
    assert simulation is not None
    assert duration is not None
    return build_plant(simulation, scene.bus.sample_time_ns), round(duration * scene.bus.rate)


def free(name: str) -> tuple[Plant, np.ndarray]:
    plant, holds = loaded(name)
    return plant, run(plant, [0.0] * holds)


@pytest.mark.parametrize("name", ["stop_1khz", "stop_50hz"])
def test_an_elastic_stop_gives_back_the_speed(name):
    plant, positions = free(name)
    flight, contact = 0.01 / 0.3, math.pi * math.sqrt(0.25 / 1e6)
    times = np.arange(len(positions)) * plant.sample_time_ns * 1e-9
    expected = np.where(times < flight, 0.3 * times, 0.01 - 0.3 * (times - flight - contact))
    inside = (times > flight) & (times < flight + contact)
    expected[inside] = 0.01 + 0.3 * contact / math.pi * np.sin((times[inside] - flight) * math.pi / contact)
    assert np.abs(positions - expected).max() <= 1e-8 * 0.01
    assert plant.velocity == pytest.approx(-0.3, rel=1e-9)
    assert residual(plant) <= 1e-12 * 0.5 * 0.25 * 0.3**2


def test_grazing_is_not_missed():
    plant, positions = free("grazing")
    deceleration, speed, pace, limit = 10.0, 0.08, math.sqrt(1e4 / 0.25), 0.319e-3
    enter = math.sqrt(speed**2 - 2 * deceleration * limit)
    contact = 2 * math.atan2(enter * pace, deceleration) / pace
    fall = np.arange(1, len(positions)) * 0.02 - (speed - enter) / deceleration - contact
    assert plant.events == 2
    assert np.allclose(positions[1:], limit - enter * fall - deceleration * fall**2 / 2, atol=1e-11)


def test_a_mass_ratio_of_ten_thousand_swings_as_two_bodies_do():
    plant, positions = free("mass_ratio")
    mass, load, stiffness = 0.25, 25e-6, 1e6
    pace, times = math.sqrt(stiffness * (1 / mass + 1 / load)), np.arange(len(positions)) * 1e-3
    twist = 1.0 / (load * pace**2) * (1 - np.cos(pace * times))  # 1 N pushes the load
    expected = (0.5 * times**2 - load * twist) / (mass + load)
    assert np.abs(positions - expected).max() <= 1e-12 * expected.max()
    assert residual(plant) <= 1e-12 * largest_flow(plant)


@pytest.mark.slow
def test_chatter_stays_under_the_cap_and_closes_its_energy():
    plant, _ = free("backlash_chatter")
    assert plant.events > 100
    assert plant.energy().dissipated > 0.0
    assert residual(plant) <= 1e-12 * largest_flow(plant)


@pytest.mark.slow
def test_a_push_below_breakaway_bends_the_bristles_and_no_more():
    plant, positions = free("lugre_presliding")
    late = positions[len(positions) // 2 :]
    assert 1e-6 * 0.99 <= late.min() <= late.max() <= 1e-6 * 1.2  # 0.1 N on 1e5 N/m, and a little creep
    assert residual(plant) <= 1e-12 * largest_flow(plant)


def recorded(name: str) -> tuple[Any, Any]:
    """A scene without its bus: what happened, and the plant."""
    scene = load_scene(FOLDER / f"sim_{name}.yaml")
    case = loop_case(scene.axes[0], scene)
    plant = case.make_plant()
    wall = case.environment

    class Law:
        torque = 0.0

        def __call__(self, position: float, _applied: float) -> "Law":
            self.torque = -wall.stiffness * min(position - wall.position, 0.0)  # type: ignore[attr-defined]
            return self

    rig = DirectRig(plant, Law(), case.sample_time_ns, 0, case.counts_per_unit, case.torque_quantum)
    return rig.run(round((scene.run.duration or 0.0) * scene.bus.rate)), plant


def test_the_encoder_dither_is_the_parabola_between_two_syncs():
    record, _ = recorded("encoder_dither")
    position, velocity, period = 0.0, -2.03e-3, 1e-3
    assert len(set(record.position.tolist())) > 2
    for k, seen in enumerate(record.position):
        assert record.true_position[k] == pytest.approx(position, abs=1e-13)
        assert seen == pytest.approx(round(position * 1e4) * 1e-4, abs=1e-12)
        torque = round(-100.0 * min(seen, 0.0) / 0.01) * 0.01
        position += velocity * period + torque / 0.25 * period**2 / 2
        velocity += torque / 0.25 * period


def test_lost_and_late_syncs_do_not_move_a_plant_in_free_space():
    scene = load_scene(FOLDER / "sim_lost_and_late_sync.yaml")
    with build(scene) as experiment:
        experiment.rig.start()
        for _ in range(300):
            experiment.cycle.step()
        [moved] = experiment.plants
        ticks = moved.tick
        energy = moved.energy()
    assert scene.axes[0].simulation is not None
    still = build_plant(scene.axes[0].simulation, scene.bus.sample_time_ns)
    still.begin(0)
    still.advance_to(round(ticks * 1e6 / (1 << 24)), 0.0)
    assert ticks & ((1 << 24) - 1) != 0  # the last SYNC came late
    assert moved.position == pytest.approx(still.position, abs=1e-9)
    assert energy.user == pytest.approx(still.energy().user, rel=1e-6)
