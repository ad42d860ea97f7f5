"""What each effect costs per sample time, one at a time on the easy scene."""

from typing import Any

from tools.bench.plants.scenes import advance, easy
from tools.bench.report import Row, interleave

HOLDS, REPEATS = 500, 5
SHAFT = {"type": "shaft_compliance", "stiffness": 1e5, "load_mass": 0.1, "damping": 0.5}
DRY = {"kinetic": 0.3, "static": 0.5, "stribeck_velocity": 0.01}
VARIANTS: dict[str, tuple[dict[str, Any], ...]] = {
    "bare": (),
    "viscous_friction": ({"type": "viscous_friction", "damping": 0.2},),
    "coulomb_friction": ({"type": "coulomb_friction", "kinetic": 0.3, "static": 0.5},),
    "stribeck_friction": ({"type": "stribeck_friction", **DRY},),
    "lugre_friction": ({"type": "lugre_friction", **DRY, "bristle_stiffness": 1e5},),
    "cogging": ({"type": "cogging", "amplitude": 0.1, "pitch": 0.01},),
    "torque_ripple": ({"type": "torque_ripple", "amplitude": 0.02, "pitch": 0.01},),
    "current_loop": ({"type": "current_loop", "time_constant": 5e-5},),
    "voltage_limit": (
        {"type": "current_loop", "time_constant": 5e-5},
        {"type": "voltage_limit", "supply": 24.0, "back_emf": 2.0, "resistance": 1.0, "inductance": 1e-3},
    ),
    "torque_saturation": ({"type": "torque_saturation", "limit": 1.0},),
    "torque_quantisation": ({"type": "torque_quantisation", "quantum": 0.01},),
    "thermal_derating": (
        {"type": "thermal_derating", "torque_limit": 2, "copper_loss": 1, "thermal_resistance": 9, "time_constant": 1},
    ),
    "shaft_compliance": (SHAFT,),
    "backlash": (SHAFT, {"type": "backlash", "gap": 1e-3}),
    "hard_stop": ({"type": "hard_stop", "position": 0.01, "stiffness": 1e6, "damping": 30},),
    "tremor": ({"type": "tremor", "amplitude": 1e-3},),
    "grasp_change": ({"type": "grasp_change", "time": 0.1, "stiffness": 50, "damping": 1},),
}


def effect_rows() -> list[Row]:
    """Returns the time per period of each effect and of the bare scene, measured in turn."""
    scene = easy(HOLDS)
    torques = scene.torques.tolist()
    runs = {}
    for name, effects in VARIANTS.items():
        plant = scene._replace(effects=effects).plant()

        def run(plant: Any = plant) -> None:
            plant.reset()
            advance(plant, torques)

        run()  # compiles its modes
        runs[name] = run
    each = {name: min(times) / HOLDS * 1e6 for name, times in interleave(runs, REPEATS).items()}
    return [
        Row(f"effect {name}, per period", each[name], "us", "bare", each["bare"], each[name] / each["bare"])
        for name in VARIANTS
        if name != "bare"
    ]
