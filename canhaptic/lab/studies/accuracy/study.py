"""The accuracy study of one axis or group: references, errors and times of plant and loop, and advice.

torques of the scene's own controller -> every method, every setting, every effect left out   against DOP853
every rate, delay, algorithm, filter and resolution                                           against the continuous run

A stopped study keeps its rows. A study takes a limited time of the processor: what is left when a part has used its
share is a row that says so, and a reference that is too dear is computed for fewer holds. See `timing` for the times.

`with_chosen_accuracy` is `accuracy: auto`: the cheapest accuracy of a simulated plant that keeps its position within
a tolerance. The controller of the scene is run once on a finely solved plant. Under the torques of that run, settings
from coarse to fine are compared with a reference solution by DOP853 with event location (`canhaptic.lab.judge`). The
setting with the fewest matrix-vector products wins; their number is the same on every machine.
"""

import itertools
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, replace
from functools import partial
from operator import itemgetter
from typing import Any, Final

from canhaptic.drive.clock import ProcessorClock
from canhaptic.drive.profile.causality import IMPEDANCE
from canhaptic.errors import CanHapticError, InputError
from canhaptic.lab.batch import Engine
from canhaptic.lab.judge.solvers import NotSolvedError
from canhaptic.lab.loop.axis_loop import LoopRun, microseconds_per_step
from canhaptic.lab.reference import continuous_motion
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.accuracy import loop_sensitivity, plant_solvers, timing
from canhaptic.lab.studies.accuracy.accuracy_table import advice, error_per_microsecond, pareto, rank_agreement
from canhaptic.lab.studies.accuracy.ideal_loop import IdealStudy
from canhaptic.lab.studies.accuracy.studied_port import PortStudy, first_rows, length_of, now, require_own_axis, studied
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.sim.plant import AccuracyParameters

DEFAULT_BUDGET: Final = 4.0
"""Time of the processor for the timings of plants [s], in addition to the runs for errors."""
_ENDS: Final = {"others": 5.0, "own": 7.5, "effects": 8.0, "continuous": 10.0, "loops": 11.0,
               "times": 16.0}  # fmt: skip
"""Time of the processor after which a part of the study ends, with the default budget [s]; a larger one has more."""
_SHARES: Final = {"references": (0.0, 0.2), "ladder": (0.2, 0.25), "loops": (0.45, 0.25), "times": (0.7, 0.3)}
"""Part of the study -> begin and length of its share of the progress bar."""
_BEFORE: Final = 0.5
"""Part of the references' share of the progress bar that a single reference may fill."""
_TENTH: Final = 0.1
_REPEATS: Final = 3


def study_accuracy(
    scene: Scene,
    axis: str | None = None,
    *,
    duration: float | None = None,
    progress: Callable[[int], None] | None = None,
    stop: loop_sensitivity.Stop = lambda: False,
    **options: Any,
) -> Row:
    """Return the study of an axis, a group or an admittance display of a scene, as plain values.

    Args:
        scene: Simulated scene.
        axis: Name of an axis or a group; the first axis by default, or its group.
        duration: Length of the comparison [s]; see `length_of`.
        progress: Called with the number of units done, of `UNITS`.
        stop: Polled often; true stops the study, which then returns the results so far.
        options: Further options of `AccuracyStudy`.

    Raises:
        InputError: No axis or group has this name, or it is not simulated.
    """
    if studied(scene, axis).ports[0].causality is not IMPEDANCE:
        return IdealStudy(scene, axis, duration=duration, progress=progress, stop=stop).run()
    chosen = length_of(scene, axis, duration)
    return AccuracyStudy(
        chosen.scene, axis, duration=chosen.holds * scene.bus.sample_time, judged=chosen.remark, progress=progress,
        stop=stop, **options,
    ).run()  # fmt: skip


