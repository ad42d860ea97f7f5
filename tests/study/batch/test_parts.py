"""The parts of the batch: rules that simplify, flows in arrays, and what the interpreter makes of source."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.models import AxisSimulation
from canhaptic.sim.drive.drive_parameters import SimulatedDriveParameters
from canhaptic.sim.plant.effects import read_effect
from canhaptic.sim.plant.plant import Plant, PlantParameters
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from canhaptic.study.batch.graph import Graph
from canhaptic.study.batch.layout import known_values
from canhaptic.study.batch.lowering import Lowering
from canhaptic.study.batch.nodes import NUMBER, TRUTH, NotBatchableError
from canhaptic.study.batch.plants import plant_numbers

NUMBERS = st.sampled_from([-2.5, -1.0, 0.0, 1.0, 0.1, 3.0])
BINARY = ("add", "sub", "mul", "max", "min")
ORDERS = ("lt", "le", "gt", "ge", "eq", "ne")


@settings(max_examples=50)
@given(st.data(), NUMBERS, NUMBERS, st.integers(1, 40))
def test_a_simplified_expression_has_the_value_of_the_plain_one(data, x, y, size):
    """Operations drawn at random, on placeholders and on floats side by side."""
    graph = Graph()
    pairs = [(graph.param("x"), x), (graph.param("y"), y), (0.0, 0.0), (1.0, 1.0)]
    truths = [(graph.op("lt", pairs[0][0], pairs[1][0]), x < y)]
    for _ in range(size):
        (a, va), (b, vb) = data.draw(st.sampled_from(pairs)), data.draw(st.sampled_from(pairs))
        (c, vc), (d, vd) = data.draw(st.sampled_from(truths)), data.draw(st.sampled_from(truths))
        kind = data.draw(st.sampled_from([*BINARY, *ORDERS, "neg", "abs", "select", "and", "or", "not"]))
        if kind in BINARY:
            pairs.append((graph.op(kind, a, b), NUMBER[kind](va, vb)))
        elif kind in ORDERS:
            truths.append((graph.op(kind, a, b), TRUTH[kind](va, vb)))
        elif kind in ("neg", "abs"):
            pairs.append((graph.op(kind, a), NUMBER[kind](va)))
        elif kind == "select":
            pairs.append((graph.select(c, a, b), va if vc else vb))
        elif kind == "not":
            truths.append((graph.op("not", c), not vc))
        else:
            truths.append((graph.op(kind, c, d), TRUTH[kind](vc, vd)))
    for node, expected in (*pairs, *truths):
        made = graph.node(node)
        assert known_values([made], {"x": x, "y": y}, {})[made] == expected


def simulation(effects=(), **user):
    typed = tuple(ComponentSpec(str(e["type"]), read_effect(e)) for e in effects)  # type: ignore[arg-type]
    hand = UserParameters(**user)
    return AxisSimulation(SimulatedDriveParameters(counts_per_unit=1.0), PlantParameters(mass=0.3), hand, typed, 0)


@pytest.mark.parametrize(
    "effects", [(), ({"type": "viscous_friction", "damping": 0.7}, {"type": "tremor", "amplitude": 1e-3})]
)
def test_flows_in_arrays_are_those_of_plants_made_one_by_one(effects):
    rng, n = np.random.default_rng(4), 12
    varied = {
        "simulation.plant.mass": rng.uniform(0.01, 3.0, n),
        "simulation.plant.damping": rng.uniform(0.0, 5.0, n),
        "simulation.plant.initial_position": rng.uniform(-0.1, 0.1, n),
        "simulation.user.stiffness": 10.0 ** rng.uniform(0.0, 4.0, n),
        "simulation.user.damping": rng.uniform(0.0, 20.0, n),
        "simulation.user.push": rng.uniform(-3.0, 3.0, n),
        "simulation.user.rest": rng.uniform(-0.1, 0.1, n),
        "simulation.user.motion.frequency": rng.uniform(0.1, 20.0, n),
        "simulation.user.motion.amplitude": rng.uniform(0.0, 0.1, n),
        "simulation.user.motion.phase": rng.uniform(-3.0, 3.0, n),
        "simulation.user.motion.offset": rng.uniform(-0.1, 0.1, n),
    }
    period = np.rint(1e9 / 10.0 ** rng.uniform(1.6, 4.0, n))
    base = simulation(effects, stiffness=1.0, motion=SinusoidMotion(amplitude=0.01, frequency=1.0))
    numbers = plant_numbers(base, period, varied)
    for i in range(n):
        of_plant, of_user, of_motion = {}, {}, {}
        for key, values in varied.items():
            name = key.split(".")[-1]
            owner = of_motion if ".motion." in key else of_user if ".user." in key else of_plant
            owner[name] = float(values[i])
        user = UserParameters(**of_user, motion=SinusoidMotion(**of_motion))
        plant = Plant(PlantParameters(**of_plant), user, [e.parameters for e in base.effects], int(period[i]))
        flow, start = plant.whole_flow(), plant.initial_state()
        for row in range(len(flow) - 2):
            assert np.broadcast_to(numbers[f"start.{row}"], (n,))[i] == pytest.approx(start[row], abs=1e-15)
            for column in range(len(flow)):
                got = np.broadcast_to(numbers.get(f"flow.{row}.{column}", 0.0), (n,))[i]
                assert got == pytest.approx(flow[row, column], rel=1e-11, abs=1e-13 * np.abs(flow[row]).max())


def test_a_flow_does_not_depend_on_the_flows_beside_it():
    mass = np.array([1e-3, 0.3, 5.0])
    user = {"stiffness": 5000.0, "damping": 1.0}
    together = plant_numbers(simulation(**user), np.full(3, 1e6), {"simulation.plant.mass": mass})
    alone = plant_numbers(simulation(**user), np.full(2, 1e6), {"simulation.plant.mass": mass[1:]})
    for name, values in alone.items():
        np.testing.assert_array_equal(np.broadcast_to(values, (2,)), np.broadcast_to(together[name], (3,))[1:], name)


class Piece:
    """Source with every kind of statement that controllers have."""

    def __init__(self) -> None:
        self.calls = 0.0

    def step(self, x: float, y: float) -> float:
        self.calls += 1.0
        if x > 0.0:
            if y < 0.0:
                return -x
            self.calls += x if y else 2.0
        for part in (x, y, 3.0):
            if part > 2.0:
                break
            self.calls += part * part
        else:
            return self.calls
        found = self.maybe(x)
        if found is not None and found > 1.0:
            return found
        return math.copysign(max(x, y, 0.5), y) + round(x) + int(y)

    def maybe(self, x: float) -> float | None:
        if x < -1.0:
            return None
        return math.sqrt(x + 1.0)


def lowered(method, *values):
    graph = Graph()
    lowering = Lowering(graph)
    piece = Piece()
    lowering.heap.instances.insert(0, piece)
    names = [f"v{i}" for i in range(len(values))]
    # the interpreter looks at this package only: hand it the functions of the class
    from canhaptic.study.batch import lowering as module

    module._HERE, before = "", module._HERE  # type: ignore[misc]
    try:
        result = lowering.call(method, (piece, *(graph.param(name) for name in names)), {})
    finally:
        module._HERE = before  # type: ignore[misc]
    return graph.node(result), graph.node(piece.calls), dict(zip(names, values, strict=True))


@given(NUMBERS, NUMBERS)
def test_interpreted_source_does_what_the_source_does(x, y):
    piece = Piece()
    expected = piece.step(x, y)
    result, calls, numbers = lowered(Piece.step, x, y)
    values = known_values([result, calls], numbers, {})
    assert values[result] == expected
    assert values[calls] == piece.calls


def test_what_data_choose_a_branch_of_is_not_decided_outside_of_the_source():
    graph = Graph()
    with pytest.raises(NotBatchableError, match="decision"):
        bool(graph.param("x") > 0.0)
    with pytest.raises(NotBatchableError, match="value"):
        float(graph.param("x"))
