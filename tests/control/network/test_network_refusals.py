"""What is not passive, does not fit or cannot be reached: refused with a clear message, or no torque."""

import math
import random
from typing import Literal

import numpy as np
import pytest

from canhaptic.control.mechanisms.five_bar import FiveBar
from canhaptic.control.mechanisms.kinematics import Identity, Limit
from canhaptic.control.mechanisms.planar_2r import Planar2R
from canhaptic.control.multi_axis import NETWORKS, build_group_controller
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.port_hamiltonian.network import (
    Damper,
    DampingMatrix,
    Mass,
    Network,
    QuadraticForm,
    Spring,
    UserEnergy,
)
from canhaptic.control.port_hamiltonian.shapes import LinearGeometry, Rendered, identity_rows
from canhaptic.control.port_hamiltonian.shapes.anisotropic_spring import AnisotropicSpring
from canhaptic.control.port_hamiltonian.shapes.box import Box
from canhaptic.control.port_hamiltonian.shapes.coupled_handles import CoupledHandles
from canhaptic.control.port_hamiltonian.shapes.general import General
from canhaptic.control.port_hamiltonian.shapes.guided_path import GuidedPath
from canhaptic.control.port_hamiltonian.shapes.plane import Plane
from canhaptic.control.port_hamiltonian.shapes.tube import Tube
from canhaptic.errors import ControlError, ParameterError
from canhaptic.registry import load
from tests.control.network.networks import EXAMPLE, FollowedNetwork, Table, group, loops, rendered

SPRING = Spring(stiffness=100.0)
MASS = Mass(mass=1.0)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Network([SPRING, MASS], gain=[[1], [0]], structure=[[0, -1], [0.5, 0]]), "J = -J'"),
        (lambda: Network([SPRING, MASS], gain=[[1], [0]], structure=[[1, 0], [0, 0]]), "J = -J'"),
        (lambda: Network([SPRING, MASS], gain=[[1], [0]], structure=[[0, -1]]), "expected 2 rows of 2"),
        (lambda: Network([SPRING], gain=[[1], [0]]), "expected 1 rows of 1"),
        (lambda: Network([SPRING], gain=[[]]), "no columns"),
        (lambda: Network([], gain=[]), "at least one"),
        (lambda: Network([SPRING], gain=[[math.nan]]), "finite"),
        (lambda: Network([SPRING], [Damper(viscous=1.0, states={1: 1.0})], gain=[[1]]), "state from 0 to 0"),
        (lambda: Network([SPRING], [Damper(viscous=1.0, beside=2)], gain=[[1]]), "state from 0 to 0"),
        (lambda: Damper(viscous=1.0), "expected one of the two"),
        (lambda: Damper(viscous=-1.0, beside=0), "expected 0 <= viscous"),
        (lambda: DampingMatrix(matrix=((1.0, 2.0), (2.0, 1.0)), ports=(0, 1)), "least eigenvalue -1"),
        (lambda: DampingMatrix(matrix=((1.0, 0.5), (0.0, 1.0)), ports=(0, 1)), "symmetric"),
        (lambda: DampingMatrix(matrix=((1.0,),), ports=(0, 1)), "or `ports`, one for each row"),
        (lambda: DampingMatrix(matrix=((1.0, 0.0), (0.0, 1.0)), states=(0, 0)), "each of them once"),
        (lambda: QuadraticForm(matrix=((1.0, 3.0), (3.0, 1.0))), "least eigenvalue -2"),
        (lambda: QuadraticForm(matrix=((1.0, 3.0),)), "square"),
        (lambda: Spring(stiffness=1.0, lower=1.0, upper=0.0), "lower <= upper"),
        (lambda: Mass(mass=0.0), "expected 0 < mass"),
        (lambda: Box(stiffness=1.0, lower=(0.0,), upper=(0.0,)), "lower < upper"),
        (lambda: Plane(stiffness=1.0, normal=(0.0, 0.0)).build(2), "not all 0"),
        (lambda: Plane(stiffness=1.0, normal=(1.0,)).build(2), "expected 2"),
        (lambda: Tube(stiffness=1.0, point=(0.0, 0.0), direction=(1.0, 0.0), radius=0.1).build(3), "expected 3"),
        (lambda: Tube(stiffness=1.0, point=(0.0,), direction=(1.0,), radius=0.1).build(1), "of 1 dimension,"),
        (lambda: CoupledHandles(stiffness=1.0).build(3), "even number"),
        (lambda: GuidedPath(points=((0.0,), (0.0,)), stiffness=1.0), "same point twice"),
        (lambda: General(storages=(SPRING, MASS), gain=((1.0,), (0.0,)), structure=((0, 1), (1, 0))), "J = -J'"),
        (lambda: General(storages=(SPRING,), gain=((1.0,),)).build(2), "1 columns, one for each port, in a task"),
        (lambda: General(storages=(SPRING,), gain=((1.0,),), offset=(0.0, 0.0)).build(1), "1, one for each port"),
        (lambda: AnisotropicSpring(centre=(0.0,), stiffness=((1.0, 0.0), (0.0, 1.0))).build(1), "expected 1"),
        (
            lambda: Network([UserEnergy(1, lambda x: x[0] ** 2, lambda x: [x[0]])], gain=[[1]]),
            "gradient",
        ),
        (lambda: Network([UserEnergy(1, lambda x: x[0] ** 2 - 1.0, lambda x: [2 * x[0]])], gain=[[1]]), ">= 0"),
    ],
)  # fmt: skip
def test_what_could_make_energy_or_does_not_fit_is_refused_where_it_is_made(make, said):
    with pytest.raises(ParameterError) as caught:
        make()
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: group(EXAMPLE, axes=2, kinematics=Identity(axes=3)), "loops of 2 axes, expected 3"),
        (
            lambda: build_group_controller(EXAMPLE, Identity(axes=2), "guarded", None, [*loops(1), *loops(1, 2e-3)]),
            "sample_time",
        ),
        (
            lambda: build_group_controller(
                EXAMPLE, Identity(axes=1), "guarded", None, [LoopProperties(sample_time=1e-3)]
            ),
            "no torque can be certified",
        ),
        (lambda: build_group_controller(EXAMPLE, Identity(axes=1), "gurded", None, loops(1)), "did you mean 'guarded'"),
        (lambda: build_group_controller(EXAMPLE, Identity(axes=1), "guarded", EXAMPLE, loops(1)), "expected Guarded"),
    ],
)
def test_parts_that_do_not_fit_together_are_refused(make, said):
    with pytest.raises(ParameterError) as caught:
        make()
    assert said in str(caught.value)


