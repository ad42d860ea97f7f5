"""Where safety costs most: low rates, a sample of delay, coarse encoders at high rates. Penetration and promise."""

import math
import statistics

import pytest

from canhaptic.control.balance import Certificate
from tests.adversary.axis import guarded, run
from tests.control.reference_loop import USER_S, continuous, sampled


def settle(controller, rate, *, force=1.0, seconds=6.0, damping=0.1, delay=0, count=0.0, grip=0.0, position=0.0):
    """Pushes with a force that rises in 0.3 s; returns (mean penetration of the last second, its swing, truth)."""

    def push(t, _q, v, _f):
        return -force * min(1.0, t / 0.3) - grip * v

    truth = run(
        controller, push, rate, int(seconds * rate), damping=damping, delay=delay, count=count, position=position
    )
    last = truth.positions[-rate:]
    return -statistics.fmean(last), max(last) - min(last), truth


@pytest.mark.slow
@pytest.mark.parametrize("start", [0.0, 0.01])
@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("hand_force", [None, 0.0, 5.0])
def test_at_100_hz_twice_colgates_damping_holds_the_stiffness_asked(hand_force, delay, start):
    """T = 10 ms, k = 500, b = 2 (k T / 2): within 5 %, with sum(h_i) + (b/T) sum(dq^2) >= 0 for every user."""
    controller = guarded(500.0, 0.0, 100, delay, hand_force=hand_force, certain=5.0, most=6.0)
    mean, swing, truth = settle(controller, 100, damping=5.0, delay=delay, position=start)
    assert mean == pytest.approx(1.0 / 500.0, rel=0.01)
    assert swing < 1e-6
    assert truth.least_with_damping >= -1e-12


@pytest.mark.parametrize("start", [0.0, 0.01])
def test_at_100_hz_without_delay_a_hand_that_never_pulls_meets_the_stiffness_asked(start):
    controller = guarded(500.0, 0.0, 100, hand_force=0.0, most=6.0)
    mean, swing, truth = settle(controller, 100, damping=5.0, position=start)
    assert mean == pytest.approx(1.0 / 500.0, rel=0.01)
    assert swing < 1e-6
    assert truth.least >= -1e-12


@pytest.mark.parametrize("delay", [0, 1])
def test_at_100_hz_a_credit_buys_contact_from_a_slow_start_under_a_hand_force(delay):
    controller = guarded(500.0, 0.0, 100, delay, hand_force=5.0, most=6.0, energy_allowance=0.02)
    mean, _, truth = settle(controller, 100, damping=5.0, delay=delay)
    assert mean == pytest.approx(1.0 / 500.0, rel=0.01)
    assert truth.least >= -0.02


@pytest.mark.slow
@pytest.mark.parametrize("delay", [pytest.param(0, marks=pytest.mark.slow), 1])
@pytest.mark.parametrize("hand_force", [0.0, 5.0])
@pytest.mark.parametrize("damping", [0.0, 5.0])
@pytest.mark.parametrize(
    ("rate", "count"), [(1000, 1e-4), (10000, 1e-4), pytest.param(10000, 1e-5, marks=pytest.mark.slow)]
)
def test_a_coarse_encoder_costs_no_stiffness(rate, count, damping, hand_force, delay):
    """The velocity comes from a window, and the outward speed is bounded over the best of many windows."""
    controller = guarded(1000.0, damping, rate, delay, hand_force=hand_force, count=count, most=0.5)
    mean, _, truth = settle(
        controller,
        rate,
        force=4.0,
        seconds=2.5 if rate < 5000 else 1.7,
        damping=0.5,
        delay=delay,
        count=count,
        grip=3.0,
        position=0.002,
    )
    assert mean == pytest.approx(4e-3, rel=0.05)
    assert truth.least >= -1e-12


def rms_error(rate, stiffness, damping, hand_force, delay=0, seconds=3.0, count=0.0):
    controller = guarded(stiffness, damping, rate, delay, hand_force=hand_force, count=count)
    found = sampled(USER_S, controller, 1.0 / rate, seconds, delay, count)
    wanted, _ = continuous(USER_S, stiffness, damping, 0.0, found.time)
    return math.sqrt(float(((found.position - wanted) ** 2).mean()))


@pytest.mark.slow
def test_the_error_falls_with_the_sample_time():
    """A7: order 0.9 to 1.3 between 200 Hz and 12.8 kHz, at most 0.01 mm at the end."""
    rates = [200 * 2**n for n in range(7)]
    errors = [rms_error(rate, 1000.0, 5.0, 0.0) for rate in rates]
    logs = [math.log(rate) for rate in rates]
    order = -statistics.linear_regression(logs, [math.log(error) for error in errors]).slope
    assert 0.9 <= order <= 1.3
    assert errors[-1] <= 1e-5


def test_the_balance_names_the_certificate_that_held():
    controller = guarded(500.0, 0.0, 100, 1, hand_force=20.0, certain=5.0, most=6.0)
    used = {controller.step(0.002 - 0.0005 * cycle, 0.0).certificate for cycle in range(20)}
    assert Certificate.DEVICE_DAMPING in used
    assert Certificate.HAND_FORCE not in used
