"""One name, one default: at its defaults a scene gives the same torques on an axis and in a group of one."""

import pytest

from canhaptic.control.mechanisms.kinematics import Identity
from canhaptic.control.multi_axis import GROUP_ALGORITHMS, build_group_controller
from canhaptic.control.passivity import ALGORITHMS, LoopProperties
from canhaptic.control.passivity.guarded import GuardedParameters
from canhaptic.control.port_hamiltonian.shapes.plane import Plane
from canhaptic.cycle import run
from canhaptic.errors import ParameterError
from canhaptic.logs.bus_reader import read_bus_log
from canhaptic.registry import load
from canhaptic.scene.build import build
from canhaptic.scene.load import scene_from_text
from tests.scene.scene_text import REPOSITORY


def test_both_take_the_same_parameters():
    on_axis, in_group = (
        load(table, "guarded", "algorithm").parameters_type for table in (ALGORITHMS, GROUP_ALGORITHMS)
    )
    assert on_axis is in_group is GuardedParameters


MACHINE = """
duration: 2 s
bus: {interface: virtual, rate: 1 kHz, rpdo: synchronous}
axes:
  - {name: handle, node_id: 1, eds: cia402_servo.eds, unit: m, counts_per_unit: 1e6, rated_torque: 10, torque_limit: 20}
simulation:
  drive: {objects: {0x6502: 0x200}}
  plant: {mass: 0.25, damping: 0.1}
  user: {stiffness: 60, damping: 5, motion: {amplitude: 0.15, frequency: 2}}
"""
PASSIVITY = "passivity: {algorithm: guarded, moving_mass: 0.2, device_damping_bound: 0.2}"
ON_AXIS = f"environment: {{type: spring_damper_wall, stiffness: 400, position: -0.02}}\n{PASSIVITY}\n"
IN_GROUP = f"""groups:
  - {{name: one, axes: [handle], network: {{type: plane, normal: [1], offset: -0.02, stiffness: 400}}, {PASSIVITY}}}
"""


@pytest.mark.slow
def test_a_scene_at_its_defaults_sends_the_same_frames_on_an_axis_and_in_a_group_of_one(tmp_path):
    frames = []
    for name, rendered in (("axis", ON_AXIS), ("group", IN_GROUP)):
        scene = scene_from_text(MACHINE + rendered, str(REPOSITORY / "configs" / "x.yaml"))
        with build(scene, "free", bus_log=tmp_path / f"{name}.log") as experiment:
            run(experiment.cycle, 1000)
        frames.append([(frame.can_id, frame.data) for frame in read_bus_log(tmp_path / f"{name}.log")])
    assert frames[0] == frames[1]
    torques = [int.from_bytes(data[2:4], "little", signed=True) for can_id, data in frames[0] if can_id == 0x201]
    assert max(torques) > 300  # 3 N at least: the wall was met


@pytest.mark.parametrize(
    ("own", "words"),
    [
        ({"hand_push": 20.0}, "got hand_push 20, expected at most hand_force .0.; .* leave out hand_push"),
        ({"earned_energy": 5e-3}, "got earned_energy 0.005, expected 0; .* leave it out"),
        ({"earned_energy": 5e-3, "drag": 0.2}, "got earned_energy"),
        ({"drag": 0.2}, "got drag 0.2, expected 0; .* leave it out"),
    ],
)
def test_a_group_refuses_by_name_what_only_an_axis_can_honour(own, words):
    loop = LoopProperties(sample_time=1e-3, delay=0, moving_mass=0.2, device_damping_bound=0.2)
    plane = Plane(normal=(1.0,), stiffness=100.0)
    with pytest.raises(ParameterError, match=f"guarded group: {words}"):
        build_group_controller(plane, Identity(axes=1), "guarded", GuardedParameters(**own), [loop])


def test_a_group_takes_a_hand_that_pushes_no_harder_than_it_pulls():
    loop = LoopProperties(sample_time=1e-3, delay=0, moving_mass=0.2, device_damping_bound=0.2)
    own = GuardedParameters(hand_force=5.0, hand_push=5.0, earned_energy=0.0)
    assert build_group_controller(Plane(normal=(1.0,), stiffness=100.0), Identity(axes=1), "guarded", own, [loop])
