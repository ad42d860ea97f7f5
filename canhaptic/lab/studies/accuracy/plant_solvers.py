"""The plant side: the whole ladder on the torques of the scene's own controller, and every effect left out in turn."""

import importlib.util
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from canhaptic.errors import InputError, ParameterError
from canhaptic.lab.judge.event_location import reference
from canhaptic.lab.judge.reference_motion import MotionError, difference
from canhaptic.lab.reference.continuous_reference import textbook_model
from canhaptic.lab.studies.accuracy.accuracy_choice import FLOOR, fitted_order, ladder
from canhaptic.lab.studies.accuracy.candidates import OURS, Candidate, candidates, ours
from canhaptic.scene.models import AxisScene, AxisSimulation, Scene
from canhaptic.scene.parts import build_plant
from canhaptic.scene.torque_history import declared_order, simulation_of, torque_history
from canhaptic.sim.plant.accuracy_parameters import AccuracyParameters
from canhaptic.sim.plant.plant_motion import Motion

FURTHEST: Final = 1.0
"""Error of the position, in travels of the reference, from which a method counts as unstable."""

Row = dict[str, Any]


class PlantSide:
    """One axis under recorded torques.

    Args:
        axis: Simulated.
        scene: Its scene.
        holds: How many.
        stop: Asked now and then whether to give up.
        with_compiled: Whether the plant is run compiled too, where numba is installed.
        torques: Torque of each hold [N or N*m]; None: those of the scene's own controller.
        settings: To try; None: every one that makes a difference to this plant.

    Attributes:
        torques: Torque of each hold [N or N*m].
        exact: The reference.
        travel: Travel of the reference [m or rad].
        energy: Largest of the works and the kinetic energy of the reference [J].
        rows: What was measured so far, one per rung of the ladder.
        effects: What was measured so far, one per effect of the scene.
    """

    def __init__(
        self,
        axis: AxisScene,
        scene: Scene,
        holds: int,
        stop: Callable[[], bool],
        *,
        with_compiled: bool = False,
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
        settings = settings or ladder(self._simulation, self._period)
        self.candidates: list[Candidate] = candidates(self._simulation, self.torques, self._period, settings)
        if with_compiled and importlib.util.find_spec("numba"):
            finest = settings[-1]
            self.candidates.append(ours(self._simulation, finest, self.torques, self._period, compiled=True))
        self.without: dict[str, Candidate] = {}
        self.rows: list[Row] = []
        self.effects: list[Row] = []

    def measure(self) -> Iterator[str]:
        """Run every rung once for its errors and evaluations; yield the name of each before it is run."""
        for candidate in self.candidates:
            yield candidate.name
            self.rows.append(self._row(candidate))

    def _row(self, candidate: Candidate) -> Row:
        try:
            motion, evaluations, events = candidate.observe()
        except InputError as error:
            return {**named(candidate), "status": f"failed: {error}", "evaluations": None}
        found = difference(motion, self.exact, self._simulation.plant.mass, self._period * 1e-9)
        stable = found.is_finite and found.position <= FURTHEST * self.travel
        errors = _errors_of(found) if stable else dict.fromkeys(("position_error", "force_error", "energy_error"))
        return {
            **named(candidate),
            "status": "ok" if stable else "unstable",
            **errors,
            "evaluations": evaluations,
            "evaluations_per_period": evaluations / len(self.torques),
            "events": events,
        }

    def measure_effects(self, accuracy: AccuracyParameters) -> Iterator[str]:
        """Run the plant without each effect at the chosen accuracy; yield the name of each before it is run.

        Args:
            accuracy: The one that the effects are priced at.
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
        """Return what leaving an effect out changes at one accuracy, the error of the method apart."""
        rest = tuple(effect for effect in self._simulation.effects if effect.name != name)
        without = replace(self._simulation, effects=rest)
        try:
            build_plant(without, self._period)
        except ParameterError as error:
            return {"effect": name, "remark": f"cannot be left out alone: {error}"}
        self.without[name] = candidate = ours(without, accuracy, self.torques, self._period)
        motion, evaluations, _ = candidate.observe()
        found = difference(motion, whole, self._simulation.plant.mass, self._period * 1e-9)
        if found.position <= FLOOR * self.travel and found.energy <= FLOOR * self.energy:
            found = MotionError(0.0, 0.0, 0.0)
        order = next(getattr(e.parameters, "order", None) for e in self._simulation.effects if e.name == name)
        return {
            "effect": name,
            "order": order,
            "remark": "",
            **_errors_of(found),
            "evaluations_saved_per_period": (base - evaluations) / len(self.torques),
        }

    def orders(self) -> list[Row]:
        """Return the order of every method with a step, declared and as fitted to this very scene."""
        return orders_of(self.candidates, self.rows, self.travel, self.declared)

    def declared(self, method: str) -> int | None:
        """Return the order that a method has on this scene: that of the effects for ours, 1 where modes switch."""
        if method == OURS:
            return declared_order(self._simulation)
        own = next(candidate.order for candidate in self.candidates if candidate.method == method)
        switching = textbook_model(self._simulation).switches
        return own if own is None or not switching else 1


def orders_of(
    tried: Sequence[Candidate], rows: Sequence[Row], travel: float, declared: Callable[[str], int | None]
) -> list[Row]:
    """Return the order of every method with a step.

    Args:
        tried: Every rung.
        rows: What was measured of them so far.
        travel: Travel of the reference [m or rad].
        declared: Method -> the order that it has on this scene; None for exact.
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
    """Return what a rung is called."""
    accuracy = candidate.accuracy
    return {
        "method": candidate.method,
        "setting": candidate.setting,
        "accuracy": accuracy and {"event_bits": accuracy.event_bits, "substeps": accuracy.substeps},
    }


def _errors_of(found: MotionError) -> Row:
    """Return the columns of the errors."""
    return {"position_error": found.position, "force_error": found.force, "energy_error": found.energy}
