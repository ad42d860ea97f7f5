"""Ten scenes that are in no folder: advice is what exhaustive rows say, and there is none where none is due.

The rows are made anew here: every event bit and every number of substeps under the torques of the scene's controller,
against LSODA with located events, which is not the reference of the study. What is advised for the loop is rendered
anew, with that change and nothing else.
"""

import numpy as np
import pytest
import yaml

from canhaptic.lab.judge.reference_model import difference
from canhaptic.lab.judge.solvers import located
from canhaptic.lab.reference import continuous_motion, textbook_model
from canhaptic.lab.studies.accuracy.accuracy_table import LEAST_ORDER, advice_lines
from canhaptic.lab.studies.accuracy.loop_sensitivity import holds_of
from canhaptic.lab.studies.accuracy.plant_solvers import fitted_order
from canhaptic.lab.studies.accuracy.study import AccuracyStudy
from canhaptic.scene.far_side import build_plant
from canhaptic.scene.load import load_scene
from canhaptic.scene.method import declared_order, simulation_of, torque_history
from canhaptic.scene.parts import build_axis_controller
from canhaptic.sim.plant import AccuracyParameters
from canhaptic.sim.plant.direct_rig import DirectRig, observed

WALL = {"type": "spring_damper_wall", "stiffness": "500 N/m", "damping": "2 N*s/m", "position": "0 m"}
AWAY = {**WALL, "position": "-1 m"}
DRY = {"type": "coulomb_friction", "kinetic": 0.2, "static": 0.3}
STRIBECK = {"type": "stribeck_friction", "kinetic": 0.3, "static": 0.5, "stribeck_velocity": 0.02}
STOP = {"type": "hard_stop", "position": 0.004, "stiffness": 1e5, "damping": 20}
SHAFT = {"type": "shaft_compliance", "stiffness": 1e4, "load_mass": 0.1, "damping": 0.5}
COGGING = {"type": "cogging", "amplitude": 2.0, "pitch": 0.001}
LUGRE = {**STRIBECK, "type": "lugre_friction", "bristle_stiffness": 1e4, "bristle_damping": 1.0}

SCENES = {  # rate, environment, effects, tolerance
    "linear, in contact": (500, WALL, [{"type": "current_loop", "time_constant": 5e-4}], 1e-6),
    "dry friction, in contact": (500, WALL, [DRY], 1e-6),
    "a stop in reach": (200, AWAY, [STOP], 1e-7),
    "a stop out of reach": (500, WALL, [{**STOP, "position": 0.5}], 1e-7),
    "friction and a stop": (100, WALL, [DRY, STOP], 1e-5),
    "backlash": (500, WALL, [SHAFT, {"type": "backlash", "gap": 1e-3}], 1e-6),
    "falling friction": (200, WALL, [STRIBECK], 1e-6),
    "bristles": (200, WALL, [LUGRE], 1e-5),
    "cogging at 40 Hz, which is out of its order": (40, AWAY, [COGGING], 1e-6),
    "a tolerance that none keeps": (200, WALL, [STRIBECK], 1e-13),
}

WITHOUT_ADVICE = {"cogging at 40 Hz, which is out of its order", "a tolerance that none keeps"}
NOT_FELT = {"a stop in reach", "cogging at 40 Hz, which is out of its order"}


def scene_of(name, **changes):
    """Returns the scene of a name, loaded from text as a user's is."""
    rate, environment, effects, _ = SCENES[name]
    bus = {"interface": "virtual", "rate": f"{rate} Hz", "rpdo": "event", **changes}
    axis = {"name": "handle", "node_id": 1, "eds": "cia402_servo.eds", "unit": "m", "counts_per_unit": "1e6 count/m",
            "rated_torque": "10 N", "torque_limit": "20 N"}  # fmt: skip
    motion = {"type": "sinusoid", "amplitude": 0.01, "frequency": 3.0}
    text = {
        "duration": f"{min(0.6, 120.0 / rate)} s", "bus": bus, "axes": [axis], "environment": environment,
        "passivity": {"algorithm": "unprotected"},
        "simulation": {"plant": {"mass": 0.25, "damping": 0.1},
                       "user": {"stiffness": 300.0, "damping": 3.0, "motion": motion}, "effects": effects},
    }  # fmt: skip
    return text


@pytest.fixture
def written(tmp_path):
    """Returns what loads a scene by its name, with changes of its bus."""

    def load(name, **changes):
        path = tmp_path / "scene.yaml"
        path.write_text(yaml.safe_dump(scene_of(name, **changes)), encoding="utf-8")
        return load_scene(path)

    return load


