"""Mechanisms against independent geometry; forces and energies in motor and in task coordinates."""

import math
import random
from typing import Any

import numpy as np
import pytest

from canhaptic.control.mechanisms import KINEMATICS
from canhaptic.control.mechanisms.five_bar import FiveBar
from canhaptic.control.mechanisms.kinematics import Identity, Limit, UserFunction
from canhaptic.control.mechanisms.planar_2r import Planar2R
from canhaptic.control.mechanisms.transmission import Transmission
from canhaptic.errors import ParameterError
from canhaptic.registry import load

FIVE_BAR = FiveBar(base=0.08, proximal=(0.12, 0.14), distal=(0.2, 0.17))
EXAMPLES: dict[str, tuple[Any, Any]] = {
    "identity": (Identity(axes=2), (0.0, 0.0)),
    "transmission": (Transmission(matrix=((0.05, 0.02), (-0.01, 0.05)), offset=(0.1, 0.2)), (0.3, 0.4)),
    "relative": (Planar2R(first=0.2, second=0.15, base=(0.1, -0.1)), (0.4, 1.2)),
    "absolute": (Planar2R(first=0.2, second=0.15, elbow="absolute"), (0.4, 1.7)),
    "five_bar": (FIVE_BAR, (2.1, 1.0)),
    "polar": (
        UserFunction(
            lambda q: (q[1] * math.cos(q[0]), q[1] * math.sin(q[0])),
            lambda q: ((-q[1] * math.sin(q[0]), math.cos(q[0])), (q[1] * math.cos(q[0]), math.sin(q[0]))),
            (0.5, 0.3),
            lambda q: Limit.SINGULAR if abs(q[1]) < 0.05 else Limit.NONE,
        ),
        (0.5, 0.3),
    ),
}


