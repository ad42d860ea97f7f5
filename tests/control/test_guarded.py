"""`guarded` judged by the energy of the plant: six kinds of user within what is declared, and beyond it."""

import itertools
import math
import random
import statistics
from typing import Any

import pytest

from canhaptic.control.balance import Branch, Certificate, residual
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import LoopProperties, build_controller
from canhaptic.control.passivity.guarded import GuardedParameters
from canhaptic.errors import ParameterError
from tests.adversary.axis import MASS, PUSH, Loss, guarded, run
from tests.adversary.users import HAND_FORCE, USERS

WALLS = [
    (1e2, 0.0),
    (1e2, 50.0),
    (1e3, 0.0),
    (1e3, 20.0),
    (1e4, 0.0),
    (1e4, 50.0),
    (1e5, 0.0),
    (1e5, 50.0),
    (1e6, 0.0),
    (1e6, 500.0),
    (0.0, 100.0),
]
RATES = [40, 100, 400, 1000, 10000]
ROUNDING = 1e-12  # [J], against sums of up to a few joules


def inward(damping):
    """The hand pulls along a negative torque, which only a damper makes, when it pushes inward."""
    return HAND_FORCE if damping else PUSH


def trial(wall, rate, delay, user, seed, *, cycles=1500, count=0.0, quantum=0.0, share=0.0, **known):
    losses: dict[str, Any] = {"max_consecutive_losses": 2} if share else {}
    controller = guarded(*wall, rate, delay, count=count, quantum=quantum, **losses, **known)  # type: ignore[call-arg, misc]
    return run(
        controller,
        USERS[user](random.Random(seed)),
        rate,
        min(3 * rate, cycles),
        delay=delay,
        push=inward(wall[1]),
        count=count,
        quantum=quantum,
        loss=Loss(share) if share else None,
        seed=seed,
    )


@pytest.mark.slow_but("adversary-1", "sudden_pull-0", "telegraph-0")
@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("user", sorted(USERS))
def test_no_user_within_the_hand_force_takes_out_more_than_came_in(user, delay):
    """A2, A3 in small; the large sweep is below."""
    for seed, (wall, rate) in enumerate(itertools.product(WALLS[::2], [40, 400, 10000])):
        truth = trial(wall, rate, delay, user, seed, cycles=600)
        assert truth.least >= -ROUNDING
        assert truth.least_margin >= -ROUNDING
        assert truth.believed_error <= ROUNDING


@pytest.mark.slow_but("2e-05-0.02-0.01-1", "0.0005-0.5-0.1-0", "0.0-0.0-0.0-0")
@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.1])
@pytest.mark.parametrize(("count", "quantum"), [(0.0, 0.0), (2e-5, 0.02), (5e-4, 0.5)])
def test_encoder_torque_quantum_and_lost_frames_do_not_make_it_active(share, delay, count, quantum):
    for seed, user in enumerate(USERS):
        for wall, rate in (((1e3, 5.0), 1000), ((1e4, 0.0), 400)):
            truth = trial(wall, rate, delay, user, seed, cycles=200, count=count, quantum=quantum, share=share)
            assert truth.least >= -ROUNDING
            if not share:
                assert truth.believed_error <= truth.error_bound + ROUNDING


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.01, 0.1])
@pytest.mark.parametrize(("count", "quantum"), [(0.0, 0.0), (2e-5, 0.02)])
@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("cycles", [600, pytest.param(4000, marks=pytest.mark.campaign)])
@pytest.mark.timeout(1200)
def test_the_whole_sweep_stays_passive(rate, delay, count, quantum, share, cycles):
    for seed, (wall, user) in enumerate(itertools.product(WALLS, USERS)):
        truth = trial(wall, rate, delay, user, seed, cycles=cycles, count=count, quantum=quantum, share=share)
        assert truth.least >= -1e-6, (wall, user)


