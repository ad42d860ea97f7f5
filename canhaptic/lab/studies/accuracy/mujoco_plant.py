"""A linear plant in MuJoCo, where it is installed: a slide joint with the hand as its spring and damper.

The hand's motion comes as a force that is held over each step. Works: the motor's is exact for a held torque, the
user's by the trapezoidal rule over the steps.
"""

import math
from collections.abc import Sequence
from importlib import import_module
from typing import Any, Final

import numpy as np

from canhaptic.lab.loop.scenes import viscous_friction
from canhaptic.scene.models import AxisSimulation
from canhaptic.sim.plant.own_hand import OwnHand
from canhaptic.sim.plant.plant_motion import Motion
from canhaptic.sim.plant.propagator import Array
from canhaptic.sim.plant.user import UserParameters

_EXPRESSIBLE: Final = ("viscous_friction", "encoder_noise", "encoder_quantisation")


def inexpressible(simulation: AxisSimulation) -> list[str]:
    """Return the effects of a scene that this joint does not have."""
    hand = ["a hand of one's own"] if isinstance(simulation.user, OwnHand) else []
    return hand + [effect.name for effect in simulation.effects if effect.name not in _EXPRESSIBLE]


class MujocoPlant:
    """One joint, stepped from Python.

    Args:
        simulation: With expressible effects only.
        integrator: "Euler" (semi-implicit) or "RK4".
        substeps: Steps in a hold.
        torques: Torque of each hold [N or N*m].
        sample_time_ns: Duration of a hold [ns].
    """

    def __init__(
        self, simulation: AxisSimulation, integrator: str, substeps: int, torques: Sequence[float], sample_time_ns: int
    ) -> None:
        self._mujoco = import_module("mujoco")
        self._plant, self._user = simulation.plant, simulation.user or UserParameters()
        self._step, self._substeps = sample_time_ns * 1e-9 / substeps, substeps
        damping = self._user.damping + self._plant.damping + viscous_friction(simulation)
        self._model = self._mujoco.MjModel.from_xml_string(f"""
<mujoco><option timestep="{self._step!r}" gravity="0 0 0" integrator="{integrator}"><flag contact="disable"/></option>
<worldbody><body><joint name="x" type="slide" axis="1 0 0" stiffness="{self._user.stiffness!r}"
damping="{damping!r}"/><geom type="sphere" size="0.01" mass="{self._plant.mass!r}"/></body></worldbody>
<actuator><motor joint="x"/></actuator></mujoco>""")
        self._torques = np.repeat(np.array(torques), substeps)
        self._commands = (self._torques + self._forces()).tolist()

    def _forces(self) -> Array:
        """Return what the hand adds to spring and damper at the start of each step [N or N*m]."""
        user, target, speed = self._user, self._target(), self._speed()
        forces: Array = user.stiffness * target + user.damping * speed + user.push
        return forces[: len(self._torques)]

    def _times(self) -> Array:
        times: Array = np.arange(len(self._torques) + 1, dtype=float)
        return times * np.float64(self._step)

    def _target(self) -> Array:
        motion = self._user.motion
        target: Array = np.full(len(self._torques) + 1, self._user.rest + (motion.offset if motion else 0.0))
        if motion:
            target += motion.amplitude * np.sin(2.0 * math.pi * motion.frequency * self._times() + motion.phase)
        return target

    def _speed(self) -> Array:
        motion = self._user.motion
        if not motion:
            return np.zeros(len(self._torques) + 1)
        omega = 2.0 * math.pi * motion.frequency
        speed: Array = motion.amplitude * omega * np.cos(omega * self._times() + motion.phase)
        return speed

    def _begin(self) -> Any:
        data = self._mujoco.MjData(self._model)
        data.qpos[0], data.qvel[0] = self._plant.initial_position, self._plant.initial_velocity
        return data

    def run(self) -> list[float]:
        """Run it and return the positions."""
        model, data, move, positions = self._model, self._begin(), self._mujoco.mj_step, []
        control, place = data.ctrl, data.qpos
        for command in self._commands:
            control[0] = command
            move(model, data)
            positions.append(place[0])
        return positions

    def motion(self) -> Motion:
        """Run it and return the motion."""
        data = self._begin()
        states = [(data.qpos[0], data.qvel[0])]
        for command in self._commands:
            data.ctrl[0] = command
            self._mujoco.mj_step(self._model, data)
            states.append((data.qpos[0], data.qvel[0]))
        position, velocity = np.array(states, dtype=float).T
        motor = np.cumsum(self._torques * np.diff(position))
        force = self._user.stiffness * (self._target() - position) + self._user.damping * (self._speed() - velocity)
        power = (force + self._user.push) * velocity
        user = np.cumsum(0.5 * self._step * (power[1:] + power[:-1]))
        ends = slice(self._substeps - 1, None, self._substeps)
        return Motion(position[1:][ends], velocity[1:][ends], motor[ends], user[ends])
