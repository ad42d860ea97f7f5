"""The plant side: the whole ladder on the torques of the scene's own controller, and every effect left out in turn.

Every method to compute one plant under given torques: our settings, fixed-step methods, LSODA.

The cost that is equal on every machine is the number of evaluations of the equations of motion: a trial matrix-vector
product of ours, a right-hand side of a textbook method (evaluations of forces for a guard included). It ranks like
time; the study reports how well.

The plant side of a group: the mechanics of its motors, under the torques of the scene's own controller.

Motors with plants of their own are each an axis of the ladder, and a setting is as good as on the worst of them; a
mechanism is compared with its equations of motion by DOP853.
"""

import importlib.util
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Final

import numpy as np

from canhaptic.errors import InputError, ParameterError
from canhaptic.lab.batch.group_loop import Motors
from canhaptic.lab.batch.scalar import render_group
from canhaptic.lab.judge.reference_group import ReferenceGroup
from canhaptic.lab.judge.reference_model import MotionError, difference
from canhaptic.lab.judge.solvers import (
    METHODS,
    fixed_step,
    fixed_step_states,
    located,
    located_states,
    reference,
    runge_kutta_4,
)
from canhaptic.lab.reference import group_model, textbook_model
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.accuracy.accuracy_choice import FLOOR, fitted_order, ladder
from canhaptic.lab.studies.accuracy.loop_sensitivity import finely_solved
from canhaptic.scene.far_side import build_plant
from canhaptic.scene.method import declared_order, simulation_of, torque_history
from canhaptic.scene.models import AxisScene, AxisSimulation, Scene
from canhaptic.sim.plant.accuracy_parameters import AccuracyParameters
from canhaptic.sim.plant.direct_rig import Motion, observed
from canhaptic.sim.plant.plant import Plant
from canhaptic.sim.plant.propagator import Array

OURS: Final = "canhaptic"
LSODA: Final = "LSODA, located"
_SUBSTEPS: Final = (1, 2, 4, 8, 16)
_TOLERANCES: Final = (1e-3, 1e-5, 1e-7, 1e-9)
_ABSOLUTE: Final = 1e-3
"""Absolute tolerance over relative."""
_MOST_WORK: Final = 130_000
"""Most evaluations of a fixed-step method in one run: finer rungs are left out."""
_WORK: Final = {"semi-implicit Euler": 1, "implicit midpoint": 8, "RK4": 4}
"""Per step, about, in right-hand sides."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """One method at one setting.

    Attributes:
        method: Name of the method.
        setting: Setting that distinguishes it from others of the same method.
        size: Relative step size, for fitting the order; None where there is no step.
        order: Declared order; None for exact and adaptive methods.
        accuracy: Accuracy as in a scene; None where no scene can express it.
        observe: Function that runs it and returns motion, evaluations and events.
        spend: Function that runs it for timing only.
    """

    method: str
    setting: str
    size: float | None
    order: int | None
    accuracy: AccuracyParameters | None
    observe: Callable[[], tuple[Motion, int, int]]
    spend: Callable[[], object]

    @property
    def name(self) -> str:
        """Method and setting."""
        return f"{self.method}, {self.setting}"


def candidates(
    simulation: AxisSimulation,
    torques: Sequence[float],
    sample_time_ns: int,
    settings: Sequence[AccuracyParameters],
) -> list[Candidate]:
    """Return the whole ladder of one plant.

    Args:
        simulation: Plant, user and effects.
        torques: Torque of each hold [N or N*m].
        sample_time_ns: Duration of a hold [ns].
        settings: Settings of our plant.
    """
    found = [ours(simulation, accuracy, torques, sample_time_ns) for accuracy in settings]
    for method, (order, _) in METHODS.items():
        for substeps in _SUBSTEPS:
            if substeps * _WORK[method] * len(torques) <= _MOST_WORK:
                found.append(_fixed(simulation, method, order, substeps, torques, sample_time_ns))
    if importlib.util.find_spec("scipy"):
        found += [_adaptive(simulation, tolerance, torques, sample_time_ns) for tolerance in _TOLERANCES]
    return found


def own_ladder(simulation: AxisSimulation, sample_time_ns: int) -> list[AccuracyParameters]:
    """Return every setting that makes a difference for this plant, and the scene's own."""
    found, now = ladder(simulation, sample_time_ns), own_setting(simulation, sample_time_ns)
    return found if now in found else [now, *found]


def own_setting(simulation: AxisSimulation, sample_time_ns: int) -> AccuracyParameters:
    """Return the accuracy of a scene, with the defaults where it makes no difference for this plant."""
    found, now = ladder(simulation, sample_time_ns), simulation.accuracy
    bits = now.event_bits if len({of.event_bits for of in found}) > 1 else found[0].event_bits
    substeps = now.substeps if len({of.substeps for of in found}) > 1 else found[0].substeps
    return now.model_copy(update={"event_bits": bits, "substeps": substeps})


