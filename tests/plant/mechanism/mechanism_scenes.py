"""Mechanisms and their independent references: textbook equations of motion by scipy's DOP853."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from canhaptic.sim.plant.mechanism.five_bar_linkage import FiveBarLinkage
from canhaptic.sim.plant.mechanism.task_hand import PlaneMotion, TaskHand
from canhaptic.sim.plant.mechanism.xy_stage import XYStage
from canhaptic.sim.plant.user import SinusoidMotion

MS = 1_000_000
LINKS: dict[str, Any] = {
    "base": 0.1, "proximal": 0.15, "distal": 0.2, "motor_inertia": 3e-4, "distal_mass": 0.05, "handle_mass": 0.1,
    "damping": 1e-3, "initial_angles": (2.2, 0.9),
}  # fmt: skip
HAND = TaskHand(
    stiffness=300,
    stiffness_across=120,
    damping=3,
    damping_across=2,
    angle=0.6,
    push=(0.2, -0.1),
    rest=(0.0, 0.25),
    motion=PlaneMotion(
        x=SinusoidMotion(amplitude=0.05, frequency=1.0), y=SinusoidMotion(amplitude=0.03, frequency=1.3)
    ),
)
STAGE: dict[str, Any] = {"mass_x": 0.6, "mass_y": 0.25, "damping_x": 0.4, "damping_y": 0.1}
Torques = Sequence[tuple[float, float]]


def five_bar(hand: TaskHand | None = HAND, substeps: int = 1, period: int = MS, **values: Any):
    return FiveBarLinkage(**{**LINKS, **values}).build(hand, period, substeps)


def stage(hand: TaskHand | None = HAND, period: int = MS, **values: Any):
    return XYStage(**{**STAGE, **values}).build(hand, period, 1)


def run(mechanism: Any, torques: Torques, period: int = MS) -> np.ndarray:
    """Positions at every SYNC, shape (len(torques) + 1, 2)."""
    mechanism.begin(0)
    rows = [mechanism.positions]
    for k, pair in enumerate(torques):
        mechanism.advance_to((k + 1) * period, pair)
        rows.append(mechanism.positions)
    return np.array(rows)


def hand_force(time: float, x: np.ndarray, v: np.ndarray, hand: TaskHand = HAND) -> np.ndarray:
    """The force of the hand, as in a textbook: K and D from their axes by rotation."""
    turn = np.array([[math.cos(hand.angle), -math.sin(hand.angle)], [math.sin(hand.angle), math.cos(hand.angle)]])
    across_k = hand.stiffness if hand.stiffness_across is None else hand.stiffness_across
    across_d = hand.damping if hand.damping_across is None else hand.damping_across
    stiffness = turn @ np.diag([hand.stiffness, across_k]) @ turn.T
    damping = turn @ np.diag([hand.damping, across_d]) @ turn.T
    target, speed = np.array(hand.rest, dtype=float), np.zeros(2)
    for i, motion in enumerate((hand.motion.x, hand.motion.y)):
        if motion is not None:
            omega = 2 * math.pi * motion.frequency
            target[i] += motion.offset + motion.amplitude * math.sin(omega * time + motion.phase)
            speed[i] = omega * motion.amplitude * math.cos(omega * time + motion.phase)
    return stiffness @ (target - x) + damping @ (speed - v) + np.array(hand.push)


def integrated(
    rates: Callable[..., Any], state: Sequence[float], torques: Torques, period: float, tolerance: float = 1e-12
) -> np.ndarray:
    """State at every SYNC, shape (len(torques) + 1, n)."""
    rows = [np.array(state, dtype=float)]
    for k, pair in enumerate(torques):
        result = solve_ivp(
            rates, (k * period, (k + 1) * period), rows[-1], "DOP853", rtol=tolerance, atol=1e-14, args=(pair,)
        )
        rows.append(result.y[:, -1])
    return np.array(rows)


class OpenChains:
    """A five-bar as two open double pendulums held together by multipliers: nothing of the closed form is in here.

    Coordinates: angles of both proximal and both distal links, (q1, q2, f1, f2); the constraint says that both distal
    links end in one point. The handle's mass is on the left one.
    """

    def __init__(self, links: dict[str, Any] = LINKS, hand: TaskHand | None = HAND) -> None:
        self.links, self.hand = links, hand

    def start(self) -> np.ndarray:
        """Angles of all links in the usual pose, by intersecting two circles, and no velocity."""
        a, b, base = self.links["proximal"], self.links["distal"], self.links["base"]
        q1, q2 = self.links["initial_angles"]
        left = np.array([-base / 2 + a * math.cos(q1), a * math.sin(q1)])
        right = np.array([base / 2 + a * math.cos(q2), a * math.sin(q2)])
        middle, way = (left + right) / 2, right - left
        height = math.sqrt(b * b - way @ way / 4)
        tip = middle + height * np.array([-way[1], way[0]]) / np.linalg.norm(way)
        f1, f2 = (math.atan2(*(tip - elbow)[::-1]) for elbow in (left, right))
        return np.array([q1, q2, f1, f2, 0, 0, 0, 0])

    def tip(self, z: np.ndarray) -> np.ndarray:
        a, b, base = self.links["proximal"], self.links["distal"], self.links["base"]
        return np.array([-base / 2 + a * math.cos(z[0]) + b * math.cos(z[2]), a * math.sin(z[0]) + b * math.sin(z[2])])

    def rates(self, time: float, z: np.ndarray, torques: tuple[float, float]) -> np.ndarray:
        a, b = self.links["proximal"], self.links["distal"]
        m, mh, inertia = self.links["distal_mass"], self.links["handle_mass"], self.links["motor_inertia"]
        v = z[4:]
        mass, forces = np.zeros((4, 4)), np.zeros(4)
        constraint, drift = np.zeros((2, 4)), np.zeros(2)
        for side, sign in ((0, 1.0), (1, -1.0)):
            q, f = z[side], z[side + 2]
            tip_mass = mh if side == 0 else 0.0
            coupling = a * b * (m / 2 + tip_mass)
            mass[side, side] = inertia + a * a * (m + tip_mass)
            mass[side + 2, side + 2] = b * b * (m / 3 + tip_mass)
            mass[side, side + 2] = mass[side + 2, side] = coupling * math.cos(q - f)
            forces[side] = (
                torques[side] - self.links["damping"] * v[side] - coupling * math.sin(q - f) * v[side + 2] ** 2
            )
            forces[side + 2] = coupling * math.sin(q - f) * v[side] ** 2
            constraint[:, side] = sign * a * np.array([-math.sin(q), math.cos(q)])
            constraint[:, side + 2] = sign * b * np.array([-math.sin(f), math.cos(f)])
            drift += sign * a * v[side] ** 2 * np.array([math.cos(q), math.sin(q)])
            drift += sign * b * v[side + 2] ** 2 * np.array([math.cos(f), math.sin(f)])
        if self.hand is not None:
            to_tip = np.array(constraint)
            to_tip[:, 1] = to_tip[:, 3] = 0.0
            forces += to_tip.T @ hand_force(time, self.tip(z), to_tip @ v, self.hand)
        system = np.block([[mass, constraint.T], [constraint, np.zeros((2, 2))]])
        solved = np.linalg.solve(system, np.concatenate([forces, drift]))
        return np.concatenate([v, solved[:4]])


def wavy(count: int, size: float = 0.1) -> list[tuple[float, float]]:
    """Torques of both motors that change at every SYNC."""
    return [(size * math.sin(0.11 * k), -0.5 * size * math.cos(0.07 * k)) for k in range(count)]
