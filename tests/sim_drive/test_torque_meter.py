"""What 0x6077 shows next to 0x6074: the motor's torque behind its current loop, filtered, with a sensor's error."""

import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canhaptic.cycle import run
from canhaptic.errors import EnergyLostError
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from canhaptic.sim.drive import SimulatedDriveParameters
from canhaptic.sim.drive.profile.servo import TorqueMeter

DEMO = Path(__file__).resolve().parents[2] / "configs" / "demo.yaml"
MILLISECOND = 1_000_000


class Still:
    """A motor that rests at a place."""

    position = 0.25


class Lagging(Still):
    """A motor whose current loop has made this of the torque held."""

    motor_torque = 1.5


STILL: Any = Still()


def meter(motor: Any = STILL, **values: Any) -> TorqueMeter:
    return TorqueMeter(motor, SimulatedDriveParameters(counts_per_unit=1.0, rated_torque=1.0, **values))


@given(st.integers(-32768, 32767))
def test_without_anything_named_the_demand_is_shown(counts: int) -> None:
    assert meter().counts(0, counts * 0.01, 0.01) == counts


def test_the_motor_behind_a_current_loop_is_measured_and_not_the_demand() -> None:
    assert meter(Lagging()).counts(0, 2.0, 1e-3) == 1500


@pytest.mark.parametrize("lag", [1e-5, 1e-3, 1e-2])
def test_the_filter_is_exact_for_a_torque_that_stands(lag: float) -> None:
    measured = meter(torque_lag=lag)
    for k in range(1, 20):
        expected = 20_000 * (1.0 - math.exp(-k * 1e-3 / lag))
        assert measured.counts(k * MILLISECOND, 2.0, 1e-4) == pytest.approx(expected, abs=0.51)


def test_a_second_look_at_one_instant_changes_nothing() -> None:
    measured = meter(torque_lag=1e-3)
    first = measured.counts(MILLISECOND, 2.0, 1e-4)
    assert measured.counts(MILLISECOND, 2.0, 1e-4) == first


def test_ripple_is_that_of_the_position() -> None:
    """At 0.25 of a pitch of 1 the sine is 1."""
    assert meter(torque_ripple=0.05, torque_ripple_pitch=1.0).counts(0, 2.0, 1e-3) == 2100
    assert meter(torque_ripple=0.05, torque_ripple_pitch=0.25).counts(0, 2.0, 1e-3) == 2000


def test_a_torque_beyond_the_object_is_held_at_its_end() -> None:
    assert meter().counts(0, 1e6, 1e-3) == 32767
    assert meter().counts(0, -1e6, 1e-3) == -32768


def test_a_drive_without_rated_torque_shows_nothing() -> None:
    assert meter().counts(0, 1.0, 0.0) == 0


@pytest.mark.parametrize("place", [math.nan, math.inf])
def test_a_motor_that_has_diverged_has_no_torque(place: float) -> None:
    diverged = Still()
    diverged.position = place
    assert meter(diverged, torque_ripple=0.05).counts(0, 1.0, 1e-3) == 0


@pytest.mark.parametrize("lag", [0.2e-3, 1e-3])
def test_in_a_scene_the_measured_torque_is_that_of_the_current_loop(lag: float) -> None:
    """One hold of torque c from rest ends at c (1 - exp(-T / lag)), by the solution of the loop's own equation."""
    overrides = [
        f"simulation.effects=[{{type: current_loop, time_constant: {lag}}}]",
        "axes.0.read_back=actual",
        "bus.rpdo=event",
        "environment={type: free_space}",
        "passivity={algorithm: unprotected}",
    ]
    scene = load_scene(DEMO, overrides)
    with build(scene) as experiment:
        rig = experiment.rig
        rig.start()
        rig.sync()
        rig.write_torques([5.0])
        sample = rig.sync()[0]
        assert sample.torque_applied == pytest.approx(5.0 * (1.0 - math.exp(-1e-3 / lag)), abs=0.51e-2)
        rig.stop()


