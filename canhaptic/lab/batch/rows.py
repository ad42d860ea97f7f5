"""The numbers of a batch, scene by scene: environment, settings of the algorithm, loop, flow and start of the plant."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from math import inf
from typing import Any, Final, NamedTuple

import numpy as np

from canhaptic.control.environments.plain import plain, plain_with
from canhaptic.control.passivity import ALGORITHMS
from canhaptic.kernels import Kernel
from canhaptic.lab.batch.batch_case import BatchCase
from canhaptic.lab.batch.closed_loop import LinearPlants, LoopSettings
from canhaptic.lab.batch.meter import MeterSettings
from canhaptic.registry import load

Numbers = Mapping[str, Any]
_OF_LOOP: Final = ("counts_per_unit", "torque_quantum", "torque_limit", "last_from", "damping_per_time", "friction")


class SceneRow(NamedTuple):
    """One scene in kernel form."""

    environment: Any  # plain object
    settings: Any  # of the algorithm
    loop: LoopSettings


def kernel_of(algorithm: str) -> Kernel | None:
    """Return the kernel of an algorithm; None for a class of one's own that has none."""
    kernel: Kernel | None = getattr(load(ALGORITHMS, algorithm, "passivity algorithm"), "kernel", None)
    return kernel


def scene_rows(case: BatchCase, kernel: Kernel, numbers: Numbers, count: int) -> Iterator[SceneRow]:
    """Yield every scene.

    Args:
        case: Common part of the scenes.
        kernel: Kernel of the algorithm.
        numbers: Varied numbers, one or of shape (count,) each.
        count: Number of scenes.
    """
    environment = _Varied("environment", case.environment, numbers)
    parameters = _Varied("passivity", case.parameters, numbers)
    properties = _Varied("loop", case.loop, numbers)
    loop = _varied_loop(case, numbers)
    fixed = environment.fixed and parameters.fixed and properties.fixed
    known: tuple[Any, Any] | None = None
    for row in range(count):
        if known is None or not fixed:
            world = environment.at(row)
            known = world, kernel.settings(world, parameters.at(row), properties.at(row))
        yield SceneRow(*known, loop(row))


class _Varied:
    """A parameter model with different numbers for each scene, as a plain object."""

    def __init__(self, section: str, model: Any, numbers: Numbers) -> None:
        self._model = model
        own = {name.removeprefix(f"{section}."): v for name, v in numbers.items() if name.startswith(f"{section}.")}
        self._columns = {name: values.tolist() for name, values in own.items() if isinstance(values, np.ndarray)}
        self._fields = {**vars(model), **{name: v for name, v in own.items() if name not in self._columns}}
        self.fixed = not self._columns
        self._known = None if not self.fixed else (plain_with(type(model), self._fields) if own else plain(model))

    def at(self, row: int) -> Any:
        """Return the model of one scene."""
        if self._known is not None:
            return self._known
        values = {name: column[row] for name, column in self._columns.items()}
        return plain_with(type(self._model), {**self._fields, **values})


def _varied_loop(case: BatchCase, numbers: Numbers) -> Any:
    """Return the function from a row to the settings of its loop."""

    def column(name: str, absent: float) -> Any:
        value = numbers.get(name)
        if isinstance(value, np.ndarray):
            return value.tolist().__getitem__
        return lambda _row: absent if value is None else float(value)

    counts, quantum = column("counts_per_unit", 0.0), column("torque_quantum", 0.0)
    limit, last_from = column("torque_limit", inf), column("last_from", 0.0)
    damping, friction = column("damping_per_time", 0.0), column("friction", 0.0)
    brief = numbers.get("is_brief", 0.0) == 1.0
    period, seed = column("loop.sample_time", case.loop.sample_time), column("seed", 0.0)

    def at(row: int) -> LoopSettings:
        meter = MeterSettings(last_from(row), damping(row), friction(row), brief)
        signals = case.signals.at(period(row), int(seed(row)))
        losses = replace(case.losses, seed=int(seed(row)))
        return LoopSettings(case.delay, counts(row), quantum(row), limit(row), case.furthest, meter, signals, losses)

    is_random = case.signals.effects or case.losses.exists
    of_loop = (*_OF_LOOP, *(("loop.sample_time", "seed") if is_random else ()))
    if any(isinstance(numbers.get(name), np.ndarray) for name in of_loop):
        return at
    shared = at(0)
    return lambda _row: shared


def linear_plants(case: BatchCase, numbers: Numbers, count: int, *, listed: bool) -> LinearPlants:
    """Return the plants of many scenes; one flow and start where all have the same.

    Args:
        case: Common part of the scenes.
        numbers: Varied numbers.
        count: Number of scenes.
        listed: Whether Python runs the loops, on lists.
    """
    states = case.size - 2
    names = [name for name in numbers if name.startswith(("flow.", "start."))]
    rows = count if any(isinstance(numbers[name], np.ndarray) for name in names) else 1
    flows, starts = np.zeros((rows, states, case.size)), np.zeros((rows, case.size))
    starts[:, -1] = 1.0
    for name in names:
        section, *places = name.split(".")
        if section == "flow":
            flows[:, int(places[0]), int(places[1])] = numbers[name]
        else:
            starts[:, int(places[0])] = numbers[name]
    found = flows, starts, np.zeros(case.size), np.zeros(states)
    return LinearPlants(*(array.tolist() for array in found) if listed else found)