def ours(
    simulation: AxisSimulation, accuracy: AccuracyParameters, torques: Sequence[float], sample_time_ns: int
) -> Candidate:
    """Return our plant at one accuracy."""
    solved = replace(simulation, accuracy=accuracy)
    kept = build_plant(solved, sample_time_ns)

    def observe() -> tuple[Motion, int, int]:
        plant = build_plant(solved, sample_time_ns)
        return observed(plant, torques), plant.products, plant.events

    return Candidate(
        OURS,
        _setting_of(accuracy, kept),
        1.0 / accuracy.substeps,
        None,
        accuracy,
        observe,
        lambda: stepped(kept, torques),
    )


def _setting_of(accuracy: AccuracyParameters, plant: Plant) -> str:
    """Return the part of an accuracy that matters to a plant."""
    words = []
    if any(part.has_guards for part in plant.scene.parts):
        words.append(f"{accuracy.event_bits} bits")
    if not plant.is_exact:
        words.append(counted(accuracy.substeps, "substep"))
    return ", ".join(words) or "exact"


def counted(count: int, what: str) -> str:
    """Return a number of things in words."""
    return f"{count} {what}{'s' if count > 1 else ''}"


def stepped(plant: Plant, torques: Sequence[float]) -> None:
    """Move a plant from its start as a drive does: one call per hold."""
    plant.reset()
    plant.begin(0)
    move, period, now = plant.advance_to, plant.sample_time_ns, 0
    for torque in torques:
        now += period
        move(now, torque)


def _fixed(
    simulation: AxisSimulation, method: str, order: int, substeps: int, torques: Sequence[float], sample_time_ns: int
) -> Candidate:
    def run() -> tuple[Motion, int, int]:
        model = textbook_model(simulation)
        motion = fixed_step(model, torques, sample_time_ns, METHODS[method][1](), substeps)
        return motion, model.evaluations, 0

    return Candidate(method, counted(substeps, "step"), 1.0 / substeps, order, None, run, run)


def _adaptive(simulation: AxisSimulation, tolerance: float, torques: Sequence[float], sample_time_ns: int) -> Candidate:
    def run() -> tuple[Motion, int, int]:
        model = textbook_model(simulation)
        motion = located(model, torques, sample_time_ns, "LSODA", tolerance, tolerance * _ABSOLUTE)
        return motion, model.evaluations, 0

    return Candidate(LSODA, f"tolerance {tolerance:.0e}", None, None, None, run, run)


FURTHEST: Final = 1.0
"""Error of the position, in travels of the reference, from which a method counts as unstable."""


