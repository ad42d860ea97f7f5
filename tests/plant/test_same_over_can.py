"""The bus adds nothing: a scene over CAN and the same scene in `DirectRig` give the same bits."""

from pathlib import Path

import numpy as np
import pytest

from canhaptic.cycle import run
from canhaptic.scene.build import build
from canhaptic.scene.far_side import build_plant
from canhaptic.scene.load import load_scene
from canhaptic.scene.parts import build_axis_controller
from canhaptic.sim.plant.direct_rig import DirectRig

REPOSITORY = Path(__file__).resolve().parents[2]
EFFECTS = {
    "bare": "",
    "dry": "{type: coulomb_friction, kinetic: 0.1 N, static: 0.2 N}, {type: current_loop, time_constant: 50 us}",
    "stop": "{type: hard_stop, position: -60 mm, side: lower, stiffness: 1 MN/m, damping: 30}",
    "shaft": "{type: backlash, gap: 1 mm}, {type: shaft_compliance, stiffness: 1e5, damping: 5, load_mass: 0.1}",
    "nonlinear": "{type: cogging, amplitude: 0.1, pitch: 10 mm}, {type: torque_ripple, amplitude: 0.05, pitch: 10 mm}",
    "hand": "{type: tremor, amplitude: 0.5 mm}, {type: grasp_change, time: 0.2 s, stiffness: 200, damping: 3}",
    "encoder": "{type: encoder_noise, deviation: 5 um}, {type: encoder_quantisation, count: 20 um}",
}


@pytest.mark.slow_but("bare-event", "stop-event")
@pytest.mark.parametrize("rpdo", ["event", "synchronous"])
@pytest.mark.parametrize("name", EFFECTS)
def test_can_and_direct_rig_agree_bit_for_bit(name, rpdo, tmp_path):
    path = tmp_path / "scene.yaml"
    text = (REPOSITORY / "configs" / "demo.yaml").read_text()
    path.write_text(f"{text}\n  effects: [{EFFECTS[name]}]\n  seed: 5\n")
    eds = REPOSITORY / "eds" / "cia402_servo.eds"
    scene = load_scene(path, [f"axes.0.eds={eds}", f"bus.rpdo={rpdo}", "simulation.user.motion.phase=2.6"])
    axis, cycles, seen = scene.axes[0], 400, []
    with build(scene, "free") as experiment:
        [controller] = [port.controller for port in experiment.cycle.ports]
        step = controller.step

        def watched(position: float, torque: float):
            balance = step(position, torque)
            seen.append((position, balance.torque, torque))
            return balance

        controller.step = watched
        motors = []
        run(experiment.cycle, cycles, progress=lambda _: motors.append(experiment.cycle.judge.interaction[0]))
    assert axis.simulation is not None
    plant = build_plant(axis.simulation, scene.bus.sample_time_ns)
    delay = 1 if rpdo == "synchronous" else 0
    direct = DirectRig(
        plant, build_axis_controller(axis).step, scene.bus.sample_time_ns, delay, counts_per_unit=1e6,
        torque_quantum=10.0 / 1000.0,
    ).run(cycles)  # fmt: skip
    positions, commands, held = np.array(seen[:cycles]).T
    assert np.any(held)
    assert positions.tobytes() == direct.position.tobytes()
    assert commands.tobytes() == direct.torque_command.tobytes()
    assert held.tobytes() == direct.torque_applied.tobytes()
    assert motors[-1] == -direct.energy.motor
