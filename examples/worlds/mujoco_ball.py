"""MuJoCo at 60 Hz behind a wall at 1 kHz: the hand pushes a ball against a block. Needs `pip install mujoco`."""

import sys
from pathlib import Path

import mujoco

import canhaptic

RIG = Path(__file__).resolve().parents[2] / "configs" / "far_world.yaml"
SCENE = """<mujoco><option timestep="0.0041666667" integrator="implicitfast" gravity="0 0 0"/><worldbody>
<body><joint name="x" type="slide" axis="1 0 0"/><geom type="sphere" size=".01" mass=".2"/></body>
<body pos=".03 0 0"><joint type="slide" axis="1 0 0" damping="2"/><geom type="sphere" size=".01" mass=".5"/></body>
<body mocap="true" pos=".07 0 0"><geom type="box" size=".01 .1 .1"/></body></worldbody>
<actuator><general joint="x" gainprm="800" biastype="affine" biasprm="0 -800 -16"/></actuator></mujoco>"""

if __name__ == "__main__":
    model = mujoco.MjModel.from_xml_string(SCENE)
    data, touches = mujoco.MjData(model), 0
    with canhaptic.World((sys.argv[1:] or ["virtual"])[0], scene=RIG) as world:
        for hand in world:
            data.ctrl[0], work = hand["handle"].position, 0.0  # a spring draws the first sphere to the hand
            for _ in range(4):
                before = data.qpos[0]
                mujoco.mj_step(model, data)
                work += data.actuator_force[0] * (data.qpos[0] - before)  # what that spring puts into the world
            world["handle"].absorbed(work)
            if any(0 in (contact.geom1, contact.geom2) for contact in data.contact[: data.ncon]):
                world["handle"].wall(at=data.qpos[0], speed=data.qvel[0], stiffness=2000.0, pushes="-", damping=6.0)
                touches += 1
            else:
                world["handle"].free()
    print(f"{touches} frames in touch, ball at {1e3 * data.qpos[1] + 30:.0f} mm")
    if world.result is not None:
        print(world.result["ports"]["handle"]["verdict"], world.result["truth"]["handle"]["least_interaction"])
