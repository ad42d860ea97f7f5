"""Frames that a bus loses, in the loop of a batch: as often as over CAN, and what controllers make of it."""

import numpy as np
import pytest

from canhaptic.lab.batch.cases import losses_of, not_in_loop
from canhaptic.lab.batch.closed_loop import CycleState, pass_frames
from canhaptic.lab.batch.marching import run_batch
from canhaptic.lab.figures.figures import METRICS
from canhaptic.lab.loop.over_can import render_over_can
from canhaptic.lab.studies.store import SweepTable
from canhaptic.lab.studies.sweep import sweep
from canhaptic.scene.load import load_scene

STIFFNESS = np.array([300.0, 1000.0, 3000.0])
LOSSY = "simulation.bus={drop: 0.02}"


def scene_of(*overrides, rpdo="synchronous"):
    return load_scene("configs/demo.yaml", [f"bus.rpdo={rpdo}", "environment.position=0.005", *overrides])


def figures(scene, cycles=2000, engine="python", **named):
    return run_batch(scene, {"environment.stiffness": STIFFNESS}, cycles, engine, **named)


@pytest.mark.slow
@pytest.mark.parametrize("bus", ["drop: 0.05", "drop: 0.05, drop_burst: 4", "drop: 0.05, direction: to_master"])
def test_frames_are_lost_as_often_as_they_are_said_to_be(bus):
    losses = losses_of(scene_of(f"simulation.bus={{{bus}}}"))
    place, heard, sent, runs, before = CycleState(), 0, 0, 0, True
    for cycle in range(1, 20001):
        pass_frames(losses, place, cycle)
        heard, sent = heard + place.is_heard, sent + place.is_sent
        runs, before = runs + (before and not place.is_sent), place.is_sent
    if losses.to_drive:
        assert sent / 20000 == pytest.approx(0.95, abs=0.012)
        assert 0.88 < heard / 20000 < 0.93  # SYNC and position
        assert (20000 - sent) / runs == pytest.approx(2.6 if "burst" in bus else 1.05, abs=0.3)
    else:
        assert (sent, heard / 20000) == (20000, pytest.approx(0.95, abs=0.006))


@pytest.mark.slow
@pytest.mark.parametrize("rpdo", ["synchronous", "event"])
def test_a_controller_that_declares_losses_gives_out_nothing_although_its_account_is_further_off(rpdo):
    declared = figures(scene_of(LOSSY, "passivity.max_consecutive_losses=3", rpdo=rpdo))
    assert (declared["least_interaction"] >= -1e-6).all()
    assert (declared["cycles"] == 2000).all()
    assert declared["torque_peak"].min() > 0.1
    ideal = figures(scene_of("passivity.max_consecutive_losses=3", rpdo=rpdo))
    assert (declared["accounted_error"] > ideal["accounted_error"] + 1e-9).all()


@pytest.mark.slow
def test_what_is_lost_over_can_is_lost_here():
    """The energies of a lossy run agree with those over CAN within what other losses of the same share give."""
    scene = scene_of(LOSSY, "passivity.max_consecutive_losses=3", "environment.stiffness=1000")
    [run] = render_over_can(scene, 2000, lambda: None)
    same = np.full(8, 1000.0)
    found = run_batch(
        scene, {"environment.stiffness": same}, 2000, "python", ["interaction", "torque_peak"], seeds=np.arange(8.0)
    )
    assert np.unique(found["interaction"]).size == 8
    low, high = found["interaction"].min(), found["interaction"].max()
    wide = high - low
    assert low - 2.0 * wide < run.interaction[-1] < high + 2.0 * wide
    assert found["torque_peak"].mean() == pytest.approx(np.abs(run.torque).max(), rel=0.3)


def test_a_sweep_says_which_effects_of_the_bus_it_leaves_out(tmp_path):
    scene = scene_of("simulation.bus={drop: 0.01, jitter: 1e-4}")
    assert not_in_loop(scene, is_batched=True).startswith("not in this loop: simulation.bus jitter;")
    assert "drop, jitter" in not_in_loop(scene, is_batched=False)
    assert not_in_loop(scene_of(LOSSY), is_batched=True) == not_in_loop(scene_of(), is_batched=False) == ""
    picked = scene_of("simulation.bus={drop: 0.01, during: [{begin: 1 s, duration: 1 s}]}")
    assert not losses_of(picked).exists
    sweep(scene, ["environment.stiffness=100,200"], tmp_path / "a", cycles=20, metrics=["travel"])
    with SweepTable(tmp_path / "a") as table:
        assert "simulation.bus drop, jitter" in table.remark(0)  # so few run one by one


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_compiled_the_same_frames_are_lost():
    pytest.importorskip("numba")
    scene = scene_of("simulation.bus={drop: 0.05, drop_burst: 3}", "passivity={algorithm: unprotected}")
    first, second = (figures(scene, 700, engine, seeds=np.array([1.0, 2.0, 3e9])) for engine in ("python", "numba"))
    for name in METRICS:
        np.testing.assert_array_equal(first[name], second[name], err_msg=name)