def test_a_structure_function_is_checked_and_its_skew_part_alone_is_used():
    def honest(x):
        return [[0.0, -1.0 - x[0] ** 2], [1.0 + x[0] ** 2, 0.0]]

    def sometimes(x):
        return [[0.0, -1.0], [1.0, 1.0 if x[0] > 100.0 else 0.0]]

    with pytest.raises(ParameterError, match="J = -J'"):
        Network([SPRING, MASS], gain=[[1], [0]], structure=lambda _x: [[0.0, -1.0], [1.0, -1.0]])
    Network([SPRING, MASS], gain=[[1], [0]], structure=honest)
    network = Network([SPRING, MASS], gain=[[1], [0]], structure=sometimes)
    followed = FollowedNetwork(network)
    followed.memory.state[0] = 200.0
    followed.settle()
    before = followed.found.energy
    for _ in range(100):
        followed.advance([0.0], [0.0], 1e-3)
    assert abs(followed.found.energy - before) <= 1e-9 * before


def test_every_named_network_can_be_loaded_and_is_a_parameter_model():
    for name in NETWORKS:
        assert load(NETWORKS, name, "network").model_json_schema()["type"] == "object"


def five_bar(base=0.1, **own):
    return FiveBar(base=base, proximal=(0.15, 0.15), distal=(0.2, 0.2), **own)


@pytest.mark.parametrize(
    ("mechanism", "inside", "outside", "limit"),
    [
        (five_bar(), (2.2, 0.9), (3.1, 0.0), Limit.SINGULAR),
        (five_bar(base=0.2), (2.2, 0.9), (3.1, 0.0), Limit.WORKSPACE),
        (five_bar(workspace_upper=(1.0, 0.3)), (2.2, 0.9), (1.8, 1.4), Limit.WORKSPACE),
        (Planar2R(first=0.2, second=0.2), (0.3, 1.2), (0.3, 0.01), Limit.SINGULAR),
    ],
)
def test_no_torque_at_a_limit_of_the_mechanism_and_the_account_goes_on(mechanism, inside, outside, limit):
    centre = mechanism.pose(inside).position
    spring = AnisotropicSpring(
        centre=tuple(c + 0.02 for c in centre), stiffness=((400.0, 0.0), (0.0, 400.0)), damping=None
    )  # fmt: skip
    controller = group(spring, kinematics=mechanism, known={"moving_mass": 1e-3, "device_damping_bound": 0.0})
    held, felt, path = (0.0, 0.0), 0.0, np.linspace(0.0, 1.0, 60)
    for share in (*path, *path[::-1]):
        q = [a + share * (b - a) for a, b in zip(inside, outside, strict=True)]
        balance = controller.step(q, held)
        if mechanism.pose(q).limit:
            assert balance.torques == (0.0, 0.0)
            assert balance.limit == mechanism.pose(q).limit
        else:
            assert balance.limit == 0
            felt = max(felt, balance.account.torque)
        assert abs(sum(balance.interactions) - balance.account.h_i) <= 1e-15
        held = balance.torques
    assert mechanism.pose(outside).limit == limit
    assert felt > 0.01


@pytest.mark.parametrize("bad", [(math.nan, 0.0), (math.inf, 0.0), (0.0,), (0.0, 0.0, 0.0)])
@pytest.mark.parametrize("algorithm", ["guarded", "step_scaling"])
def test_positions_and_torques_that_are_no_numbers_stop_the_group(bad, algorithm):
    controller = group(EXAMPLE, algorithm=algorithm)
    controller.step((0.0, 0.0), (0.0, 0.0))
    with pytest.raises(ControlError, match="expected 2 finite numbers"):
        controller.step(bad, (0.0, 0.0))
    assert controller.step((0.01, 0.0), (0.0, 0.0)).torques == (0.0, 0.0)
    with pytest.raises(ControlError, match="expected 2 finite numbers"):
        controller.step((0.0, 0.0), bad)


