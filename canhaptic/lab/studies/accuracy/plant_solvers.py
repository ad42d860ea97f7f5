"""Accuracy and cost of the methods to compute a plant, under the torques of the scene's own controller.

A ladder of methods and settings is compared with a reference: the settings of `sim.plant`, fixed-step methods, LSODA.
Every effect of the scene is also left out in turn. The cost, equal on every machine, is the number of evaluations of
the equations of motion: trial matrix-vector products of `sim.plant`, right-hand sides of the textbook methods (with the
evaluations of forces for a guard). The study reports how well it ranks the methods by time.

In a group, motors with separate plants are compared one by one, and a setting is as good as for the worst of them; a
mechanism is compared with its equations of motion, solved by DOP853.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Final
from warnings import catch_warnings

import numpy as np

from canhaptic.axis_units import counted
from canhaptic.errors import InputError, ParameterError
from canhaptic.lab.batch.object_loop import Motors, motors_of
from canhaptic.lab.batch.scalar import render
from canhaptic.lab.judge import solvers
from canhaptic.lab.judge.reference_group import ReferenceMechanism
from canhaptic.lab.judge.reference_model import Model, MotionError, difference, largest_error
from canhaptic.lab.reference import mechanism_of, textbook_model
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.accuracy.loop_sensitivity import Stop, finely_solved
from canhaptic.scene.far_side import build_plant
from canhaptic.scene.method import declared_order, simulation_of, torque_history
from canhaptic.scene.models import AxisScene, AxisSimulation, Scene
from canhaptic.sim.plant import AccuracyParameters
from canhaptic.sim.plant.direct_rig import Motion, observed
from canhaptic.sim.plant.plant import Plant
from canhaptic.sim.plant.propagator import Array

OURS: Final = "canhaptic"
LSODA: Final = "LSODA, located"
FLOOR: Final = 2e-13
"""Fraction of the travel below which errors count as equal, because they may come from the reference or rounding."""
FURTHEST: Final = 1.0
"""Error of the position, as a multiple of the travel, from which a method counts as unstable."""
_CEILING: Final = 3e-2
"""Fraction of the travel above which errors do not yet show the order of a method."""
_BITS: Final = (4, 8, 12, 16, 20, 24)
_FEW_BITS: Final = (8, 16, 24)
"""Event bits that are tried if substeps are to be chosen too."""
_OUR_SUBSTEPS: Final = (1, 2, 4, 8, 16, 32)
_SUBSTEPS: Final = (1, 2, 4, 8, 16)
_RUNGE_KUTTA: Final = (1, 2, 4, 8)
_TOLERANCES: Final = (1e-3, 1e-5, 1e-7, 1e-9)
_ABSOLUTE: Final = 1e-3
"""Ratio of the absolute to the relative tolerance."""
_MOST_WORK: Final = 130_000
"""Largest number of evaluations of a fixed-step method in one run; finer settings are left out."""
_MOST_OF_REFERENCE: Final = 200_000
"""Evaluations of the reference, 2 to 5 s, after which it is computed for no further hold."""
_TIMES_OURS: Final = 100
"""A method of a textbook is cut when it needs so many times the evaluations of the package's own solver."""
LEFT_OUT: Final = "left out"
"""Status of a candidate for which no time was left."""
_WORK: Final = {"semi-implicit Euler": 1, "implicit midpoint": 8, "RK4": 4}
"""Approximate number of right-hand sides per step."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """One method to compute the plant, at one setting.

    Attributes:
        method: Name of the method.
        setting: Setting that distinguishes it from others of the same method.
        size: Relative step size, for fitting the order; None for a method without a step.
        order: Order of the method on this plant; None for exact and adaptive methods.
        accuracy: Accuracy as in a scene; None for a setting that no scene can express.
        observe: Function that runs the method and returns motion, evaluations and events.
        spend: Function that runs the method for timing only.
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
        """Name of method and setting, for tables."""
        return f"{self.method}, {self.setting}"


def ladder(simulation: AxisSimulation, sample_time_ns: int) -> list[AccuracyParameters]:
    """Return every accuracy that makes a difference for this plant, from coarse to fine."""
    plant = build_plant(simulation, sample_time_ns)
    bits: Sequence[int] = (24,)
    if any(part.has_guards for part in plant.scene.parts):
        bits = _BITS if plant.is_exact else _FEW_BITS
    most, substeps = simulation.accuracy.max_events, (1,) if plant.is_exact else _OUR_SUBSTEPS
    return [AccuracyParameters(event_bits=b, substeps=s, max_events=most) for s in substeps for b in bits]


