"""The sign sequence in the torques of `guarded`: within what is certified, and what it says of the hold of a drive."""

from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canhaptic.audit.inspection import inspect
from canhaptic.audit.recompute import recompute_all
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import LoopProperties, build_controller
from canhaptic.control.passivity.guarded import Guarded, GuardedParameters
from canhaptic.control.passivity.hold_dither import DitheredGuarded, HoldWatch
from canhaptic.control.verdict import EARLY, FOUND, LATE, UNDECIDED
from canhaptic.cycle import run
from canhaptic.errors import SceneError
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.scene.build import build, experiment_account
from canhaptic.scene.load import load_scene

DEMO = Path(__file__).resolve().parents[2] / "configs" / "demo.yaml"
HAND = GuardedParameters(hand_force=0.0, hand_push=20.0, energy_allowance=1e-2)


def dithered(amplitude: float, quantum: float = 0.0, lag: float = 0.0) -> DitheredGuarded:
    loop = LoopProperties(
        sample_time=1e-3, delay=1, moving_mass=0.1, device_damping_bound=0.2, device_friction_bound=0.0,
        sync_jitter=0.0, torque_window=0.0, current_lag=lag, torque_limit=20.0, torque_quantum=quantum,
    )  # fmt: skip
    wall = SpringDamperWall(stiffness=500.0, damping=2.0, position=0.0)
    controller = build_controller(wall, "guarded", HAND, loop, amplitude)
    assert isinstance(controller, DitheredGuarded)
    return controller


@given(st.integers(0, 2**31), st.sampled_from([0.0, 0.01]), st.floats(0.01, 0.5))
def test_a_sign_takes_a_torque_nearer_to_zero_on_the_grid_of_the_drive_and_never_beyond_it(
    seed: int, quantum: float, amplitude: float
) -> None:
    controller, chance, torque, lowered = dithered(amplitude, quantum), np.random.default_rng(seed), [0.0, 0.0], 0
    down = 2.0 * amplitude if quantum == 0.0 else int(2.0 * amplitude / quantum + 1e-9) * quantum
    position, speed = 1e-3, -2e-5
    for _ in range(40):
        without = Guarded.step(deepcopy(controller), position, torque[-2]).torque
        balance = controller.step(position, torque[-2])
        torque.append(balance.torque)
        assert balance.torque == without or abs(balance.torque) == pytest.approx(abs(without) - down, abs=1e-9)
        assert balance.torque * without >= 0.0
        assert controller._memory.axis.commands.torques[controller._axis.oldest - 1] == balance.torque
        assert quantum == 0.0 or balance.torque == round(balance.torque / quantum) * quantum
        lowered += balance.torque != without
        speed += float(chance.normal()) * 1e-6
        position += speed
    assert lowered or max(map(abs, torque)) < down + 1.0


def said_of(shift: int, *, lag: float = 0.0, lost: float = 0.0, holds: int = 1200) -> DitheredGuarded:
    """Returns the controller of a mass on a soft hand whose drive acts by `shift` holds after its own."""
    controller, sent, chance = dithered(0.1, lag=lag), [0.0, 0.0, 0.0], np.random.default_rng(5)
    position, speed = -1e-3, 0.0
    for hold in range(holds):
        is_lost = hold > 0 and chance.random() < lost
        balance = controller.sample_lost() if is_lost else controller.step(position, sent[-2])
        sent = [*sent[1:], balance.torque]
        force = sent[-2 - shift] + 200.0 * (-0.006 + 0.002 * np.sin(6e-3 * hold) - position) - 3.0 * speed
        position += 1e-3 * speed + 0.5e-6 * force / 0.12
        speed += 1e-3 * force / 0.12
    return controller


@pytest.mark.slow_but("-1-*", "0-*")
@pytest.mark.parametrize(("shift", "said"), [(-1, EARLY), (0, FOUND), (1, LATE)])
def test_signs_find_the_drive_that_acts_in_another_hold_and_take_its_certificate(shift: int, said: str) -> None:
    controller = said_of(shift)
    assert controller.hold_found == said
    after = controller.step(-1e-3, 0.0)
    is_wrong = said != FOUND
    assert (after.certificate == 4) is is_wrong
    assert (controller.sample_lost().certificate == 4) is is_wrong
    assert bool(controller.energy_resolution > 1e-4) is is_wrong
    controller.reset()
    assert controller.hold_found == UNDECIDED


@pytest.mark.slow
def test_a_late_drive_does_not_differ_from_a_lag_of_half_a_hold_and_samples_may_be_lost() -> None:
    assert said_of(1, lag=5e-4).hold_found == UNDECIDED
    assert said_of(-1, lag=5e-4).hold_found == EARLY
    assert said_of(0, lost=0.1, holds=2400).hold_found == FOUND
    assert said_of(-1, lost=0.1, holds=2400).hold_found == EARLY


def test_looks_are_as_few_as_doublings() -> None:
    watch = HoldWatch(1, tells_late=True)
    for _ in range(1100):
        watch.take(0.0, 1)
    assert (watch.looks, watch.found) == (5, "")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drive", "said", "cycles"),
    [
        ("acts_at_once=false", UNDECIDED, 1700),
        pytest.param("acts_at_once=false", FOUND, 4000, marks=pytest.mark.slow),
        ("acts_at_once=true", EARLY, 1700),
        pytest.param("syncs_late=1", LATE, 1700, marks=pytest.mark.slow),
    ],
)
def test_a_run_says_what_its_signs_found_and_its_log_recomputes(
    tmp_path: Path, drive: str, said: str, cycles: int
) -> None:
    values = [
        "axes.0.hold_dither=0.8",
        f"simulation.drive.{drive}",
        "axes.0.read_back=none",
        "environment.stiffness=400",
    ]
    with build(load_scene(DEMO, values), energy_log=tmp_path / "run.h5") as experiment:
        run(experiment.cycle, cycles)
        port = experiment_account(experiment, "completed", 1.7)["ports"]["handle"]
    assert port["hold"] == said
    assert port["in"] > 1e-3
    assert ("none" in port["certificates"]) is (said in (EARLY, LATE))
    assert said == FOUND or port["passive"] == "in doubt"
    with EnergyLog.open(tmp_path / "run.h5") as log:
        assert [one["mismatch"] for one in recompute_all(log)] == [None]
        assert inspect(log)["ports"]["handle"]["hold"] == said


@pytest.mark.filterwarnings("ignore:--set")
@pytest.mark.parametrize(
    ("values", "text"),
    [
        (["passivity.algorithm=unprotected", "axes.0.hold_dither=0.3"], "does not render on this axis alone"),
        (["axes.0.hold_dither=0.004"], "at least half a step of the torque, 0.01"),
    ],
)
def test_signs_are_refused_where_guarded_does_not_render_or_no_step_is_that_small(values: list[str], text: str) -> None:
    with pytest.raises(SceneError, match=text):
        load_scene(DEMO, values)
