"""The plant and its textbook twin agree: equations written twice, solved by methods that share nothing."""

import math
from typing import Literal

import pytest

from canhaptic.errors import InputError, ParameterError
from canhaptic.lab.judge.reference_model import Model, difference
from canhaptic.lab.judge.solvers import METHODS, fixed_step, located, reference
from canhaptic.lab.reference import textbook_model
from canhaptic.lab.studies.accuracy.plant_solvers import fitted_order
from canhaptic.scene.far_side import build_plant
from canhaptic.sim.plant.direct_rig import observed
from canhaptic.sim.plant.effects import EFFECTS as ALL_EFFECTS
from canhaptic.sim.plant.effects.viscous_friction import ViscousFriction
from canhaptic.sim.plant.plant import Plant
from tests.lab.accuracy.accuracy_scenes import (
    EFFECTS,
    EXACT,
    PERIOD,
    PLANT,
    WARM,
    random_torques,
    simulation,
    smooth_torques,
)
from tests.plant.read_effect import read_effect

HOLDS = 60
SECONDS = PERIOD * 1e-9


def apart(one, other):
    return difference(one, other, PLANT.mass, SECONDS)


@pytest.mark.slow
@pytest.mark.parametrize("name", EXACT)
def test_an_exact_plant_is_where_dop853_has_its_textbook_twin(name):
    scene, torques = simulation(*EFFECTS[name]), random_torques(HOLDS)
    exact = reference(textbook_model(scene), torques, PERIOD)
    error = apart(observed(build_plant(scene, PERIOD), torques), exact)
    assert error.position < 1e-10
    assert error.energy < 1e-9
    assert exact.user.min() < -1e-6 or exact.user.max() > 1e-4  # something happened


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(EFFECTS) - set(EXACT)))
def test_an_approximate_plant_converges_to_its_textbook_twin(name):
    torques = random_torques(HOLDS)
    exact = reference(textbook_model(simulation(*EFFECTS[name])), torques, PERIOD)
    errors = [
        apart(observed(build_plant(simulation(*EFFECTS[name], substeps=n), PERIOD), torques), exact).position
        for n in (1, 64)
    ]
    assert errors[1] < 2e-7
    assert errors[1] < errors[0] / 10.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stribeck_friction", "hard_stop", "lugre_friction"])
def test_two_solvers_agree_on_the_textbook_twin(name):
    torques = random_torques(40)
    exact = reference(textbook_model(simulation(*EFFECTS[name])), torques, PERIOD)
    witness = located(textbook_model(simulation(*EFFECTS[name])), torques, PERIOD, "LSODA", 1e-9, 1e-12)
    assert apart(witness, exact).position < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("method", sorted(METHODS))
@pytest.mark.parametrize("effects", [(), EFFECTS["cogging"]], ids=["linear", "cogging"])
def test_a_fixed_step_method_has_its_declared_order(method, effects):
    order, make = METHODS[method]
    scene, torques = simulation(*effects), random_torques(30)
    exact = reference(textbook_model(scene), torques, PERIOD)
    counts = (1, 2, 4, 8)
    motions = [fixed_step(textbook_model(scene), torques, PERIOD, make(), count) for count in counts]
    errors = [apart(motion, exact).position for motion in motions]
    travel = float(exact.position.max() - exact.position.min())
    fitted = fitted_order([1.0 / count for count in counts], errors, travel)
    assert fitted == pytest.approx(order, abs=0.2), errors


@pytest.mark.slow
@pytest.mark.parametrize("method", sorted(METHODS))
def test_a_fixed_step_method_falls_to_order_1_where_modes_change(method):
    scene, torques = simulation(*EFFECTS["hard_stop"]), random_torques(60)
    exact = reference(textbook_model(scene), torques, PERIOD)
    make = METHODS[method][1]
    errors = [
        apart(fixed_step(textbook_model(scene), torques, PERIOD, make(), count), exact).position for count in (16, 256)
    ]
    assert 4.0 < errors[0] / errors[1] < 256.0  # 16 at order 1; 256 at order 2, 65536 at order 4


@pytest.mark.slow
@pytest.mark.parametrize(
    "effects",
    [
        EFFECTS["cogging"],
        EFFECTS["torque_ripple"],
        EFFECTS["lugre_friction"],
        EFFECTS["stribeck_friction"],
        (*EFFECTS["torque_ripple"], *EFFECTS["current_loop"]),
        (*EFFECTS["cogging"], *EFFECTS["current_loop"], *EFFECTS["torque_ripple"]),
    ],
    ids=["cogging", "ripple", "lugre", "stribeck", "ripple behind a current loop", "all of a motor"],
)
def test_an_approximate_effect_has_its_declared_order_beside_the_textbook(effects):
    torques, counts = smooth_torques(40), (2, 4, 8, 16)
    exact = reference(textbook_model(simulation(*effects)), torques, PERIOD)
    errors = [
        apart(observed(build_plant(simulation(*effects, substeps=n), PERIOD), torques), exact).position for n in counts
    ]
    fitted = fitted_order([1.0 / count for count in counts], errors, 0.03)
    declared = min(e.parameters.order for e in simulation(*effects).effects if e.parameters.order is not None)
    assert fitted == pytest.approx(declared, abs=0.25), errors


