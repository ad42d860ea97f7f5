import math
from typing import Any

import numpy as np
import pytest

from canhaptic.errors import ParameterError
from canhaptic.sim.plant.effects import encoder_noise
from canhaptic.sim.plant.effects.voltage_limit import VoltageLimit
from tests.plant.plant_scenes import (
    DAMPING,
    MASS,
    MS,
    ReferenceMode,
    Way,
    hand,
    largest_flow,
    make_plant,
    reference,
    residual,
    run,
)

TORQUES = [2.0 * math.sin(0.05 * k) for k in range(150)]


def difference(plant_positions: np.ndarray, expected: np.ndarray) -> float:
    return float(np.abs(plant_positions - expected).max())


def free(time: float, state: Any, torque: float) -> list[float]:
    q, v = state[:2]
    return [v, (torque + hand(time, q, v) - DAMPING * v) / MASS]


def test_coulomb_friction_agrees_with_an_event_located_reference():
    kinetic, static = 0.3, 0.5

    def sliding(sign: float) -> ReferenceMode:
        return ReferenceMode(
            lambda t, y, u: [y[1], free(t, y, u)[1] - sign * kinetic / MASS],
            [Way(lambda t, y, u: sign * y[1], "stuck", lambda y: np.array([y[0], 0.0]))],
        )

    def margin(sign: float) -> Way:
        return Way(lambda t, y, u: static - sign * MASS * free(t, y, u)[1], "forward" if sign > 0 else "backward")

    modes = {
        "stuck": ReferenceMode(lambda t, y, u: [0.0, 0.0], [margin(1.0), margin(-1.0)]),
        "forward": sliding(1.0),
        "backward": sliding(-1.0),
    }
    torques = [2.0 * math.sin(0.05 * k) for k in range(200)]
    expected = reference(modes, "stuck", [0.0, 0.0], torques, 1e-3)
    plant = make_plant({"type": "coulomb_friction", "kinetic": kinetic, "static": static})
    assert difference(run(plant, torques), expected[:, 0]) <= 2e-9
    assert plant.events >= 4
    assert residual(plant) <= 1e-12 * largest_flow(plant)


@pytest.mark.parametrize("time_constant", [50e-6, 2e-3])
@pytest.mark.parametrize("period", [MS, 20 * MS])
def test_the_current_loop_agrees_with_closed_form_steps_up_to_four_hundred_time_constants(time_constant, period):
    plant = make_plant({"type": "current_loop", "time_constant": time_constant}, user=None, damping=0.0, period=period)
    torques = [1.0, -2.0, 0.5, 0.0, 3.0]
    positions = run(plant, torques)
    q = v = current = 0.0
    sample = period * 1e-9
    for k, held in enumerate(torques):
        lost = -math.expm1(-sample / time_constant)
        gap = current - held
        q += v * sample + (held * sample**2 / 2 + gap * time_constant * (sample - time_constant * lost)) / MASS
        v += (held * sample + gap * time_constant * lost) / MASS
        current = held + gap * (1 - lost)
        assert positions[k + 1] == pytest.approx(q, rel=1e-12)
    assert plant.energy().motor == pytest.approx(0.5 * MASS * v * v, rel=1e-12)


WINDING = {"type": "voltage_limit", "supply": 6.0, "back_emf": 2.0, "resistance": 1.5, "inductance": 3e-3}


