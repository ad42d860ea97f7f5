"""The whole study of one axis or group: references, both ladders, times and advice; a stopped study keeps its rows.

torques of the scene's own controller -> every method, every setting, every effect left out   against DOP853
every rate, delay, algorithm, filter and resolution                                           against the continuous run
"""

from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np

from canhaptic.errors import InputError
from canhaptic.lab.batch.engine import Engine
from canhaptic.lab.loop.cost import microseconds_per_step
from canhaptic.lab.studies.accuracy.accuracy_choice import FLOOR, holds_of
from canhaptic.lab.studies.accuracy.advice import advice, error_per_microsecond, pareto, rank_agreement
from canhaptic.lab.studies.accuracy.candidates import LSODA
from canhaptic.lab.studies.accuracy.control_thread import exchange_time, log_time
from canhaptic.lab.studies.accuracy.cycle_timing import WORKLOAD, WallTime, interleaved, workload
from canhaptic.lab.studies.accuracy.group_plant_side import Plants
from canhaptic.lab.studies.accuracy.loop_sensitivity import FINEST, LoopRow, bus_figures, engines_of, loop_row
from canhaptic.lab.studies.accuracy.part import chosen_part
from canhaptic.lab.studies.accuracy.plant_solvers import Row
from canhaptic.scene.models import Scene
from canhaptic.sim.plant.accuracy_parameters import AccuracyParameters

DEFAULT_BUDGET: Final = 12.0
"""Time for timings [s], the plant side's; runs for errors come on top."""
UNITS: Final = 1000
"""Units of progress in the whole study."""
_SHARES: Final = {"references": 200, "ladder": 250, "loops": 250, "times": 300}
_TENTH: Final = 0.1
_REPEATS: Final = 3
_WORKLOAD: Final = "workload"
_IDEAL: Final = 1e9
"""Fineness of what has no step, as a number that JSON can hold."""
_COMPILING: Final = 5.0
"""Budget from which the plant is timed compiled too, which costs seconds once [s]."""


class _StoppedError(InputError):
    """The study was asked to stop."""