@pytest.mark.slow
def test_thermal_derating_has_its_declared_order_in_the_sample_time():
    effect = {"type": "thermal_derating", "torque_limit": 2.0, "warm": 320.0, "hot": 400.0, **WARM}
    errors, periods = [], (4_000_000, 2_000_000, 1_000_000, 500_000)
    for period in periods:
        count = 80_000_000 // period
        scene, torques = simulation(effect), [1.5] * count
        exact = reference(textbook_model(scene), torques, period)
        plant = build_plant(scene, period)
        errors.append(abs(observed(plant, torques).position[-1] - exact.position[-1]))
    fitted = fitted_order([period / 1e6 for period in periods], errors, 0.03)
    assert fitted == pytest.approx(1.0, abs=0.25), errors


def test_the_reference_can_be_stopped():
    with pytest.raises(InputError, match="stopped before the reference"):
        reference(textbook_model(simulation()), random_torques(40), PERIOD, lambda: True)


def test_a_diverging_method_gives_an_infinite_error():
    scene, torques = simulation({"type": "current_loop", "time_constant": 2e-5}), random_torques(60)
    motion = fixed_step(textbook_model(scene), torques, PERIOD, METHODS["RK4"][1](), 1)
    exact = observed(build_plant(scene, PERIOD), torques)
    assert not apart(motion, exact).is_finite


def test_a_guard_that_stays_at_zero_is_no_event():
    stop = {"type": "hard_stop", "position": 0.0, "stiffness": 1e5, "damping": 3.0}
    scene = simulation(*EFFECTS["coulomb_friction"], stop, user=None)
    exact = reference(textbook_model(scene), [0.1] * 5, PERIOD)  # stuck where the stop begins
    assert float(abs(exact.position).max()) == 0.0


@pytest.mark.slow
def test_closed_forms_of_a_slide_to_rest_and_of_an_elastic_bounce():
    moving = PLANT.model_copy(update={"damping": 0.0, "initial_velocity": 0.3})
    friction = [read_effect({"type": "coulomb_friction", "kinetic": 0.3, "static": 0.5})]
    slide = reference(Model(moving, None, friction), [0.0] * 300, PERIOD)
    assert slide.position[-1] == pytest.approx(0.25 * 0.3**2 / (2.0 * 0.3), rel=1e-11)  # m v^2 / (2 F)
    assert slide.velocity[-1] == 0.0
    stop = [read_effect({"type": "hard_stop", "position": 0.01, "stiffness": 1e6})]
    bounce = reference(Model(moving, None, stop), [0.0] * 60, PERIOD)
    contact = math.pi * math.sqrt(0.25 / 1e6)  # half a period of mass and spring
    assert bounce.velocity[-1] == pytest.approx(-0.3, rel=1e-10)
    assert bounce.position[-1] == pytest.approx(0.01 - 0.3 * (0.06 - 0.01 / 0.3 - contact), rel=1e-9)


class Eddies(ViscousFriction):
    """An effect that the plant takes and the textbook has never heard of."""

    type: Literal["eddies"] = "eddies"  # type: ignore[assignment]


def test_an_effect_without_textbook_equations_is_refused_by_name():
    unknown = Eddies(damping=2.0)
    plant = Plant(PLANT, None, [unknown], PERIOD)  # the plant itself simulates it
    plant.begin(0)
    plant.advance_to(PERIOD, 1.0)
    with pytest.raises(ParameterError, match="got 'eddies', for which the textbook plant has no equations") as refused:
        Model(PLANT, None, [unknown])
    assert refused.value.part == "eddies"
    shaft = read_effect({"type": "shaft_compliance", "load_mass": 1.0, "stiffness": 1e4})
    with pytest.raises(ParameterError, match=r"shaft_compliance for the 2\. time"):
        Model(PLANT, None, [shaft, shaft])


def test_every_effect_of_the_plant_has_textbook_equations():
    compared = {effect["type"] for effects in EFFECTS.values() for effect in effects}
    apart = {"thermal_derating", "encoder_noise", "encoder_quantisation"}  # a test of its own, and not of the motion
    assert compared | apart == set(ALL_EFFECTS)
