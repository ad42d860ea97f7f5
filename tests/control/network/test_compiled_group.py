"""A group as loops compile it is the interpreted one: the same source, the same bits; Python of its own is refused."""

import random
import struct

import pytest

from canhaptic.control.mechanisms.five_bar import FiveBar
from canhaptic.control.mechanisms.kinematics import Identity, UserFunction
from canhaptic.control.mechanisms.planar_2r import Planar2R
from canhaptic.control.mechanisms.transmission import Transmission
from canhaptic.control.multi_axis import build_group_controller
from canhaptic.control.multi_axis.group_kernel import SteppedGroup, world_of
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.guarded import GuardedParameters
from canhaptic.control.port_hamiltonian.network import Network, UserEnergy
from canhaptic.control.port_hamiltonian.shapes import Rendered, identity_rows, linear_geometry
from canhaptic.control.port_hamiltonian.shapes.anisotropic_spring import AnisotropicSpring
from canhaptic.control.port_hamiltonian.shapes.box import Box
from canhaptic.control.port_hamiltonian.shapes.coupled_handles import CoupledHandles
from canhaptic.control.port_hamiltonian.shapes.guided_path import GuidedPath
from canhaptic.control.port_hamiltonian.shapes.moving_wall import MovingWall
from canhaptic.control.port_hamiltonian.shapes.sphere import Sphere
from canhaptic.control.port_hamiltonian.shapes.tube import Tube
from canhaptic.control.port_hamiltonian.shapes.virtual_mass import MassOnSpring, VirtualMass
from canhaptic.errors import ControlError, ParameterError
from canhaptic.lab.rivals.scaled_group import ScaledGroupParameters

pytest.importorskip("numba")

from canhaptic.lab.batch.compiled_loops import compiled_world
from tests.control.network.compiled_steps import begin_compiled

ODD = (-0.0, 5e-324, -1e-310, 1e-160, 1e3, 1e150)
"""Positions that no hand has: zeros of both signs, subnormal numbers, and such whose squares vanish or overflow."""


def environment_of(rng, place):
    """An environment of every kind about a place of two dimensions."""
    material = {"stiffness": 10.0 ** rng.uniform(2, 5), "damping": rng.choice((0.0, 5.0))}
    low, high = tuple(v - 0.004 for v in place), tuple(v + 0.006 for v in place)
    normal = (rng.gauss(0.0, 1.0), rng.gauss(0.0, 1.0))
    size = (normal[0] ** 2 + normal[1] ** 2) ** 0.5
    offset = (normal[0] * place[0] + normal[1] * place[1]) / size - 0.01
    corners = tuple((place[0] + 0.02 * i, place[1] + 0.01 * i * i) for i in (-1, 0, 1))
    return rng.choice(
        [
            lambda: Box(lower=low, upper=high, side=rng.choice(("inside", "outside")), **material),
            lambda: Sphere(centre=place, radius=0.006, side=rng.choice(("inside", "outside")), **material),
            lambda: Tube(point=place, direction=(1.0, 2.0), radius=0.004, **material),
            lambda: GuidedPath(points=corners, **material),
            lambda: MovingWall(normal=normal, offset=offset, amplitude=0.02, frequency=3.0, **material),
            lambda: VirtualMass(mass=0.3, hardening=1e6, floor=2.0, **material),
            lambda: MassOnSpring(mass=0.2, anchor=place, anchor_stiffness=100.0, **material),
            lambda: CoupledHandles(scale=2.0, **material),
            lambda: AnisotropicSpring(
                centre=place, stiffness=((900.0, 200.0), (200.0, 300.0)), damping=((2.0, 0.0), (0.0, 5.0))
            ),
        ]
    )()


LATE = {"sync_jitter": 0.02, "torque_window": 1e-4, "current_lag": 2e-4, "torque_rate_limit": 500.0, "power_limit": 5.0}