@pytest.mark.slow_but("0.0-quirk0", "0.001-quirk1")
@pytest.mark.parametrize("quirk", [[], ["late_following"]])
@pytest.mark.parametrize("lag", [0.0, 5e-5, 2e-4, 1e-3, 5e-3])
def test_the_energy_of_a_measured_torque_is_known_to_its_bound(lag: float, quirk: list[str]) -> None:
    """Booked are the torque measured at the end of each hold and its displacement; the plant knows the true work."""
    effects = f"simulation.effects=[{{type: current_loop, time_constant: {lag}}}]" if lag else "duration=1"
    for rpdo in ("event", "synchronous"):
        overrides = [effects, "axes.0.read_back=actual", f"axes.0.quirks={quirk}", f"bus.rpdo={rpdo}"]
        overrides += ["passivity={algorithm: unprotected}"]  # which books what was read back, and no bound of it
        with build(load_scene(DEMO, [*overrides, "environment.side=above", "environment.stiffness=400"])) as experiment:
            run(experiment.cycle, cycles=500)
            assert experiment.cycle.judge is not None
            [drive] = experiment.rig.drives
            assert experiment.cycle.ledgers[0].summary().energy_in > 1e-3
            assert 0.0 < experiment.cycle.judge.believed_error[0] <= drive.read_back_bound


@pytest.mark.slow_but("ids:*")
@pytest.mark.parametrize("lost", ["direction: to_drive, ids: [0x201]", "ids: [0x181, 0x201]"])
def test_where_nothing_is_read_back_lost_commands_are_within_the_bound(lost: str) -> None:
    overrides = ["axes.0.read_back=none", "environment.side=above", "environment.stiffness=400"]
    overrides += [f"simulation.bus={{drop: 0.1, {lost}}}"]
    with build(load_scene(DEMO, [*overrides, "passivity={algorithm: unprotected}"])) as experiment:
        errors = []

        def note(_cycles: int) -> None:
            assert experiment.cycle.judge is not None
            errors.append(experiment.cycle.judge.believed_error[0])
            assert errors[-1] <= experiment.rig.drives[0].read_back_bound + 1e-12

        run(experiment.cycle, cycles=500, progress=note)
        assert errors[-1] > 1e-6


def test_where_nothing_is_read_back_a_rig_that_loses_energy_stops_all_the_same() -> None:
    overrides = ["axes.0.read_back=none", "axes.0.energy_loss_limit=10 mJ", "environment.damping=0"]
    overrides += ["environment.stiffness=5000"]
    with build(load_scene(DEMO, [*overrides, "passivity={algorithm: unprotected}"])) as experiment:
        with pytest.raises(EnergyLostError):
            run(experiment.cycle, cycles=4000)
        assert experiment.rig.drives[0].read_back_bound > 0.05


def test_a_demand_that_is_read_back_needs_no_bound() -> None:
    with build(load_scene(DEMO, ["environment.side=above"])) as experiment:
        run(experiment.cycle, cycles=300)
        assert experiment.rig.drives[0].read_back_bound == 0.0


@pytest.mark.slow
def test_a_lagging_read_back_costs_exactness_and_the_run_says_how_much() -> None:
    """The ledger books the torque at the end of each hold; the true work is that of the torque inside it."""
    errors = []
    for lag in (0.0, 2e-4):
        effects = f"simulation.effects=[{{type: current_loop, time_constant: {lag}}}]" if lag else "duration=1"
        scene = load_scene(DEMO, [effects, "axes.0.read_back=actual", "environment.side=above"])
        with build(scene) as experiment:
            run(experiment.cycle, cycles=500)
            assert experiment.cycle.judge is not None
            errors.append(experiment.cycle.judge.believed_error[0] / experiment.cycle.ledgers[0].summary().energy_in)
    assert errors[0] < 1e-4
    assert 1e-4 < errors[1] < 0.05
