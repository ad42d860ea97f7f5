"""Cup and ball against its continuous equations, and the paper's mass with force in and velocity out (AD8)."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from canhaptic.control.admittance import DISPLAY_ALGORITHMS, build_display_controller
from canhaptic.control.admittance.admittance_environment import AdmittanceEnvironment, AdmittanceMass
from canhaptic.control.admittance.cup_and_ball import CupAndBall
from canhaptic.control.admittance.dissipating_admittance import next_speed
from canhaptic.control.admittance.port import AdmittanceProperties
from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters
from canhaptic.control.balance import Certificate, residual
from canhaptic.errors import ParameterError

_GRAVITY = 9.80665


def _sampled(environment: CupAndBall, forces: list[float], time: float) -> tuple[list[float], float, float]:
    """Returns (states, speed, position) after one hold under each force."""
    inner, speed, position = [0.0] * environment.states, 0.0, 0.0
    for force in forces:
        before, speed = speed, environment.speed_after(inner, speed, force, position, time)
        environment.go_along(inner, before, speed, time)
        position += speed * time
    return inner, speed, position


def _continuous(environment: CupAndBall, force: float, duration: float) -> np.ndarray:
    """Returns angle, rate, speed and position by the equations of motion, solved apart."""
    cup, ball, length, damping = environment.cup, environment.ball, environment.length, environment.damping

    def rates(_time: float, state: np.ndarray) -> list[float]:
        angle, rate, speed, _ = state
        inertia = [[cup + ball, ball * length * math.cos(angle)], [math.cos(angle), length]]
        push = [force - damping * speed + ball * length * rate * rate * math.sin(angle), -_GRAVITY * math.sin(angle)]
        change = np.linalg.solve(inertia, push)
        return [rate, change[1], change[0], speed]

    found = solve_ivp(rates, (0.0, duration), [0.0] * 4, rtol=1e-9, atol=1e-12)
    return np.asarray(found.y[:, -1])


def test_cup_and_ball_follow_their_equations_in_first_order() -> None:
    environment = CupAndBall(damping=1.0)
    true, errors = _continuous(environment, 12.0, 0.8), []
    for time in (2e-3, 1e-3):
        (angle, rate, _), speed, position = _sampled(environment, [12.0] * round(0.8 / time), time)
        errors.append(float(np.abs(np.array([angle, rate, speed, position]) - true).max()))
    assert errors[1] < 1e-2
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.4)


def test_a_free_cup_with_its_ball_keeps_momentum_and_energy() -> None:
    environment = CupAndBall()
    time, inner, speed = 1e-3, [0.8, 0.0, 0.0], 0.0
    energy = environment.stored(inner, speed, 0.0)
    for _ in range(3000):
        before, speed = speed, environment.speed_after(inner, speed, 0.0, 0.0, time)
        environment.go_along(inner, before, speed, time)
        along = environment.inertia * speed + environment.ball * environment.length * math.cos(inner[0]) * inner[1]
        assert abs(along + inner[2]) < 1e-12  # the push of the hold that ended comes with the next speed
        assert environment.stored(inner, speed, 0.0) == pytest.approx(energy, rel=0.01)


def test_the_balance_of_the_paper_holds_to_rounding() -> None:
    random, kept = np.random.default_rng(0), 0
    for _ in range(300):
        mass, damping, time = random.uniform(0.1, 5.0), random.choice([0.0, 5.0, 100.0]), random.choice([1e-3, 4e-3])
        environment = AdmittanceMass(mass=mass, damping=damping)
        speed, impulse, risen = random.normal(0.0, 0.5), random.normal(0.0, 0.02), random.normal(0.0, 1e-3)
        found = next_speed(environment, time, speed, impulse, risen)
        left = (
            0.5 * mass * found**2 + time * damping * speed * found - (0.5 * mass * speed**2 + speed * impulse - risen)
        )
        if found != 0.0:
            kept += 1
            assert abs(left) < 1e-12 * (1.0 + mass * speed**2)
        share = time * damping / mass
        overdrawn = (1.0 + share * share) * mass * speed**2 / 2.0 + speed * impulse - risen < 0.0
        assert found != 0.0 or overdrawn or 0.5 * mass * speed**2 + speed * impulse - risen < 0.0
    assert kept > 200


def test_a_start_creates_no_more_than_the_square_of_its_impulse() -> None:
    properties = AdmittanceProperties(
        sample_time=1e-3, delay=1, sampling="mean", force_slew=1e-3, handle_acceleration=10.0, speed_limit=5.0,
        acceleration_limit=1e3,
    )  # fmt: skip
    controller = build_display_controller(AdmittanceMass(mass=0.5), "internal_dissipation", None, properties)
    controller.step(0.0, 0.0)
    for force in (3.0, -2.0, 7.0):
        controller.reset()
        controller.step(0.0, -force)
        balance = controller.step(0.0, -force)
        assert balance.torque == pytest.approx(force * 1e-3 / 0.5)  # no hold of rest before it
        assert balance.gen == pytest.approx((force * 1e-3) ** 2 / (2.0 * 0.5), rel=1e-6)


def _pushed(environment: AdmittanceEnvironment, algorithm: str, holds: int) -> tuple[Any, float]:
    """Returns a controller whose drive follows at once, after holds under 6 N, and the position [m]."""
    properties = AdmittanceProperties(
        sample_time=1e-3, delay=1, sampling="mean", force_slew=1e-3, handle_acceleration=50.0, speed_limit=5.0,
        acceleration_limit=20.0,
    )  # fmt: skip
    drive = GuardedAdmittanceParameters(drive_mass=1.0, loop_gain=200.0, energy_allowance=1.0)
    known = drive if algorithm == "guarded" else None
    controller, position, speed = build_display_controller(environment, algorithm, known, properties), 0.0, 0.0
    for _ in range(holds):
        position += 1e-3 * speed
        speed = controller.step(position, -6.0).torque
    return controller, position


@pytest.mark.parametrize("algorithm", ["unprotected", "guarded"])
def test_the_ball_swings_on_where_samples_are_lost(algorithm: str) -> None:
    environment = CupAndBall()
    controller, _ = _pushed(environment, algorithm, 200)
    inner = controller.of._inner[0]
    expected, before = [*inner], controller.of._each[0].commands.speed
    for _ in range(30):
        speed = controller.sample_lost().torque
        environment.go_along(expected, before, speed, 1e-3)
        before = speed
    assert expected == [*inner]
    assert abs(expected[1]) > 0.1


@pytest.mark.parametrize("algorithm", [name for name in DISPLAY_ALGORITHMS if name != "guarded"])
def test_after_a_lost_sample_the_speed_rises_from_the_zero_that_was_sent(algorithm: str) -> None:
    """0.02 m/s in a hold is the limit of the acceleration, and 30 N a hard push."""
    controller, position = _pushed(AdmittanceMass(mass=0.5), algorithm, 60)
    assert controller.of._each[0].commands.speed > 0.3
    assert controller.sample_lost().torque == 0.0
    assert 0.0 < controller.step(position, -30.0).torque <= 0.02 + 1e-12


def test_the_balance_of_the_paper_is_for_a_mass() -> None:
    properties = AdmittanceProperties(
        sample_time=1e-3, force_slew=1e3, handle_acceleration=10.0, speed_limit=5.0, acceleration_limit=1e3
    )
    with pytest.raises(ParameterError, match="virtual_mass"):
        build_display_controller(CupAndBall(), "internal_dissipation", None, properties)


def test_the_balance_of_the_paper_takes_nothing_out_beyond_the_damper_of_the_mass() -> None:
    controller, place = _pushed(AdmittanceMass(mass=3.0, damping=5.0), "internal_dissipation", 30)
    taken = set()
    for k in range(60):
        balance = controller.step(place, -5.0 * math.cos(0.1 * k))
        taken.add(balance.h_pas)
        place += 1e-3 * balance.torque
    assert taken == {0.0}
    assert balance.h_i != 0.0


def test_the_account_of_a_display_without_a_certificate_closes() -> None:
    controller, place = _pushed(AdmittanceMass(mass=3.0, damping=5.0), "unprotected", 30)
    stored = controller.step(place, -6.0).h_s
    for k in range(60):
        balance = controller.step(place, -5.0 * math.cos(0.1 * k))
        assert abs(residual(balance, stored)) < 1e-12
        stored, place = balance.h_s, place + 1e-3 * balance.torque
    assert stored > 0.0


@pytest.mark.parametrize(("integral", "jitter", "loses"), [(900.0, 0.1, False), (0.5, 0.0, True), (900.0, 0.0, True)])
def test_an_integral_proves_nothing_where_holds_are_uneven_or_may_be_longer(
    integral: float, jitter: float, loses: bool
) -> None:
    properties = AdmittanceProperties(
        sample_time=1e-3, delay=1, sampling="mean", force_slew=1e-3, handle_acceleration=50.0, speed_limit=5.0,
        acceleration_limit=20.0, jitter=jitter,
    )  # fmt: skip
    drive = GuardedAdmittanceParameters(drive_mass=1.0, loop_gain=200.0, integral_gain=integral, energy_allowance=1.0)
    controller: Any = build_display_controller(AdmittanceMass(mass=3.0), "guarded", drive, properties)
    for _ in range(4):
        before = controller.step(0.0, -0.5)
    assert (before.certificate == Certificate.NONE.value) is (jitter > 0.0)
    if loses:
        controller.sample_lost()
        controller.note_skipped_syncs(2.0)
        assert controller.step(0.0, -0.5).certificate == Certificate.NONE.value
