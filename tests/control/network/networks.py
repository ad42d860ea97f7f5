"""Networks, groups and an independent plant for the tests of this folder."""

import math

import numpy as np

from canhaptic.control.mechanisms.kinematics import Identity
from canhaptic.control.multi_axis import build_group_controller
from canhaptic.control.multi_axis.group_certificates import (
    Acting,
    inward_first,
    needed_by_hand,
    per_axis_limits,
    per_axis_memory,
    share_per_axis,
    take_sent,
)
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.guarded import GuardedParameters
from canhaptic.control.port_hamiltonian.network import Damper, DoubleWell, Mass, Network, QuadraticForm, Spring
from canhaptic.control.port_hamiltonian.sampled_network import (
    NetworkState,
    advance_network,
    network_memory,
    settle_network,
)
from canhaptic.control.port_hamiltonian.shapes.virtual_mass import VirtualMass

MASS, FRICTION = 0.25, 0.1
EXAMPLE = VirtualMass(mass=0.3, stiffness=800.0, hardening=1e6, damping=2.0, floor=2.0)


def loops(axes, sample_time=1e-3, delay=0, **known):
    known = {"moving_mass": MASS, "device_damping_bound": 2.0 * FRICTION, **known}
    return [LoopProperties(sample_time=sample_time, delay=delay, **known) for _ in range(axes)]


def group(environment, axes=2, *, algorithm="guarded", sample_time=1e-3, delay=0, kinematics=None, known=None, **own):
    mechanism = kinematics or Identity(axes=axes)
    parameters = GuardedParameters(**own) if algorithm == "guarded" else None
    return build_group_controller(
        environment, mechanism, algorithm, parameters, loops(axes, sample_time, delay, **(known or {}))
    )


NO_OLDER = Acting([0.0] * 3, [0.0] * 3)


class AxesApart:
    """The certificates of axes that may act apart, with their buffers; none that a mover moves where none is given."""

    def __init__(self, axes, delay, losses):
        self.axes, self.limits = axes, per_axis_limits(axes, delay, losses)
        self.memory = per_axis_memory(self.limits)

    def take(self, displacement, position_uncertainty, torques, under_way, mover_motion=()):
        still = [[0.0] * len(torques)] * self.limits.holds
        self.mover_motion = mover_motion or still
        take_sent(
            self.axes, self.limits, self.memory, displacement, position_uncertainty, torques, under_way, 0, NO_OLDER
        )

    def share_per_axis(self, torques, budget):
        return share_per_axis(self.axes, self.limits, self.memory, self.mover_motion, torques, budget)

    def needed_by_hand(self):
        return needed_by_hand(self.axes, self.limits, self.memory, self.mover_motion)

    def inward_first(self, torques, budget):
        found, ideal = [0.0] * len(torques), [0.0] * len(torques)
        inward_first(self.axes, self.limits, self.memory, self.mover_motion, torques, ideal, budget, found)
        return tuple(found)


class FollowedNetwork:
    """A network with what it remembers, followed at no coordinates but its own."""

    def __init__(self, network):
        self.network, self.found = network, NetworkState()
        self.memory = network_memory(network.tables)
        self.settle()

    def settle(self):
        settle_network(self.network, self.found, self.memory)

    def advance(self, coordinates, displacement, elapsed):
        return advance_network(self.network, self.found, self.memory, coordinates, displacement, elapsed)


def random_network(rng):
    """A network of one port: springs, hardening springs or double wells in a chain with masses, k 1e-3..1e7."""

    def decades(low, high):
        return 10.0 ** rng.uniform(low, high)

    def elastic():
        kind = rng.randrange(3)
        if kind == 0:
            return Spring(stiffness=decades(-3, 7))
        if kind == 1:
            return Spring(stiffness=decades(-3, 7), hardening=decades(0, 12))
        return DoubleWell(hardening=decades(2, 10), well=decades(-4, -1.5))

    links = rng.randrange(1, 4)
    storages, dampers, size = [], [], 2 * links - rng.randrange(2)
    for state in range(size):
        if state % 2 == 0:
            storages.append(elastic())
            if rng.random() < 0.6:
                dampers.append(Damper(viscous=decades(-3, 3), beside=state))
        else:
            storages.append(Mass(mass=decades(-3, 1)))
            if rng.random() < 0.6:
                dampers.append(Damper(viscous=decades(-3, 3), coulomb=rng.choice((0.0, 1.0)), states={state: 1.0}))
    structure = [[0.0] * size for _ in range(size)]
    for state in range(size - 1):  # extension' = velocity in - velocity out, momentum' = force in - force out
        structure[state][state + 1], structure[state + 1][state] = -1.0, 1.0
    gain = [[1.0 if state == 0 else 0.0] for state in range(size)]
    return Network(storages, dampers, gain=gain, structure=structure)


