"""The plant side of a group: what its motors move, under the torques of the scene's own controller.

Motors with plants of their own are each an axis of the ladder, and a setting is as good as on the worst of them; a
mechanism is held against its equations of motion by DOP853.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Final, Protocol

import numpy as np

from canhaptic.errors import InputError
from canhaptic.lab.batch.group_loop import GroupRecorder, Motors, motors_of, render_group
from canhaptic.lab.judge.event_location import located_states
from canhaptic.lab.judge.fixed_step import fixed_step_states, runge_kutta_4
from canhaptic.lab.judge.reference_group import GroupModel
from canhaptic.lab.reference.continuous_group import group_model
from canhaptic.lab.studies.accuracy.accuracy_choice import ladder
from canhaptic.lab.studies.accuracy.candidates import LSODA, OURS, Candidate, counted
from canhaptic.lab.studies.accuracy.group_variants import finely_solved
from canhaptic.lab.studies.accuracy.plant_solvers import FURTHEST, PlantSide, Row, named, orders_of
from canhaptic.scene.models import Scene
from canhaptic.scene.torque_history import simulation_of
from canhaptic.sim.plant.accuracy_parameters import AccuracyParameters
from canhaptic.sim.plant.plant_motion import Motion
from canhaptic.sim.plant.propagator import Array

_SUBSTEPS: Final = (1, 2, 4, 8, 16, 32)
_TOLERANCES: Final = (1e-3, 1e-5, 1e-7, 1e-9)
_REFERENCE: Final = 1e-12
_RUNGE_KUTTA: Final = (1, 2, 4, 8)


class Plants(Protocol):
    """One side of a study: see `PlantSide`."""

    rows: list[Row]
    effects: list[Row]
    candidates: list[Candidate]
    without: dict[str, Candidate]
    travel: float
    energy: float
    evaluations: int

    def measure(self) -> Iterator[str]:
        """Run every rung once; yield the name of each before it is run."""

    def measure_effects(self, accuracy: AccuracyParameters) -> Iterator[str]:
        """Run the plant without each effect; yield the name of each before it is run."""

    def orders(self) -> list[Row]:
        """Return the order of every method with a step."""


def group_side(scene: Scene, holds: int, stop: Callable[[], bool], *, with_compiled: bool) -> Plants:
    """Return the plant side of the one group of a scene; arguments as for `PlantSide`.

    Raises:
        InputError: The loop of the scene does not run to its end, or there are no equations to compare with.
    """
    run = render_group(finely_solved(scene), holds + 1, GroupRecorder(len(scene.axes)))
    if run.ended:
        raise InputError(f"{scene.source}: the loop {run.ended} before its end ({run.reason}); nothing can be compared")
    torques = run.torque[1:]
    return _Mechanism(scene, torques, stop) if scene.mechanisms else _OwnPlants(scene, torques, stop, with_compiled)


class _OwnPlants:
    """Plants that each axis of the group has by itself; see `PlantSide`."""

    def __init__(self, scene: Scene, torques: Array, stop: Callable[[], bool], with_compiled: bool) -> None:
        axes = [scene.axis(name) for name in scene.groups[0].axes]
        period = scene.bus.sample_time_ns
        ladders = [ladder(simulation_of(axis), period) for axis in axes]
        lead = max(range(len(axes)), key=lambda place: len(ladders[place]))  # names the settings
        self._names = [axis.parameters.name for axis in axes]
        self._sides = [
            PlantSide(
                axis,
                scene,
                len(torques),
                stop,
                with_compiled=with_compiled,
                torques=column.tolist(),
                settings=ladders[lead],
            )
            for axis, column in zip(axes, torques.T, strict=True)
        ]
        rungs = [{_rung(candidate): candidate for candidate in side.candidates} for side in self._sides]
        self.candidates = [
            replace(candidate, spend=partial(_spend, [of[rung] for of in rungs]))
            for rung, candidate in rungs[lead].items()
            if all(rung in of for of in rungs)
        ]
        self.travel, self.energy = (max(getattr(side, name) for side in self._sides) for name in ("travel", "energy"))
        self.evaluations = sum(side.evaluations for side in self._sides)
        self.rows: list[Row] = []
        self.effects: list[Row] = []
        self.without: dict[str, Candidate] = {}

    def measure(self) -> Iterator[str]:
        """Run every rung once on every plant; yield the name of each before it is run."""
        rows: list[dict[object, Row]] = []
        for axis, side in zip(self._names, self._sides, strict=True):
            for name in side.measure():
                yield f"{axis}: {name}"
            rows.append({_rung(of): row for of, row in zip(side.candidates, side.rows, strict=True)})
        for candidate in self.candidates:
            self.rows.append({**_worst([of[_rung(candidate)] for of in rows]), "setting": candidate.setting})

    def measure_effects(self, accuracy: AccuracyParameters) -> Iterator[str]:
        """Run every plant without each of its effects; yield the name of each before it is run."""
        for axis, side in zip(self._names, self._sides, strict=True):
            for name in side.measure_effects(accuracy):
                yield f"{axis}: {name}"
            self.effects += [{**row, "effect": f"{axis}: {row['effect']}"} for row in side.effects]
            self.without |= {f"{axis}: {name}".rstrip(): of for name, of in side.without.items()}

    def orders(self) -> list[Row]:
        """Return the order of every method with a step, by the worst plant."""

        def declared(method: str) -> int | None:
            found = [side.declared(method) for side in self._sides]
            return min((order for order in found if order is not None), default=None)

        return orders_of(self.candidates, self.rows, self.travel, declared)


def _rung(candidate: Candidate) -> tuple[str, object]:
    """Return what a rung is on every plant; a setting of ours names only what matters to one of them."""
    return candidate.method, candidate.accuracy or candidate.setting


def _spend(parts: Sequence[Candidate]) -> None:
    for part in parts:
        part.spend()


def _worst(rows: Sequence[Row]) -> Row:
    """Return one row of several plants: the largest errors, and the sum of the prices."""
    bad = next((row for row in rows if row["status"] != "ok"), None)
    if bad is not None:
        return bad
    errors = {key: max(row[key] for row in rows) for key in ("position_error", "force_error", "energy_error")}
    prices = {key: sum(row[key] for row in rows) for key in ("evaluations", "evaluations_per_period", "events")}
    return {**rows[0], **errors, **prices}


@dataclass(slots=True)
class _Mechanism:
    """A mechanism that the motors of the group move together; its motions have a column for each motor."""

    scene: Scene
    torques: Array
    stop: Callable[[], bool]
    candidates: list[Candidate] = field(default_factory=list)
    rows: list[Row] = field(default_factory=list)
    effects: list[Row] = field(default_factory=list)
    without: dict[str, Candidate] = field(default_factory=dict)
    evaluations: int = 0
    travel: float = 0.0
    energy: float = 0.0
    _switches: bool = False
    _exact: Any = None  # Motion
    _inertia: Any = None  # in every pose of it, shape (holds, axes, axes)

    def __post_init__(self) -> None:
        model = group_model(self.scene)
        self._switches = model.switches
        self._exact = exact = self._solved(model, "DOP853", _REFERENCE)
        self._inertia = np.array([model.inertia(row) for row in exact.position])
        self.evaluations, self.travel = model.evaluations, max(float(np.ptp(exact.position, axis=0).max()), 1e-9)
        works = (exact.motor, exact.user, self._kinetic(exact))
        self.energy = max(float(np.abs(work).max()) for work in works)
        settings = _SUBSTEPS if self._order else (1,)
        self.candidates = [self._ours(n) for n in settings]
        self.candidates += [self._runge_kutta(n) for n in _RUNGE_KUTTA] + [self._adaptive(t) for t in _TOLERANCES]

    @property
    def _order(self) -> int | None:
        order: int | None = getattr(self.scene.mechanisms[0].mechanism.parameters, "order", None)
        return order

    def measure(self) -> Iterator[str]:
        """Run every rung once; yield the name of each before it is run."""
        for candidate in self.candidates:
            yield candidate.name
            motion, evaluations, events = candidate.observe()
            self.rows.append({**named(candidate), **self._judged(motion), "evaluations": evaluations,
                              "evaluations_per_period": evaluations / len(self.torques), "events": events})  # fmt: skip

    def measure_effects(self, accuracy: AccuracyParameters) -> Iterator[str]:
        """Yield nothing: a mechanism has no effects."""
        return iter(())

    def orders(self) -> list[Row]:
        """Return the order of every method with a step, declared and as fitted to this very scene."""
        declared: Mapping[str, int | None] = {OURS: self._order, "RK4": 1 if self._switches else 4}
        return orders_of(self.candidates, self.rows, self.travel, lambda method: declared.get(method))

    def _judged(self, motion: Motion) -> Row:
        """Return the largest differences from the reference at the end of any hold."""
        exact, period = self._exact, self.scene.bus.sample_time
        with np.errstate(all="ignore"):
            apart = np.einsum("kij,kj->ki", self._inertia, motion.velocity - exact.velocity)
            kicks = np.diff(apart, axis=0, prepend=np.zeros((1, apart.shape[1]))) / period
            works = (motion.motor - exact.motor, motion.user - exact.user, self._kinetic(motion) - self._kinetic(exact))
            found = [motion.position - exact.position, kicks, np.array(works)]
        largest = [float(np.abs(values).max()) if np.isfinite(values).all() else math.inf for values in found]
        stable = math.isfinite(sum(largest)) and largest[0] <= FURTHEST * self.travel
        names = ("position_error", "force_error", "energy_error")
        errors = dict(zip(names, largest, strict=True)) if stable else dict.fromkeys(names)
        return {"status": "ok" if stable else "unstable", **errors}

    def _kinetic(self, motion: Motion) -> Array:
        return np.asarray(0.5 * np.einsum("ki,kij,kj->k", motion.velocity, self._inertia, motion.velocity))

    def _ours(self, substeps: int) -> Candidate:
        mechanisms = tuple(replace(of, substeps=substeps) for of in self.scene.mechanisms)
        scene = replace(self.scene, mechanisms=mechanisms)
        axes = [scene.axis(name) for name in scene.groups[0].axes]
        accuracy = AccuracyParameters(substeps=substeps)

        def run(look: Callable[[Motors], object]) -> tuple[list[Any], int]:
            motors, period, found = motors_of(scene, axes), scene.bus.sample_time_ns, []
            for k, torques in enumerate(self.torques.tolist()):
                motors.advance_to((k + 1) * period, tuple(torques))
                found.append(look(motors))
            return found, motors.evaluations() or len(found)

        def observe() -> tuple[Motion, int, int]:
            table, evaluations = run(lambda m: (m.positions(), m.velocities(), m.work(), m.user_work()))
            return Motion(*(np.array(column) for column in zip(*table, strict=True))), evaluations, 0

        setting = "exact" if self._order is None else counted(substeps, "substep")
        return Candidate(
            OURS, setting, 1.0 / substeps, None, accuracy, observe, lambda: run(lambda _motors: None)
        )  # fmt: skip

    def _adaptive(self, tolerance: float) -> Candidate:
        def run() -> tuple[Any, int, int]:
            model = group_model(self.scene)
            return self._solved(model, "LSODA", tolerance), model.evaluations, 0

        return Candidate(LSODA, f"tolerance {tolerance:.0e}", None, None, None, run, run)

    def _runge_kutta(self, substeps: int) -> Candidate:
        def run() -> tuple[Any, int, int]:
            model, period = group_model(self.scene), self.scene.bus.sample_time_ns
            states = fixed_step_states(model, self.torques.tolist(), period, runge_kutta_4, substeps)
            return _motion_of(model, states), model.evaluations, 0

        return Candidate("RK4", counted(substeps, "step"), 1.0 / substeps, 4, None, run, run)

    def _solved(self, model: GroupModel, method: str, rtol: float) -> Motion:
        """Return the motion by one of scipy's solvers, hold by hold; errors as for `located_states`."""
        period = self.scene.bus.sample_time_ns
        states = located_states(model, self.torques.tolist(), period, method, rtol, 1e-3 * rtol, self.stop)
        return _motion_of(model, states)


def _motion_of(model: GroupModel, states: Sequence[Any]) -> Motion:
    works = np.array([model.works(state) for state in states])
    positions = np.array([model.positions(state) for state in states])
    velocities = np.array([model.velocities(state) for state in states])
    return Motion(positions, velocities, works[:, 0], works[:, 1])
