"""A plant without events in plain Python floats: its hold over one sample time, written out.

A plant with a single mode moves over a whole sample time by one small matrix, most of whose entries are zero. The
products that are left cost a third of the calls of NumPy when they are written out; beyond `_MOST_STATES` NumPy costs
less. The text depends only on the shape of a plant: on the number of its states, and on which entries are not zero. It
is compiled once a shape; the numbers are arguments of its function `make`.

The works of a hold are quadratic forms of the state at its start and of its torque. A hold only notes these. The works
are booked when the energies are read, or at the next `tidy`: of one hold in floats, of many in columns of NumPy. Both
are the same expressions in the same order, so an energy has the same bits however often energies are read.
"""

import struct
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property, lru_cache
from typing import Any, Final, NamedTuple

import numpy as np

from canhaptic.sim.plant.assembly import Account, Mode, PlantModel
from canhaptic.sim.plant.hybrid_automaton import ACCOUNTS, HybridAutomaton, matrix_of
from canhaptic.sim.plant.propagator import Array

_MOST_STATES: Final = 5
"""Largest number of states that is written out; beyond, NumPy costs less."""
_MANY: Final = 64  # holds from which columns cost less than floats

Entries = tuple[tuple[int, ...], ...]  # for each row the columns whose entry is not zero


class FlatShape(NamedTuple):
    """Where the numbers of a plant are not zero; the last two components of its state are the torque and the one."""

    flow: Entries  # of the states, without torque and one
    shift: tuple[int, ...]  # states in the deflection of the hand, which replaces the position in `works`
    works: tuple[Entries, ...]  # upper triangle of the form of each work
    storage: Entries  # upper triangle of the stored energy, a form of the states
    accounts: tuple[tuple[int, ...], ...]  # works of the motor, of the user, and dissipated


class FlatHold(NamedTuple):
    """Functions of one plant, which share its state."""

    noted: list[float]  # states and torque of each hold that is not booked yet, one behind the other
    width: int  # number of states and torque
    period: Callable[[float], float]  # takes one sample time under a torque; returns the position after it
    states: Callable[[], tuple[float, ...]]
    load: Callable[..., None]  # sets the states
    works: Callable[..., Sequence[Array]]  # of holds, from columns of their states and torques
    book: Callable[..., None]  # adds the works of one hold, from its states and torque
    totals: Callable[[], list[float]]  # works since the last `tidy` [J]
    settle: Callable[..., None]  # sets totals, sums and carries of the works
    accounts: Callable[[], list[float]]  # works since the start, by account [J]
    stored: Callable[[], float]  # kinetic and elastic energy [J]


def can_be_flat(scene: PlantModel) -> bool:
    """Return whether a plant has one mode and few states, and is therefore cheaper written out."""
    has_one_mode = all(len(part.modes) == 1 for part in scene.parts)
    return (
        has_one_mode and not (scene.efforts or scene.schedule or scene.settings) and len(scene.states) <= _MOST_STATES
    )


def _flat_hold(mode: Mode, booked: Sequence[Account]) -> FlatHold:
    """Return the functions of a plant.

    Args:
        mode: Its only mode.
        booked: Account of each work.
    """
    size = len(mode.storage)
    flow, shift = matrix_of(mode.flows[0])[:-2], matrix_of(mode.works[0])[-size:][:1].copy()
    shift[0, 0] = 0.0
    halves = [np.triu(form) for form in (*mode.forms, mode.storage)]
    matrices = [flow, shift, *(half + np.triu(half, 1) for half in halves)]
    found = [_entries(matrix) for matrix in matrices]
    accounts = tuple(tuple(k for k, of in enumerate(booked) if of == account) for account in ACCOUNTS)
    shape = FlatShape(found[0], found[1][0], tuple(found[2:-1]), found[-1], accounts)
    return _maker(shape)(*(value for matrix in matrices for value in matrix[matrix != 0.0].tolist()))


def _entries(matrix: Array) -> Entries:
    return tuple(tuple(np.flatnonzero(row).tolist()) for row in matrix)


@lru_cache(maxsize=256)
def _maker(shape: FlatShape) -> Callable[..., FlatHold]:
    """Compile the function that makes a `FlatHold` of this shape from the numbers of a plant."""
    names: dict[str, Any] = {"FlatHold": FlatHold}
    exec(compile(_source(shape), "<a plant written out>", "exec"), names)
    maker: Callable[..., FlatHold] = names["make"]
    return maker


_MAKE: Final = """
def make({arguments}):
    {all_z} = 0.0
    {all_since} = 0.0
    noted = []
    note = noted.extend

    def period(u):
        nonlocal {z}
        note(({z}, u))
        {z} = {flow}
        return z0

    def states():
        return {z}

    def load(*states):
        nonlocal {z}
        {z} = states

    def works({z}, u):
        y = {deflection}
        return {works},

    def book({z}, u):
        nonlocal {t}
        y = {deflection}
        {booked}

    def totals():
        return [{t}]

    def settle(*values):
        nonlocal {since}
        {since} = values

    def accounts():
        return [{accounts}]

    def stored():
        return {stored}

    return FlatHold(noted, {width}, period, states, load, works, book, totals, settle, accounts, stored)
"""
"""Text of the function that makes the functions of a plant."""