class AccuracyStudy:
    """Measures, and keeps what was measured.

    Args:
        scene: Simulated.
        axis: Name of an axis or a group; the first axis by default, or its group.
        tolerance: Largest error of the position [m or rad]; by default what the scene's `accuracy: {auto: ...}` says,
            else a tenth of an encoder count.
        duration: Length of the comparison [s]; by default 1000 sample times, or the scene's if that is shorter.
        budget: Time for timings [s]; 0 for none.
        engine: Engine of the loops; "auto" compiles them where that pays.
        progress: Called with the number of units done, of `UNITS`.
        stop: Asked often whether to stop.
    """

    def __init__(
        self,
        scene: Scene,
        axis: str | None = None,
        *,
        tolerance: float | None = None,
        duration: float | None = None,
        budget: float = DEFAULT_BUDGET,
        engine: Engine = "auto",
        progress: Callable[[int], None] | None = None,
        stop: Callable[[], bool] | None = None,
    ) -> None:
        self.scene, self.part = scene, chosen_part(scene, axis)
        counts = max(abs(given.counts_per_unit) for given in self.part.parameters)
        self.tolerance = tolerance or scene.accuracy_tolerance or _TENTH / counts
        self.holds = holds_of(scene, duration)
        self._budget, self._engine, self._progress, self._stop = budget, engine, progress, stop or (lambda: False)
        self._done = 0
        self._plant: Plants | None = None
        self._loops: list[LoopRow] = []
        self._loop_rows: list[Row] = []
        self._times: dict[str, WallTime] = {}
        self._remarks: list[str] = []
        self._status = "not begun"
        self._log_us: float | None = None

    def run(self) -> dict[str, Any]:
        """Return the result; `status` is "completed", or "stopped" with everything up to there."""
        self._status = "stopped"
        try:
            self._measure()
            self._status = "completed"
        except InputError:
            if not self._stop():
                raise
        return self.result()

    def _measure(self) -> None:
        with_compiled = self._budget >= _COMPILING
        self._plant = plant = self.part.plants(self.holds, self._stop, with_compiled=with_compiled)
        self._remarks = self.part.remarks()
        period = self.scene.bus.sample_time_ns
        exact = self.part.continuous(period // FINEST, self.holds * FINEST, self._stop)
        self._advance("references", 1.0)
        self._each(plant.measure(), len(plant.candidates), "ladder")
        self._each(plant.measure_effects(self._accuracy(plant)))
        every = self.part.variants()
        engines = engines_of(every, self.holds * period, self._engine)
        for number, (variant, engine) in enumerate(zip(every, engines, strict=True)):
            self._loops.append(loop_row(variant, exact, self.holds * period, self._check, engine))
            self._loop_rows.append(self._loop_row(self._loops[-1]))
            self._advance("loops", (number + 1) / len(every))
        if self._budget > 0.0:
            self._time(plant)

    def _each(self, steps: Iterator[str], count: int = 0, part: str = "") -> None:
        for number, _name in enumerate(steps):
            self._check()
            if part:
                self._advance(part, min(1.0, number / count))  # every plant of a group runs each of them

    def _check(self) -> None:
        if self._stop():
            raise _StoppedError("stopped")

    def _advance(self, part: str, share: float) -> None:
        names = list(_SHARES)
        before = sum(_SHARES[name] for name in names[: names.index(part)])
        self._done = max(self._done, min(UNITS, round(before + _SHARES[part] * share)))
        if self._progress is not None:
            self._progress(self._done)

    def _accuracy(self, plant: Plants) -> AccuracyParameters:
        """Return the accuracy that effects are priced at: the advised one, else the most exact."""
        found = advice(plant.rows, [], self.tolerance)
        row = found["chosen"] or found["most_exact"]
        return AccuracyParameters(**row["accuracy"]) if row else AccuracyParameters()

    def _time(self, plant: Plants) -> None:
        stable = [c for c, row in zip(plant.candidates, plant.rows, strict=True) if row["status"] == "ok"]
        jobs: dict[str, Callable[[], object]] = {_WORKLOAD: workload}
        jobs |= {f"without {name}": candidate.spend for name, candidate in plant.without.items()}
        jobs |= {candidate.name: candidate.spend for candidate in stable}
        self._times = interleaved(jobs, self._budget, self._stop, lambda share: self._advance("times", 0.9 * share))
        self._check()
        cases = {str(i): (row.variant.case, row.run) for i, row in enumerate(self._loops) if len(row.run.position) > 1}
        each = microseconds_per_step(cases, _REPEATS)
        exchange = exchange_time(self.scene)
        self._log_us = log_time(self.scene)
        for index, row in enumerate(self._loop_rows):
            step = each.get(str(index))
            row["controller_us"] = step
            row["control_thread_us"] = thread = None if step is None or exchange is None else step + exchange
            row["thread_share"] = None if thread is None else thread * 1e-6 * row["rate"]
        self._advance("times", 1.0)

    def _loop_row(self, row: LoopRow) -> Row:
        variant, stable = row.variant, row.is_stable
        return {
            "group": variant.group,
            "setting": variant.setting,
            "is_scene": variant.is_scene,
            "remark": variant.remark or row.run.reason,
            "engine": row.run.engine,
            "fineness": None if variant.fineness is None else min(variant.fineness, _IDEAL),
            "largest_torque": float(np.abs(row.run.torque).max(initial=0.0)),
            "status": "ok" if stable else "unstable" if row.run.ended == "diverged" else row.run.ended,
            "position_error": row.position_error if stable else None,
            "force_error": row.force_error if stable else None,
            "energy_error": row.energy_error if stable else None,
            "energy_uncertainty": row.run.believed_error,
            "energy_given_out": -row.run.least_interaction,
            "wall_per_second": row.seconds / (self.holds * self.scene.bus.sample_time),
            "rate": variant.bus.rate,
            **bus_figures(variant, self.scene),
        }

    def result(self) -> dict[str, Any]:
        """Return everything that was measured so far, as plain values."""
        bus = self.scene.bus
        found: dict[str, Any] = {
            "scene": self.scene.source,
            "config_hash": self.scene.config_hash(),
            "axis": self.part.name,
            "is_group": self.part.is_group,
            "unit": self.part.parameters[0].unit,
            "status": self._status,
            "rate": 1.0 / bus.sample_time,
            "holds": self.holds,
            "duration": self.holds * bus.sample_time,
            "tolerance": self.tolerance,
            "workload": self._workload(),
            "log_us": self._log_us,
            "remarks": self._remarks,
        }
        plant = self._plant
        if plant is None:
            return {**found, "reference": None, "plant": [], "orders": [], "loop": [], "advice": None}
        rows, orders = self._plant_rows(plant), plant.orders()
        return {
            **found,
            "reference": self._reference(plant, rows),
            "plant": rows,
            "orders": orders,
            "loop": self._loop_rows,
            "advice": None
            if self._status == "stopped"
            else advice(rows, self._effect_rows(plant), self.tolerance, orders),
        }

    def _workload(self) -> dict[str, Any] | None:
        time = self._times.get(_WORKLOAD)
        return time and {"what": WORKLOAD, "seconds": time.least, "spread": time.spread}

    def _reference(self, plant: Plants, rows: list[Row]) -> dict[str, Any]:
        witness = next((row for row in rows if row["method"] == LSODA and row["setting"] == "tolerance 1e-09"), None)
        timed = [row for row in rows if row.get("us_per_period") is not None]
        return {
            "method": "DOP853, events located, relative tolerance 1e-12",
            "evaluations": plant.evaluations,
            "travel": plant.travel,
            "energy": plant.energy,
            "witness": witness
            and {"method": "LSODA, events located, tolerance 1e-9", "apart": witness["position_error"]},
            "rank_agreement": rank_agreement(
                [row["evaluations"] for row in timed], [row["us_per_period"] for row in timed]
            ),
        }

    def _plant_rows(self, plant: Plants) -> list[Row]:
        rows = [{**row, **self._wall(f"{row['method']}, {row['setting']}")} for row in plant.rows]
        for price, key in (("evaluations", "pareto"), ("us_per_period", "pareto_in_time")):
            for row, mark in zip(rows, pareto(rows, price, FLOOR * plant.travel), strict=True):
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

    def _effect_rows(self, plant: Plants) -> list[Row]:
        """Return the effects with their times; "AXIS: EFFECT" of a group is compared with that axis as it is."""
        rows = []
        for row in plant.effects:
            whole, _, _ = row["effect"].rpartition(" ")
            base = self._wall(f"without {whole}")["us_per_period"]
            mine = self._wall(f"without {row['effect']}")["us_per_period"]
            saved = None if base is None or mine is None else base - mine
            error = row.get("position_error")
            worth = None if error is None else error_per_microsecond(error, saved)
            rows.append({**row, "us_saved_per_period": saved, "error_per_microsecond": worth})
        return rows