def test_a_winding_at_its_supply_is_the_closed_form_of_a_stalled_and_of_a_running_motor():
    """Stalled, K U / R (1 - exp(-t R / L)); running free, to U / K. Then a torque below both, followed as asked."""
    loop, torque = {"type": "current_loop", "time_constant": 1e-5}, 2.0 * 6.0 / 1.5
    stalled = make_plant(loop, WINDING, user=None, mass=1e6, damping=0.0)
    stalled.begin(0)
    for k in range(1, 6):
        stalled.advance_to(k * MS, 100.0)
        assert stalled.motor_torque == pytest.approx(torque * -math.expm1(-k * 1e-3 * 1.5 / 3e-3), rel=1e-7)
    stalled.advance_to(7 * MS, 1.0)
    assert stalled.motor_torque == pytest.approx(1.0, rel=1e-9)
    running = make_plant(loop, WINDING, user=None, damping=0.0)
    running.begin(0)
    for k in range(1, 2001):
        running.advance_to(k * MS, 100.0)
    assert running.velocity == pytest.approx(6.0 / 2.0, rel=1e-3)
    assert running.energy().motor == pytest.approx(0.5 * MASS * running.velocity**2, rel=1e-9)
    assert running.events <= 2
    free = make_plant(loop, {**WINDING, "supply": 1e6}, user=None)
    bare = make_plant(loop, user=None)
    assert run(free, [1.0, -2.0, 0.5]) == pytest.approx(run(bare, [1.0, -2.0, 0.5]), rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("torque", [1.0, 4.0, 8.0])
def test_the_slowest_lag_of_a_winding_bounds_how_late_its_torque_is(torque):
    limit, lag = VoltageLimit(**{key: of for key, of in WINDING.items() if key != "type"}), 1e-4
    slowest = limit.slowest_lag(lag, torque, 0.5)
    assert (slowest == math.inf) is (1.5 * torque / 2.0 + 2.0 * 0.5 + 1e-9 >= 6.0)
    for speed in (-0.5, 0.5):
        plant = make_plant({"type": "current_loop", "time_constant": lag}, WINDING, user=None, mass=1e6, damping=0.0,
                           initial_velocity=speed)  # fmt: skip
        plant.begin(0)
        held = -torque
        plant.advance_to(MS * 20, held)
        missing = 0.0
        for k in range(1, 2000):  # the area between step and response, in units of the step
            plant.advance_to(MS * 20 + k * 10_000, torque)
            missing += (torque - plant.motor_torque) * 1e-5
        assert missing <= slowest * 2.0 * torque * (1.0 + 1e-2)


def test_a_voltage_limit_without_a_current_loop_is_refused():
    with pytest.raises(ParameterError, match="voltage_limit: got no current_loop, expected one"):
        make_plant(WINDING)


def shaft_rates(time: float, y: Any, torque: float, force: float) -> list[float]:
    """[motor position, motor velocity, load position, load velocity] under a shaft force."""
    return [
        y[1],
        (torque - DAMPING * y[1] - force) / MASS,
        y[3],
        (hand(time, y[2], y[3]) + force) / 0.1,
    ]


def test_shaft_compliance_agrees_with_an_adaptive_integrator():
    def rates(t: float, y: Any, u: float) -> list[float]:
        return shaft_rates(t, y, u, 1e5 * (y[0] - y[2]) + 10 * (y[1] - y[3]))

    expected = reference({"only": ReferenceMode(rates)}, "only", [0, 0, 0, 0], TORQUES, 1e-3)
    plant = make_plant({"type": "shaft_compliance", "stiffness": 1e5, "damping": 10, "load_mass": 0.1})
    assert difference(run(plant, TORQUES), expected[:, 0]) <= 1e-11
    assert residual(plant) <= 1e-12 * largest_flow(plant)


def test_backlash_agrees_with_an_event_located_reference():
    stiffness, damping, half = 1e5, 10.0, 0.5e-3

    def force(y: Any, sign: float) -> float:
        depth = y[4] if sign > 0 else y[5]
        return sign * stiffness * depth + damping * (y[1] - y[3])

    def rates(sign: float) -> Any:
        def write(t: float, y: Any, u: float) -> list[float]:
            shaft = force(y, sign) if sign else 0.0
            creep = [-stiffness / damping * y[4], -stiffness / damping * y[5]]
            if sign:
                creep[0 if sign > 0 else 1] = sign * (y[1] - y[3])
            return [*shaft_rates(t, y, u, shaft), *creep]

        return write

    def meet(sign: float) -> Way:
        index = 4 if sign > 0 else 5

        def reset(y: Any) -> Any:
            y = y.copy()
            y[index] = sign * (y[0] - y[2]) - half
            return y

        way = "forward" if sign > 0 else "backward"
        return Way(lambda t, y, u: 1e3 * (y[index] - sign * (y[0] - y[2]) + half), way, reset)

    modes = {
        "free": ReferenceMode(rates(0.0), [meet(1.0), meet(-1.0)]),
        "forward": ReferenceMode(rates(1.0), [Way(lambda t, y, u: force(y, 1.0), "free")]),
        "backward": ReferenceMode(rates(-1.0), [Way(lambda t, y, u: -force(y, -1.0), "free")]),
    }
    shaft = {"type": "shaft_compliance", "stiffness": stiffness, "damping": damping, "load_mass": 0.1}
    plant = make_plant(shaft, {"type": "backlash", "gap": 2 * half})
    expected = reference(modes, "free", [0.0] * 6, TORQUES, 1e-3)
    assert difference(run(plant, TORQUES), expected[:, 0]) <= 1e-9
    assert plant.events >= 4
    assert residual(plant) <= 1e-12 * largest_flow(plant)


def test_a_push_below_stiction_creeps_exactly_nowhere_in_ten_seconds():
    plant = make_plant({"type": "coulomb_friction", "kinetic": 0.3, "static": 0.5}, user=None, initial_position=0.01)
    assert set(run(plant, [0.3] * 10_000)) == {0.01}
    assert plant.velocity == 0.0
    assert plant.events == 0


def test_friction_decelerates_by_the_textbook_and_stops_for_good():
    plant = make_plant(
        {"type": "coulomb_friction", "kinetic": 0.5, "static": 0.5}, user=None, damping=0.0, initial_velocity=0.2
    )
    run(plant, [0.0] * 200)
    assert plant.position == pytest.approx(0.2**2 * MASS / (2 * 0.5), rel=1e-9)
    assert plant.velocity == 0.0
    assert plant.energy().dissipated == pytest.approx(0.5 * MASS * 0.2**2, rel=1e-12)


def test_commands_are_clipped_rounded_and_derated():
    clipped = make_plant({"type": "torque_saturation", "limit": 0.5}, user=None)
    plain = make_plant(user=None)
    assert np.array_equal(run(clipped, [2.0, -3.0, 0.2]), run(plain, [0.5, -0.5, 0.2]))
    rounded = make_plant({"type": "torque_quantisation", "quantum": 0.25}, user=None)
    assert np.array_equal(run(rounded, [0.3, -0.4, 0.1]), run(make_plant(user=None), [0.25, -0.5, 0.0]))


def test_a_winding_warms_exponentially_and_holds_the_torque_it_can_stand():
    derating = {
        "type": "thermal_derating", "torque_limit": 2.0, "copper_loss": 1.0, "thermal_resistance": 50.0,
        "time_constant": 0.5, "ambient": 300.0, "warm": 350.0, "hot": 400.0,
    }  # fmt: skip
    plant = make_plant(derating, user=None)
    winding = plant.scene.commands[0]
    run(plant, [1.0] * 300)
    assert winding.temperature == pytest.approx(300 + 50 * (1 - math.exp(-0.3 / 0.5)), rel=1e-12)  # type: ignore[attr-defined]
    plant.reset()
    run(plant, [2.0] * 10_000)
    held = 2.0 * (400.0 - winding.temperature) / 50.0  # type: ignore[attr-defined]
    assert winding.temperature == pytest.approx(300 + 50 * held**2, rel=1e-6)  # type: ignore[attr-defined]
    assert 0.5 < held < 2.0


@pytest.mark.parametrize(
    ("seed", "published"),
    [
        (0, [0xE220A8397B1DCDAF, 0x6E789E6AA1B965F4, 0x06C45D188009454F]),
        (1234567, [6457827717110365317, 3203168211198807973, 9817491932198370423]),
    ],
)
def test_noise_comes_from_splitmix64(seed, published):
    """The published first numbers of that generator."""
    assert [encoder_noise._mix(seed + step * encoder_noise._GAMMA) for step in (1, 2, 3)] == published


def test_the_encoder_reads_steps_and_repeatable_noise():
    plant = make_plant({"type": "encoder_quantisation", "count": 1e-4}, {"type": "encoder_noise", "deviation": 1e-3})
    plant.begin(0)
    readings, errors = [], []
    for k in range(4000):
        plant.advance_to((k + 1) * MS, 0.0)
        assert plant.encoder_position == plant.encoder_position
        readings.append(plant.encoder_position)
        errors.append(plant.encoder_position - plant.position)
    assert np.allclose(np.array(readings) / 1e-4, np.round(np.array(readings) / 1e-4), atol=1e-9)
    assert np.std(errors) == pytest.approx(1e-3, rel=0.05)
    assert abs(np.mean(errors)) < 1e-4
    again = make_plant(
        {"type": "encoder_quantisation", "count": 1e-4}, {"type": "encoder_noise", "deviation": 1e-3}, seed=2
    )
    run(again, [0.0] * 4000)
    assert again.position == plant.position
    assert again.encoder_position != plant.encoder_position
    assert np.isnan(plant.scene.encoders[-1].read(float("nan"), 0, 0))  # for the drive to find, not an exception
