"""The source of one step of a group, unfolded from its classes, and where its numbers are."""

import inspect
from collections.abc import Sequence
from enum import Enum
from types import ModuleType
from typing import Any, Final, NamedTuple

from canhaptic.control.mechanisms.kinematics import Kinematics, Pose
from canhaptic.control.multi_axis.unfolding.memory import Memory, changing, leaves, loaded, same_shape
from canhaptic.control.multi_axis.unfolding.source_writer import Frame
from canhaptic.control.multi_axis.unfolding.statements import Statements
from canhaptic.control.multi_axis.unfolding.values import (
    DEAD,
    CannotUnfoldError,
    Cell,
    Var,
    as_kind,
    is_scalar,
    kind_of,
    text_of,
)
from canhaptic.control.port_hamiltonian.njit_registry import plain_constants, plain_functions
from canhaptic.control.port_hamiltonian.sampled_network import SampledNetwork
from canhaptic.control.velocity import AdaptiveWindow
from canhaptic.errors import ControlError
from canhaptic.units import Parameters

NAMES: Final = """from __future__ import annotations
import math
from math import cos, exp, hypot, inf, sin, sqrt
from typing import Any
from numba import njit
from canhaptic.control.port_hamiltonian.equation import Workspace
from canhaptic.control.port_hamiltonian.discrete_gradient import Matrix, NetworkTables, Vector
"""
_FUNCTIONS: Final = """
@njit(error_model="python", cache=True)
def exact_sum(values):
    total = error = 0.0
    for term in values:
        before = total
        total = before + term
        part = total - before
        error += (before - (total - part)) + (term - part)
    return total + error


@njit(error_model="python", cache=True)
def length_of(values):
    total = 0.0
    for value in values:
        total += value * value
    return sqrt(total)
"""
_STEP: Final = """
@njit("boolean(float64[::1], float64[::1], int64[::1])", cache=True, error_model="python")
def group_step(numbers, before, beside):
    for k in range(numbers.size):
        before[k] = numbers[k]
"""
_KEPT: Final = {SampledNetwork: ("state", "_next", "_ahead"), AdaptiveWindow: ("_ring",)}


class StandIn:
    """A mechanism that is always inside its limits: it lends a controller the shapes of its state."""

    def __init__(self, kinematics: Kinematics) -> None:
        self.axes, self.dimensions = kinematics.axes, kinematics.dimensions

    def pose(self, positions: Sequence[float]) -> Pose:
        """Returns some pose."""
        return Pose((0.0,) * self.dimensions, ((1.0,) * self.axes,) * self.dimensions)

    def forward(self, positions: Sequence[float]) -> tuple[float, ...]:
        """Is not asked.

        Raises:
            ControlError: Always.
        """
        raise ControlError(f"stand-in: asked at {tuple(positions)}, expected nobody to ask; report this")

    def jacobian(self, positions: Sequence[float]) -> tuple[tuple[float, ...], ...]:
        """Is not asked.

        Raises:
            ControlError: Always.
        """
        raise ControlError(f"stand-in: asked at {tuple(positions)}, expected nobody to ask; report this")


class Unfolded(NamedTuple):
    """A step as text, and its array."""

    functions: str  # of networks, as they are
    source: str  # of the step; it calls them
    memory: Memory
    constants: dict[int, list[float]]  # first entry -> numbers of the network that never change
    beside: list[int]
    outputs: int  # first entry of the balance
    kinds: tuple[str, ...]  # of its numbers


def owners(root: Any) -> list[Any]:
    """Returns a controller and all objects of the package that it is made of, in a fixed order."""
    found: dict[int, Any] = {}

    def visit(value: Any) -> None:
        if isinstance(value, (list, tuple)):
            for entry in value:
                visit(entry)
        elif _is_part(value) and id(value) not in found:
            found[id(value)] = value
            for name in _names(value):
                visit(getattr(value, name, None))

    visit(root)
    return list(found.values())


