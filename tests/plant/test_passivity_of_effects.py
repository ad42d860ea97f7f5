"""Nothing in a plant without hand and torque creates energy, alone or in pairs; every balance closes to 1e-12."""

import itertools
from typing import Any

import pytest

from canhaptic.sim.plant.effects import EFFECTS
from tests.plant.plant_scenes import USER_S, largest_flow, make_plant, residual

DRY = {"kinetic": 0.3, "static": 0.5}
SHAFT: dict[str, Any] = {"type": "shaft_compliance", "stiffness": 2e4, "damping": 2.0, "load_mass": 0.1}
VARIANTS: dict[str, list[dict[str, Any]]] = {
    "backlash": [SHAFT, {"type": "backlash", "gap": 1e-3}],
    "cogging": [{"type": "cogging", "amplitude": 0.5, "pitch": 0.01}],
    "coulomb_friction": [{"type": "coulomb_friction", **DRY}],
    "current_loop": [{"type": "current_loop", "time_constant": 5e-5}],
    "encoder_noise": [{"type": "encoder_noise", "deviation": 1e-5}],
    "encoder_quantisation": [{"type": "encoder_quantisation", "count": 1e-5}],
    "grasp_change": [{"type": "grasp_change", "time": 0.0105, "stiffness": 500, "damping": 5}],
    "hard_stop": [
        {"type": "hard_stop", "position": 0.004, "stiffness": 1e6, "damping": 30},
        {"type": "hard_stop", "position": -0.004, "side": "lower", "stiffness": 1e5},
    ],
    "lugre_friction": [
        {"type": "lugre_friction", **DRY, "stribeck_velocity": 0.01, "bristle_stiffness": 1e5, "bristle_damping": 1.0,
         "viscous": 1.0},
    ],
    "shaft_compliance": [SHAFT],
    "stribeck_friction": [{"type": "stribeck_friction", **DRY, "stribeck_velocity": 0.01}],
    "thermal_derating": [
        {"type": "thermal_derating", "torque_limit": 2, "copper_loss": 1, "thermal_resistance": 9, "time_constant": 1}
    ],
    "torque_quantisation": [{"type": "torque_quantisation", "quantum": 0.01}],
    "torque_ripple": [{"type": "torque_ripple", "amplitude": 0.1, "pitch": 0.01}],
    "torque_saturation": [{"type": "torque_saturation", "limit": 1.0}],
    "tremor": [{"type": "tremor", "amplitude": 1e-3}],
    "viscous_friction": [{"type": "viscous_friction", "damping": 0.3}],
    "voltage_limit": [
        {"type": "current_loop", "time_constant": 5e-5},
        {"type": "voltage_limit", "supply": 8.0, "back_emf": 2.0, "resistance": 1.0, "inductance": 1e-3},
    ],
}  # fmt: skip
NEEDS_HAND = {"tremor", "grasp_change"}
FRICTIONS = {"coulomb_friction", "stribeck_friction", "lugre_friction"}


def possible(names: tuple[str, ...]) -> bool:
    return len(FRICTIONS.intersection(names)) < 2


def effects_of(names: tuple[str, ...]) -> list[dict[str, Any]]:
    chosen: list[dict[str, Any]] = []
    for name in names:
        chosen += [effect for effect in VARIANTS[name] if effect not in chosen]
    return chosen


PAIRS: list[tuple[str, ...]] = [pair for pair in itertools.combinations(EFFECTS, 2) if possible(pair)]
SETS: list[tuple[str, ...]] = [*((name,) for name in EFFECTS), *PAIRS]


def parameters(sets: list[tuple[str, ...]]) -> list[Any]:
    """Sets of effects, the pairs marked as slow."""
    return [pytest.param(s, marks=[pytest.mark.slow] if s in PAIRS else []) for s in sets]


def test_every_effect_has_a_variant_here():
    assert set(VARIANTS) == set(EFFECTS)


@pytest.mark.parametrize("names", parameters([s for s in SETS if not NEEDS_HAND.intersection(s)]), ids="+".join)
def test_energy_never_rises_without_hand_and_torque(names):
    plant = make_plant(*effects_of(names), user=None, damping=0.0, initial_velocity=0.3, initial_position=0.001)
    plant.begin(0)
    start = 0.5 * 0.25 * 0.3**2
    stored = plant.energy().stored
    for k in range(60):
        plant.advance_to((k + 1) * 1_000_000, 0.0)
        energy = plant.energy()
        assert energy.stored <= stored + 1e-12 * start
        stored = energy.stored
    assert plant.energy().motor == 0.0
    assert residual(plant) <= 1e-12 * start


@pytest.mark.parametrize("names", parameters(SETS), ids="+".join)
def test_the_balance_closes_under_hand_and_torque(names):
    plant = make_plant(*effects_of(names), user=USER_S)
    plant.begin(0)
    for k in range(60):
        plant.advance_to((k + 1) * 1_000_000, 2.0 if k % 20 < 10 else -1.5)
    energy = plant.energy()
    assert energy.dissipated >= 0.0
    assert energy.motor != 0.0
    assert residual(plant) <= 1e-12 * largest_flow(plant)
