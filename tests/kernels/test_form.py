"""Every function that a kernel reaches keeps to what `canhaptic.kernels` allows: else numba or the bits would fail.

Compiling every algorithm with every environment takes minutes and is a slow test; this one reads the source.
"""

import ast
import inspect
import textwrap
from collections.abc import Iterator
from functools import cache
from types import FunctionType
from typing import Any

import pytest

from canhaptic.control.balance import AT_REST
from canhaptic.control.environments import ENVIRONMENTS
from canhaptic.control.mechanisms.five_bar import FiveBarMap
from canhaptic.control.mechanisms.kinematics import IdentityMap
from canhaptic.control.mechanisms.planar_2r import LinkMap
from canhaptic.control.mechanisms.transmission import LinearMap
from canhaptic.control.multi_axis import GROUP_ALGORITHMS
from canhaptic.control.passivity import ALGORITHMS
from canhaptic.control.passivity.stepped import SteppedController
from canhaptic.control.passivity.unprotected import Unprotected
from canhaptic.control.port_hamiltonian.shapes import LinearGeometry
from canhaptic.control.port_hamiltonian.shapes.box import BoxInside
from canhaptic.control.port_hamiltonian.shapes.guided_path import FromPath
from canhaptic.control.port_hamiltonian.shapes.sphere import Round
from canhaptic.control.port_hamiltonian.shapes.tube import AroundLine
from canhaptic.errors import ParameterError
from canhaptic.lab.batch import closed_loop
from canhaptic.lab.batch.closed_loop import run_loop
from canhaptic.lab.batch.continuous_run import watch_continuous
from canhaptic.lab.batch.network_loop import explain, move_five_bar, respond_together
from canhaptic.lab.batch.plants import (
    book_motor,
    booked_work,
    by_its_way,
    event_position_of,
    move_event_motors,
    residual_of_plant,
    run_substeps,
)
from canhaptic.registry import load

FORBIDDEN = (
    ast.Raise, ast.Try, ast.With, ast.Lambda, ast.ListComp, ast.GeneratorExp, ast.DictComp, ast.SetComp, ast.Dict,
    ast.Yield, ast.Import, ast.ImportFrom, ast.Global, ast.Nonlocal, ast.ClassDef, ast.Pow, ast.Starred, ast.JoinedStr,
)  # fmt: skip
METHODS = ("contact", "true_state", "admissible", "stored_energy", "effort", "state_of_energy", "relaxed")
METHODS_OF_GROUPS: list[Any] = [
    *(mechanism.locate for mechanism in (IdentityMap, LinearMap, LinkMap, FiveBarMap)),
    *(geometry.measure for geometry in (LinearGeometry, Round, AroundLine, FromPath, BoxInside)),
]


def reached(function: Any, known: set[Any]) -> Iterator[Any]:
    """Yields a function of this package and every one that it names."""
    if function in known or not function.__module__.startswith("canhaptic."):
        return
    known.add(function)
    yield function
    for name in function.__code__.co_names:
        value = function.__globals__.get(name)
        if isinstance(value, FunctionType):
            yield from reached(value, known)


@cache
def faults(function: Any) -> list[str]:
    """Returns what a kernel must not have."""
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(function))).body
    assert isinstance(definition, ast.FunctionDef)
    where = f"{function.__module__}.{function.__name__}"
    found = []
    for node in (part for statement in definition.body for part in ast.walk(statement)):
        if isinstance(node, FORBIDDEN):
            found.append(f"{where}: {type(node).__name__}")
        elif isinstance(node, ast.FunctionDef):
            found.append(f"{where}: a function inside")
        elif isinstance(node, ast.Constant) and node.value is None:
            found.append(f"{where}: None")
        elif isinstance(node, ast.Name) and node.id in ("sum", "print", "getattr", "isinstance", "sorted"):
            found.append(f"{where}: {node.id}")
    return found


def all_faults(function: Any) -> list[str]:
    return [fault for part in reached(function, set()) for fault in faults(part)]


@pytest.mark.slow_but("guarded", "internal_dissipation", "passivity_observer", "unprotected")
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_an_algorithm_keeps_to_the_form_of_kernels(algorithm: str) -> None:
    kernel = load(ALGORITHMS, algorithm, "passivity algorithm").kernel
    assert len(list(reached(kernel.step, set()))) >= 8
    assert all_faults(kernel.step) == []


@pytest.mark.slow_but("guarded")
@pytest.mark.parametrize("algorithm", GROUP_ALGORITHMS)
def test_an_algorithm_of_groups_keeps_to_the_form_of_kernels(algorithm: str) -> None:
    kernel = load(GROUP_ALGORITHMS, algorithm, "group algorithm").kernel
    assert len(list(reached(kernel.step, set()))) >= 40
    assert all_faults(kernel.step) == []


