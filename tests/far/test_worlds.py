"""Random programs behind a rig, by the truth of its plant; MuJoCo at 60 Hz; and a rig in a process of its own."""

import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import canhaptic
from tools.attack.far import FALSE, campaign, first_false
from tools.attack.worlds import OF_A_WORLD, outcome
from tools.bench.slow_worlds import Ball, behind_a_wall, by_held_force, pressed

SCENE = "configs/far_world.yaml"


@pytest.mark.slow
def test_no_random_program_makes_a_rig_give_out_what_did_not_come_and_broken_rules_are_found() -> None:
    found = campaign(partial(outcome, length=3.0), range(50_000, 50_060))
    assert (found["false"], found["least"]) == (0, 0.0)
    assert found["with_torque"] > 0.6
    assert found["gave"] > 0.1
    for name in ("not taken off", "program gives what it lacks", "totals go on after the session"):
        assert first_false(partial(outcome, length=3.0, mutant=OF_A_WORLD[name]), range(1, 301)), name


def met(seed: int) -> tuple[float, float, str]:
    """Returns the least energy at the motor with S and R, with the program's gifts [J], and the verdict."""
    random = np.random.default_rng([3, seed])
    loss, delay = random.choice([0.0, 5.0, 30.0]), random.choice([0.0, 10.0, 50.0])
    changes = {
        "simulation.far_network": {"delay": f"{delay} ms", "loss": f"{loss} %", "burst": 3, "double": "5 %"},
        "simulation.user.motion.frequency": f"{random.uniform(0.4, 2.0):.3g} Hz", "simulation.seed": seed,
        "far.level": f"{random.uniform(10.0, 60.0):.3g} mJ", "duration": "3 s",
    }  # fmt: skip
    given = most = least = 0.0
    with canhaptic.World("virtual", scene=SCENE, changes=changes, period=float(random.choice([5e-3, 1 / 60]))) as world:
        for hand in world:
            x, axis = hand["handle"].position, world["handle"]
            work = float(random.normal(0.0, 1e-3))
            cycle = cast("Any", world)._place.experiment.cycle
            least = min(least, cycle.judge.interaction[0] - cycle.ledgers[0].supplied + most)
            given, most = given - work, max(most, given - work)
            axis.absorbed(work)
            at, speed = x + random.uniform(-0.06, 0.06), random.uniform(-0.3, 0.3)
            if random.random() < 0.05:
                axis.wall(at, 2000.0 * random.random(), str(random.choice(["-", "+"])), speed, 20.0 * random.random())
            elif random.random() < 0.05:
                axis.spring(at, 2000.0 * random.random(), speed)
            elif random.random() < 0.02:
                axis.free()
            if random.random() < 0.02:
                world.pause(random.uniform(0.05, 0.5))
    assert world.result is not None
    result = world.result
    return result["truth"]["handle"]["least_interaction"], least, result["ports"]["handle"]["verdict"]


@pytest.mark.slow
def test_random_programs_over_the_bus_are_true_and_a_rig_that_keeps_what_it_sends_is_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = [met(seed) for seed in range(4)]
    assert min(min(one[:2]) for one in found) >= FALSE
    assert {one[2] for one in found} == {"yes"}
    monkeypatch.setattr("canhaptic.far.port.deduct", lambda _run, _given: None)
    assert any(least < -1e-4 and verdict == "no" for least, _, verdict in map(met, range(8)))


@pytest.mark.slow
def test_a_ball_in_mujoco_is_felt_and_nothing_given_out_where_the_held_force_gives_joules(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    assert behind_a_wall(Ball(0, stalls=False, jumps=False), 0, tmp_path / "a.h5") >= FALSE
    felt, ripple = pressed(tmp_path / "a.h5")
    assert felt >= 1500.0
    assert ripple < 1.0
    assert behind_a_wall(Ball(3, stalls=True, jumps=True), 3) >= FALSE
    assert min(by_held_force(Ball(seed, stalls=True, jumps=True), seed) for seed in (1, 2)) < -0.1


@pytest.mark.slow
def test_a_plain_loop_with_time_sleep_meets_a_rig_in_a_process_of_its_own() -> None:
    slow = ["bus.rate=100 Hz", "far.coupling.stiffness=300 N/m", "far.level=200 mJ", "duration=4 s"]
    words = [sys.executable, "-m", "canhaptic", "run", SCENE, "--pace", "real", "--json"]
    for change in slow:
        words += ["--set", change]
    turns, changes = 0, dict(change.split("=") for change in slow)
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as rig:
        with canhaptic.World("loopback", scene=SCENE, changes=changes) as world:
            for _ in world:
                turns += 1
                world["handle"].wall(at=0.03, stiffness=300.0, pushes="-")
                world.pause(0.4 if turns == 60 else 1.0 / 60.0)
        said, error = rig.communicate(timeout=60)
    assert rig.returncode == 0, error
    assert '"sessions": 1' in said
    assert turns > 60
