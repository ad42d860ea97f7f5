"""How fast and how true is a network on several axes? `python -m tools.bench.network`.

The step of a group; and the example in two dimensions - a hand on a hardening spring and a damper with a virtual mass
of 0.3 kg on a viscous floor, four states - against the continuous solution of scipy and the same network sampled by
explicit Euler. Energies are those of the plant.
"""

import math
from collections.abc import Callable, Sequence
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from canhaptic.control.mechanisms.five_bar import FiveBar
from canhaptic.control.mechanisms.kinematics import Identity
from canhaptic.control.multi_axis import build_group_controller
from canhaptic.control.multi_axis.group_controller import GroupController
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.guarded import GuardedParameters
from canhaptic.control.port_hamiltonian.shapes.box import Box
from canhaptic.control.port_hamiltonian.shapes.sphere import Sphere
from canhaptic.control.port_hamiltonian.shapes.virtual_mass import VirtualMass
from tools.bench.report import Row, publish

Array = NDArray[np.float64]

EXAMPLE = VirtualMass(mass=0.3, stiffness=800.0, hardening=1e6, damping=2.0, floor=2.0)
BOX = Box(stiffness=2000.0, damping=5.0, lower=(-0.005, -0.005), upper=(0.005, 0.005))
FIVE_BAR = FiveBar(base=0.1, proximal=(0.15, 0.15), distal=(0.2, 0.2))
MASS, FRICTION, STIFFNESS, DAMPING = 0.25, 0.1, 300.0, 3.0  # of the handle and of the hand
HAND_FORCE = 1.0
"""Declared [N]. At 100 Hz with a delay the hand pulls that hard within a hold; with 0 N the margin there is -7 mJ."""
DURATION = 2.0
LONGEST = 1e-4
STEPS = 4000


class Followed(NamedTuple):
    """One run of the example."""

    rms: float  # [m]
    margin: float  # least sum(h_i) - sum(h_r) [J]
    least: float  # least sum(h_i) [J]


def controller_of(environment: Any, kinematics: Any, rate: float, delay: int) -> GroupController:
    """Returns a guarded group of two axes with a hand-force certificate."""
    loop = LoopProperties(sample_time=1.0 / rate, delay=delay, moving_mass=MASS, device_damping_bound=2.0 * FRICTION)
    parameters = GuardedParameters(hand_force=HAND_FORCE)
    return build_group_controller(environment, kinematics, "guarded", parameters, [loop, loop])


def hand(time: float, position: Array, velocity: Array) -> Array:
    """Returns the force of a hand on a figure of eight [N]."""
    w = 2.0 * math.pi
    reach = np.array([0.03 * math.cos(w * time) - 0.03, 0.02 * math.sin(2.0 * w * time)])
    speed = np.array([-0.03 * w * math.sin(w * time), 0.04 * w * math.cos(2.0 * w * time)])
    force: Array = STIFFNESS * (reach - position) + DAMPING * (speed - velocity)
    return force


class Handle:
    """The handle under hand and torque, in Runge-Kutta steps shorter than a hold."""

    def __init__(self, sample_time: float) -> None:
        self.position, self.velocity = np.zeros(2), np.zeros(2)
        self.parts = max(1, math.ceil(sample_time / LONGEST))
        self.step, self.time, self.interaction = sample_time / self.parts, 0.0, 0.0

    def advance(self, torques: Sequence[float]) -> None:
        """Moves by one hold."""
        held, before, h = np.array(torques), self.position, self.step

        def rate(t: float, z: Array) -> Array:
            return np.concatenate([z[2:], (held - FRICTION * z[2:] + hand(t, z[:2], z[2:])) / MASS])

        z = np.concatenate([self.position, self.velocity])
        for _ in range(self.parts):
            t = self.time
            k1 = rate(t, z)
            k2 = rate(t + h / 2.0, z + h / 2.0 * k1)
            k3 = rate(t + h / 2.0, z + h / 2.0 * k2)
            k4 = rate(t + h, z + h * k3)
            z = z + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
            self.time += h
        self.position, self.velocity = z[:2], z[2:]
        self.interaction -= float(held @ (self.position - before))


def continuous(times: Array) -> Array:
    """Returns the positions of the continuous example, shape (n, 2) [m]; scipy, and none of the package's code."""
    k, k3, d, m, floor = EXAMPLE.stiffness, EXAMPLE.hardening, EXAMPLE.damping, EXAMPLE.mass, EXAMPLE.floor

    def rate(t: float, z: Array) -> Array:
        q, v, x, p = z[:2], z[2:4], z[4:6], z[6:]
        pull = x * (k + k3 * x * x) + d * (v - p / m)
        free = hand(t, q, v) - FRICTION * v
        return np.concatenate([v, (free - pull) / MASS, v - p / m, pull - floor * p / m])

    found: Array = (
        solve_ivp(rate, (0.0, times[-1]), np.zeros(8), "DOP853", t_eval=times, rtol=1e-10, atol=1e-13).y[:2].T
    )
    return found


