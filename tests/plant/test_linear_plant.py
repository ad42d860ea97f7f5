import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from canhaptic.errors import ParameterError
from canhaptic.sim.plant.plant import Plant, PlantParameters
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters

MS = 1_000_000


def user_s() -> UserParameters:
    return UserParameters(stiffness=300, damping=3, motion=SinusoidMotion(amplitude=0.03, frequency=1.0))


def user_f(amplitude: float) -> UserParameters:
    return UserParameters(stiffness=60, damping=5, motion=SinusoidMotion(amplitude=amplitude, frequency=0.5))


def plant_of(user: UserParameters | None, sample_time_ns: int = MS, **values: float) -> Plant:
    return Plant(PlantParameters(**{"mass": 0.25, "damping": 0.1, **values}), user, (), sample_time_ns)


def torque_at(k: int) -> float:
    return 2.0 * math.sin(0.37 * k) - 0.5


def reference(user: UserParameters, torques: list[float], sample_time: float) -> np.ndarray:
    """Position, velocity, hand work, viscous loss at the end, by DOP853 of the equations as written in a textbook."""

    def rates(time: float, state: np.ndarray, torque: float) -> list[float]:
        motion = user.motion
        assert motion is not None
        angle = 2 * math.pi * motion.frequency * time + motion.phase
        target = motion.offset + motion.amplitude * math.sin(angle)
        speed = 2 * math.pi * motion.frequency * motion.amplitude * math.cos(angle)
        hand = user.stiffness * (target - state[0]) + user.damping * (speed - state[1]) + user.push
        return [state[1], (torque + hand - 0.1 * state[1]) / 0.25, hand * state[1], 0.1 * state[1] ** 2]

    state = np.array([0.01, -0.2, 0.0, 0.0])
    for k, torque in enumerate(torques):
        span = (k * sample_time, (k + 1) * sample_time)
        state = solve_ivp(rates, span, state, method="DOP853", rtol=1e-13, atol=1e-16, args=(torque,)).y[:, -1]
    return state


@pytest.mark.parametrize(("user", "period_ns"), [(user_s(), MS), (user_f(0.15), 25 * MS), (user_f(0.1), 10 * MS)])
def test_motion_and_energies_agree_with_an_adaptive_integrator(user, period_ns):
    user = user.model_copy(update={"push": 0.4})
    plant = plant_of(user, period_ns, initial_position=0.01, initial_velocity=-0.2)
    torques = [torque_at(k) for k in range(60)]
    plant.begin(5 * MS)
    for k, torque in enumerate(torques):
        plant.advance_to(5 * MS + (k + 1) * period_ns, torque)
    expected = reference(user, torques, period_ns * 1e-9)
    assert plant.position == pytest.approx(expected[0], rel=1e-11, abs=1e-13)
    assert plant.velocity == pytest.approx(expected[1], rel=1e-10, abs=1e-12)
    assert plant.energy().user == pytest.approx(expected[2], rel=1e-11, abs=1e-14)
    assert plant.energy().dissipated == pytest.approx(expected[3], rel=1e-11, abs=1e-14)


@pytest.mark.slow
@given(st.lists(st.integers(min_value=1, max_value=MS * 3), min_size=1, max_size=6))
def test_stopping_on_the_way_changes_nothing(pauses):
    straight, halting = plant_of(user_s()), plant_of(user_s())
    end = (sum(pauses) // MS + 1) * MS
    for plant in (straight, halting):
        plant.begin(7)
    straight.advance_to(end + 7, 1.5)
    now = 7
    for pause in pauses:
        now += pause
        halting.advance_to(now, 1.5)
    halting.advance_to(end + 7, 1.5)
    assert halting.position == pytest.approx(straight.position, rel=1e-12, abs=1e-15)
    assert halting.energy().user == pytest.approx(straight.energy().user, rel=1e-11, abs=1e-15)


def test_the_plant_stands_still_until_it_begins_and_repeats_after_reset():
    plant = plant_of(user_s(), initial_position=0.02)
    plant.advance_to(3 * MS, 5.0)
    assert (plant.position, plant._epoch) == (0.02, None)
    runs = []
    for _ in range(2):
        plant.begin(10 * MS)
        plant.begin(11 * MS)
        plant.advance_to(12 * MS, 5.0)
        plant.advance_to(13 * MS, 0.0)
        runs.append((plant.position, plant.velocity, plant.energy()))
        plant.reset()
    assert runs[0] == runs[1]
    assert plant.position == 0.02


def test_a_time_before_the_last_call_is_refused():
    plant = plant_of(None)
    plant.begin(0)
    plant.advance_to(2 * MS, 0.0)
    with pytest.raises(ParameterError, match="time went back"):
        plant.advance_to(MS, 0.0)


@pytest.mark.parametrize("values", [{"mass": -0.25}, {"mass": 0.0}, {"damping": -1.0}, {"mass": math.nan}])
def test_values_outside_physics_are_refused_by_name(values):
    with pytest.raises(ParameterError, match=next(iter(values))):
        PlantParameters(**{"mass": 0.25, **values})


@pytest.mark.slow
def test_rounding_does_not_grow_with_the_length_of_a_run():
    plant = plant_of(user_s(), damping=0.1)
    plant.begin(0)
    for k in range(300_000):
        plant.advance_to((k + 1) * MS, -0.5 if k % 2 else 0.0)
    energy = plant.energy()
    assert abs(energy.motor + energy.user - energy.dissipated - energy.stored) <= 3e-13 * energy.user
    # Steady response to the hand after 300 s, in closed form, next to the mean torque.
    omega, stiffness, damping = 2 * math.pi, 300, 3
    force = (stiffness + 1j * omega * damping) * 0.03
    steady = force / (stiffness + 1j * omega * (damping + 0.1) - 0.25 * omega**2)
    assert plant.position == pytest.approx(steady.imag - 0.25 / 300, abs=2e-6)  # 2e-6: ripple of the torque itself


def test_tidying_keeps_the_sums_whole():
    plant = plant_of(user_s())
    plant.begin(0)
    energies = []
    for k in range(2100):
        plant.advance_to((k + 1) * MS, 0.3)
        energies.append(plant.energy().user)
    straight = plant_of(user_s())
    straight.begin(0)
    straight.advance_to(2100 * MS, 0.3)
    assert straight.energy().user == pytest.approx(energies[-1], rel=1e-12)
    assert max(abs(b - a) for a, b in itertools.pairwise(energies)) < 1e-3


def test_the_hands_oscillator_keeps_its_amplitude():
    plant = plant_of(user_s())
    plant.begin(0)
    for k in range(20_480):
        plant.advance_to((k + 1) * MS, 0.0)
    sine, cosine = plant._machine.state[2:4]
    assert math.hypot(sine, cosine) == pytest.approx(1.0, abs=5e-14)
