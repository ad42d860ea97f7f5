"""My MuJoCo scene: from an installed package to a contact that the hand feels, with 30 lines of scene and program."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.journeys.person import EDS, Person

FAR = """\

far:
  name: world
  axis: axis1
  world: loopback
  coupling: {type: model, stiffness: 0.25 N*m/rad}
  level: 0.2 mJ
  drag: 5 mN*m*s/rad
  silence: 2 s
"""
PROGRAM = '''\
import canhaptic
import mujoco

model = mujoco.MjModel.from_xml_string("""<mujoco><option timestep="0.0041666667" gravity="0 0 0"/><worldbody>
<body><joint name="x" type="slide" axis="1 0 0"/><geom type="sphere" size=".01" mass=".2"/></body>
<body mocap="true" pos=".12 0 0"><geom type="box" size=".01 .1 .1"/></body></worldbody><actuator>
<general joint="x" gainprm="800" biastype="affine" biasprm="0 -800 -16"/></actuator></mujoco>""")
data, touches, torque = mujoco.MjData(model), 0, 0.0
with canhaptic.World("virtual", scene="rig.yaml") as world:
    for hand in world:
        data.ctrl[0] = hand["axis1"].position
        mujoco.mj_step(model, data, 4)
        if data.ncon:
            world["axis1"].wall(at=data.qpos[0], stiffness=0.25, pushes="-")
            touches += 1
        else:
            world["axis1"].free()
        torque = min(torque, hand["axis1"].torque)
print(touches > 50, torque < -0.004, world.result["ports"]["axis1"]["verdict"])
'''


def test_what_the_user_writes_is_at_most_thirty_lines() -> None:
    assert len((FAR + PROGRAM).strip().splitlines()) <= 30


@pytest.mark.slow
def test_a_scene_is_made_names_the_world_and_the_hand_feels_the_box(person: Person) -> None:
    pytest.importorskip("mujoco")
    person.types("new", str(EDS / "cia402_servo.eds"), "--simulate", "--out", "rig.yaml")
    rig = Path(person.folder, "rig.yaml")
    refused = person.types("run", "rig.yaml", "--set", "far.world=loopback", status=2)
    assert not refused
    assert "far" in person.errors
    rig.write_text(rig.read_text(encoding="utf-8") + FAR, encoding="utf-8")
    said = " ".join(person.types("check", "rig.yaml").split())
    assert "canhaptic.World at 127.0.0.1:5578" in said
    person.types("run", "rig.yaml", status=2)
    assert "--pace real" in person.errors
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", PROGRAM], cwd=person.folder, capture_output=True, text=True, timeout=100,
        check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (0, "True True yes\n"), done.stderr