def at(mechanism, positions):
    """Place in task space at motor positions."""
    return np.array(mechanism.pose(positions.tolist()).position)


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_jacobian_is_the_derivative_of_the_map(name):
    mechanism, centre = EXAMPLES[name]
    rng = random.Random(name)
    for _ in range(50):
        q = np.array([c + rng.uniform(-0.15, 0.15) for c in centre])
        if mechanism.pose(q.tolist()).limit:
            continue
        step = 1e-6
        expected = np.array(
            [(at(mechanism, q + step * e) - at(mechanism, q - step * e)) / (2 * step) for e in np.eye(2)]
        ).T
        assert np.allclose(mechanism.pose(q.tolist()).jacobian, expected, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("assembly", ["up", "down"])
def test_the_links_of_the_five_bar_keep_their_lengths(assembly):
    mechanism = FIVE_BAR.model_copy(update={"assembly": assembly, "base": 0.08})
    (l1, l2), (l3, l4) = mechanism.proximal, mechanism.distal
    rng, sides = random.Random(1), set()
    for _ in range(500):
        q = (rng.uniform(1.2, 2.9), rng.uniform(0.2, 1.9))
        if mechanism.pose(q).limit:
            continue
        x, y = mechanism.pose(q).position
        ax, ay = -0.04 + l1 * math.cos(q[0]), l1 * math.sin(q[0])
        bx, by = 0.04 + l2 * math.cos(q[1]), l2 * math.sin(q[1])
        assert math.hypot(x - ax, y - ay) == pytest.approx(l3, rel=1e-12)
        assert math.hypot(x - bx, y - by) == pytest.approx(l4, rel=1e-12)
        sides.add((bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0.0)
    assert sides == {assembly == "up"}


@pytest.mark.slow_but("five_bar", "polar", "transmission")
@pytest.mark.parametrize("name", EXAMPLES)
def test_work_at_the_motors_is_work_in_task_space_to_the_curvature_of_the_map(name):
    """|tau . dq - F . dx| <= |F| c |dq|^2 / 2, c the largest second derivative near: measured order 2 in dq."""
    mechanism, centre = EXAMPLES[name]
    rng = random.Random(name)
    force = np.array([3.0, -2.0])
    errors = []
    for size in (1e-3, 1e-4):
        worst = 0.0
        for _ in range(200):
            q = np.array([c + rng.uniform(-0.05, 0.05) for c in centre])
            angle = rng.uniform(0.0, 2.0 * math.pi)
            motion = size * np.array([math.cos(angle), math.sin(angle)])
            torques = np.array(mechanism.pose(q.tolist()).jacobian).T @ force
            task = at(mechanism, q + motion) - at(mechanism, q)
            error = abs(float(torques @ motion - force @ task))
            assert error <= np.linalg.norm(force) * curvature(mechanism, q, motion) * size**2 / 2.0 * 1.05 + 1e-15
            worst = max(worst, error)
        errors.append(worst)
    if errors[0] > 1e-12:  # a map that is curved
        assert math.log10(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)


def curvature(mechanism, q, motion):
    """Norm of the second derivative of the map along a motion, by differences."""
    along, step = motion / np.linalg.norm(motion), 2e-4
    middle = q + 0.5 * motion
    values = [at(mechanism, middle + k * step * along) for k in (-1, 0, 1)]
    return float(np.linalg.norm(values[0] - 2.0 * values[1] + values[2])) / step**2


@pytest.mark.parametrize("name", KINEMATICS)
def test_every_named_mechanism_can_be_loaded(name):
    assert load(KINEMATICS, name, "kinematics").model_json_schema()["type"] == "object"


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Transmission(matrix=((1.0, 1.0), (1.0, 1.0))), "singular"),
        (lambda: Transmission(matrix=((1.0,), (0.0,))), "at most as many"),
        (lambda: Transmission(matrix=((1.0, 0.0), (0.0,))), "equal length"),
        (lambda: Transmission(matrix=((1.0,),), offset=(1.0, 2.0)), "expected 1"),
        (lambda: Transmission(matrix=((1.0,),), workspace_lower=(0.0, 0.0)), "expected 1"),
        (
            lambda: Transmission(matrix=((1.0,),), workspace_lower=(1.0,), workspace_upper=(0.0,)),
            "expected lower < upper",
        ),
        (
            lambda: Transmission(matrix=((1.0,),), workspace_upper=(math.nan,)),
            "workspace_upper.0: got nan, expected a finite number for workspace_upper [m or rad]",
        ),
        (lambda: FiveBar(base=2.0, proximal=(0.1, 0.1), distal=(0.2, 0.2)), "expected < 0.6"),
        (lambda: FiveBar(base=0.1, proximal=(0.1, -0.1), distal=(0.2, 0.2)), "expected 0 < proximal"),
        (lambda: Planar2R(first=0.1, second=0.1, least_sine=0.0), "expected 0 < least_sine"),
        (lambda: Identity(axes=0), "expected 1 <= axes"),
        (lambda: UserFunction(lambda q: (q[0] ** 2,), lambda q: ((q[0],),), (1.0,)), "off by"),
        (lambda: UserFunction(lambda q: (q[0],), lambda q: (q[0],), (1.0,)), "shape"),  # type: ignore[arg-type, return-value]
    ],
)
def test_a_mechanism_that_cannot_be_is_refused(make, said):
    with pytest.raises(ParameterError) as caught:
        make()
    assert said in str(caught.value)


def test_a_user_function_that_returns_no_number_is_a_singular_pose():
    mechanism = UserFunction(lambda q: (1.0 / q[0] if q[0] else math.inf,), lambda q: ((-1.0 / q[0] ** 2,),), (1.0,))
    assert mechanism.pose((1.0,)).limit == Limit.NONE
    broken = UserFunction(
        lambda q: (q[0] if q[0] < 2.0 else math.nan,), lambda _q: ((1.0,),), (1.0,)
    )  # fmt: skip
    assert broken.pose((3.0,)).limit == Limit.SINGULAR
