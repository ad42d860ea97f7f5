"""Users who try to take energy out of a group, on a plant that is exact: none of the package's mathematics of motion.

M q'' + B q' = torque + hand, both constant in each part of a hold, so that the matrix exponential moves it exactly. The
energy of the motors is their torque, constant, times their displacement.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import expm

from canhaptic.haptics.kinematics.identity import Identity
from canhaptic.haptics.network import build_group_controller
from canhaptic.haptics.network.anisotropic_spring import AnisotropicSpring
from canhaptic.haptics.network.box import Box
from canhaptic.haptics.network.coupled_handles import CoupledHandles
from canhaptic.haptics.network.guarded_group import GuardedGroupParameters
from canhaptic.haptics.network.plane import Plane
from canhaptic.haptics.network.sphere import Sphere
from canhaptic.haptics.passivity.protocol import LoopProperties

PHASES = ("in", "pull", "pull", "pull_next", "across", "free", "brake", "each")


@dataclass(frozen=True)
class Attack:
    """One run. Masses are the declared under-estimates, `coupling` is what the true inertia has beyond them."""

    environment: object
    sample_time: float = 1e-3
    delay: int = 0
    masses: tuple = (0.25, 0.25)
    coupling: tuple = ((0.0, 0.0), (0.0, 0.0))
    friction: tuple = (0.0, 0.0)
    declared_friction: float = 0.0
    hand_force: float = 0.0
    pulls: float = 1.0  # of the declared force
    start: tuple = (0.02, 0.0)
    velocity: tuple = (0.0, 0.0)
    count: float = 0.0
    quantum: float = 0.0
    limits: tuple | None = None  # declared
    cuts: tuple | None = None  # not declared: a limiter after the controller
    lost_commands: float = 0.0  # chance of each axis, in each hold
    lost_samples: float = 0.0
    lost_frames: int = 0
    own: dict = field(default_factory=dict)
    known: dict = field(default_factory=dict)
    parts: int = 2
    cycles: int = 150


class ExactTable:
    """Two coupled masses with viscous friction."""

    def __init__(self, attack):
        inertia = np.diag(attack.masses) + np.array(attack.coupling)
        self.mobility = np.linalg.inv(inertia)
        rates = np.zeros((6, 6))
        rates[:2, 2:4] = np.eye(2)
        rates[2:4, 2:4] = -self.mobility @ np.diag(attack.friction)
        rates[2:4, 4:] = self.mobility
        self._step = expm(rates * attack.sample_time / attack.parts)[:4]
        self.state = np.array([*attack.start, *attack.velocity])
        self.given = self.least = 0.0

    def move(self, torque, hand):
        before = self.state[:2]
        self.state = self._step @ np.concatenate([self.state, torque + hand])
        self.given -= float(torque @ (self.state[:2] - before))
        self.least = min(self.least, self.given)


def group_of(attack):
    known = dict(attack.known)
    if attack.declared_friction:
        known["device_damping_bound"] = attack.declared_friction
    loops = [
        LoopProperties(
            sample_time=attack.sample_time, delay=attack.delay, moving_mass=mass, encoder_count=attack.count,
            torque_quantum=attack.quantum, torque_limit=attack.limits[i] if attack.limits else None, **known,
        )
        for i, mass in enumerate(attack.masses)
    ]  # fmt: skip
    own = {"hand_force": attack.hand_force, **attack.own}
    if attack.lost_frames:
        own["lost_frames"] = attack.lost_frames
    return build_group_controller(attack.environment, Identity(axes=2), "guarded", GuardedGroupParameters(**own), loops)


class Hand:
    """Pulls each axis with no more than the declared force, in whatever direction pays."""

    def __init__(self, attack, mobility, rng):
        self._most, self._rng, self._mobility = attack.hand_force * attack.pulls, rng, mobility
        self._phase, self._left, self._aim = "free", 0, np.zeros(2)

    def force(self, held, following, velocity):
        if self._left <= 0:
            self._phase, self._left = self._rng.choice(PHASES), self._rng.choice((1, 1, 2, 3, 5, 10, 30))
            self._aim = np.array([self._rng.gauss(0.0, 1.0), self._rng.gauss(0.0, 1.0)])
        self._left -= 1
        if self._phase == "free" or not self._most:
            return np.zeros(2)
        if self._phase == "each":
            return self._most * np.sign(held)
        wanted = {
            "in": -held,
            "pull": self._mobility @ held,
            "pull_next": self._mobility @ following,
            "across": np.array([-held[1], held[0]]),
            "brake": -velocity,
        }[self._phase]
        if not wanted.any():
            wanted = self._aim
        return self._most * np.sign(wanted) if self._rng.random() < 0.5 else self._most * wanted / abs(wanted).max()


def run(attack, rng):
    """Returns (least true sum of h_i [J], largest torque)."""
    controller, plant = group_of(attack), ExactTable(attack)
    hand = Hand(attack, plant.mobility, rng)
    pending, held, strongest = [np.zeros(2)] * attack.delay, np.zeros(2), 0.0
    unheard, lost = 0, [0, 0]  # in a row: no axis goes without a new torque for longer than declared
    for cycle in range(attack.cycles):
        position = plant.state[:2]
        if attack.count:
            position = np.floor(position / attack.count) * attack.count
        most = max(1, attack.lost_frames)
        if cycle > 1 and unheard < most and not any(lost) and rng.random() < attack.lost_samples:
            unheard += 1
            balance = controller.hold()
        else:
            unheard = 0
            balance = controller.step(position.tolist(), tuple(held.tolist()))
        command = np.array(balance.torques)
        pending.append(command)
        acting = pending.pop(0)
        for axis in range(2):
            lose = not unheard and lost[axis] < most and rng.random() < attack.lost_commands
            lost[axis] = lost[axis] + 1 if lose else 0
            if lose:
                acting = np.where(np.arange(2) == axis, held, acting)
        if attack.cuts:
            acting = np.clip(acting, [-c for c in attack.cuts], attack.cuts)
        held, strongest = acting, max(strongest, float(np.abs(acting).max()))
        for _ in range(attack.parts):
            plant.move(held, hand.force(held, command, plant.state[2:]))
        if np.abs(plant.state[:2]).max() > 10.0:
            break
    return plant.least, strongest


def environment(rng):
    """A wall or spring of 1e2 to 1e6 N/m, damped or not."""
    stiffness, damping = 10.0 ** rng.uniform(2, 6), rng.choice((0.0, 0.0, 5.0, 50.0))
    kind = rng.choice(("plane", "box", "sphere", "spring", "handles"))
    angle = rng.uniform(0.0, 2.0 * math.pi)
    if kind == "plane":
        return Plane(normal=(math.cos(angle), math.sin(angle)), stiffness=stiffness, damping=damping)
    if kind == "box":
        return Box(stiffness=stiffness, damping=damping, lower=(-0.01, -0.01), upper=(0.01, 0.01))
    if kind == "sphere":
        return Sphere(stiffness=stiffness, damping=damping, centre=(0.0, 0.0), radius=0.02)
    if kind == "handles":
        return CoupledHandles(stiffness=stiffness, damping=damping)
    along, across = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
    matrix = stiffness * (np.outer(along, along) + 10.0 ** rng.uniform(-3, 0) * np.outer(across, across))
    matrix = 0.5 * (matrix + matrix.T)
    return AnisotropicSpring(
        centre=(0.0, 0.0), stiffness=tuple(map(tuple, matrix.tolist())), damping=((damping, 0.0), (0.0, 0.3 * damping))
    )


def random_attack(rng, **given):
    """Anything within the promise; inertia that is coupled has no friction."""
    masses = tuple(10.0 ** rng.uniform(-1.5, 0.5) for _ in range(2))
    masses = rng.choice((masses, (0.05, 5.0), (masses[0], masses[0])))
    coupled = rng.random() < 0.4
    coupling = np.zeros((2, 2))
    if coupled:
        half = math.sqrt(max(masses)) * 10.0 ** rng.uniform(-1, 1) * np.array(
            [[rng.gauss(0, 1), rng.gauss(0, 1)], [rng.gauss(0, 1) * rng.choice((0, 1)), 0.0]]
        )  # fmt: skip
        coupling = half.T @ half
    friction = 0.0 if coupled else rng.choice((0.0, 0.1, 1.0, 5.0))
    angle, distance = rng.uniform(0.0, 2.0 * math.pi), rng.choice((0.005, 0.02, 0.03))
    start = distance * math.cos(angle), distance * math.sin(angle)
    speed = 10.0 ** rng.uniform(-2, 0.7)
    aim = np.array([rng.gauss(0.0, 0.01) - start[0], rng.gauss(0.0, 0.01) - start[1]])
    drawn = Attack(
        environment=environment(rng),
        sample_time=1.0 / 10.0 ** rng.uniform(2, math.log10(4000.0)),
        delay=rng.randrange(2),
        masses=masses,
        coupling=tuple(map(tuple, coupling.tolist())),
        friction=tuple(friction * rng.choice((0.0, 1.0, rng.random())) for _ in range(2)),
        declared_friction=friction,
        hand_force=rng.choice((0.0, 0.0, 2.0, 8.0)),
        start=start,
        velocity=tuple((speed * aim / np.linalg.norm(aim)).tolist()),
        parts=rng.choice((1, 2, 4)),
    )
    return replace(drawn, **given)