class PlantSide:
    """One axis under recorded torques.

    Args:
        axis: Simulated axis.
        scene: Scene of the axis.
        holds: Number of holds.
        stop: Polled regularly; true aborts.
        torques: Torque of each hold [N or N*m]; None: from the scene's own controller.
        settings: Settings to try; None: every one that makes a difference for this plant.

    Attributes:
        torques: Torque of each hold [N or N*m].
        exact: Motion of the reference.
        travel: Travel of the reference [m or rad].
        energy: Largest of the works and the kinetic energy of the reference [J].
        rows: Results so far, one per setting of the ladder.
        effects: Results so far, one per effect of the scene.
    """

    def __init__(
        self,
        axis: AxisScene,
        scene: Scene,
        holds: int,
        stop: Callable[[], bool],
        *,
        torques: Sequence[float] | None = None,
        settings: Sequence[AccuracyParameters] | None = None,
    ) -> None:
        self._simulation: AxisSimulation = simulation_of(axis)
        self._period = scene.bus.sample_time_ns
        self.torques = torque_history(axis, scene, holds) if torques is None else torques
        model = textbook_model(self._simulation)
        self.exact: Motion = reference(model, self.torques, self._period, stop)
        self.evaluations = model.evaluations
        self.travel = max(float(np.ptp(self.exact.position)), 1e-9)
        kinetic = 0.5 * self._simulation.plant.mass * self.exact.velocity**2
        self.energy = max(float(np.abs(work).max()) for work in (self.exact.motor, self.exact.user, kinetic))
        settings = settings or own_ladder(self._simulation, self._period)
        self.candidates: list[Candidate] = candidates(self._simulation, self.torques, self._period, settings)
        self.without: dict[str, Candidate] = {}
        self.rows: list[Row] = []
        self.effects: list[Row] = []

    def measure(self) -> Iterator[str]:
        """Run every setting once for its errors and evaluations; yield the name of each before it is run."""
        for candidate in self.candidates:
            yield candidate.name
            self.rows.append(_row_of(candidate, self._judged, self.travel, len(self.torques)))

    def _judged(self, motion: Motion) -> MotionError:
        return difference(motion, self.exact, self._simulation.plant.mass, self._period * 1e-9)

    def measure_effects(self, accuracy: AccuracyParameters) -> Iterator[str]:
        """Run the plant without each effect at the chosen accuracy; yield the name of each before it is run.

        Args:
            accuracy: Accuracy at which the effects are timed.
        """
        names = list(dict.fromkeys(effect.name for effect in self._simulation.effects))
        if not names:
            return
        self.without[""] = whole = ours(self._simulation, accuracy, self.torques, self._period)
        motion, evaluations, _ = whole.observe()
        for name in names:
            yield f"without {name}"
            self.effects.append(self._effect_row(name, accuracy, motion, evaluations))

    def _effect_row(self, name: str, accuracy: AccuracyParameters, whole: Motion, base: int) -> Row:
        """Return the change from leaving an effect out at one accuracy, apart from the method's error."""
        order = next(getattr(e.parameters, "order", None) for e in self._simulation.effects if e.name == name)
        without, name, problem = self._left_out(name)
        if problem:
            return {"effect": name, "remark": f"cannot be left out alone: {problem}"}
        self.without[name] = candidate = ours(without, accuracy, self.torques, self._period)
        motion, evaluations, _ = candidate.observe()
        found = difference(motion, whole, self._simulation.plant.mass, self._period * 1e-9)
        if found.position <= FLOOR * self.travel and found.energy <= FLOOR * self.energy:
            found = MotionError(0.0, 0.0, 0.0)
        return {
            "effect": name,
            "order": order,
            "remark": "",
            **_errors_of(found),
            "evaluations_saved_per_period": (base - evaluations) / len(self.torques),
        }

    def _left_out(self, name: str) -> tuple[AxisSimulation, str, str]:
        """Return the plant without an effect, the effect left out, or the reason why it cannot be.

        An effect that another needs, as a backlash its shaft, is left out together with that one.
        """
        effects, problem = self._simulation.effects, ""
        for other in ("", *dict.fromkeys(effect.name for effect in effects if effect.name != name)):
            without = replace(self._simulation, effects=tuple(e for e in effects if e.name not in (name, other)))
            try:
                build_plant(without, self._period)
            except ParameterError as error:
                problem = problem or str(error)
                continue
            return without, f"{name} with {other}" if other else name, ""
        return self._simulation, name, problem

    def orders(self) -> list[Row]:
        """Return the declared order of every method with a step, and the order fitted to this scene."""
        return orders_of(self.candidates, self.rows, self.travel, self.declared)

    def declared(self, method: str) -> int | None:
        """Return the order that a method has on this scene: the effects' order for ours, 1 where modes switch."""
        if method == OURS:
            return declared_order(self._simulation)
        own = next(candidate.order for candidate in self.candidates if candidate.method == method)
        switching = textbook_model(self._simulation).switches
        return own if own is None or not switching else 1


def _row_of(candidate: Candidate, judged: Callable[[Motion], MotionError], travel: float, holds: int) -> Row:
    """Return the row of a setting, run once; errors are None where it is unstable."""
    try:
        motion, evaluations, events = candidate.observe()
    except InputError as error:
        return {**named(candidate), "status": f"failed: {error}", "evaluations": None}
    found = judged(motion)
    stable = found.is_finite and found.position <= FURTHEST * travel
    return {
        **named(candidate),
        "status": "ok" if stable else "unstable",
        **(_errors_of(found) if stable else dict.fromkeys(_errors_of(found))),
        "evaluations": evaluations,
        "evaluations_per_period": evaluations / holds,
        "events": events,
    }


def orders_of(
    tried: Sequence[Candidate], rows: Sequence[Row], travel: float, declared: Callable[[str], int | None]
) -> list[Row]:
    """Return the order of every method with a step.

    Args:
        tried: Every setting.
        rows: Results for these settings so far.
        travel: Travel of the reference [m or rad].
        declared: Method -> its order on this scene; None for exact.
    """
    found = []
    for method in dict.fromkeys(candidate.method for candidate in tried):
        own = [
            (candidate.size, row["position_error"])
            for candidate, row in zip(tried, rows, strict=False)
            if candidate.method == method and candidate.size is not None and row["status"] == "ok"
            and (candidate.accuracy is None or candidate.accuracy.event_bits == _most_bits(tried))
        ]  # fmt: skip
        sizes, errors = [size for size, _ in own if size], [error for _, error in own]
        if len(set(sizes)) > 1:
            fitted = fitted_order(sizes, errors, travel)
            found.append({"method": method, "declared": declared(method), "fitted": fitted})
    return found


def _most_bits(found: Sequence[Candidate]) -> int:
    return max(candidate.accuracy.event_bits for candidate in found if candidate.accuracy is not None)