@dataclass
class AccuracyStudy(PortStudy):
    """Study of an axis or a group: its plant, its loop against the continuous one, and the times of both.

    Args:
        scene: See `PortStudy`.
        axis: See `PortStudy`.
        duration: See `PortStudy`.
        progress: See `PortStudy`.
        stop: See `PortStudy`.
        tolerance: Largest error of the position [m or rad]; by default from the scene's `accuracy: {auto: ...}`,
            else a tenth of an encoder count.
        budget: Time of the processor for timings [s]; 0 for none.
        engine: Engine of the loops; "auto" compiles them where that is worthwhile.
        judged: Remark from `length_of`.
        say: Called with each of the first rows, which need no reference, as soon as it is ready.
    """

    _: KW_ONLY
    tolerance: float | None = None
    budget: float = DEFAULT_BUDGET
    engine: Engine = "auto"
    judged: str = ""
    say: Callable[[str], None] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        counts = max(abs(axis.parameters.counts_per_unit) for axis in self.alone.axes)
        self._tolerance = self.tolerance or self.scene.accuracy_tolerance or _TENTH / counts
        self._plant: plant_solvers.Plants | None = None
        self._loops: list[tuple[loop_sensitivity.Variant, LoopRun]] = []
        self._times: dict[str, timing.ProcessorTime] = {}
        self._run_price: timing.RunPrice | None = None
        self._remarks: list[str] = []
        self._clock = ProcessorClock()
        self._begin = self._clock.now()

    def _measure(self) -> None:
        if self.say is not None:
            for row in first_rows(self.alone, self.holds):
                self._check()
                self.say(row)
        try:
            self._measure_plant()
        except NotSolvedError as error:
            self._remark(f"the plant is compared with nothing: {error}")
        try:
            self._measure_loops()
        except NotSolvedError as error:
            self._remark(f"the loop is compared with nothing: {error}")
        if self.budget > 0.0:
            self._time()

    def _measure_plant(self) -> None:
        """Run the ladder of settings and methods, and the plant without each effect."""
        plant = plant_solvers.plants_of(self.alone, self.holds, self._counted_stop("references"))
        if len(plant.torques) < self.holds:
            self._remark(
                f"left out: all but the first {len(plant.torques)} of {self.holds} sample times, whose reference took "
                f"{plant.evaluations} evaluations"
            )
            self.holds = len(plant.torques)
        self._plant = plant
        for number, _name in enumerate(plant.measure(lambda is_own: self._is_over("own" if is_own else "others"))):
            self._check()
            self._advance("ladder", min(1.0, number / len(plant.candidates)))  # every plant of a group runs each
        if skipped := sum(row["status"] == plant_solvers.LEFT_OUT for row in plant.rows):
            self._remark(f"left out: {skipped} of {len(plant.rows)} settings and methods of the plant, for their time")
        found = advice(plant.rows, [], self._tolerance)
        chosen = found["chosen"] or found["most_exact"] or {"accuracy": {}}  # the advised one, else the most exact
        for name in plant.measure_effects(AccuracyParameters(**chosen["accuracy"])):
            self._check()
            if self._is_over("effects"):
                self._remark(f"left out: the plant {name}, and what follows, for their time")
                break

    def _measure_loops(self) -> None:
        """Run the loop with each change."""
        period = self.scene.bus.sample_time_ns
        step, steps = period // loop_sensitivity.FINEST, self.holds * loop_sensitivity.FINEST
        asked = self._counted_stop("loops")

        def stop() -> bool:
            if self._is_over("continuous"):
                raise NotSolvedError("its reference takes too long; left out (a larger --budget includes it)")
            return asked()

        exact = continuous_motion(self.alone, step, steps, stop)
        every = loop_sensitivity.variants(self.alone, self.scene, self._remark)
        engines = loop_sensitivity.engines_of(every, self.holds * period, self.engine)
        for number, (variant, engine) in enumerate(zip(every, engines, strict=True)):
            if number and self._is_over("loops"):
                self._remark(f"left out: {len(every) - number} of {len(every)} changes of the loop, for their time")
                return
            whole = self.scene, exact, step, self.holds * period
            row, run = loop_sensitivity.loop_row(variant, *whole, self._check, engine)
            self._loops.append((variant, run))
            self._rows.append(row)
            self._advance("loops", (number + 1) / len(every))

    def _left(self, part: str) -> float:
        """Return the time of the processor that is left until a part ends [s]."""
        return _ENDS[part] * max(1.0, self.budget / DEFAULT_BUDGET) - (self._clock.now() - self._begin) * 1e-9

    def _is_over(self, part: str) -> bool:
        return self._left(part) < 0.0

    def _remark(self, text: str) -> None:
        self._remarks.append(text)
        if self.say is not None:
            self.say(text)

    def _counted_stop(self, part: str) -> loop_sensitivity.Stop:
        """Return a `stop` that also advances the bar by ever smaller steps, for a reference without progress."""
        asked = itertools.count(1)

        def stop() -> bool:
            times = next(asked)
            self._advance(part, _BEFORE * times / (times + self.holds))
            return self.stop()

        return stop

    def _advance(self, part: str, share: float, begin: float = 0.0) -> None:
        before, length = _SHARES[part]
        self._reach(before + length * min(1.0, begin + share))

    def _time(self) -> None:
        budget = min(self.budget, max(0.25 * self.budget, self._left("times")))  # a loop was compiled for long
        own: dict[str, Callable[[], object]] = {timing.WORKLOAD: timing.workload}
        others: dict[str, Callable[[], object]] = {}
        if plant := self._plant:
            pairs = zip(plant.candidates, plant.rows, strict=False)
            stable = sorted(
                ((row["evaluations"], of.name, of) for of, row in pairs if row["status"] == "ok"), key=itemgetter(0)
            )
            own |= {name: of.spend for _, name, of in stable if of.method == plant_solvers.OURS}
            own |= {f"without {name}": candidate.spend for name, candidate in plant.without.items()}
            others = {name: of.spend for _, name, of in stable if of.method != plant_solvers.OURS}
        for begin, jobs in ((0.0, own), (0.45, others)):  # a method that takes long leaves ours their repeats
            advance = partial(self._advance, "times", begin=begin)
            self._times |= timing.interleaved(jobs, 0.5 * budget, self.stop, advance)
        self._check()
        cases = {str(i): (variant, run) for i, (variant, run) in enumerate(self._loops) if run.torque.any()}
        each = microseconds_per_step(cases, _REPEATS, 0.5 * budget)
        try:
            exchange = timing.exchange_time(self.scene, self.holds)
            self._run_price = timing.run_price(self.scene, self.holds)
        except CanHapticError as error:
            exchange = None
            self._remark(f"the cycle was not timed: {error}")
        for index, row in enumerate(self._rows):
            step = each.get(str(index))
            row["controller_us"] = step
            row["control_thread_us"] = thread = None if step is None or exchange is None else step + exchange
            row["thread_share"] = None if thread is None else thread * 1e-6 * row["rate"]
        self._advance("times", 1.0)

    def result(self) -> Row:
        """Return all results so far, as plain values."""
        bus, plant, is_group = self.scene.bus, self._plant, bool(self.alone.groups)
        moved = (of.mechanism.name for of in self.alone.mechanisms)
        work = self._times.get(timing.WORKLOAD)
        rows, orders = ([], []) if plant is None else (self._plant_rows(plant), plant.orders())
        return {
            "scene": self.scene.source,
            "config_hash": self.scene.config_hash(),
            "axis": self.alone.ports[0].name,
            "is_group": is_group,
            "unit": self.alone.axes[0].parameters.unit,
            "status": self._status,
            "rate": 1.0 / bus.sample_time,
            "holds": self.holds,
            "duration": self.holds * bus.sample_time,
            "tolerance": self._tolerance,
            "now": now(self.alone),
            "judged": self.judged,
            "workload": work and {"what": timing.WORKLOAD, "seconds": work.least, "spread": work.spread},
            "log_us": self._run_price and self._run_price.log,
            "run_us": self._run_price and self._run_price.cycle,
            "run_share": self._run_price and self._run_price.cycle * 1e-6 / bus.sample_time,
            "remarks": [
                *self._remarks,
                *(f"Euler and midpoint methods: not run on a {name}" for name in moved if plant),
            ],
            "reference": plant and self._reference(plant, rows),
            "plant": rows,
            "orders": orders,
            "loop": self._rows,
            "advice": None
            if plant is None or self._status == "stopped"
            else advice(rows, self._effect_rows(plant), self._tolerance, orders),
        }

    def _reference(self, plant: plant_solvers.Plants, rows: list[Row]) -> Row:
        known = (row for row in rows if row["setting"] == "tolerance 1e-09" and row.get("position_error") is not None)
        witness = next((row for row in known if row["method"] == plant_solvers.LSODA), None)
        timed = [row for row in rows if row.get("us_per_period") is not None]
        prices = ([row[key] for row in timed] for key in ("evaluations", "us_per_period"))
        return {
            "method": "DOP853, events located, relative tolerance 1e-12",
            "evaluations": plant.evaluations,
            "travel": plant.travel,
            "energy": plant.energy,
            "witness": witness
            and {"method": "LSODA, events located, tolerance 1e-9", "apart": witness["position_error"]},
            "rank_agreement": rank_agreement(*prices),
        }

    def _plant_rows(self, plant: plant_solvers.Plants) -> list[Row]:
        rows = [{**row, **self._price(f"{row['method']}, {row['setting']}")} for row in plant.rows]
        for price, key in (("evaluations", "pareto"), ("us_per_period", "pareto_in_time")):
            for row, mark in zip(rows, pareto(rows, price, plant_solvers.FLOOR * plant.travel), strict=True):
                row[key] = mark
        return rows

    def _price(self, name: str) -> Row:
        """Return the time columns of one candidate; None where it was not timed."""
        time, fixed = self._times.get(name), self._times.get(timing.WORKLOAD)
        if time is None:
            return dict.fromkeys(("us_per_period", "cpu_per_second", "spread", "repeats", "ratio"))
        return {
            "us_per_period": time.least / self.holds * 1e6,
            "cpu_per_second": time.least / (self.holds * self.scene.bus.sample_time),
            "spread": time.spread,
            "repeats": time.repeats,
            "ratio": time.least / fixed.least if fixed else None,
        }

    def _effect_rows(self, plant: plant_solvers.Plants) -> list[Row]:
        """Return the effects with their times; "AXIS: EFFECT" of a group is compared with the unchanged axis."""
        rows = []
        for row in plant.effects:
            whole, _, _ = row["effect"].rpartition(" ")
            base, mine = (self._times.get(f"without {name}") for name in (whole, row["effect"]))
            saved = timing.saving(base, mine)
            saved = saved if saved is None else saved / self.holds * 1e6
            error = row.get("position_error")
            worth = None if error is None else error_per_microsecond(error, saved)
            rows.append({**row, "us_saved_per_period": saved, "error_per_microsecond": worth})
        return rows


