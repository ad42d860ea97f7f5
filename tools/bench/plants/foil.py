"""The foil: the easy scene in an engine that carries every effect behind a flag that is read at run time, all off."""

import math
from collections.abc import Sequence

import numpy as np

from tools.bench.plants.scenes import DAMPING, MASS, PERIOD, Array, Scene

FLAGS = (
    "coulomb", "stribeck", "lugre", "cogging", "ripple", "current_loop", "saturation", "quantisation", "thermal",
    "compliance", "backlash", "upper_stop", "lower_stop", "encoder_noise", "tremor", "grasp_change",
)  # fmt: skip


class Foil:
    """One step of Runge-Kutta 4 a period, as such engines take."""

    def __init__(self, scene: Scene) -> None:
        self.flags = dict.fromkeys(FLAGS, False)
        self.user = scene.user
        self.state = [0.0] * 10  # position, velocity, current, twist, bristle, temperature, depths, ...

    def _rates(self, time: float, state: Sequence[float], torque: float) -> list[float]:
        flags, user = self.flags, self.user
        assert user.motion is not None
        omega = 2.0 * math.pi * user.motion.frequency
        target = user.motion.amplitude * math.sin(omega * time)
        speed = user.motion.amplitude * omega * math.cos(omega * time)
        force = user.stiffness * (target - state[0]) + user.damping * (speed - state[1]) + torque - DAMPING * state[1]
        rates = [0.0] * 10
        for place, flag in enumerate(FLAGS):
            if flags[flag]:
                force -= state[place % 10]
        rates[0], rates[1] = state[1], force / MASS
        return rates

    def run(self, torques: Sequence[float]) -> Array:
        """Returns the positions."""
        state, step, positions = [0.0] * 10, PERIOD, []
        for k, torque in enumerate(torques):
            time = k * step
            a = self._rates(time, state, torque)
            b = self._rates(time + step / 2, [s + step / 2 * r for s, r in zip(state, a, strict=True)], torque)
            c = self._rates(time + step / 2, [s + step / 2 * r for s, r in zip(state, b, strict=True)], torque)
            d = self._rates(time + step, [s + step * r for s, r in zip(state, c, strict=True)], torque)
            slopes = zip(state, a, b, c, d, strict=True)
            state = [s + step / 6 * (w + 2 * x + 2 * y + z) for s, w, x, y, z in slopes]
            positions.append(state[0])
        return np.array(positions)