def _is_part(value: Any) -> bool:
    kind = type(value)
    return kind.__module__.startswith("canhaptic.control.") and not issubclass(
        kind, (Parameters, Enum, type, ModuleType, StandIn)
    ) and not hasattr(value, "pose")  # fmt: skip


def _names(value: Any) -> list[str]:
    slots = getattr(type(value), "__slots__", ())
    return sorted(vars(value)) if hasattr(value, "__dict__") else sorted(slots)


def unfold(group: Any, twin: Any) -> Unfolded:
    """Returns the source of the step of a group.

    Args:
        group: The controller.
        twin: The same on a `StandIn`, after some steps: its state has the shape that it has in motion.

    Raises:
        CannotUnfoldError: Something in it has no form of plain numbers.
    """
    memory = Memory()
    axes = group.axes
    inputs = memory.take(2 * axes)
    walk = Statements(memory)
    network = _lay_out(memory, walk, group, twin)
    positions = tuple(Var(f"s{inputs + i}", "float") for i in range(axes))
    applied = tuple(Var(f"s{inputs + axes + i}", "float") for i in range(axes))
    frame = Frame({}, {}, type(group).__name__)
    balance = walk.call(group.step, [positions, applied], {}, frame)
    if balance is DEAD:
        raise CannotUnfoldError(f"compiled: no step of {type(group).__name__} comes to its end")
    constants, lines = _constants(memory, network)
    stores = _stores(memory, walk)
    values = list(_flat(balance, walk))
    outputs = memory.take(len(values))
    stores += [f"numbers[{outputs + i}] = {as_kind(value, 'float')}" for i, value in enumerate(values)]
    body = [*lines, *_loads(memory, inputs, 2 * axes), *walk.writer.lines, *stores, "return True"]
    source = NAMES + _STEP + "".join(f"    {line}\n" for line in body)
    kinds = tuple(kind_of(value) for value in values)
    return Unfolded(
        NAMES + _FUNCTIONS + _functions(),
        source,
        memory,
        constants,
        [int(b) for b in network.tables.beside] or [-1],
        outputs,
        kinds,
    )


_READ: Final = {"float": "numbers[{}]", "int": "int(numbers[{}])", "bool": "numbers[{}] != 0.0"}


def _loads(memory: Memory, inputs: int, count: int) -> list[str]:
    """Returns the lines that name inputs, state and parameters."""
    lines = [f"s{i} = numbers[{i}]" for i in range(inputs, inputs + count)]
    lines += [
        f"s{slot.first + i} = {_READ[kind].format(slot.first + i)}"
        for slot in memory.slots.values() for i, kind in enumerate(slot.kinds)
    ]  # fmt: skip
    return [*lines, *(f"s{first} = numbers[{first}]" for first in memory.parameters)]


def _lay_out(memory: Memory, walk: Statements, group: Any, twin: Any) -> SampledNetwork:
    """Gives every attribute that changes its place."""
    pairs = list(zip(owners(group), owners(twin), strict=True))
    (network,) = [owner for owner, _ in pairs if isinstance(owner, SampledNetwork)]
    states, dissipators = len(network.state), len(network.tables.viscous)
    for name in network.room._fields:
        size = dissipators if name in ("flows", "losses", "factors", "engaged") else states
        memory.add_block(network.room, name, (size, size) if name in ("jacobian", "mobility") else (size,))
    for owner, other in pairs:
        kept = _KEPT.get(type(owner), ())
        for name in kept:
            memory.add_block(owner, name, (len(getattr(owner, name)),))
        for name in sorted(changing(type(owner)) - {*kept}):
            if not hasattr(other, name):
                raise CannotUnfoldError(f"compiled: {type(owner).__name__}.{name} is not there after some steps")
            example = getattr(other, name)
            slot = memory.add_slot(owner, name, example)
            walk.writer.state.attributes[id(owner), name] = loaded(slot, walk.writer.state.lists)
    return network


