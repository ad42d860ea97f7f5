"""An independent small simulation: user and moving mass, exact over each hold, and the continuous wall.

Shares nothing with `canhaptic.sim`: scipy's matrix exponential for the sampled loop, DOP853 with events for the
continuous one.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm


@dataclass(frozen=True)
class User:
    """m q'' = torque - b q' + k (r - q) + d (r' - q'), r = amplitude sin(2 pi f t)."""

    stiffness: float
    damping: float
    amplitude: float
    frequency: float
    mass: float = 0.25
    friction: float = 0.1

    def matrix(self):
        """States q, v, sin, cos (reference), torque."""
        w = 2.0 * math.pi * self.frequency
        a = self.amplitude
        m, k, d = self.mass, self.stiffness, self.damping
        f = np.zeros((5, 5))
        f[0, 1] = 1.0
        f[1] = [-k / m, -(d + self.friction) / m, k * a / m, d * a * w / m, 1.0 / m]
        f[2, 3] = w
        f[3, 2] = -w
        return f


def user_f(amplitude):
    return User(60.0, 5.0, amplitude, 0.5)


USER_S = User(300.0, 3.0, 0.03, 1.0)


@dataclass
class Run:
    time: np.ndarray
    position: np.ndarray  # at the samples
    torque: np.ndarray  # torque[k] held during the hold that ended at sample k
    balances: list


def sampled(user, controller, sample_time, duration, delay=0, count=0.0, torque_limit=math.inf):
    """Runs a controller on the user; torque computed at sample k acts in the hold that begins at sample k + delay."""
    propagate = expm(user.matrix() * sample_time)
    state = np.array([0.0, 0.0, 0.0, 1.0, 0.0])
    pending = deque([0.0] * delay)
    n = round(duration / sample_time)
    positions, torques, balances = np.empty(n + 1), np.empty(n + 1), []
    held = 0.0
    for k in range(n + 1):
        q = state[0] if count == 0.0 else round(state[0] / count) * count
        balance = controller.step(float(q), held)
        positions[k], torques[k] = state[0], held
        balances.append(balance)
        pending.append(balance.torque)
        held = min(torque_limit, max(-torque_limit, pending.popleft()))
        state[4] = held
        state = propagate @ state
    return Run(np.arange(n + 1) * sample_time, positions, torques, balances)


def continuous(user, stiffness, damping, wall, times):
    """Returns (position, torque) of the user against the continuous spring-damper wall below `wall`."""
    f = user.matrix()

    def rate(_t, z, inside):
        s = np.append(z, -stiffness * (z[0] - wall) - damping * z[1] if inside else 0.0)
        return (f @ s)[:4]

    z, t, inside = np.array([0.0, 0.0, 0.0, 1.0]), times[0], wall > 0.0
    position, torque = np.empty(len(times)), np.empty(len(times))
    while t < times[-1]:

        def crossing(_t, z, _inside):
            return z[0] - wall

        crossing.terminal, crossing.direction = True, 1.0 if inside else -1.0  # type: ignore[attr-defined]
        solved = solve_ivp(
            rate,
            (t, times[-1]),
            z,
            "DOP853",
            dense_output=True,
            events=crossing,
            args=(inside,),
            rtol=1e-10,
            atol=1e-13,
        )
        chosen = (times >= t) & (times <= solved.t[-1])
        states = solved.sol(times[chosen])
        position[chosen] = states[0]
        torque[chosen] = (-stiffness * (states[0] - wall) - damping * states[1]) if inside else 0.0
        t, z, inside = solved.t[-1], solved.y[:, -1], not inside
    return position, torque


def variation(torque):
    return float(np.abs(np.diff(torque)).sum())
