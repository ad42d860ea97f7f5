"""Does the simulated plant see every event, and how far is it from the truth in position, velocity and energy?

Random guarded scenes (friction, stops, backlash, current loops, hands; 0.1 to 20 ms) against an independent judge with
located events, and against the same plant with its sample time cut into 32. A scene whose events differ because it is
chaotic (its own runs with other ticks differ as well) or grazes within 1e-9 of a guard is listed, not counted.
Stribeck friction is fitted for its order. `--scenes N` judges N scenes and screens 4 N.
"""

import argparse
import math
from typing import Any, Final

import numpy as np

from canhaptic.lab.judge.reference_model import Model
from canhaptic.lab.judge.solvers import reference
from canhaptic.sim.plant import AccuracyParameters
from canhaptic.sim.plant.plant import Plant, PlantParameters
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from tests.plant.read_effect import read_effect
from tools.bench.plants.affine_judge import judged
from tools.bench.plants.random_scenes import RandomScene, apart, random_scene
from tools.bench.report import Row, out_folder, publish, write_result

SHOWN: Final = 40
_GRAZING: Final = 1e-9
_PACKAGES: Final = ("canhaptic", "numpy", "scipy")


def chaotic(scene: RandomScene) -> bool:
    """Whether runs that differ in nothing but the length of a tick differ in events, or by a ten-thousandth."""
    (one, moved), (other, parts) = scene.move(8), scene.move(32)
    size = np.abs(parts).max(axis=0) + 1e-9
    return one.events != other.events or bool((np.abs(moved - parts) > 1e-5 * size).any())


def judge_all(count: int) -> tuple[list[Row], list[dict[str, Any]]]:
    """Returns the figures of the judge, and a table of scenes with their errors."""
    wrong, listed, events = 0, 0, 0
    table: list[dict[str, Any]] = []
    for seed in range(count):
        scene = random_scene(seed)
        told, found = judged(scene)
        events += found["events"]
        is_listed = bool(told) and (found["grazing"] < _GRAZING or chaotic(scene))
        listed += is_listed
        wrong += bool(told) and not is_listed
        if told:
            print(f"scene {seed} ({scene.names}): {told}{', listed' if is_listed else ''}")
        if len(table) < SHOWN or told:
            table.append({"seed": seed, "scene": scene.names, "sample_time_ns": scene.period_ns, **found, "told": told})
    worst = [max(row[key] for row in table[:SHOWN]) for key in ("position", "velocity", "motor", "user")]
    return [
        Row(f"scenes of {count} ({events} events) that differ from the judge", wrong, "1", target="0", met=wrong == 0),
        Row(f"chaotic or grazing scenes of {count}, listed", listed, "1"),
        Row(f"largest position error of {SHOWN} scenes, of the largest value", worst[0], "1"),
        Row(f"largest velocity error of {SHOWN} scenes, of the largest value", worst[1], "1"),
        Row(f"largest energy error of {SHOWN} scenes, of the largest value", max(worst[2:]), "1"),
    ], table


def screen_all(count: int) -> Row:
    """Returns how many scenes differ from themselves with their sample time cut."""
    wrong = 0
    for seed in range(count):
        scene = random_scene(seed)
        told = apart(scene)
        is_listed = bool(told) and chaotic(scene)
        wrong += bool(told) and not is_listed
        if told:
            print(f"scene {seed} ({scene.names}): {told}{', listed' if is_listed else ''}")
    return Row(f"scenes of {count} that differ from T / 32", wrong, "1", target="0", met=wrong == 0)


def servo_row() -> Row:
    """Returns the error of a servo that dry friction stops inside a hold, with its current still rising."""
    effects = [
        read_effect({"type": "coulomb_friction", "kinetic": 2.7, "static": 3.8}),
        read_effect({"type": "current_loop", "time_constant": 2e-4}),
    ]
    parameters, user = (
        PlantParameters(mass=0.15, damping=0.1, initial_velocity=1.84e-3),
        UserParameters(stiffness=130.0, damping=0.84),
    )
    plant = Plant(parameters, user, effects, 10_000_000)
    torques = [3.5, -3.5, 3.2, 5.0]
    exact = reference(Model(parameters, user, effects), torques, 10_000_000).position
    error = float(np.abs(plant.run(np.array(torques)) - exact).max())
    return Row("servo that stops inside a hold of 10 ms, error", error, "m", target="<= 1e-9", met=error <= 1e-9)


def stribeck_row() -> Row:
    """Returns the order that is fitted to stick-slip, 1 to 128 substeps."""
    effects = [read_effect({"type": "stribeck_friction", "kinetic": 0.5, "static": 1.0, "stribeck_velocity": 0.02})]
    parameters = PlantParameters(mass=0.25, damping=0.1)
    user = UserParameters(stiffness=200, damping=1, motion=SinusoidMotion(amplitude=0.02, frequency=1))
    torques = [0.3 * math.sin(0.3 * k) for k in range(150)]
    exact = reference(Model(parameters, user, effects), torques, 10_000_000).position
    counts = [1, 2, 4, 8, 16, 32, 64, 128]
    errors = []
    for substeps in counts:
        plant = Plant(parameters, user, effects, 10_000_000, 0, AccuracyParameters(substeps=substeps))
        errors.append(float(np.abs(plant.run(np.array(torques)) - exact).max()))
    order = -float(np.polyfit(np.log(counts), np.log(errors), 1)[0])
    note = f"{errors[0]:.1e} m at one substep of 10 ms, {errors[-1]:.1e} m at 128"
    return Row("Stribeck stick-slip, fitted order", order, "1", target="declared 2", met=order > 1.9, note=note)


def main() -> None:
    """Judges, screens and publishes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=500)
    count = parser.parse_args().scenes
    rows, table = judge_all(count)
    rows += [screen_all(4 * count), servo_row(), stribeck_row()]
    publish("plant_truth", rows, _PACKAGES)
    write_result(out_folder() / "plant_truth_scenes.json", _PACKAGES, {"scenes": table})


if __name__ == "__main__":
    main()