def _flat(value: Any, walk: Statements) -> Any:
    """Yields the numbers of a value."""
    if is_scalar(value):
        yield value
    elif isinstance(value, (Cell, tuple)):
        for entry in walk.writer.state.lists[value] if isinstance(value, Cell) else value:
            yield from _flat(entry, walk)
    elif value is not None:
        raise CannotUnfoldError(f"compiled: {value!r} has no form of plain numbers")


def _shape(value: Any, walk: Statements, example: Any) -> Any:
    """Returns a value with its lists in place, of the types of an example."""
    if isinstance(value, Cell):
        entries = walk.writer.state.lists[value]
        like = list(example) if len(example) == len(entries) else [None] * len(entries)
        return type(example)(_shape(v, walk, e) for v, e in zip(entries, like, strict=True))
    if isinstance(value, tuple) and not isinstance(value, Var):
        like = list(example) if isinstance(example, tuple) and len(example) == len(value) else [None] * len(value)
        entries = [_shape(v, walk, e) for v, e in zip(value, like, strict=True)]
        return type(value)(*entries) if hasattr(value, "_fields") else tuple(entries)
    return 0.0 if isinstance(value, Var) else value


def _stores(memory: Memory, walk: Statements) -> list[str]:
    """Returns the lines that keep what has changed."""
    lines = []
    for (owner, name), slot in memory.slots.items():
        value = walk.writer.state.attributes[owner, name]
        if not same_shape(slot.example, _shape(value, walk, slot.example)):
            raise CannotUnfoldError(f"compiled: {type(slot.owner).__name__}.{name} changes its shape")
        for i, (leaf, kind) in enumerate(zip(_flat(value, walk), slot.kinds, strict=True)):
            if kind_of(leaf) == "float" and kind != "float":
                raise CannotUnfoldError(f"compiled: {type(slot.owner).__name__}.{name} turns from {kind} to float")
            if text_of(leaf) != f"s{slot.first + i}":
                lines.append(f"numbers[{slot.first + i}] = {as_kind(leaf, 'float')}")
    return lines


def _constants(memory: Memory, network: SampledNetwork) -> tuple[dict[int, list[float]], list[str]]:
    """Returns the numbers of the network, and the lines that name them and the lists kept in place."""
    constants: dict[int, list[float]] = {}
    parts, data = [], network.tables
    shapes = {
        "quadratic": (len(data.stiffness),) * 2, "structure": (len(data.stiffness),) * 2,
        "gain": (len(data.stiffness), len(data.gain[0])), "on_states": (len(data.viscous), len(data.stiffness)),
        "on_ports": (len(data.viscous), len(data.gain[0])),
    }  # fmt: skip
    for name, value in data._asdict().items():
        if isinstance(value, bool):
            parts.append(repr(value))
        elif name == "beside":
            parts.append(f"beside[:{len(value)}]")
        else:
            numbers = list(leaves(value))
            first = memory.take(len(numbers))
            constants[first] = numbers
            text = f"numbers[{first}:{first + len(numbers)}]"
            parts.append(f"{text}.reshape({shapes[name]})" if name in shapes else text)
    lines = [f"tables = NetworkTables({', '.join(parts)})"]
    rooms = {}
    for block in memory.blocks.values():
        count = block.shape[0] * (block.shape[1] if len(block.shape) > 1 else 1)
        text = f"numbers[{block.first}:{block.first + count}]"
        lines.append(f"{block.array.name} = {text}{f'.reshape({block.shape})' if len(block.shape) > 1 else ''}")
        if block.owner is network.room:
            rooms[block.name] = block.array.name
    return constants, [*lines, f"room = Workspace({', '.join(rooms[name] for name in network.room._fields)})"]


def _functions() -> str:
    """Returns the plain functions and their constants as source."""
    text = "".join(f"{name} = {value!r}\n" for name, value in plain_constants().items())
    decorated = [f'\n@njit(error_model="python", cache=True)\n{inspect.getsource(f)}' for f in plain_functions()]
    return text + "".join(decorated)