def own_ladder(simulation: AxisSimulation, sample_time_ns: int) -> list[AccuracyParameters]:
    """Return every accuracy that makes a difference for this plant, and the scene's own."""
    found, now = ladder(simulation, sample_time_ns), own_setting(simulation, sample_time_ns)
    return found if now in found else [now, *found]


def own_setting(simulation: AxisSimulation, sample_time_ns: int) -> AccuracyParameters:
    """Return the accuracy of a scene, with defaults for the values that make no difference for this plant."""
    found, now = ladder(simulation, sample_time_ns), simulation.accuracy
    useless = (key for key in ("event_bits", "substeps") if len({getattr(of, key) for of in found}) == 1)
    return now.model_copy(update={key: getattr(found[0], key) for key in useless})


def ours(
    simulation: AxisSimulation, accuracy: AccuracyParameters, torques: Sequence[float], sample_time_ns: int
) -> Candidate:
    """Return the package's own plant solver at one accuracy, as a candidate."""
    solved = replace(simulation, accuracy=accuracy)
    kept = build_plant(solved, sample_time_ns)

    def spend() -> None:  # with the computing of its modes
        stepped(build_plant(solved, sample_time_ns), torques)

    def observe() -> tuple[Motion, int, int]:
        plant = build_plant(solved, sample_time_ns)
        return observed(plant, torques), plant.products, plant.events

    size, order, setting = 1.0 / accuracy.substeps, declared_order(simulation), _setting_of(accuracy, kept)
    return Candidate(OURS, setting, size, order, accuracy, observe, spend)


def _setting_of(accuracy: AccuracyParameters, plant: Plant) -> str:
    """Return the values of an accuracy that make a difference for a plant."""
    words = []
    if any(part.has_guards for part in plant.scene.parts):
        words.append(f"{accuracy.event_bits} bits")
    if not plant.is_exact:
        words.append(counted(accuracy.substeps, "substep"))
    return ", ".join(words) or "exact"


def stepped(plant: Plant, torques: Sequence[float]) -> None:
    """Move a plant from its start by one call per hold, like a drive."""
    plant.begin(0)
    move, period, now = plant.advance_to, plant.sample_time_ns, 0
    for torque in torques:
        now += period
        move(now, torque)


class Plants:
    """Plants under recorded torques: their reference, the ladder, and the results so far.

    Attributes:
        torques: Torque of each hold [N or N*m]; of a mechanism one for each motor.
        evaluations: Evaluations of the reference.
        travel: Travel of the reference [m or rad].
        energy: Largest work or kinetic energy of the reference [J].
        candidates: Methods and settings to measure.
        rows: Results so far, one per candidate.
        effects: Results so far, one per effect of the scene.
        without: Plants without one effect each, and the unchanged plants, by name.
        cut: Evaluations after which an adaptive method is cut.
    """

    torques: Any
    evaluations: int
    travel: float
    energy: float
    candidates: list[Candidate]

    def __init__(self) -> None:
        self.rows: list[Row] = []
        self.effects: list[Row] = []
        self.without: dict[str, Candidate] = {}
        self.cut = math.inf

    def measure(self, is_over: Callable[[bool], bool] = lambda _is_own: False) -> Iterator[str]:
        """Run every candidate once for its errors and evaluations; yield the name of each before it is run.

        Args:
            is_over: Asked before each run, with whether it is one of the package's own; true leaves it out.
        """
        for candidate in self.candidates:
            yield candidate.name
            if is_over(candidate.method == OURS):
                self.rows.append({**_named(candidate), "status": LEFT_OUT, "evaluations": None})
            else:
                self.rows.append(_row_of(candidate, self._judged, self.travel, len(self.torques)))
            spent = [row["evaluations"] for row in self.rows if row["method"] == OURS and row["evaluations"]]
            self.cut = _TIMES_OURS * max(spent, default=len(self.torques))

    def measure_effects(self, accuracy: AccuracyParameters) -> Iterator[str]:
        """Run the plant without each effect at the chosen accuracy; yield the name of each before it is run.

        Args:
            accuracy: Accuracy at which the effects are timed.
        """
        return iter(())

    def orders(self) -> list[Row]:
        """Return the declared order of every method with a step, and the order fitted to this scene."""
        found, most = [], max(of.accuracy.event_bits for of in self.candidates if of.accuracy is not None)
        for method in dict.fromkeys(candidate.method for candidate in self.candidates):
            own = [
                (candidate, row["position_error"])
                for candidate, row in zip(self.candidates, self.rows, strict=False)
                if candidate.method == method and candidate.size is not None and row["status"] == "ok"
                and (candidate.accuracy is None or candidate.accuracy.event_bits == most)
            ]  # fmt: skip
            sizes, errors = [of.size for of, _ in own if of.size], [error for _, error in own]
            if len(set(sizes)) > 1:
                fitted = fitted_order(sizes, errors, self.travel)
                found.append({"method": method, "declared": own[0][0].order, "fitted": fitted})
        return found

    def _judged(self, motion: Motion) -> MotionError:
        """Return the largest differences from the reference at the end of any hold."""
        raise NotImplementedError