def with_chosen_accuracy(scene: Scene) -> Scene:
    """Return the scene with a chosen accuracy for every simulated plant; a scene without `auto` is unchanged.

    Raises:
        InputError: scipy is missing, or no setting keeps the tolerance.
    """
    if scene.accuracy_tolerance is None or scene.accuracy_choices or scene.simulation is None:
        return scene
    axes, choices, holds = [], {}, loop_sensitivity.holds_of(scene)
    for axis in scene.axes:
        require_own_axis(axis, scene)
        chosen, simulation = choose(axis, scene, scene.accuracy_tolerance), simulation_of(axis)
        accuracy = simulation.accuracy.model_copy(update=chosen["accuracy"])
        axes.append(replace(axis, simulation=replace(simulation, accuracy=accuracy)))
        choices[axis.parameters.name] = {
            "tolerance": scene.accuracy_tolerance,
            "holds": holds,
            **{key: chosen[key] for key in ("position_error", "force_error", "energy_error")},
            "products_per_period": chosen["evaluations_per_period"],
        }
    return replace(scene, axes=tuple(axes), accuracy_choices=choices)


def choose(axis: AxisScene, scene: Scene, tolerance: float) -> Row:
    """Return the row of the cheapest accuracy that keeps the position of one axis within a tolerance [m or rad].

    Raises:
        InputError: scipy is missing, no setting keeps the tolerance, or the errors do not fall as declared.
    """
    settings = plant_solvers.ladder(simulation_of(axis), scene.bus.sample_time_ns)
    side = plant_solvers.PlantSide(axis, scene, loop_sensitivity.holds_of(scene), lambda: False, settings=settings)
    side.candidates = [candidate for candidate in side.candidates if candidate.method == plant_solvers.OURS]
    list(side.measure())
    found = advice(side.rows, [], tolerance, side.orders())
    where = f"{scene.source}: accuracy: auto of axis {axis.parameters.name}"
    if found["doubt"]:
        raise InputError(f"{where}: {found['doubt']} instead of auto")
    if found["chosen"] is None:
        finest = side.rows[-1]["position_error"]
        raise InputError(
            f"{where} with tolerance {tolerance:g}: the finest setting "
            + ("is unstable" if finest is None else f"errs by {finest:.2g} in position")
            + "; allow at least that, or a higher rate"
        )
    chosen: Row = found["chosen"]
    return chosen
