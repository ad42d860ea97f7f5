"""Users who try to take energy out of a group, on a plant that is exact: none of the package's mathematics of motion.

M q'' + B q' = torque + hand, both constant in each part of a hold, so that the matrix exponential moves it exactly. The
energy of the motors is their torque, constant, times their displacement.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import expm

from canhaptic.control.mechanisms.kinematics import Identity
from canhaptic.control.multi_axis import build_group_controller
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.guarded import GuardedParameters
from canhaptic.control.port_hamiltonian.shapes.anisotropic_spring import AnisotropicSpring
from canhaptic.control.port_hamiltonian.shapes.box import Box
from canhaptic.control.port_hamiltonian.shapes.coupled_handles import CoupledHandles
from canhaptic.control.port_hamiltonian.shapes.moving_wall import MovingWall
from canhaptic.control.port_hamiltonian.shapes.plane import Plane
from canhaptic.control.port_hamiltonian.shapes.sphere import Sphere

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
    hand_force: float | None = 0.0  # None: the hand moves the axes with up to own["hand_speed"]
    pulls: float = 1.0  # of the declared force or speed
    start: tuple = (0.02, 0.0)
    velocity: tuple = (0.0, 0.0)
    count: float = 0.0
    quantum: float = 0.0
    limits: tuple | None = None  # declared
    cuts: tuple | None = None  # not declared: a limiter after the controller
    lost_commands: float = 0.0  # chance of each axis, in each hold
    lost_samples: float = 0.0
    max_consecutive_losses: int = 0
    in_a_row: int = 0  # that are lost; 0: as many as declared
    own: dict = field(default_factory=dict)
    known: dict = field(default_factory=dict)
    windows: tuple | None = None  # of a sample time, in which an older torque of each axis acts at most
    lags: tuple | None = None  # of a sample time, of the torque of each motor
    jitter: float = 0.0
    parts: int = 2
    cycles: int = 150

    @property
    def is_late(self):
        return bool(self.windows or self.lags or self.jitter)


class ExactTable:
    """Coupled masses with viscous friction. `least` is the least energy that came in by the motors [J].

    A mover's part of it counts as well: `wall` is (normal, place of the wall at a time).
    """

    def __init__(self, attack, wall=None):
        n = len(attack.masses)
        inertia = np.diag(attack.masses) + np.array(attack.coupling)
        self.mobility = np.linalg.inv(inertia)
        rates = np.zeros((3 * n, 3 * n))
        rates[:n, n : 2 * n] = np.eye(n)
        rates[n : 2 * n, n : 2 * n] = -self.mobility @ np.diag(attack.friction)
        rates[n : 2 * n, 2 * n :] = self.mobility
        self._n, self._short, self._rates = n, attack.sample_time / attack.parts, rates
        self._is_late, self._steps = attack.is_late, {}
        self.last(1.0)
        self.state = np.array([*attack.start, *attack.velocity])
        self._wall, self.time = wall, 0.0
        self.given = self.least = 0.0

    def last(self, share):
        """Takes how long the next hold is, as a part of the sample time."""
        if share not in self._steps:
            self._steps[share] = expm(self._rates * self._short * share)[: 2 * self._n]
        self._step = self._steps[share]

    @property
    def position(self):
        return self.state[: self._n]

    @property
    def velocity(self):
        return self.state[self._n :]

    def move(self, torque, hand):
        before, began = self.position, self.time
        self.time += self._short
        self.state = self._displaced(torque, hand)
        self.given -= float(torque @ (self.position - before))
        if self._wall:
            normal, place = self._wall
            self.given += float(torque @ normal) * (place(self.time) - place(began))
        if not (self._wall or self._is_late):  # what is uneven inside a hold is foreseen at its end
            self.least = min(self.least, self.given)

    def _displaced(self, torque, hand):
        return self._step @ np.concatenate([self.state, torque + hand])


class DraggedTable(ExactTable):
    """Moves as the hand says: what pushes is a velocity, and nothing resists."""

    def _displaced(self, _torque, hand):
        return np.concatenate([self.position + hand * self._short, hand])


def group_of(attack):
    known = {"device_damping_bound": attack.declared_friction or 0.0, "sync_jitter": attack.jitter, **attack.known}
    late = [
        {"torque_window": w * attack.sample_time, "current_lag": lag * attack.sample_time}
        for w, lag in zip(attack.windows or (0.0,) * 9, attack.lags or (0.0,) * 9, strict=False)
    ]
    loops = [
        LoopProperties(
            **late[i],
            sample_time=attack.sample_time, delay=attack.delay, moving_mass=mass, encoder_count=attack.count,
            torque_quantum=attack.quantum, torque_limit=attack.limits[i] if attack.limits else None, **known,
        )
        for i, mass in enumerate(attack.masses)
    ]  # fmt: skip
    own = {"hand_force": attack.hand_force, **attack.own}
    if attack.max_consecutive_losses:
        own["max_consecutive_losses"] = attack.max_consecutive_losses
    mechanism = Identity(axes=len(attack.masses))
    return build_group_controller(attack.environment, mechanism, "guarded", GuardedParameters(**own), loops)


class Hand:
    """Pulls each axis with no more than the declared force, in the direction that pays."""

    def __init__(self, attack, mobility, rng):
        most = attack.own["hand_speed"] if attack.hand_force is None else attack.hand_force
        self._most, self._rng, self._mobility = most * attack.pulls, rng, mobility
        self._phase, self._left, self._aim = "free", 0, np.zeros(len(mobility))

    def force(self, held, following, velocity):
        if self._left <= 0:
            self._phase, self._left = self._rng.choice(PHASES), self._rng.choice((1, 1, 2, 3, 5, 10, 30))
            self._aim = np.array([self._rng.gauss(0.0, 1.0) for _ in held])
        self._left -= 1
        if self._phase == "free" or not self._most:
            return np.zeros(len(held))
        if self._phase == "each":
            return self._most * np.sign(held)
        wanted = {
            "in": -held,
            "pull": self._mobility @ held,
            "pull_next": self._mobility @ following,
            "across": np.roll(held, 1) * np.where(np.arange(len(held)) % 2, 1.0, -1.0),
            "brake": -velocity,
        }[self._phase]
        if not wanted.any():
            wanted = self._aim
        return self._most * np.sign(wanted) if self._rng.random() < 0.5 else self._most * wanted / abs(wanted).max()


class Motors:
    """Torques as they come: each axis somewhere in its window after the SYNC, and with its lag."""

    def __init__(self, attack, rng):
        self._attack, self._rng, axes = attack, rng, len(attack.masses)
        self._before, self._true = np.zeros(axes), np.zeros(axes)
        self._windows, self._lags = attack.windows or (0.0,) * axes, attack.lags or (0.0,) * axes

    def parts_of(self, held, longer):
        """Returns the mean torques of the parts of a hold, which lasts `longer` sample times."""
        count, step, rows = self._attack.parts, longer / self._attack.parts, []
        at = [self._rng.choice((0.0, window, self._rng.uniform(0.0, window))) for window in self._windows]
        for part in range(count):
            row = np.zeros(len(held))
            for i, lag in enumerate(self._lags):
                late = min(1.0, max(0.0, at[i] / step - part))
                demand = mean = late * self._before[i] + (1.0 - late) * held[i]
                if lag > 0.0:
                    kept = math.exp(-step / lag)
                    mean = demand + (self._true[i] - demand) * (1.0 - kept) * lag / step
                    self._true[i] = demand + (self._true[i] - demand) * kept
                row[i] = mean
            rows.append(row)
        self._before = held
        return rows


class Losses:
    """Frames lost in any mix: no axis is without a new torque for more than the declared cycles in a row.

    A command is new when it was computed from a sample; one repeated for want of a sample is not, for any axis, in the
    hold for which it is sent.
    """

    def __init__(self, attack, rng):
        self._attack, self._rng, self._most = attack, rng, attack.in_a_row or max(1, attack.max_consecutive_losses)
        self._without = [0] * len(attack.masses)  # cycles in a row, of each axis
        self._due = [True] * attack.delay  # whether the commands under way are new

    def sample(self, cycle):
        """Returns whether the samples of this cycle are lost."""
        without = max(self._without)
        for new in self._due:
            without = 0 if new else without + 1
        lost = cycle > 1 and without < self._most and self._rng.random() < self._attack.lost_samples
        self._due.append(not lost)
        return lost

    def command(self, axis):
        """Returns whether the command of an axis for this hold is lost; called once for each axis, in order."""
        new, *following = self._due
        if axis == len(self._without) - 1:
            self._due = following
        later = following.index(True) if True in following else len(following)
        free = not new or self._without[axis] + 1 + later <= self._most
        lost = free and self._rng.random() < self._attack.lost_commands
        self._without[axis] = self._without[axis] + 1 if lost or not new else 0
        return lost


def run(attack, rng, each=None):
    """Returns (least true energy that came in [J], largest torque); calls `each(plant, balance)` at every sample."""
    controller, axes = group_of(attack), len(attack.masses)
    plant = (ExactTable if attack.hand_force is not None else DraggedTable)(attack, wall_of(attack.environment))
    hand, losses = Hand(attack, plant.mobility, rng), Losses(attack, rng)
    pending, held, strongest = [np.zeros(axes)] * attack.delay, np.zeros(axes), 0.0
    motors = Motors(attack, rng)
    for cycle in range(attack.cycles):
        position = plant.position
        if attack.count:
            position = np.floor(position / attack.count) * attack.count
        lost = losses.sample(cycle)
        balance = controller.sample_lost() if lost else controller.step(position.tolist(), tuple(held.tolist()))
        if each is not None:
            each(plant, balance)
        command = np.array(balance.torques)
        pending.append(command)
        acting = pending.pop(0)
        acting = np.where([losses.command(axis) for axis in range(axes)], held, acting)
        if attack.cuts:
            acting = np.clip(acting, [-c for c in attack.cuts], attack.cuts)
        held, strongest = acting, max(strongest, float(np.abs(acting).max()))
        longer = rng.choice((1.0 - attack.jitter, 1.0 + attack.jitter, 1.0)) if attack.jitter else 1.0
        plant.last(longer)
        for torque in motors.parts_of(held, longer) if attack.is_late else [held] * attack.parts:
            plant.move(torque, hand.force(held, command, plant.velocity))
        plant.least = min(plant.least, plant.given)
        if np.abs(plant.position).max() > 10.0:
            break
    return plant.least, strongest


def wall_of(environment):
    """Returns normal and motion of a wall that moves; None of others."""
    if not isinstance(environment, MovingWall):
        return None
    normal = np.array(environment.normal) / np.linalg.norm(environment.normal)
    half, rate = 0.5 * environment.amplitude, 2.0 * math.pi * environment.frequency
    return normal, lambda time: half * (1.0 - math.cos(rate * time))


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


def late(attack, rng):
    """Returns an attack with torques that come late, by axis, and holds that jitter."""
    axes = len(attack.masses)
    windows = tuple(rng.choice((0.0, rng.uniform(0.0, 0.6))) for _ in range(axes))
    lags = tuple(rng.choice((0.0, 10.0 ** rng.uniform(-2, 0.3))) for _ in range(axes))
    jitter = rng.choice((0.0, 0.0, 0.02, 0.2)) if not attack.own.get("hand_speed") else 0.0
    return replace(attack, windows=windows, lags=lags, jitter=jitter, parts=12)


def in_space(attack, rng):
    """Returns an attack of two axes with a third one."""
    half = np.array([[rng.gauss(0.0, 1.0) for _ in range(3)] for _ in range(3)])
    coupled = np.array(attack.coupling).any()
    coupling = max(attack.masses) * 10.0 ** rng.uniform(-2, 2) * half.T @ half if coupled else np.zeros((3, 3))
    normal = tuple(rng.gauss(0.0, 1.0) for _ in range(3))
    stiffness, damping = 10.0 ** rng.uniform(2, 6), rng.choice((0.0, 0.0, 5.0, 50.0))
    matrix = 10.0 ** rng.uniform(2, 6) * (turned := np.array([rng.gauss(0.0, 1.0) for _ in range(9)]).reshape(3, 3)).T
    matrix = matrix @ turned
    environment = rng.choice((
        Plane(normal=normal, stiffness=stiffness, damping=damping),
        Box(stiffness=stiffness, damping=damping, lower=(-0.01,) * 3, upper=(0.01,) * 3),
        Sphere(stiffness=stiffness, damping=damping, centre=(0.0,) * 3, radius=0.02),
        AnisotropicSpring(centre=(0.0,) * 3, stiffness=tuple(map(tuple, (0.5 * (matrix + matrix.T)).tolist()))),
    ))  # fmt: skip
    return replace(
        attack, environment=environment, masses=(*attack.masses, 10.0 ** rng.uniform(-1.5, 0.5)),
        coupling=tuple(map(tuple, coupling.tolist())), friction=(*attack.friction, 0.0),
        start=(*attack.start, rng.gauss(0.0, 0.01)), velocity=(*attack.velocity, rng.gauss(0.0, 1.0)),
    )  # fmt: skip


def before_moving_wall(attack, rng):
    """Returns an attack on a wall that moves."""
    normal = rng.gauss(0.0, 1.0), rng.gauss(0.0, 1.0)
    wall = MovingWall(
        normal=normal, stiffness=10.0 ** rng.uniform(2, 5), damping=rng.choice((0.0, 0.0, 5.0, 50.0)),
        amplitude=rng.choice((0.005, 0.02)), frequency=10.0 ** rng.uniform(-0.5, 1),
    )  # fmt: skip
    return replace(attack, environment=wall)


def dragged(attack, rng):
    """Returns an attack by a hand that moves the axes as it likes, up to a declared speed."""
    speed = 10.0 ** rng.uniform(-2, 0.5)
    own = {"hand_speed": speed, "energy_allowance": 1e-3}  # without a credit no torque can be the first
    return replace(attack, hand_force=None, own=own, velocity=(0.0, 0.0))