@pytest.mark.parametrize("algorithm", [*ALGORITHMS, *GROUP_ALGORITHMS])
def test_no_field_of_a_record_has_the_name_of_a_method_which_compiled_code_would_take(algorithm: str) -> None:
    pytest.importorskip("numba")
    from canhaptic.kernels.compiler import METHODS as COMPILED

    for table in (ALGORITHMS, GROUP_ALGORITHMS):
        for part in reached(load(table, algorithm, "algorithm").kernel.step, set()) if algorithm in table else ():
            kinds = [part.__globals__.get(name) for name in part.__code__.co_names]
            assert [(kind, of) for kind in kinds for of in getattr(kind, "_fields", ()) if of in COMPILED] == []


@pytest.mark.parametrize("method", METHODS_OF_GROUPS, ids=lambda method: method.__qualname__)
def test_a_mechanism_and_a_geometry_keep_to_the_form_of_kernels(method: Any) -> None:
    assert all_faults(method) == []


@pytest.mark.parametrize("world", ENVIRONMENTS)
def test_an_environment_keeps_to_the_form_of_kernels(world: str) -> None:
    kind = load(ENVIRONMENTS, world, "environment")
    assert [fault for method in METHODS for fault in all_faults(getattr(kind, method))] == []


def test_the_loop_with_plant_reference_and_figures_keeps_to_the_form() -> None:
    known = {load(ALGORITHMS, "unprotected", "passivity algorithm").kernel.step}
    every = (part for function in (run_loop, watch_continuous) for part in reached(function, known))
    parts = [part for part in every if part.__name__ != "step"]  # the place of an algorithm's
    assert len(parts) >= 15
    assert [fault for part in parts for fault in faults(part)] == []


def parts_of_groups() -> list[Any]:
    """Returns what the loop of a group reaches; of the stepper not what it replaces."""
    known = {closed_loop.step, *by_its_way()}
    group = (run_loop, respond_together, explain, move_five_bar)
    moving = (*group, move_event_motors, event_position_of, booked_work, run_substeps, residual_of_plant, book_motor)
    return [part for move in moving for part in reached(move, known)]


def test_the_loop_of_a_group_and_its_motors_keep_to_the_form() -> None:
    parts = parts_of_groups()
    assert {part.__name__ for part in parts} >= {"pose_at", "discrete_gradient", "mean_pull", "run_substeps", "explain"}
    assert [fault for part in parts for fault in faults(part)] == []


def with_transcendental_functions() -> set[str]:
    """Returns the kernels of controllers that call a function of the C library whose last bit is its own."""
    kernels = [load(table, name, "algorithm").kernel.step for table in (ALGORITHMS, GROUP_ALGORITHMS) for name in table]
    worlds = [load(ENVIRONMENTS, name, "environment") for name in ENVIRONMENTS]
    parts = [*METHODS_OF_GROUPS, *(getattr(world, method) for world in worlds for method in METHODS)]
    every = [part for kernel in (*kernels, *parts) for part in reached(kernel, set())] + parts_of_groups()
    names = {"sin", "cos", "tan", "asin", "acos", "atan", "atan2", "exp", "expm1", "log", "tanh", "pow", "hypot"}
    return {part.__qualname__ for part in every if names.intersection(part.__code__.co_names)}


def test_the_kernels_with_transcendental_functions_are_these() -> None:
    """Elsewhere Python and numba have the same bits on any machine; here if they take the same C library."""
    assert with_transcendental_functions() == {
        "Detents.effort", "Detents.state_of_energy", "Detents.stored_energy", "ViscoelasticMedium.relaxed",
        "FiveBarMap.locate", "LinkMap.locate", "moved_by", "pose_at", "hand_target", "gaussian",
        "mean_sine", "falling_friction", "bent",
    }  # fmt: skip


def test_an_algorithm_with_settings_state_and_memory_one_by_one_is_refused() -> None:
    def step(environment: Any, settings: Any, state: Any, memory: Any, position: float, torque_applied: float) -> Any:
        return AT_REST

    with pytest.raises(ParameterError, match=r"Old: got a step of 6 arguments, expected \(environment, run, position"):

        class Old(SteppedController):
            kernel = Unprotected.kernel._replace(step=step)


def test_a_fault_is_found() -> None:
    def bad(x: float) -> float:
        return sum([x**2])

    assert {fault.rsplit(": ")[1] for fault in faults(bad)} == {"sum", "Pow"}
