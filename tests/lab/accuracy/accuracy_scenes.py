"""Plants with one effect each, and the five scenes of the gallery, for the tests of the accuracy study."""

from pathlib import Path

import numpy as np

from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.models import AxisSimulation
from canhaptic.sim.drive import SimulatedDriveParameters
from canhaptic.sim.plant import AccuracyParameters
from canhaptic.sim.plant.plant import PlantParameters
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from tests.plant.read_effect import read_effect

REPOSITORY = Path(__file__).resolve().parents[3]
FOLDER = REPOSITORY / "configs" / "accuracy"
SCENES = ("paper_wall", "stiff_stop", "stick_slip", "delayed_bus", "coarse_encoder")
PERIOD = 1_000_000  # [ns]
PLANT = PlantParameters(mass=0.25, damping=0.1)
USER = UserParameters(stiffness=300.0, damping=3.0, motion=SinusoidMotion(amplitude=0.03, frequency=1.0, phase=0.3))
SHAFT = {"type": "shaft_compliance", "stiffness": 1e5, "load_mass": 0.1, "damping": 0.5}
DRY = {"kinetic": 0.3, "static": 0.5, "stribeck_velocity": 0.01}
EFFECTS = {
    "none": (),
    "viscous_friction": ({"type": "viscous_friction", "damping": 0.7},),
    "coulomb_friction": ({"type": "coulomb_friction", "kinetic": 0.3, "static": 0.5},),
    "stribeck_friction": ({"type": "stribeck_friction", **DRY},),
    "lugre_friction": ({"type": "lugre_friction", **DRY, "bristle_stiffness": 1e4, "bristle_damping": 1.0},),
    "cogging": ({"type": "cogging", "amplitude": 0.1, "pitch": 0.01},),
    "torque_ripple": ({"type": "torque_ripple", "amplitude": 0.02, "pitch": 0.01},),
    "current_loop": ({"type": "current_loop", "time_constant": 3e-4},),
    "voltage_limit": (
        {"type": "current_loop", "time_constant": 3e-4},
        {"type": "voltage_limit", "supply": 1.0, "back_emf": 1.3, "resistance": 0.6, "inductance": 1e-3},
    ),
    "torque_saturation": ({"type": "torque_saturation", "limit": 0.6},),
    "torque_quantisation": ({"type": "torque_quantisation", "quantum": 0.1},),
    "shaft_compliance": (SHAFT,),
    "backlash": (SHAFT, {"type": "backlash", "gap": 1e-3}),
    "hard_stop": ({"type": "hard_stop", "position": 0.01, "stiffness": 1e5, "damping": 30},),
    "tremor": ({"type": "tremor", "amplitude": 1e-3},),
    "grasp_change": ({"type": "grasp_change", "time": 0.0253, "stiffness": 50, "damping": 1},),
}
WARM = {"copper_loss": 1.0, "thermal_resistance": 400.0, "time_constant": 0.05}  # derates within a tenth of a second
EXACT = sorted(set(EFFECTS) - {"stribeck_friction", "lugre_friction", "cogging", "torque_ripple"})


def simulation(*effects, substeps=1, event_bits=24, user=USER):
    """Returns the plant with these effects, as a scene would give it."""
    typed = tuple(ComponentSpec(effect["type"], read_effect(effect)) for effect in effects)  # type: ignore[arg-type]
    accuracy = AccuracyParameters(substeps=substeps, event_bits=event_bits)
    drive = SimulatedDriveParameters(counts_per_unit=1e6, rated_torque=10.0)
    return AxisSimulation(drive, PLANT, user, typed, 1, accuracy)


def random_torques(count, size=1.0):
    """Returns torques within +-size [N]."""
    return np.random.default_rng(7).uniform(-size, size, count).tolist()


def smooth_torques(count):
    """Returns torques of one sign that vary slowly [N]."""
    return (0.8 + 0.3 * np.sin(np.arange(count) * 0.05)).tolist()