def fitted_order(sizes: Sequence[float], errors: Sequence[float], travel: float) -> float | None:
    """Return the slope of log error over log size between the coarsest and the finest significant error.

    Args:
        sizes: Sizes of the steps, relative.
        errors: Errors of the position [m or rad].
        travel: Travel of the reference [m or rad].
    """
    pairs = zip(sizes, errors, strict=True)
    points = [(size, error) for size, error in pairs if FLOOR * travel < error < _CEILING * travel]
    if len({size for size, _ in points}) < 2:
        return None
    x, y = np.log(points).T
    return float(np.polyfit(x, y, 1)[0])


class _Solved(Plants):
    """One plant, or one mechanism, and the solvers of its textbook equations.

    Args:
        make: Sets up the equations.
        torques: Torque of each hold [N or N*m]; of a mechanism one for each motor.
        period: Length of a hold [ns].
        stop: Polled regularly; true aborts.
        most: Evaluations of the reference after which it is computed for no further hold.
    """

    def __init__(
        self, make: Callable[[], Model | ReferenceMechanism], torques: Sequence[Any], period: int, stop: Stop,
        most: float,
    ) -> None:  # fmt: skip
        super().__init__()
        self._make, self._period, model = make, period, make()
        self.exact: Motion = solvers.reference(model, torques, period, stop, most)
        self.torques = torques[: len(self.exact.position)]
        self.evaluations, self._switches = model.evaluations, model.switches
        self.travel = max(float(np.ptp(self.exact.position, axis=0).max()), 1e-9)
        works = (self.exact.motor, self.exact.user, self._kinetic(self.exact))
        self.energy = max(float(np.abs(work).max()) for work in works)

    def _kinetic(self, motion: Motion) -> Array:
        """Return the kinetic energy at the end of each hold [J]."""
        raise NotImplementedError

    def _textbook(
        self, method: str, setting: str, solve: Callable[..., Motion], substeps: int | None = None
    ) -> Candidate:
        """Return a textbook method; the equations are set up again for every run."""

        def run() -> tuple[Motion, int, int]:
            model = self._make()
            motion = solve(model)
            return motion, model.evaluations, 0

        order = None if substeps is None else 1 if self._switches else solvers.METHODS[method][0]
        return Candidate(method, setting, substeps and 1.0 / substeps, order, None, run, run)

    def _fixed(self, method: str, substeps: int) -> Candidate:
        def solve(model: solvers.MovedModel) -> Motion:
            return solvers.fixed_step(model, self.torques, self._period, solvers.METHODS[method][1](), substeps)

        return self._textbook(method, counted(substeps, "step"), solve, substeps)

    def _adaptive(self) -> list[Candidate]:
        def solve(tolerance: float, model: solvers.MovedModel) -> Motion:
            asked = self._period, "LSODA", tolerance, tolerance * _ABSOLUTE
            motion = solvers.located(model, self.torques, *asked, most=self.cut)
            if len(motion.position) < len(self.torques):
                raise InputError(f"needs more than {_TIMES_OURS} times our evaluations")
            return motion

        return [self._textbook(LSODA, f"tolerance {t:.0e}", partial(solve, t)) for t in _TOLERANCES]