def tangled_network(rng):
    """A network in which anything acts on anything: springs on springs, walls, quadratic forms, dampers across."""

    def decades(low, high):
        return 10.0 ** rng.uniform(low, high)

    def quadratic():
        rows = [[rng.gauss(0.0, 1.0) * decades(-1, 3) for _ in range(2)] for _ in range(2)]
        return QuadraticForm(matrix=[[sum(a * b for a, b in zip(x, y, strict=True)) for y in rows] for x in rows])

    kinds = (
        lambda: Spring(stiffness=decades(-3, 7)),
        lambda: Spring(stiffness=decades(-3, 7), hardening=decades(0, 12)),
        lambda: DoubleWell(hardening=decades(2, 10), well=decades(-4, -1.5)),
        lambda: Spring(stiffness=decades(0, 6), lower=-decades(-5, -2), upper=rng.choice((None, decades(-5, -2)))),
        lambda: Mass(mass=decades(-3, 1)),
        quadratic,
    )
    storages = [rng.choice(kinds)() for _ in range(rng.randrange(2, 5))]
    size = sum(2 if isinstance(each, QuadraticForm) else 1 for each in storages)
    structure = [[0.0] * size for _ in range(size)]
    for i in range(size):
        for j in range(i):
            structure[i][j] = rng.choice((0.0, 1.0)) * rng.gauss(0.0, 1.0)
            structure[j][i] = -structure[i][j]
    dampers = [
        Damper(
            viscous=decades(-3, 1), squared=rng.choice((0.0, 1.0)), coulomb=rng.choice((0.0, 0.0, 1.0)),
            states={i: rng.gauss(0.0, 1.0) for i in range(size)}, ports={0: rng.choice((0.0, 1.0))},
        )
        for _ in range(rng.randrange(3))
    ]  # fmt: skip
    gain = [[rng.choice((0.0, 1.0)) * rng.gauss(0.0, 1.0)] for _ in range(size)]
    return Network(storages, dampers, gain=gain, structure=structure)


class Table:
    """Independent masses under motor torque and hand, by Runge-Kutta steps much shorter than a hold.

    The energy of each motor is the torque, constant, times the displacement: exact.
    """

    def __init__(self, sample_time, hand, masses=(MASS, MASS), friction=FRICTION, position=(0.0, 0.0), longest=5e-5):
        self.q, self.v = np.array(position, dtype=float), np.zeros(len(masses))
        self.masses, self.friction, self.hand = np.array(masses), friction, hand
        self.parts = max(1, math.ceil(sample_time / longest))
        self.step, self.time, self.interaction = sample_time / self.parts, 0.0, 0.0
        self.least = 0.0

    def advance(self, torques):
        held, before = np.array(torques), self.q.copy()

        def acceleration(t, q, v):
            return (held - self.friction * v + self.hand(t, q, v, held)) / self.masses

        h = self.step
        for _ in range(self.parts):
            t, q, v = self.time, self.q, self.v
            a1 = acceleration(t, q, v)
            a2 = acceleration(t + h / 2, q + h / 2 * v, v + h / 2 * a1)
            a3 = acceleration(t + h / 2, q + h / 2 * v + h * h / 4 * a1, v + h / 2 * a2)
            a4 = acceleration(t + h, q + h * v + h * h / 2 * a2, v + h * a3)
            self.q = q + h * v + h * h / 6 * (a1 + a2 + a3)
            self.v = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
            self.time += h
        self.interaction -= float(held @ (self.q - before))
        self.least = min(self.least, self.interaction)


def rendered(controller, plant, cycles, delay=0, each=None):
    """Runs a controller on a plant; calls `each(balance, plant)` at every sample."""
    pending = [(0.0,) * controller.axes] * delay
    held = (0.0,) * controller.axes
    for _ in range(cycles):
        balance = controller.step(plant.q.tolist(), held)
        if each is not None:
            each(balance, plant)
        pending.append(balance.torques)
        held = pending.pop(0)
        plant.advance(held)
        assert np.all(np.abs(plant.q) < 100.0), "diverged"