def named(candidate: Candidate) -> Row:
    """Return the name of a setting."""
    accuracy = candidate.accuracy
    return {
        "method": candidate.method,
        "setting": candidate.setting,
        "accuracy": accuracy and {"event_bits": accuracy.event_bits, "substeps": accuracy.substeps},
    }


def _errors_of(found: MotionError) -> Row:
    """Return the columns of the errors."""
    return {"position_error": found.position, "force_error": found.force, "energy_error": found.energy}


_GROUP_SUBSTEPS: Final = (1, 2, 4, 8, 16, 32)
_REFERENCE: Final = 1e-12
_RUNGE_KUTTA: Final = (1, 2, 4, 8)


def group_side(scene: Scene, holds: int, stop: Callable[[], bool]) -> "Plants":
    """Return the plant side of the one group of a scene; arguments as for `PlantSide`.

    Raises:
        InputError: The loop of the scene does not run to its end, or there are no equations to compare with.
    """
    run = render_group("python", finely_solved(scene), holds + 1)
    if run.ended:
        raise InputError(f"{scene.source}: the loop {run.ended} before its end ({run.reason}); nothing can be compared")
    torques = run.torque[1:]
    return _Mechanism(scene, torques, stop) if scene.mechanisms else _OwnPlants(scene, torques, stop)


class _OwnPlants:
    """Separate plants of the axes of a group; see `PlantSide`."""

    def __init__(self, scene: Scene, torques: Array, stop: Callable[[], bool]) -> None:
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
    """Return a rung on every plant; our own setting names only the parts that matter to one of them."""
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
        settings = _GROUP_SUBSTEPS if self._order else (1,)
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
            self.rows.append(_row_of(candidate, self._judged, self.travel, len(self.torques)))

    def measure_effects(self, accuracy: AccuracyParameters) -> Iterator[str]:
        """Yield nothing: a mechanism has no effects."""
        return iter(())

    def orders(self) -> list[Row]:
        """Return the order of every method with a step, declared and as fitted to this very scene."""
        declared: Mapping[str, int | None] = {OURS: self._order, "RK4": 1 if self._switches else 4}
        return orders_of(self.candidates, self.rows, self.travel, lambda method: declared.get(method))

    def _judged(self, motion: Motion) -> MotionError:
        """Return the largest differences from the reference at the end of any hold."""
        exact, period = self._exact, self.scene.bus.sample_time
        with np.errstate(all="ignore"):
            apart = np.einsum("kij,kj->ki", self._inertia, motion.velocity - exact.velocity)
            kicks = np.diff(apart, axis=0, prepend=np.zeros((1, apart.shape[1]))) / period
            works = (motion.motor - exact.motor, motion.user - exact.user, self._kinetic(motion) - self._kinetic(exact))
            found = [motion.position - exact.position, kicks, np.array(works)]
        largest = [float(np.abs(values).max()) if np.isfinite(values).all() else math.inf for values in found]
        return MotionError(*largest)

    def _kinetic(self, motion: Motion) -> Array:
        return np.asarray(0.5 * np.einsum("ki,kij,kj->k", motion.velocity, self._inertia, motion.velocity))

    def _ours(self, substeps: int) -> Candidate:
        mechanisms = tuple(replace(of, substeps=substeps) for of in self.scene.mechanisms)
        scene = replace(self.scene, mechanisms=mechanisms)
        axes = [scene.axis(name) for name in scene.groups[0].axes]
        accuracy = AccuracyParameters(substeps=substeps)

        def run(look: Callable[[Motors], object]) -> tuple[list[Any], int]:
            motors, period, found = Motors(scene, axes), scene.bus.sample_time_ns, []
            for k, torques in enumerate(self.torques.tolist()):
                motors.advance_to((k + 1) * period, tuple(torques))
                found.append(look(motors))
            return found, motors.evaluations() or len(found)

        def observe() -> tuple[Motion, int, int]:
            table, evaluations = run(lambda m: (m.positions(), m.velocities(), *m.works()))
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

    def _solved(self, model: ReferenceGroup, method: str, rtol: float) -> Motion:
        """Return the motion by one of scipy's solvers, hold by hold; errors as for `located_states`."""
        period = self.scene.bus.sample_time_ns
        states = located_states(model, self.torques.tolist(), period, method, rtol, 1e-3 * rtol, self.stop)
        return _motion_of(model, states)


Plants = PlantSide | _OwnPlants | _Mechanism
"""The plant side of a study."""


def _motion_of(model: ReferenceGroup, states: Sequence[Any]) -> Motion:
    works = np.array([model.works(state) for state in states])
    positions = np.array([model.positions(state) for state in states])
    velocities = np.array([model.velocities(state) for state in states])
    return Motion(positions, velocities, works[:, 0], works[:, 1])
