"""Figs. 4, 5, 7, 8, 9 of the paper against an independent simulation (A9, A10), without delay and with one sample."""

from functools import partial

import numpy as np
import pytest

from canhaptic.control.balance import residual
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.ledger import Ledger
from canhaptic.control.passivity import LoopProperties, build_controller
from canhaptic.control.passivity.internal_dissipation import InternalDissipation, StoredModelParameters
from canhaptic.control.passivity.stepped import open_hold
from canhaptic.kernels.records import bound
from canhaptic.lab.rivals.a_priori_dissipation import APrioriDissipationParameters
from tests.control.reference_loop import continuous, sampled, user_f, variation

DURATION = 8.0
FINE = np.arange(0.0, DURATION + 5e-5, 1e-4)
FIGURE_4 = {"stiffness": 100.0, "damping": 5.0, "position": 0.0}
FIGURE_7 = {"stiffness": 100.0, "damping": 10.0, "position": -0.05}
RECOVERY = StoredModelParameters(alpha="200 s/m^2")


@pytest.fixture(scope="module")
def reference():
    """The continuous wall's (position, torque) for both figures."""
    return {
        5.0: continuous(user_f(0.1), 100.0, 5.0, 0.0, FINE),
        10.0: continuous(user_f(0.15), 100.0, 10.0, -0.05, FINE),
    }


def render(wall, algorithm, rate, delay=0, parameters=None, **loop):
    """Returns the run of user F on a wall."""
    made = build_controller(
        SpringDamperWall(**wall), algorithm, parameters, LoopProperties(sample_time=1.0 / rate, delay=delay, **loop)
    )
    return sampled(user_f(0.1 if wall is FIGURE_4 else 0.15), made, 1.0 / rate, DURATION, delay)


def account(run):
    ledger = Ledger()
    for cycle, balance in enumerate(run.balances):
        ledger.add(balance, cycle)
    return ledger.summary()


def variation_ratio(run, reference, wall):
    return variation(run.torque) / variation(reference[wall["damping"]][1])


@pytest.mark.slow
@pytest.mark.parametrize("rate", [40, 100])
@pytest.mark.parametrize("wall", [FIGURE_4, FIGURE_7])
@pytest.mark.parametrize("parameters", [None, RECOVERY])
def test_the_papers_force_varies_less_than_one_and_a_half_times_the_continuous_walls(reference, wall, rate, parameters):
    run = render(wall, "internal_dissipation", rate, parameters=parameters)
    assert variation_ratio(run, reference, wall) < 1.5
    assert run.position.min() == pytest.approx(reference[wall["damping"]][0].min(), abs=0.006)


# 10 Ns/m at 40 Hz with one sample of delay is beyond any sampled damper on 0.25 kg: there the cap is needed.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("wall", "rate", "mass"),
    [
        (FIGURE_4, 40, None),
        (FIGURE_4, 100, None),
        (FIGURE_4, 1000, None),
        (FIGURE_7, 40, 0.25),
        (FIGURE_7, 100, None),
        (FIGURE_7, 1000, None),
    ],
)
def test_with_one_sample_of_delay_the_force_varies_less_than_three_times(reference, wall, rate, mass):
    run = render(wall, "internal_dissipation", rate, delay=1, parameters=RECOVERY, moving_mass=mass)
    assert variation_ratio(run, reference, wall) < 3.0


@pytest.mark.slow
def test_booking_the_newest_damper_effort_instead_would_ring_with_one_sample_of_delay(reference, monkeypatch):
    """Trap 11: the printed H_R, with the velocity of the newest command, at 1 kHz."""

    def newest(settings, axis, memory, position, torque_applied):
        effort = memory.commands.dampers[axis.oldest - 1]
        return open_hold(settings, axis, memory, position, torque_applied)._replace(damper=effort)

    paired = render(FIGURE_7, "internal_dissipation", 1000, delay=1)
    kernel = InternalDissipation.kernel
    step = bound(kernel.step, {"open_hold": partial(newest)})
    monkeypatch.setattr(InternalDissipation, "kernel", kernel._replace(step=step))
    printed = render(FIGURE_7, "internal_dissipation", 1000, delay=1)
    assert variation_ratio(paired, reference, FIGURE_7) < 3.0
    assert variation_ratio(printed, reference, FIGURE_7) > 30.0


def test_the_failure_of_the_original_rests_on_the_printed_start_inside_the_wall(reference):
    run = render(FIGURE_4, "a_priori_dissipation", 100, parameters=APrioriDissipationParameters(rearm="displacement"))
    assert variation_ratio(run, reference, FIGURE_4) < 2.0


@pytest.mark.parametrize("rate", [40, 100])
def test_the_papers_algorithm_keeps_eq_4_within_5_millijoules_and_sticks_before_the_exit(rate):
    run = render(FIGURE_7, "internal_dissipation", rate, parameters=RECOVERY)
    summary = account(run)
    assert summary.margin_value >= -5e-3
    assert summary.least_interaction >= 0.0
    exits = [k for k in range(1, len(run.position)) if run.position[k] >= -0.05 > run.position[k - 1]]
    assert len(exits) == 4
    assert all(run.torque[k] < -1.0 for k in exits)


@pytest.mark.parametrize("delay", [0, 1])
def test_the_modulated_damper_pays_back_what_the_starts_created(delay):
    without = account(render(FIGURE_7, "internal_dissipation", 100, delay))
    recovered = account(render(FIGURE_7, "internal_dissipation", 100, delay, RECOVERY))
    assert recovered.surplus_end <= 0.05 * max(without.surplus_end, 1e-6)
    assert recovered.margin_value >= without.margin_value


@pytest.mark.parametrize("algorithm", ["unprotected", "a_priori_dissipation", "internal_dissipation"])
@pytest.mark.parametrize("delay", [0, 1])
def test_the_account_of_a_whole_figure_closes_at_every_hold(algorithm, delay):
    run = render(FIGURE_7, algorithm, 100, delay)
    for before, now in zip(run.balances, run.balances[1:], strict=False):
        largest = max(now.h_s, before.h_s, abs(now.h_i), now.gen, now.leak)
        assert abs(residual(now, before.h_s)) <= 1e-12 * largest