def _source(shape: FlatShape) -> str:
    """Return the text of `make`; its arguments are the entries of flow, shift, works and storage, row by row."""
    states = [f"z{i}" for i in range(len(shape.flow))]
    z, kinds = ", ".join(states), range(len(shape.works))
    flow = [_sum(f"f{i}", [*states, "u", ""], row) for i, row in enumerate(shape.flow)]
    works = [_form(f"w{k}_", ["y", *states[1:], "u", ""], entries) for k, entries in enumerate(shape.works)]
    deflection = "z0 + " + _sum("s", [*states, "u", ""], shape.shift)
    numbers = [*_numbers("f", shape.flow), *(f"s_{j}" for j in shape.shift)]
    numbers += [name for k in kinds for name in _numbers(f"w{k}_", shape.works[k])]
    t, since = ", ".join(f"t{k}" for k in kinds), ", ".join(f"{name}{k}" for name in "tbc" for k in kinds)
    accounts = [" + ".join(f"(b{k} + (c{k} + t{k}))" for k in of) or "0.0" for of in shape.accounts]
    return _MAKE.format(
        arguments=", ".join([*numbers, *_numbers("p", shape.storage)]), z=z, all_z=" = ".join(states),
        t=t, since=since, all_since=" = ".join(since.split(", ")), flow=", ".join(flow), deflection=deflection,
        works=", ".join(works), booked="; ".join(f"t{k} += {work}" for k, work in enumerate(works)),
        accounts=", ".join(accounts), stored=_form("p", [*states, "0.0", ""], shape.storage), width=len(states) + 1,
    )  # fmt: skip


def _numbers(name: str, entries: Entries) -> list[str]:
    return [f"{name}{i}_{j}" for i, row in enumerate(entries) for j in row]


def _sum(name: str, factors: Sequence[str], places: Iterable[int]) -> str:
    """Return the text of a sum of numbers `name_j` times their factors; the factor of the one is empty."""
    terms = [f"{name}_{j} * {factors[j]}" if factors[j] else f"{name}_{j}" for j in places]
    return " + ".join(terms) or "0.0"


def _form(name: str, factors: Sequence[str], entries: Entries) -> str:
    """Return the text of a quadratic form, row by row."""
    rows = [(factors[i], _sum(f"{name}{i}", factors, row)) for i, row in enumerate(entries) if row]
    return " + ".join(f"{factor} * ({terms})" if factor else terms for factor, terms in rows) or "0.0 * u"


class FlatAutomaton(HybridAutomaton):
    """A plant with one mode, whose state is in the floats of a `FlatHold` instead of an array."""

    @cached_property
    def _flat(self) -> FlatHold:
        return _flat_hold(self.first_mode, list(self.scene.works.values()))

    @property
    def state(self) -> Array:
        """A copy of the state, shape (n,)."""
        noted = self._flat.noted
        return np.array([*self._flat.states(), noted[-1] if noted else self._torque, 1.0])

    @state.setter
    def state(self, state: Array) -> None:
        *states, self._torque, _ = state.tolist()
        self._flat.load(*states)

    def value(self, place: int) -> float:
        """Return one component of the state."""
        return self._flat.states()[place]

    @property
    def products(self) -> int:
        """Number of flow steps tried since the start, a machine-independent cost."""
        self._book()
        return super().products

    def reset(self) -> None:
        """Return to the initial state, with no energy booked."""
        self._flat.noted.clear()
        super().reset()
        self._settle()

    def mover(self) -> Callable[[float], float]:
        """Return the function that takes one whole sample time under a torque and returns the position after it."""
        return self._flat.period

    def hold(self, ticks: int, torque: float) -> None:
        """Move by `ticks` under a torque, ignoring guards."""
        self._hand_back()
        self._torque = torque
        self.run_free(ticks)
        self._settle()

    def works(self) -> list[float]:
        """Return the work booked since the start, in the order of `scene.works` [J]."""
        self._hand_back()
        return super().works()

    def accounts(self) -> list[float]:
        """Work of the motor, of the user, and dissipation, since the start [J]."""
        if self._flat.noted:
            self._book()
        return self._flat.accounts()

    def tidy(self) -> None:
        """Bound the growth of rounding errors over a run; called at fixed times, never by a reader."""
        self._hand_back()
        super().tidy()
        self._settle()

    def stored(self) -> float:
        """Return the kinetic and elastic energy [J]."""
        return self._flat.stored()

    def _hand_back(self) -> None:
        """Write the totals to their array, for what is the same in every plant."""
        self._book()
        self.totals[:] = self._flat.totals()

    def _settle(self) -> None:
        """Read the totals from their array, and the sums and the carries."""
        self._flat.settle(*self.totals.tolist(), *self._sums, *self._carries)

    def _book(self) -> None:
        """Book the works of the holds that were noted."""
        flat = self._flat
        noted, width = flat.noted, flat.width
        if not noted:
            return
        if len(noted) == width:
            flat.book(*noted)
        elif len(noted) < _MANY * width:
            for begin in range(0, len(noted), width):
                flat.book(*noted[begin : begin + width])
        else:
            self._book_columns(flat)
        self._torque = noted[-1]
        self._periods += len(noted) // width
        noted.clear()

    def _book_columns(self, flat: FlatHold) -> None:
        columns = np.frombuffer(struct.pack(f"{len(flat.noted)}d", *flat.noted)).reshape(-1, flat.width).T.copy()
        totals = flat.totals()
        for kind, work in enumerate(flat.works(*columns)):
            work[0] += totals[kind]
            totals[kind] = np.add.accumulate(work).item(-1)  # a plain sum adds in another order
        flat.settle(*totals, *self._sums, *self._carries)