_RESULTS = {}


def studied(name, scene):
    """Returns the result of the study of a scene, which both tests read."""
    if name not in _RESULTS:
        _RESULTS[name] = AccuracyStudy(scene, tolerance=SCENES[name][3], budget=0.0).run()
    return _RESULTS[name]


def exhaustive(scene):
    """Returns position error and products by (event bits, substeps), against LSODA with located events."""
    simulation, period = simulation_of(scene.axes[0]), scene.bus.sample_time_ns
    torques = torque_history(scene.axes[0], scene, holds_of(scene))
    witness = located(textbook_model(simulation), torques, period, "LSODA", 1e-11, 1e-14)
    plant = build_plant(simulation, period)
    switches = any(part.has_guards for part in plant.scene.parts)
    bits = ((8, 16, 24) if not plant.is_exact else (4, 8, 12, 16, 20, 24)) if switches else (24,)
    found = {}
    for substeps in (1,) if plant.is_exact else (1, 2, 4, 8, 16, 32):
        for event_bits in bits:
            accuracy = AccuracyParameters(event_bits=event_bits, substeps=substeps)
            plant = build_plant(simulation, period)
            plant = type(plant)(plant.parameters, plant.user, plant.effects, period, plant.seed, accuracy)
            motion = observed(plant, torques)
            found[event_bits, substeps] = difference(motion, witness, 0.25, period * 1e-9).position, plant.products
    return found, float(np.ptp(witness.position))


def expected_setting(rows, tolerance):
    """Returns the cheapest setting that keeps the tolerance as every finer one does; None where there is none."""

    def lasts(bits, substeps):
        return all(rows[b, s][0] <= tolerance for b, s in rows if b >= bits and s >= substeps)

    good = [key for key in rows if lasts(*key)]
    return min(good, key=lambda key: (rows[key][1], rows[key][0]), default=None)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_advice_is_what_exhaustive_rows_say(name, written):
    scene, tolerance = written(name), SCENES[name][3]
    result = studied(name, scene)
    rows, travel = exhaustive(scene)
    declared, most = declared_order(simulation_of(scene.axes[0])), max(bits for bits, _ in rows)
    own = [(1.0 / substeps, error) for (bits, substeps), (error, _) in rows.items() if bits == most]
    order = fitted_order([size for size, _ in own], [error for _, error in own], travel)
    expected = expected_setting(rows, tolerance)
    advised = result["advice"]["chosen"]
    assert (advised is None) == (name in WITHOUT_ADVICE)
    if declared is not None and order is not None and order < LEAST_ORDER * declared:
        assert advised is None
        assert "is declared" in advice_lines(result)[0]
        return
    assert (advised is None) == (expected is None)
    if advised is not None:
        key = advised["accuracy"]["event_bits"], advised["accuracy"]["substeps"]
        assert rows[key][1] == rows[expected][1]
        assert rows[key][0] <= tolerance


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_what_is_advised_for_the_loop_brings_it_nearer_when_it_is_done(name, written):
    scene = written(name)
    result = studied(name, scene)
    [line] = [line for line in advice_lines(result) if line.startswith("loop: ")]
    assert ("does not reach the wall" in line) == (name in NOT_FELT)
    if name in NOT_FELT:
        return
    base = apart(scene)
    nearer = [row for row in result["loop"] if f"{row['group']}: {row['setting']} (" in line]
    assert nearer or "no single change" in line
    for row in nearer:
        if row["group"] == "sample rate":
            assert apart(written(name, rate=f"{row['rate']} Hz")) < base
        if row["group"] == "RPDO":
            assert apart(written(name, rpdo=row["setting"])) < base


def apart(scene):
    """Returns the largest distance of the rendered axis from the continuous one at its own SYNCs [m]."""
    axis, period, holds = scene.axes[0], scene.bus.sample_time_ns, holds_of(scene)
    simulation = simulation_of(axis)
    plant = build_plant(simulation, period)
    fine = AccuracyParameters(substeps=32)
    plant = type(plant)(plant.parameters, plant.user, plant.effects, period, plant.seed, fine)
    given, quantum = axis.parameters, axis.loop.torque_quantum or None
    rig = DirectRig(plant, build_axis_controller(axis).step, period, scene.bus.delay, given.counts_per_unit, quantum,
                    given.torque_limit)  # fmt: skip
    exact = continuous_motion(scene, period, holds).position
    run = rig.run(min(holds + 1, len(exact)))
    return float(np.abs(run.true_position - exact[: len(run.true_position)]).max())