class PlantSide(_Solved):
    """Methods to compute the plant of one axis under recorded torques, and their results.

    Args:
        axis: Simulated axis.
        scene: Scene of the axis.
        holds: Number of holds.
        stop: Polled regularly; true aborts.
        torques: Torque of each hold [N or N*m]; None: from the scene's own controller.
        settings: Settings to try; None: every one that makes a difference for this plant.
        most: Evaluations of the reference after which it is computed for no further hold.
    """

    def __init__(
        self, axis: AxisScene, scene: Scene, holds: int, stop: Stop, *, torques: Sequence[float] | None = None,
        settings: Sequence[AccuracyParameters] | None = None, most: float = math.inf,
    ) -> None:  # fmt: skip
        self._simulation, period = simulation_of(axis), scene.bus.sample_time_ns
        held = torque_history(axis, scene, holds) if torques is None else torques
        super().__init__(partial(textbook_model, self._simulation), held, period, stop, most)
        settings, held = settings or own_ladder(self._simulation, period), self.torques
        self.candidates = [ours(self._simulation, of, held, period) for of in settings]
        for method in solvers.METHODS:
            work = _WORK[method] * len(held)
            self.candidates += [self._fixed(method, n) for n in _SUBSTEPS if n * work <= _MOST_WORK]
        self.candidates += self._adaptive()

    def _kinetic(self, motion: Motion) -> Array:
        return np.asarray(0.5 * self._simulation.plant.mass * motion.velocity**2)

    def _judged(self, motion: Motion) -> MotionError:
        return difference(motion, self.exact, self._simulation.plant.mass, self._period * 1e-9)

    def measure_effects(self, accuracy: AccuracyParameters) -> Iterator[str]:
        """See `Plants.measure_effects`."""
        names = list(dict.fromkeys(effect.name for effect in self._simulation.effects))
        if not names:
            return
        self.without[""] = whole = ours(self._simulation, accuracy, self.torques, self._period)
        motion, evaluations, _ = whole.observe()
        for name in names:
            yield f"without {name}"
            self.effects.append(self._effect_row(name, accuracy, motion, evaluations))

    def _effect_row(self, name: str, accuracy: AccuracyParameters, whole: Motion, base: int) -> Row:
        """Return the change by leaving an effect out at one accuracy, without the error of the method."""
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
        """Return the plant without an effect, what was left out, or the reason why the effect cannot be left out.

        An effect that another needs, like the shaft of a backlash, is left out together with the other.
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


def _row_of(candidate: Candidate, judged: Callable[[Motion], MotionError], travel: float, holds: int) -> Row:
    """Return the row of a candidate, run once; its errors are None if it is unstable."""
    try:
        with catch_warnings(action="ignore", category=UserWarning):  # of LSODA, whose row says that it failed
            motion, evaluations, events = candidate.observe()
    except InputError as error:
        return {**_named(candidate), "status": f"failed: {error}", "evaluations": None}
    found = judged(motion)
    stable = found.is_finite and found.position <= FURTHEST * travel
    return {
        **_named(candidate),
        "status": "ok" if stable else "unstable",
        **(_errors_of(found) if stable else dict.fromkeys(_errors_of(found))),
        "evaluations": evaluations,
        "evaluations_per_period": evaluations / holds,
        "events": events,
    }


def _named(candidate: Candidate) -> Row:
    """Return the name of a setting."""
    accuracy = candidate.accuracy and candidate.accuracy.model_dump(include={"event_bits", "substeps"})
    return {"method": candidate.method, "setting": candidate.setting, "accuracy": accuracy}


def _errors_of(found: MotionError) -> Row:
    """Return the columns of the errors."""
    return {f"{name}_error": value for name, value in found._asdict().items()}


def plants_of(scene: Scene, holds: int, stop: Stop) -> Plants:
    """Return the plants of the only axis or group of a scene, under its recorded torques; arguments as for `PlantSide`.

    Raises:
        NotSolvedError: The loop of the scene ends early, or a solver fails.
        InputError: The group has no equations to compare with.
    """
    if not scene.groups:
        return PlantSide(scene.axes[0], scene, holds, stop, most=_MOST_OF_REFERENCE)
    run = render(finely_solved(scene), holds + 1)
    if run.ended:
        raise solvers.NotSolvedError(f"the loop {run.ended} before its end ({run.reason})")
    return (_Mechanism if scene.mechanisms else _OwnPlants)(scene, run.torque[1:], stop)


class _OwnPlants(Plants):
    """A group whose axes have separate plants."""

    def __init__(self, scene: Scene, torques: Array, stop: Stop) -> None:
        super().__init__()
        axes = scene.ports[0].axes
        ladders = [ladder(simulation_of(axis), scene.bus.sample_time_ns) for axis in axes]
        lead = max(range(len(axes)), key=lambda place: len(ladders[place]))  # names the settings
        self._names, self.torques = [axis.parameters.name for axis in axes], torques
        self._sides = [
            PlantSide(
                axis,
                scene,
                len(torques),
                stop,
                torques=column.tolist(),
                settings=ladders[lead],
                most=_MOST_OF_REFERENCE / len(axes),
            )
            for axis, column in zip(axes, torques.T, strict=True)
        ]
        shown = min(len(side.torques) for side in self._sides)
        if shown < len(torques):  # all of them over the same holds
            self.__init__(scene, torques[:shown], stop)  # type: ignore[misc]
            return
        rungs = [{_rung(candidate): candidate for candidate in side.candidates} for side in self._sides]
        self.candidates = []
        for rung, candidate in rungs[lead].items():
            every = [of[rung] for of in rungs if rung in of]
            if len(every) == len(rungs):
                order = min((of.order for of in every if of.order is not None), default=None)
                self.candidates.append(replace(candidate, order=order, spend=partial(_spend, every)))
        self.travel, self.energy = (max(getattr(side, name) for side in self._sides) for name in ("travel", "energy"))
        self.evaluations = sum(side.evaluations for side in self._sides)

    def measure(self, is_over: Callable[[bool], bool] = lambda _is_own: False) -> Iterator[str]:
        """Run every candidate once on every plant; see `Plants.measure`."""
        rows: list[dict[object, Row]] = []
        for axis, side in zip(self._names, self._sides, strict=True):
            for name in side.measure(is_over):
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


def _rung(candidate: Candidate) -> tuple[str, object]:
    """Return the key of a candidate, alike for all plants; a setting of `sim.plant` may read differently for each."""
    return candidate.method, candidate.accuracy or candidate.setting


def _spend(parts: Sequence[Candidate]) -> None:
    for part in parts:
        part.spend()


def _worst(rows: Sequence[Row]) -> Row:
    """Return one row for several plants: the largest errors, and the sum of the costs."""
    bad = next((row for row in rows if row["status"] != "ok"), None)
    if bad is not None:
        return bad
    errors = {key: max(row[key] for row in rows) for key in ("position_error", "force_error", "energy_error")}
    prices = {key: sum(row[key] for row in rows) for key in ("evaluations", "evaluations_per_period", "events")}
    return {**rows[0], **errors, **prices}


class _Mechanism(_Solved):
    """A mechanism that the motors of the group move together; its motions have a column for each motor."""

    def __init__(self, scene: Scene, torques: Array, stop: Stop) -> None:
        self._scene, order = scene, getattr(scene.mechanisms[0].mechanism.parameters, "order", None)
        super().__init__(
            partial(mechanism_of, scene), torques.tolist(), scene.bus.sample_time_ns, stop, _MOST_OF_REFERENCE
        )
        self.candidates = [self._ours(n, order) for n in (_OUR_SUBSTEPS if order else (1,))]
        self.candidates += [*(self._fixed("RK4", n) for n in _RUNGE_KUTTA), *self._adaptive()]

    @cached_property
    def _inertia(self) -> Array:
        """Inertia at the motors along the reference, shape (holds, axes, axes)."""
        model = mechanism_of(self._scene)
        return np.array([model.inertia(row) for row in self.exact.position])

    def _judged(self, motion: Motion) -> MotionError:
        exact, period = self.exact, self._scene.bus.sample_time
        with np.errstate(all="ignore"):
            apart = np.einsum("kij,kj->ki", self._inertia, motion.velocity - exact.velocity)
            kicks = np.diff(apart, axis=0, prepend=np.zeros((1, apart.shape[1]))) / period
            works = (motion.motor - exact.motor, motion.user - exact.user, self._kinetic(motion) - self._kinetic(exact))
            return largest_error(motion.position - exact.position, kicks, np.array(works))

    def _kinetic(self, motion: Motion) -> Array:
        return np.asarray(0.5 * np.einsum("ki,kij,kj->k", motion.velocity, self._inertia, motion.velocity))

    def _ours(self, substeps: int, order: int | None) -> Candidate:
        mechanisms = tuple(replace(of, substeps=substeps) for of in self._scene.mechanisms)
        scene = replace(self._scene, mechanisms=mechanisms)
        axes = scene.ports[0].axes

        def run(look: Callable[[Motors], object]) -> tuple[list[Any], int]:
            motors, found = motors_of(scene, axes), []
            for k, torques in enumerate(self.torques):
                motors.advance_to((k + 1) * self._period, tuple(torques))
                found.append(look(motors))
            return found, motors.evaluations() or len(found)

        def observe() -> tuple[Motion, int, int]:
            table, evaluations = run(lambda m: (m.positions(), m.velocities(), *m.works()))
            return Motion(*(np.array(column) for column in zip(*table, strict=True))), evaluations, 0

        setting, accuracy = counted(substeps, "substep") if order else "exact", AccuracyParameters(substeps=substeps)
        return Candidate(OURS, setting, 1.0 / substeps, order, accuracy, observe, lambda: run(lambda _motors: None))