@pytest.mark.slow_but("adversary-0", "telegraph-1")
@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("user", sorted(USERS))
def test_with_device_damping_declared_no_user_at_all_takes_more_than_device_and_wall_take_in(user, delay):
    for seed, (wall, rate) in enumerate(itertools.product(WALLS[1::2], [100, 1000])):
        controller = guarded(*wall, rate, delay, hand_force=None, certain=3.0)
        law = USERS[user](random.Random(seed))
        truth = run(controller, law, rate, 500, delay=delay, damping=3.0, hand_force=300.0, push=300.0, seed=seed)
        assert truth.least_with_damping >= -ROUNDING


@pytest.mark.parametrize("delay", [0, 1])
def test_with_a_hand_speed_declared_no_slower_user_takes_out_more_than_came_in_and_the_credit(delay):
    sample_time, top, credit = 1e-2, 0.4, 1e-3
    controller = build_controller(
        SpringDamperWall(stiffness=2000.0, damping=5.0),
        "guarded",
        GuardedParameters(hand_force=None, hand_speed=top, energy_allowance=credit),
        LoopProperties(sample_time=sample_time, delay=delay),
    )
    rng, position, interaction, pending, used = random.Random(3), 0.002, 0.0, [0.0] * (delay + 1), 0.0
    for _ in range(3000):
        held = pending[0]
        moved = rng.choice((-1.0, 1.0, rng.uniform(-1.0, 1.0))) * top * sample_time
        if abs(position + moved) > 0.02:
            moved = -moved
        position += moved
        interaction -= held * moved
        assert interaction >= -credit - ROUNDING
        pending.append(controller.step(position, pending.pop(0)).torque)
        used = max(used, abs(pending[-1]))
    assert used > 0.1


@pytest.mark.parametrize("delay", [0, 1])
def test_beyond_the_declared_force_the_loss_of_a_hold_is_bounded_and_paid_back(delay):
    rate, declared, actual = 1000, 5.0, 40.0
    controller = guarded(1e4, 20.0, rate, delay, hand_force=declared)
    deficits, torques, surplus = [], [0.0], []
    step = controller.step

    def watched(position, held):
        balance = step(position, held)
        deficits.append(balance.deficit)
        torques.append(abs(balance.torque))
        surplus.append(balance.h_dis)
        return balance

    controller.step = watched

    def law(t, q, v, torque):
        if t > 2.0:
            return 600.0 * (0.01 * math.sin(6.0 * math.pi * t) - q) - 5.0 * v
        if q > 0.002:
            return -3.0 - 3.0 * v
        return actual if torque > 0.3 else -6.0

    truth = run(controller, law, rate, 4000, delay=delay, hand_force=actual, push=actual)
    limit = max(torques) * (actual - declared) / (rate * rate * MASS) * (1 + delay)
    assert 0.0 < max(deficits) <= limit
    assert truth.least >= -sum(deficits) - ROUNDING
    assert surplus[-1] <= 0.1 * sum(deficits)


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("stiffness", [1000.0, 5000.0])
def test_after_long_tremor_the_wall_has_the_stiffness_asked(stiffness, delay):
    """A5, with a hand of 300 N/m and 3 Ns/m that trembles for 9 s and rests for 1 s."""
    rate = 1000
    truth = run(
        guarded(stiffness, 0.0, rate, delay, hand_force=0.0),
        lambda t, q, v, _f: 300.0 * (-0.015 + (0.005 * math.sin(16 * math.pi * t) if t < 9.0 else 0.0) - q) - 3.0 * v,
        rate,
        10 * rate,
        delay=delay,
    )
    rest = statistics.fmean(truth.torques[-rate:]) / -statistics.fmean(truth.positions[-rate:])
    assert rest / stiffness >= (0.99 if delay == 0 else 0.95)


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0, 1])
def test_half_the_damping_of_colgate_makes_no_limit_cycle(delay):
    """A6: the plain wall swings 10 mm."""
    truth = run(
        guarded(1000.0, 0.0, 1000, delay, hand_force=0.0, most=0.25),
        lambda *_: -1.0,
        1000,
        20000,
        delay=delay,
        damping=0.25,
        position=0.0,
    )
    last = truth.positions[-2000:]
    assert max(last) - min(last) < 1e-5
    assert statistics.fmean(last) == pytest.approx(-1e-3, rel=0.01)