def follow(rate: float, delay: int) -> Followed:
    """Runs the example in a guarded group."""
    controller, handle = controller_of(EXAMPLE, Identity(axes=2), rate, delay), Handle(1.0 / rate)
    pending, held = [(0.0, 0.0)] * delay, (0.0, 0.0)
    places, dissipated, margin, least = [], 0.0, 0.0, 0.0
    for _ in range(round(DURATION * rate)):
        places.append(handle.position)
        balance = controller.step(handle.position.tolist(), held)
        dissipated += balance.account.h_r
        margin, least = min(margin, handle.interaction - dissipated), min(least, handle.interaction)
        pending.append((balance.torques[0], balance.torques[1]))
        held = pending.pop(0)
        handle.advance(held)
    error = np.array(places) - continuous(np.arange(len(places)) / rate)
    return Followed(float(np.sqrt((error**2).sum(axis=1).mean())), margin, least)


def euler(rate: float) -> float:
    """Returns the largest position of the example sampled by explicit Euler [m]; infinite where it diverges."""
    sample_time, handle = 1.0 / rate, Handle(1.0 / rate)
    extension, momentum, before, largest = np.zeros(2), np.zeros(2), np.zeros(2), 0.0
    for _ in range(round(DURATION * rate)):
        velocity, before = (handle.position - before) / sample_time, handle.position
        relative = velocity - momentum / EXAMPLE.mass
        pull = extension * (EXAMPLE.stiffness + EXAMPLE.hardening * extension**2) + EXAMPLE.damping * relative
        extension = extension + sample_time * relative
        momentum = momentum + sample_time * (pull - EXAMPLE.floor * momentum / EXAMPLE.mass)
        handle.advance((-pull).tolist())
        largest = max(largest, float(np.abs(handle.position).max()))
        if not largest < 10.0:
            return math.inf
    return largest


def step_time(controller: GroupController, path: Callable[[int], list[float]]) -> tuple[float, float]:
    """Returns the median and the 10 % fastest of the step [us]."""
    held, following, times = (0.0, 0.0), (0.0, 0.0), []
    for k in range(STEPS):
        positions = path(k)
        start = perf_counter()
        balance = controller.step(positions, held)
        times.append(perf_counter() - start)
        held, following = following, (balance.torques[0], balance.torques[1])
    times.sort()
    return 1e6 * times[STEPS // 2], 1e6 * times[STEPS // 10]


def circle(radius: float) -> Callable[[int], list[float]]:
    """Returns positions on a circle about 0 [m]."""
    return lambda k: [radius * math.sin(0.02 * k), radius * math.cos(0.017 * k)]


def around(k: int) -> list[float]:
    """Returns motor positions of the five-bar about the sphere [rad]."""
    return [2.2 + 0.05 * math.sin(0.01 * k), 0.9 + 0.05 * math.cos(0.01 * k)]


def cost_rows() -> list[Row]:
    """Returns the cost of a step."""
    ball = Sphere(stiffness=1500.0, damping=3.0, centre=FIVE_BAR.pose((2.2, 0.9)).position, radius=0.05)
    cases: list[tuple[str, Any, Any, Callable[[int], list[float]], float]] = [
        ("step, 4 states, two axes, delay 1", EXAMPLE, Identity(axes=2), circle(0.01), 200.0),
        ("step, two axes in a box, no mass", BOX, Identity(axes=2), circle(0.01), 100.0),
        ("step, five-bar at a sphere, no mass", ball, FIVE_BAR, around, 100.0),
    ]
    rows = []
    for name, environment, kinematics, path, limit in cases:
        median, fast = step_time(controller_of(environment, kinematics, 1000.0, 1), path)
        rows.append(Row(name, median, "us", "10 % fastest", fast, target=f"<= {limit:g}", met=median <= limit))
    return rows


def truth_rows() -> list[Row]:
    """Returns accuracy and margin of the example by rate."""
    rows = []
    for delay in (0, 1):
        for rate in (100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0):
            run, plain = follow(rate, delay), euler(rate)
            name = f"{rate:g} Hz, delay {delay}"
            at = rate == 1000.0
            rows.append(
                Row(
                    f"rms against the continuous one, {name}", 1e3 * run.rms, "mm", "explicit Euler, largest position",
                    None if math.isinf(plain) else 1e3 * plain, target="<= 0.05" if at else "",
                    met=run.rms <= 5e-5 if at else None, note="explicit Euler diverges" if math.isinf(plain) else "",
                )
            )  # fmt: skip
            limit = {100.0: -5.0, 1000.0: -0.5}.get(rate)
            rows.append(
                Row(
                    f"margin of (4), {name}", 1e3 * run.margin, "mJ", "least sum(h_i)", 1e3 * run.least,
                    target="" if limit is None else f">= {limit:g}",
                    met=None if limit is None else 1e3 * run.margin >= limit,
                )
            )  # fmt: skip
    return rows


def main() -> None:
    """Measures and publishes."""
    publish("network", cost_rows() + truth_rows(), ["canhaptic", "numpy", "scipy", "numba"])


if __name__ == "__main__":
    main()