def group_of(rng):
    """Returns what makes a random group, the positions at which it begins, and its masses."""
    kinematics, start, mass = rng.choice(
        [
            (Identity(axes=2), (0.0, 0.0), 0.25),
            (Transmission(matrix=((0.05, 0.05), (0.05, -0.05)), workspace_upper=(0.02, 0.02)), (0.0, 0.0), 1e-3),
            (Planar2R(first=0.2, second=0.15), (0.3, 1.2), 0.02),
            (FiveBar(base=0.1, proximal=(0.15, 0.15), distal=(0.2, 0.2)), (2.2, 0.9), 0.02),
        ]
    )
    environment = environment_of(rng, kinematics.pose(start).position)
    count, quantum, limit = rng.choice((0.0, 1e-5)), rng.choice((0.0, 1e-3)), rng.choice((None, 2.0))
    loop = LoopProperties(
        sample_time=rng.choice((1e-3, 1e-2)), delay=rng.choice((0, 1, 2)), moving_mass=mass,
        device_damping=rng.choice((None, 0.1)), device_damping_bound=0.4, encoder_count=count, torque_quantum=quantum,
        torque_limit=limit, **rng.choice(({}, LATE)),
    )  # fmt: skip
    alpha, losses, speed = rng.choice(("0", "100 s/m^2")), rng.choice((0, 1, 3)), rng.choice((None, 0.5))
    algorithm, force = rng.choice(("guarded", "guarded", "step_scaling")), rng.choice((0.0, 2.0))

    def make():
        own = {"hand_force": force, "hand_speed": speed, "max_consecutive_losses": losses}
        kind = GuardedParameters if algorithm == "guarded" else ScaledGroupParameters
        parameters = kind(alpha=alpha, **(own if algorithm == "guarded" else {}))
        group = build_group_controller(environment, kinematics, algorithm, parameters, [loop, loop])
        world = world_of(environment, kinematics, (loop, loop))
        assert isinstance(group, SteppedGroup)
        return group, world, group.kernel.settings(world, parameters, (loop, loop))

    return make, start, mass, loop


def bits_of(balance):
    numbers = (*balance.torques, *balance.account, *balance.interactions, *balance[3:])
    return struct.pack(f"{len(numbers)}d", *numbers)


def outcome(group, positions, applied):
    """Returns the balance of a step, or None where it raises."""
    try:
        return group.step(positions, applied)
    except ControlError:
        return None


def differences(seed, cycles=300):
    """Runs a random group both ways against a trembling hand; returns (SYNCs that differ, SYNCs with a torque)."""
    rng = random.Random(seed)
    make, start, mass, loop = group_of(rng)
    (one, _, _), (other, world, settings) = make(), make()
    other._begin = begin_compiled(other.kernel, world, settings)
    other.reset()
    pair: list[SteppedGroup] = [one, other]
    q, v, held, pending = list(start), [0.0, 0.0], [0.0, 0.0], [[0.0, 0.0]] * loop.delay
    differ = felt = 0
    for cycle in range(cycles):
        seen = [rng.choice(ODD) if rng.random() < 0.01 else x for x in q]
        if cycle > 1 and rng.random() < 0.05:
            found = [group.sample_lost() for group in pair]
        else:
            found = [outcome(group, seen, held) for group in pair]
        one, other = found
        if one is None or other is None:
            differ += one is not other
            torques = [0.0, 0.0]
            pair[0].reset(), pair[1].reset()
        else:
            differ += bits_of(one) != bits_of(other)
            torques = list(one.torques)
        felt += any(torques)
        pending.append(torques)
        held = [t * rng.choice((1.0, 1.0, 1.0, 0.5)) for t in pending.pop(0)]
        for i in range(2):
            v[i] += loop.sample_time * (held[i] / mass + 1200.0 * (start[i] - q[i]) - 30.0 * v[i] + rng.gauss(0, 30.0))
            q[i] += loop.sample_time * v[i]
        if not all(abs(x - s) < 1.0 for x, s in zip(q, start, strict=True)):
            q, v = list(start), [0.0, 0.0]
    return differ, felt


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_thirty_compiled_groups_have_the_bits_of_the_interpreted_ones():
    found = [differences(seed) for seed in range(30)]
    assert [differ for differ, _ in found] == [0] * 30
    assert sum(felt > 30 for _, felt in found) >= 15


def refused(environment, kinematics):
    loop = LoopProperties(sample_time=1e-3, moving_mass=0.25, device_damping_bound=0.0)
    with pytest.raises(ParameterError, match="Python code of its own") as caught:
        compiled_world(world_of(environment, kinematics, (loop,)))
    return str(caught.value)


class OwnEnergy:
    def build(self, dimensions):
        energy = UserEnergy(1, lambda x: 50.0 * x[0] ** 2, lambda x: [100.0 * x[0]])
        return Rendered(Network([energy], gain=[[1.0]]), linear_geometry(identity_rows(1), [0.0]))


def test_what_is_python_of_its_own_is_not_compiled():
    assert "UserFunctions" in refused(OwnEnergy(), Identity(axes=1))
    own = UserFunction(lambda q: [2.0 * q[0]], lambda _q: [[2.0]], [0.1])
    box = Box(stiffness=100.0, lower=(-0.1,), upper=(0.1,))
    assert "PoseAsked" in refused(box, own)