def test_bad_declarations_are_refused_and_named():
    wall, loop = SpringDamperWall(stiffness=100.0), LoopProperties(sample_time=1e-3)
    with pytest.raises(ParameterError, match="moving_mass"):
        build_controller(wall, "guarded", None, loop)
    with pytest.raises(ParameterError, match="hand_speed"):
        GuardedParameters(hand_speed=0.0)
    with pytest.raises(ParameterError, match="alpha"):
        GuardedParameters(alpha=100.0)


def test_a_softer_wall_says_so():
    """At 40 Hz no hand of 20 N can be certified 1e5 N/m: the balances name the certificate."""
    controller = guarded(1e5, 50.0, 40, 0, hand_force=0.0)
    seen, position, held = set(), 0.01, 0.0
    for _ in range(60):
        balance = controller.step(position, held)
        held, position = balance.torque, position - 0.002
        seen.add((balance.branch, balance.certificate))
        assert balance.damping_rendered < 50.0
    assert (Branch.EXACT, Certificate.HAND_FORCE) in seen


def test_torque_commands_are_whole_quanta_and_never_above_the_bound():
    controller = guarded(1000.0, 5.0, 1000, 0, quantum=0.02)
    position, held = 0.002, 0.0
    for _ in range(60):
        balance = controller.step(position, held)
        held = balance.torque
        assert held / 0.02 == pytest.approx(round(held / 0.02), abs=1e-9)
        position -= 1e-4


@pytest.mark.parametrize("delay", [0, 1])
def test_what_is_taken_from_an_empty_store_is_lacking_though_nothing_dissipates(delay: int) -> None:
    """A torque that was not commanded gives energy out of a wall without a damper, in which nothing was stored."""
    loop = LoopProperties(sample_time=1e-3, delay=delay, moving_mass=0.2, device_damping_bound=0.0)
    controller = build_controller(SpringDamperWall(stiffness=100.0), "guarded", None, loop)
    controller.step(-0.001, 0.0)
    taken = controller.step(-0.0005, 4.0)
    assert (taken.h_i, taken.h_s, taken.deficit, taken.h_dis) == (-0.002, 0.0, 0.002, 0.002)
    assert (taken.branch, taken.torque) == (Branch.DEPLETED, 0.0)
    paid_back = controller.step(-0.001, 2.0)
    assert (paid_back.h_i, paid_back.deficit) == (0.001, 0.0)
    assert residual(paid_back, taken.h_s) == pytest.approx(0.0, abs=1e-18)


def test_a_modulated_damper_pays_the_surplus_back_in_a_wall_that_dissipates_nothing() -> None:
    loop = LoopProperties(sample_time=1e-3, delay=0, moving_mass=0.2, device_damping_bound=0.0)
    parameters = GuardedParameters(alpha="2000 s/m^2")
    controller = build_controller(SpringDamperWall(stiffness=100.0), "guarded", parameters, loop)
    controller.step(-0.001, 0.0)
    last = controller.step(-0.0005, 4.0)
    assert last.h_dis > 0.0
    paid, position = 0.0, -0.0005
    for _ in range(40):
        position -= 1e-4
        balance = controller.step(position, last.torque)
        assert balance.h_dis - last.h_dis == pytest.approx(balance.deficit - balance.h_pas - balance.paid, abs=1e-15)
        assert residual(balance, last.h_s) == pytest.approx(0.0, abs=1e-15)
        paid += balance.h_pas
        last = balance
    assert paid > 1e-4