@pytest.mark.slow_for("2")
@pytest.mark.parametrize("losses", [0, 2])
def test_numbers_at_the_edge_of_the_range_give_torques_or_a_clear_error(losses):
    """Squares that vanish or overflow, zeros of both signs: no division by zero, no NaN for an integer."""
    edge = (0.0, -0.0, 5e-324, -1e-310, 1e-200, 1e-160, -1e3, 1e150, 1e300, 0.012)
    rng, felt = random.Random(losses), 0
    known = {"moving_mass": 0.25, "torque_limit": 2.0, "torque_quantum": 1e-3, "encoder_count": 1e-5}
    for environment in (EXAMPLE, Box(stiffness=2000.0, damping=5.0, lower=(-0.01, -0.01), upper=(0.01, 0.01))):
        controller = group(environment, known=known, delay=1, max_consecutive_losses=losses)
        held = [0.0, 0.0]
        for _ in range(100):
            try:
                held = list(controller.step([rng.choice(edge), rng.choice(edge)], held).torques)
            except ControlError:
                held = [0.0, 0.0]
            assert all(abs(torque) <= 2.0 for torque in held)
            felt += any(held)
    assert felt > 15


@pytest.mark.parametrize("algorithm", ["guarded", "step_scaling"])
@pytest.mark.parametrize(
    ("spring", "dampers"),
    [(Spring(stiffness=0.0, hardening=1e8), ()), (Spring(stiffness=0.0), (Damper(viscous=2.0, beside=0),))],
)
def test_what_acts_everywhere_is_felt_without_a_linear_stiffness(spring, dampers, algorithm):
    network = General(storages=(spring,), dissipators=dampers, gain=((1.0,),))
    controller, torque = group(network, axes=1, algorithm=algorithm), 0.0
    for sample in range(20):
        torque = controller.step([5e-4 * sample], [torque]).torques[0]
    assert torque < -0.5


class _Unsolvable:
    """A network whose user energy jumps: no step solves it."""

    def build(self, dimensions):
        network = Network(
            [
                UserEnergy(1, lambda x: 1e6 * (1.0 + math.sin(1e9 * x[0])), lambda x: [1e15 * math.cos(1e9 * x[0])]),
                MASS,
            ],
            gain=[[1.0], [0.0]],
            structure=[[0.0, -1.0], [1.0, 0.0]],
        )
        return Rendered(network, LinearGeometry(identity_rows(1), [0.0], 1, 1))


def test_a_step_that_is_not_solved_is_rendered_as_no_torque(monkeypatch):
    monkeypatch.setattr("canhaptic.control.port_hamiltonian.network.check_gradient", lambda _storage: None)
    controller = group(_Unsolvable(), axes=1)
    limits = set()
    for cycle in range(20):
        balance = controller.step([1e-3 * math.sin(cycle)], [0.0])
        limits.add(balance.limit)
        if balance.limit:
            assert balance.torques == (0.0,)
    assert Limit.UNSOLVED in limits


@pytest.mark.parametrize("algorithm", ["guarded", "step_scaling"])
def test_a_reset_group_is_as_new(algorithm):
    def torques(controller):
        found = []
        plant = Table(1e-3, lambda t, q, v, _f: -200.0 * (q - 0.02 * math.sin(20.0 * t)) - 3.0 * v, longest=5e-4)
        rendered(controller, plant, 100, 0, lambda balance, _plant: found.append(balance.torques))
        return found

    controller = group(EXAMPLE, algorithm=algorithm)
    first = torques(controller)
    controller.reset()
    assert torques(controller) == first
    assert max(abs(t) for pair in first for t in pair) > 0.0


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, 2.0, 0.0), (1.0, -2.0, 0.5)])
@pytest.mark.parametrize("along", [0.0, 0.3, -17.0])
@pytest.mark.parametrize("side", ["inside", "outside"])
def test_on_the_line_of_a_tube_the_way_out_is_across_it(
    direction: tuple[float, ...], along: float, side: Literal["inside", "outside"]
) -> None:
    """Rounding, or a first coordinate that happened to be the line's own, pushed along it."""
    place, size = (0.1, 0.2, -0.3), math.hypot(*direction)
    tube = Tube(point=place, direction=direction, radius=0.01, side=side, stiffness=100.0).build(3).geometry
    values, normal = [0.0], [0.0] * 3
    tube.measure([p + along * d for p, d in zip(place, direction, strict=True)], values, [normal])
    assert values[0] == pytest.approx(-0.01 if side == "outside" else 0.01)
    assert math.hypot(*normal) == pytest.approx(1.0)
    assert sum(n * d for n, d in zip(normal, direction, strict=True)) == pytest.approx(0.0, abs=1e-12 * size)
