"""The accuracy study of one axis or group: references, errors and times of plant and loop, and advice.

torques of the scene's own controller -> every method, every setting, every effect left out   against DOP853
every rate, delay, algorithm, filter and resolution                                           against the continuous run

A stopped study keeps its rows. `exchange_time` measures a cycle of the control thread without the algorithm: frames,
checks and accounts. The rig runs in one thread with its simulated drives, whose time is measured and subtracted.
`interleaved` measures wall times that a busy machine disturbs little, as the minimum of interleaved repeats with their
spread. A fixed workload is timed with them, so that the ratios of a table hold on another machine.

`with_chosen_accuracy` is `accuracy: auto`: the cheapest accuracy of a simulated plant that keeps its position within
a tolerance. The controller of the scene is run once on a finely solved plant. Under the torques of that run, settings
from coarse to fine are compared with a reference solution by DOP853 with event location (`canhaptic.lab.judge`). The
setting with the fewest matrix-vector products wins; their number is the same on every machine.
"""

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple

import numpy as np

from canhaptic.control.balance import AT_REST, EnergyBalance
from canhaptic.cycle import Cycle, run
from canhaptic.drive.can.bus_cycle import can_buses
from canhaptic.drive.can.link import Link
from canhaptic.drive.clock import VirtualClock, WallClock
from canhaptic.drive.rig import Rig
from canhaptic.errors import InputError
from canhaptic.lab.batch import Engine
from canhaptic.lab.loop.axis_loop import able_under, microseconds_per_step, parts_of
from canhaptic.lab.reference import continuous_motion
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.accuracy import loop_sensitivity, plant_solvers
from canhaptic.lab.studies.accuracy.accuracy_table import advice, error_per_microsecond, length, pareto, rank_agreement
from canhaptic.scene.build import build, open_bus, private_channel
from canhaptic.scene.far_side import build_drive_group, build_plant
from canhaptic.scene.method import simulation_of, torque_history
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.scene.parts import build_servo_drive
from canhaptic.signals import SimulatedPeer
from canhaptic.sim.plant import AccuracyParameters
from canhaptic.sim.plant.direct_rig import observed

_CYCLES: Final = 600
_TURNS: Final = 3
_BLOCK: Final = 50
"""Cycles between two readings of the clock; only the fastest block counts, so that interruptions do not."""
_NS_PER_US: Final = 1e3


def exchange_time(scene: Scene) -> float | None:
    """Return the time of a cycle in the control thread without its algorithms [us].

    None if the scene has real drives, effects on its bus or several buses.
    """
    if not scene.simulated or scene.bus_effects is not None or len(scene.buses) != 1:
        return None
    with ExitStack() as stack:
        channel = private_channel()
        ends = [open_bus(scene.bus, channel) for _ in range(2)]
        for end in ends:
            stack.callback(end.shutdown)
        far_side = _TimedFarSide(build_drive_group(scene, ends[0]))
        link = Link(ends[1], VirtualClock([far_side]))
        drives = [build_servo_drive(axis, link, scene.bus) for axis in scene.axes]
        rig = Rig(can_buses(link, drives, scene.bus), drives, scene.bus)
        cycle = Cycle(rig, [_Idle() for _ in scene.axes])
        return _fastest_block(cycle, _CYCLES, lambda: far_side.clock.now() - far_side.spent)


def _fastest_block(cycle: Cycle, cycles: int, clock: Callable[[], int]) -> float:
    """Return the time of a cycle in the fastest block of a run [us]."""
    readings: list[int] = []

    def read(done: int) -> None:
        if done % _BLOCK == 0:
            readings.append(clock())

    run(cycle, cycles, progress=read)
    return min(after - before for before, after in itertools.pairwise(readings)) / _BLOCK / _NS_PER_US


