"""The two baselines that the paper names: what each promises, and what it does not."""

from collections import deque

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.ledger import Ledger
from canhaptic.control.passivity import LoopProperties, build_controller
from canhaptic.control.passivity.passivity_observer import PassivityObserverParameters
from canhaptic.errors import ParameterError
from canhaptic.lab.rivals.force_augmentation import ForceAugmentationParameters
from tests.control.reference_loop import USER_S, sampled
from tests.drawn import examples

STIFF = SpringDamperWall(stiffness=20_000.0, damping=0.0)
DEVICE_DAMPING = 2.0
motions = st.lists(st.one_of(st.floats(-0.01, 0.01), st.floats(-1e-5, 1e-5), st.just(0.0)), min_size=1, max_size=80)


@pytest.mark.parametrize("delay", [0, 1, 2])
@settings(max_examples=examples(100))
@given(motion=motions)
def test_energy_bounding_holds_for_every_motion_whatever_the_wall(delay, motion):
    loop = LoopProperties(sample_time=1e-3, delay=delay, device_damping=DEVICE_DAMPING)
    made = build_controller(SpringDamperWall(stiffness=1e6, damping=100.0), "energy_bounding", None, loop)
    pending, position, account = deque([0.0] * (delay + 1)), 0.0, 0.0
    pending.append(made.step(position, pending.popleft()).torque)
    for displacement in motion:
        position += displacement
        held = pending.popleft()
        account += -held * displacement + DEVICE_DAMPING / 1e-3 * displacement**2
        assert account >= -1e-9
        pending.append(made.step(position, held).torque)


def test_energy_bounding_at_its_limit_is_tight():
    """The worst motion for the torque permitted takes the account to zero exactly: dx = F T / 2 b."""
    loop = LoopProperties(sample_time=1e-3, device_damping=DEVICE_DAMPING)
    made = build_controller(SpringDamperWall(stiffness=1e6), "energy_bounding", None, loop)
    made.step(0.0, 0.0)
    torque = made.step(-1e-4, 0.0).torque
    account = DEVICE_DAMPING / 1e-3 * 1e-8
    worst = torque * 1e-3 / (2.0 * DEVICE_DAMPING)
    assert account - torque * worst + DEVICE_DAMPING / 1e-3 * worst**2 == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("stiffness", [3.0, 1e6])
def test_energy_bounding_sends_whole_steps_of_torque_that_are_not_above_its_bound(stiffness):
    loop = LoopProperties(sample_time=1e-3, device_damping=DEVICE_DAMPING)
    torques = []
    for quantum in (0.0, 1e-4):
        of = loop.model_copy(update={"torque_quantum": quantum})
        made = build_controller(SpringDamperWall(stiffness=stiffness), "energy_bounding", None, of)
        made.step(0.0, 0.0)
        torques.append(made.step(-1.1902e-4, 0.0).torque)
    steps = torques[1] / 1e-4
    assert steps == pytest.approx(round(steps), abs=1e-9)
    assert 0.0 < torques[1] <= torques[0] < torques[1] + 1e-4
    assert torques[0] / 1e-4 % 1.0 > 0.5  # the nearest step is above it


@pytest.mark.parametrize("damping", [None, 0.0])
def test_energy_bounding_without_device_damping_is_refused(damping):
    with pytest.raises(ParameterError, match="device_damping"):
        build_controller(STIFF, "energy_bounding", None, LoopProperties(sample_time=1e-3, device_damping=damping))


def test_an_observer_without_any_bound_on_its_damper_is_refused():
    with pytest.raises(ParameterError, match="damping_limit"):
        build_controller(STIFF, "passivity_observer", None, LoopProperties(sample_time=1e-3))


def least_interaction(algorithm, delay, parameters=None):
    loop = LoopProperties(sample_time=1e-3, delay=delay, moving_mass=0.25)
    run = sampled(USER_S, build_controller(STIFF, algorithm, parameters, loop), 1e-3, 2.0, delay)
    ledger = Ledger()
    for cycle, balance in enumerate(run.balances):
        ledger.add(balance, cycle)
    true = (-np.cumsum(run.torque[1:] * np.diff(run.position))).min()
    summary = ledger.summary()
    assert summary.least_interaction == pytest.approx(min(0.0, true), rel=1e-9, abs=1e-12)
    return summary


def test_the_observer_bounds_what_a_stiff_wall_without_damper_would_lose():
    plain = least_interaction("unprotected", 0)
    observed = least_interaction("passivity_observer", 0)
    assert plain.least_interaction < -0.05
    assert observed.least_interaction > 0.02 * plain.least_interaction
    assert observed.recovered > 0.0
    assert observed.damping_most > 10.0


def test_the_observer_does_nothing_while_more_was_put_in_than_taken_out():
    """It guards eq. 3 only: energy that the model should have dissipated may be given back (sec. II of the paper)."""
    wall = SpringDamperWall(stiffness=1000.0, damping=5.0)
    loop = LoopProperties(sample_time=2e-3, delay=1, moving_mass=0.25)
    runs = [
        sampled(USER_S, build_controller(wall, algorithm, None, loop), 2e-3, 2.0, 1)
        for algorithm in ("unprotected", "passivity_observer")
    ]
    assert np.array_equal(runs[0].torque, runs[1].torque)
    assert sum(balance.gen for balance in runs[1].balances) > 1e-3


def test_the_damper_of_the_observer_keeps_its_own_limit():
    summary = least_interaction("passivity_observer", 1, PassivityObserverParameters(damping_limit=7.0))
    assert summary.damping_most == pytest.approx(7.0)


def test_force_augmentation_has_the_reach_and_the_coarse_step_of_its_source_where_none_is_given():
    parameters = ForceAugmentationParameters()
    assert (parameters.reach, parameters.coarse) == (1e-5, 1000.0)
