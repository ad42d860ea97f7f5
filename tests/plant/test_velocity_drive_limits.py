"""The drive of an admittance display: its torque limit is lowered by 0x6072, its torque offset is 0x60B2."""

from pathlib import Path

import pytest

from canhaptic.cycle import run
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from canhaptic.sim.plant.plant import PlantParameters
from canhaptic.sim.plant.velocity_drive import (
    AdmittanceSimulation,
    GripParameters,
    VelocityDrivenPlant,
    VelocityLoopParameters,
)

SCENE = Path(__file__).parents[2] / "configs" / "admittance" / "virtual_mass.yaml"
MS = 1_000_000
MASS, GAIN, BEHIND = 2.0, 628.0, 1e-3


def plant_of(integral: float = 0.0, limit: float | None = None) -> VelocityDrivenPlant:
    loop = VelocityLoopParameters(gain=GAIN, integral_gain=integral, torque_limit=limit)
    simulation = AdmittanceSimulation(loop=loop, grip=GripParameters(mass=BEHIND, stiffness=1e4, damping=5.0))
    plant = VelocityDrivenPlant(PlantParameters(mass=MASS, damping=0.0), simulation, None, (), MS)
    plant.begin(0)
    return plant


def test_a_torque_offset_is_a_torque_on_the_mass() -> None:
    plain, offset = plant_of(), plant_of()
    offset.feed_forward(31.4)
    for k in range(1, 51):
        plain.advance_to(k * MS, 0.05)
        offset.advance_to(k * MS, 0.0)
    assert offset.velocity == pytest.approx(plain.velocity, abs=1e-12)  # 31.4 N is 0.05 m/s of the P loop
    assert offset.velocity == pytest.approx(31.4 / GAIN, rel=1e-3)
    offset.feed_forward(0.0)
    for k in range(51, 101):
        offset.advance_to(k * MS, 0.0)
    assert abs(offset.velocity) < 1e-5


def test_with_an_integral_it_pushes_and_is_then_taken_back() -> None:
    plant = plant_of(integral=2e4)
    plant.feed_forward(10.0)
    plant.advance_to(MS // 10, 0.0)
    assert plant.velocity == pytest.approx(10.0 / (MASS + BEHIND) * 1e-4, rel=0.05)
    for k in range(1, 2001):
        plant.advance_to(k * MS, 0.0)
    assert abs(plant.velocity) < 1e-4  # the loop holds against it
    assert plant.position == pytest.approx(10.0 / 2e4, rel=0.01)


def test_on_again_after_its_integral_was_full_it_integrates_from_nothing() -> None:
    plant = plant_of(integral=2e4, limit=30.0)
    for k in range(1, 4):
        plant.advance_to(k * MS, 10.0)  # the integral of 200 N within one hold is cut at 30
    plant.power(on=False)
    plant.power(on=True)
    before, place = plant.velocity, plant.state_names.index("loop_integral")
    plant.advance_to(4 * MS, before + 1e-3)
    assert plant.state[place] == pytest.approx(2e4 * 1e-3 * 1e-3, rel=0.2)


@pytest.mark.parametrize(("own", "limit", "acts"), [(500.0, 30.0, 30.0), (20.0, 30.0, 20.0), (None, 30.0, None)])
def test_a_limit_is_lowered_and_never_raised(own: float | None, limit: float, acts: float | None) -> None:
    plant = plant_of(limit=own)
    plant.limit_torque(limit)
    assert plant.display.loop.torque_limit == acts
    plant.begin(0)
    for k in range(1, 6):
        plant.advance_to(k * MS, 10.0)
    unlimited = plant_of()
    for k in range(1, 6):
        unlimited.advance_to(k * MS, 10.0)
    if acts is None:
        assert plant.velocity == unlimited.velocity
    else:
        assert plant.velocity == pytest.approx(acts / (MASS + BEHIND) * 5e-3, rel=0.05)
        assert plant.velocity < 0.2 * unlimited.velocity


def test_the_start_writes_the_limit_and_takes_the_offsets_away() -> None:
    given = ["simulation.drive.objects={0x60B1: 1000, 0x60B2: 50}", "axes.0.torque_limit=30 N"]
    with build(load_scene(SCENE, [*given, "simulation.admittance.loop.torque_limit=500 N"])) as experiment:
        assert experiment.far_side is not None
        drive, plant = experiment.far_side.drives[0], experiment.plants[0]
        offsets = [drive.store.entry(0x60B2, 0x03), drive.store.entry(0x60B1, 0x04)]
        seen: set[object] = set()
        run(experiment.cycle, 20, progress=lambda _: seen.update(offset.value for offset in offsets))
        assert seen == {0}
        assert [offset.value for offset in offsets] == [50, 1000]  # put back at the end
        assert isinstance(plant, VelocityDrivenPlant)
        assert plant.display.loop.torque_limit == 30.0