def log_time(scene: Scene) -> float | None:
    """Return the time that writing the energy log takes in a cycle [us]; None if the scene cannot be run here.

    It is the fastest block with the log minus the fastest block without it; the two run alternately.
    """
    if not scene.simulated or scene.bus_effects is not None:
        return None
    least = [math.inf, math.inf]
    with TemporaryDirectory() as folder:
        for turn in range(2 * _TURNS):
            log = Path(folder) / f"{turn}.h5" if turn % 2 else None
            with build(replace(scene, auto_accuracy=None), energy_log=log) as experiment:
                block = _fastest_block(experiment.cycle, _CYCLES // 2, WallClock().now)
            least[turn % 2] = min(least[turn % 2], block)
    return max(0.0, least[1] - least[0])


class _TimedFarSide:
    """The simulated drives, and the time that they took [ns]."""

    def __init__(self, far_side: SimulatedPeer) -> None:
        self.clock, self.spent = WallClock(), 0
        self._far_side = far_side

    def process(self, now: int) -> None:
        """Handle everything that is due."""
        begin = self.clock.now()
        self._far_side.process(now)
        self.spent += self.clock.now() - begin

    def next_due(self) -> int:
        """Return the time of the next timer [ns]."""
        begin = self.clock.now()
        due = self._far_side.next_due()
        self.spent += self.clock.now() - begin
        return due


class _Idle:
    """A controller that does nothing."""

    def reset(self) -> None:
        """Reset nothing."""

    def sample_lost(self) -> EnergyBalance:
        """Return the balance at rest."""
        return AT_REST

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        """Return the balance at rest."""
        return AT_REST


_LEAST_REPEATS: Final = 2
_MOST_REPEATS: Final = 15
_LONG: Final = 1_000_000_000  # [ns]; what takes longer is timed once
_PRODUCTS: Final = 20_000
WORKLOAD: Final = f"{_PRODUCTS} products of a 6 x 6 matrix with a vector, called from Python"


class WallTime(NamedTuple):
    """Wall-clock time of one candidate."""

    least: float  # [s]
    spread: float  # median over least, less one
    repeats: int


def interleaved(
    candidates: Mapping[str, Callable[[], object]],
    budget: float,
    stop: Callable[[], bool],
    progress: Callable[[float], None],
) -> dict[str, WallTime]:
    """Return the wall time of each candidate; they run in turn, A B C A B C, and fast ones are repeated more often.

    Args:
        candidates: Candidates by name.
        budget: Total time, shared equally [s]; a candidate that exceeds its share is run twice, a long one once.
        stop: Polled before each run; true aborts, and the results so far are returned.
        progress: Called with the completed fraction.
    """
    clock = WallClock()
    share = round(budget * 1e9 / max(1, len(candidates)))
    done = 0
    times: dict[str, list[int]] = {name: [] for name in candidates}
    for repeat in range(_MOST_REPEATS):
        for name, candidate in candidates.items():
            taken = times[name]
            enough = repeat >= _LEAST_REPEATS and sum(taken) > share
            if stop() or enough or (taken and min(taken) > _LONG):
                continue
            start = clock.now()
            candidate()
            taken.append(clock.now() - start)
            done += 1
            progress(min(1.0, done / (_LEAST_REPEATS * len(candidates))))
    progress(1.0)
    return {name: _wall_time(of_one) for name, of_one in times.items() if of_one}


def _wall_time(times: list[int]) -> WallTime:
    least = min(times)
    return WallTime(least * 1e-9, float(np.median(times)) / max(least, 1) - 1.0, len(times))


def workload() -> None:
    """Run the fixed workload that every time is compared with."""
    matrix, state = np.eye(6) * 0.999, np.ones(6)
    product = matrix.dot
    for _ in range(_PRODUCTS):
        state = product(state)


@dataclass(frozen=True, slots=True)
class StudiedPart:
    """An axis outside groups, or a group, as the subject of a study.

    Attributes:
        name: Name of the axis or the group.
        scene: Scene of the part alone.
    """

    name: str
    scene: Scene

    def first_rows(self, holds: int) -> Iterator[str]:
        """Yield a line for each plant setting of an axis: its cost, and its difference from the finest setting."""
        if self.scene.groups:
            return
        (axis,), period = self.scene.axes, self.scene.bus.sample_time_ns
        simulation, clock = simulation_of(axis), WallClock()
        torques = torque_history(axis, self.scene, holds, simulation.accuracy)
        settings = plant_solvers.own_ladder(simulation, period)
        best = observed(build_plant(replace(simulation, accuracy=settings[-1]), period), torques).position
        for accuracy in dict.fromkeys((plant_solvers.own_setting(simulation, period), *settings)):
            rung = plant_solvers.ours(simulation, accuracy, torques, period)
            begin = clock.now()
            rung.spend()
            spent = (clock.now() - begin) / holds / _NS_PER_US
            apart = length(float(np.abs(rung.observe()[0].position - best).max()), axis.parameters.unit)
            yield f"{rung.setting}: {spent:.3g} us per period, {apart} from the finest setting"

    def now(self) -> Row:
        """Return the scene's own values of the settings that variants change, by kind of change, and its accuracy."""
        accuracy = AccuracyParameters()
        if not self.scene.groups:
            accuracy = plant_solvers.own_setting(simulation_of(self.scene.axes[0]), self.scene.bus.sample_time_ns)
        as_plain = accuracy.model_dump(include={"event_bits", "substeps"})
        return {"accuracy": as_plain, **loop_sensitivity.settings_now(self.scene)}


def chosen_part(scene: Scene, name: str | None) -> StudiedPart:
    """Return an axis or a group by name; by default the first axis, or its group.

    Raises:
        InputError: There is none of that name, or it is not simulated.
    """
    axis = next((axis for axis in scene.axes if name in (None, axis.parameters.name)), None)
    parts = parts_of(scene)
    if axis is None and name not in parts:
        raise InputError(f"{scene.source}: got axis {name!r}, expected one of: {', '.join(parts)}")
    if axis is not None and not axis.group:
        require_own_axis(axis, scene)
    chosen = str(name if axis is None else axis.group or axis.parameters.name)
    return StudiedPart(chosen, parts[chosen])


_LONGEST: Final = 4000
"""Largest number of sample times that are searched for the second contact."""
_AFTER: Final = 100
"""Number of sample times of the second contact that are compared."""
_JUDGED_WITH: Final = "unprotected"
"""Algorithm of a study if the scene's own algorithm sends no torque."""


class Length(NamedTuple):
    """The scene that an accuracy study runs, and the number of holds that it compares."""

    scene: Scene
    holds: int
    remark: str = ""  # why the scene is not the one that was given


def length_of(scene: Scene, name: str | None, duration: float | None = None) -> Length:
    """Return the length over which a scene is compared: until its second contact, unless a duration is given [s].

    If the algorithm of the scene sends no torque, the unprotected controller is used instead.
    """
    part = chosen_part(scene, name)
    if part.scene.groups:
        return Length(scene, loop_sensitivity.holds_of(scene, duration))
    most = loop_sensitivity.holds_of(scene, duration) if duration is not None else _LONGEST
    if duration is None and scene.run.duration is not None:
        most = min(_LONGEST, round(scene.run.duration / scene.bus.sample_time))
    (own,), remark = part.scene.axes, ""
    begins = _contacts(own, scene, most)
    if not begins and own.passivity.name != _JUDGED_WITH:
        axis = able_under(own, _JUDGED_WITH, scene).axis
        plain = replace(scene, axes=tuple(axis if of is own else of for of in scene.axes))
        begins = _contacts(axis, plain, most)
        if begins:
            scene, remark = plain, f"this loop gives no torque; judged with {_JUDGED_WITH}"
    if duration is not None:
        return Length(scene, most, remark)
    last = begins[1] + _AFTER if len(begins) > 1 else (begins[0] if begins else 0) + loop_sensitivity.HOLDS
    return Length(scene, min(most, last), remark)


def _contacts(axis: AxisScene, scene: Scene, holds: int) -> list[int]:
    """Return the sample times at which the torque of an axis begins."""
    torques = torque_history(axis, scene, holds, simulation_of(axis).accuracy)
    return [k for k, torque in enumerate(torques) if torque and not (k and torques[k - 1])]


DEFAULT_BUDGET: Final = 4.0
"""Time for the timings of plants [s], in addition to the runs for errors."""
UNITS: Final = 1000
"""Units of progress in the whole study."""
_SHARES: Final = {"references": 200, "ladder": 250, "loops": 250, "times": 300}
_BEFORE: Final = 0.5
"""Part of the references' share of the progress bar that a single reference may fill."""
_TENTH: Final = 0.1
_REPEATS: Final = 3
_WORKLOAD: Final = "workload"
_IDEAL: Final = 1e9
"""Number that represents in JSON the infinite fineness of a method without a step."""


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
    studied = next((of for of in scene.axes if axis in (None, of.parameters.name, of.group)), None)
    if studied is not None and studied.parameters.admittance is not None:
        return loop_sensitivity.study_display(
            scene, axis, duration, stop, lambda share: progress and progress(round(UNITS * share))
        )
    chosen = length_of(scene, axis, duration)
    return AccuracyStudy(
        chosen.scene, axis, duration=chosen.holds * scene.bus.sample_time, judged=chosen.remark, progress=progress,
        stop=stop, **options,
    ).run()  # fmt: skip


@dataclass
class AccuracyStudy:
    """Runs an accuracy study and stores its results.

    Args:
        scene: Simulated scene.
        axis: Name of an axis or a group; the first axis by default, or its group.
        tolerance: Largest error of the position [m or rad]; by default from the scene's `accuracy: {auto: ...}`,
            else a tenth of an encoder count.
        duration: Length of the comparison [s]; by default 1000 sample times, or the scene's if that is shorter; see
            `length_of`.
        budget: Time for timings [s]; 0 for none.
        engine: Engine of the loops; "auto" compiles them where that is worthwhile.
        progress: Called with the number of units done, of `UNITS`.
        stop: Polled often; true stops the study.
        judged: Remark from `length_of`.
        say: Called with each of the first rows, which need no reference, as soon as it is ready.
    """

    scene: Scene
    axis: str | None = None
    _: KW_ONLY
    tolerance: float | None = None
    duration: float | None = None
    budget: float = DEFAULT_BUDGET
    engine: Engine = "auto"
    progress: Callable[[int], None] | None = None
    stop: loop_sensitivity.Stop = lambda: False
    judged: str = ""
    say: Callable[[str], None] | None = None

    def __post_init__(self) -> None:
        self.part, self.holds = chosen_part(self.scene, self.axis), loop_sensitivity.holds_of(self.scene, self.duration)
        counts = max(abs(axis.parameters.counts_per_unit) for axis in self.part.scene.axes)
        self._tolerance = self.tolerance or self.scene.accuracy_tolerance or _TENTH / counts
        self._done = 0
        self._plant: plant_solvers.Plants | None = None
        self._loops: list[loop_sensitivity.LoopRow] = []
        self._loop_rows: list[Row] = []
        self._times: dict[str, WallTime] = {}
        self._status = "stopped"
        self._log_us: float | None = None

    def run(self) -> Row:
        """Return the result; `status` is "completed", or "stopped" with all results so far."""
        try:
            self._measure()
            self._status = "completed"
        except InputError:
            if not self.stop():
                raise
        return self.result()

    def _measure(self) -> None:
        if self.say is not None:
            for row in self.part.first_rows(self.holds):
                self._check()
                self.say(row)
        self._plant = plant = plant_solvers.plants_of(self.part.scene, self.holds, self._counted_stop("references"))
        for number, _name in enumerate(plant.measure()):
            self._check()
            self._advance("ladder", min(1.0, number / len(plant.candidates)))  # every plant of a group runs each
        found = advice(plant.rows, [], self._tolerance)
        chosen = found["chosen"] or found["most_exact"] or {"accuracy": {}}  # the advised one, else the most exact
        for _name in plant.measure_effects(AccuracyParameters(**chosen["accuracy"])):
            self._check()
        period = self.scene.bus.sample_time_ns
        step, steps = period // loop_sensitivity.FINEST, self.holds * loop_sensitivity.FINEST
        exact = continuous_motion(self.part.scene, step, steps, self._counted_stop("loops"))
        every = loop_sensitivity.variants(self.part.scene, self.scene)
        engines = loop_sensitivity.engines_of(every, self.holds * period, self.engine)
        for number, (variant, engine) in enumerate(zip(every, engines, strict=True)):
            rendered = loop_sensitivity.loop_row(variant, exact, step, self.holds * period, self._check, engine)
            self._loops.append(rendered)
            self._loop_rows.append(self._loop_row(rendered))
            self._advance("loops", (number + 1) / len(every))
        if self.budget > 0.0:
            self._time(plant)

    def _counted_stop(self, part: str) -> loop_sensitivity.Stop:
        """Return a `stop` that also advances the bar by ever smaller steps, for a reference without progress."""
        asked = itertools.count(1)

        def stop() -> bool:
            times = next(asked)
            self._advance(part, _BEFORE * times / (times + self.holds))
            return self.stop()

        return stop

    def _check(self) -> None:
        if self.stop():
            raise InputError("stopped")

    def _advance(self, part: str, share: float) -> None:
        names = list(_SHARES)
        before = sum(_SHARES[name] for name in names[: names.index(part)])
        self._done = max(self._done, min(UNITS, round(before + _SHARES[part] * share)))
        if self.progress is not None:
            self.progress(self._done)

    def _time(self, plant: plant_solvers.Plants) -> None:
        stable = [c for c, row in zip(plant.candidates, plant.rows, strict=True) if row["status"] == "ok"]
        jobs: dict[str, Callable[[], object]] = {_WORKLOAD: workload}
        jobs |= {f"without {name}": candidate.spend for name, candidate in plant.without.items()}
        jobs |= {candidate.name: candidate.spend for candidate in stable}
        self._times = interleaved(jobs, self.budget, self.stop, lambda share: self._advance("times", 0.9 * share))
        self._check()
        cases = {str(i): (row.variant, row.run) for i, row in enumerate(self._loops) if len(row.run.position) > 1}
        each = microseconds_per_step(cases, _REPEATS)
        exchange = exchange_time(self.scene)
        self._log_us = log_time(self.scene)
        for index, row in enumerate(self._loop_rows):
            step = each.get(str(index))
            row["controller_us"] = step
            row["control_thread_us"] = thread = None if step is None or exchange is None else step + exchange
            row["thread_share"] = None if thread is None else thread * 1e-6 * row["rate"]
        self._advance("times", 1.0)

    def _loop_row(self, row: loop_sensitivity.LoopRow) -> Row:
        variant, run, stable = row.variant, row.run, not row.run.ended
        return {
            "group": variant.group,
            "setting": variant.setting,
            "is_scene": variant.is_scene,
            "remark": variant.remark or run.reason,
            "engine": run.engine,
            "fineness": None if variant.fineness is None else min(variant.fineness, _IDEAL),
            "largest_torque": float(np.abs(run.torque).max(initial=0.0)),
            "status": "ok" if stable else "unstable" if run.ended == "diverged" else run.ended,
            **{f"{name}_error": value if stable else None for name, value in row.errors._asdict().items()},
            "energy_uncertainty": run.believed_error,
            "energy_given_out": -run.least_interaction,
            "wall_per_second": row.seconds / (self.holds * self.scene.bus.sample_time),
            "rate": variant.scene.bus.rate,
            **loop_sensitivity.bus_figures(variant, self.scene),
        }

    def result(self) -> Row:
        """Return all results so far, as plain values."""
        bus, plant, is_group = self.scene.bus, self._plant, bool(self.part.scene.groups)
        moved = (of.mechanism.name for of in self.part.scene.mechanisms)
        work = self._times.get(_WORKLOAD)
        rows, orders = ([], []) if plant is None else (self._plant_rows(plant), plant.orders())
        return {
            "scene": self.scene.source,
            "config_hash": self.scene.config_hash(),
            "axis": self.part.name,
            "is_group": is_group,
            "unit": self.part.scene.axes[0].parameters.unit,
            "status": self._status,
            "rate": 1.0 / bus.sample_time,
            "holds": self.holds,
            "duration": self.holds * bus.sample_time,
            "tolerance": self._tolerance,
            "now": self.part.now(),
            "judged": self.judged,
            "workload": work and {"what": WORKLOAD, "seconds": work.least, "spread": work.spread},
            "log_us": self._log_us,
            "remarks": [f"Euler and midpoint methods: not run on a {name}" for name in moved if plant],
            "reference": plant and self._reference(plant, rows),
            "plant": rows,
            "orders": orders,
            "loop": self._loop_rows,
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
        rows = [{**row, **self._wall(f"{row['method']}, {row['setting']}")} for row in plant.rows]
        for price, key in (("evaluations", "pareto"), ("us_per_period", "pareto_in_time")):
            for row, mark in zip(rows, pareto(rows, price, plant_solvers.FLOOR * plant.travel), strict=True):
                row[key] = mark
        return rows

    def _wall(self, name: str) -> Row:
        """Return the time columns of one candidate; None where it was not timed."""
        time, fixed = self._times.get(name), self._times.get(_WORKLOAD)
        if time is None:
            return dict.fromkeys(("us_per_period", "wall_per_second", "spread", "repeats", "ratio"))
        return {
            "us_per_period": time.least / self.holds * 1e6,
            "wall_per_second": time.least / (self.holds * self.scene.bus.sample_time),
            "spread": time.spread,
            "repeats": time.repeats,
            "ratio": time.least / fixed.least if fixed else None,
        }

    def _effect_rows(self, plant: plant_solvers.Plants) -> list[Row]:
        """Return the effects with their times; "AXIS: EFFECT" of a group is compared with the unchanged axis."""
        rows = []
        for row in plant.effects:
            whole, _, _ = row["effect"].rpartition(" ")
            base, mine = (self._wall(f"without {name}")["us_per_period"] for name in (whole, row["effect"]))
            saved = None if base is None or mine is None else base - mine
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


def require_own_axis(axis: AxisScene, scene: Scene) -> None:
    """Refuse an axis without its own plant and its own controller.

    Raises:
        InputError: The axis belongs to a group, or moves a mechanism together with others.
    """
    if axis.group or axis.simulated_drive is not None:
        what = f"group {axis.group} renders on it" if axis.group else "it moves a mechanism with other drives"
        raise InputError(
            f"{scene.source}: axis {axis.parameters.name}: {what}, expected an axis with its own plant and "
            "algorithm; to run the scene, give accuracy: {event_bits, substeps} instead of auto"
        )
