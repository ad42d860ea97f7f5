"""The loop of an admittance display, or of a group of them, one thing changed at a time, against an ideal display.

The ideal display renders the same environment without protection at a 32nd of the sample time (20 kHz at most). Its
drive is a thousand times as stiff, its encoder a thousand times as fine, and its sensor shows the mean of each hold
without error. Its distance from an ideal display with twice its sample time estimates its own error. The simulated
plant of a display is compared with its textbook equations, under the commands of the scene's own controller.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, cast

import numpy as np

from canhaptic.drive.axis_parameters import CanBusParameters
from canhaptic.drive.clock import ProcessorClock
from canhaptic.drive.profile.motion_parameters import MotionParameters
from canhaptic.errors import CanHapticError
from canhaptic.lab.batch.scalar import render
from canhaptic.lab.figures.figures import figures_of
from canhaptic.lab.judge.reference_group import DisplayModel
from canhaptic.lab.judge.solvers import located
from canhaptic.lab.loop.axis_loop import LoopRun, at_rate, under
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.accuracy.loop_sensitivity import Variant, algorithms, hertz, largest_apart
from canhaptic.lab.studies.accuracy.studied_port import PortStudy
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import AxisScene, AxisSimulation, Scene
from canhaptic.sim.plant.direct_rig import Motion
from canhaptic.sim.plant.velocity_drive import AdmittanceSimulation, SimulatedForceSensor

_STEPS: Final = 32
"""Largest number of holds of the ideal display in one sample time; the display that checks it has half as many."""
_FASTEST: Final = 20e3
"""Highest rate that a scene may have [Hz]."""
_STIFFER: Final = 1000.0
_PLAIN: Final = "unprotected"


@dataclass
class IdealStudy(PortStudy):
    """Study of an admittance display, or of a group of them."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._plants: list[Row] = []
        alone, self._steps = self.alone, _steps(self.scene)
        self._ideal = render(_ideal(alone, self._steps), self.holds * self._steps)
        self._coarser = render(_ideal(alone, self._steps // 2), self.holds * self._steps // 2)

    def _measure(self) -> None:
        every = list(_variants(self.alone))
        for number, variant in enumerate(every, 1):
            self._reach(number / (1 + len(every)))
            self._check()
            self._rows.append(self._row(variant))
        self._plants = [_plant_row(self.alone, axis, self.holds) for axis in self.alone.axes]

    def _row(self, variant: Variant) -> Row:
        steps = round(self._steps * variant.sample_time_ns / self.alone.bus.sample_time_ns)
        row, clock = Row(group=variant.group, setting=variant.setting, is_scene=variant.is_scene), ProcessorClock()
        begin = clock.now()
        try:
            run = render(variant.scene, self.holds * self._steps // steps)
        except CanHapticError as error:
            return row | {"status": f"refused: {str(error).splitlines()[0]}"}
        spent, figures = clock.now() - begin, figures_of(run, variant.scene)
        position, energy = self._apart(run, steps)
        return row | {
            "status": run.reason or run.ended or "ok",
            "position_error": position,
            "energy_error": energy,
            "mass_felt": figures["mass_felt"],
            "given_out": -run.least_interaction,
            "guard_acts": figures["guard_acts"],
            "energy_unsure": run.resolution,
            "us_per_cycle": spent * 1e-3 / max(1, len(run.rows)),
        }

    def _apart(self, run: LoopRun, steps: int) -> list[float]:
        """Return the largest errors of position and energy; `steps` holds of the ideal display make one of the run."""
        exact = self._ideal.true_position[::steps], self._ideal.interaction[::steps]
        return largest_apart((run.true_position, run.interaction), exact)

    def result(self) -> Row:
        """Return all results so far, as plain values."""
        ideal = self._ideal
        return {
            "scene": self.scene.source,
            "axis": self.alone.ports[0].name,
            "unit": self.alone.axes[0].parameters.unit,
            "rate": 1.0 / self.scene.bus.sample_time,
            "holds": self.holds,
            "reference": {
                "ended": ideal.reason or ideal.ended,
                "travel": float(np.ptp(ideal.true_position, axis=0).max()),
                "energy": float(ideal.interaction[-1]),
                "apart": self._apart(self._coarser, 2)[0],
            },
            "plant": self._plants,
            "loop": self._rows,
            "status": self._status,
        }


def _steps(scene: Scene) -> int:
    """Return the number of holds of the ideal display in one sample time, a power of two."""
    steps = _STEPS
    while steps > 4 and steps / scene.bus.sample_time > _FASTEST:
        steps //= 2
    return steps


def _plant_row(scene: Scene, axis: AxisScene, holds: int) -> Row:
    """Return the difference of the plant from a solver, under the commands of the scene's own controller."""
    simulation, name = simulation_of(axis), axis.parameters.name
    if reason := why_no_equations(simulation):
        return {"axis": name, "status": f"not compared: no equations for {reason}"}
    run, place = render(scene, holds), scene.axes.index(axis)
    exact = exact_motion(simulation, run.torque[1:, place].tolist(), scene.bus.sample_time_ns)
    row: Row = {"axis": name, "status": "ok"}
    row["position_error"] = float(np.abs(run.true_position[1:, [place]] - exact.position).max())
    if run.axes == 1:
        row["energy_error"] = float(np.abs(run.interaction[1:] - exact.user).max())
    return row


def _variants(scene: Scene) -> Iterator[Variant]:
    """Yield the scene and its changes."""
    yield Variant("as it is", scene.ports[0].passivity.name, scene, is_scene=True)
    for factor in (0.5, 2.0, 4.0):
        rate = factor / scene.bus.sample_time
        yield Variant("sample rate", hertz(rate), at_rate(scene, rate))
    yield from algorithms(scene)
    for sampling in ("point", "mean"):
        yield Variant("sampling", sampling, _sensed(scene, sampling=sampling))
    exact = _sensed(scene, gain=1.0, offset=0.0, drift=0.0, noise=0.0, quantum=0.0)
    yield Variant("sensor", "without errors", exact)
    finer = replace(scene, axes=tuple(_with(axis, {}, 10.0) for axis in scene.axes))
    yield Variant("encoder count", "10 times finer", finer)


def _sensed(scene: Scene, **values: float | str) -> Scene:
    """Return a scene with other properties of the simulated sensor, whose sampling is also declared."""
    known = {key: value for key, value in values.items() if key == "sampling"}

    def changed(axis: AxisScene) -> AxisScene:
        return _with(axis, known, sensor=_servo(axis).sensor.model_copy(update=values))

    return replace(scene, axes=tuple(map(changed, scene.axes)))


def _servo(axis: AxisScene) -> AdmittanceSimulation:
    """Return what is simulated of the velocity loop and the force sensor of an axis."""
    return cast(AdmittanceSimulation, simulation_of(axis).admittance)


def _with(
    axis: AxisScene, known: Mapping[str, object], counts: float = 1.0, delay: int | None = None, **simulated: object
) -> AxisScene:
    """Return a display with another declared sensor, another encoder resolution, delay and simulation."""
    simulation, declared = simulation_of(axis), _declared(axis)
    force, drive = declared.force.model_copy(update=known), simulation.drive
    if (own := drive.display) is not None:
        scales = {"force_per_count": force.per_count, "force_offset_counts": force.offset_counts}
        drive = drive.model_copy(update={"display": own.model_copy(update=scales)})
    update = {
        "admittance": declared.model_copy(update={"force": force}),
        "counts_per_unit": counts * axis.parameters.counts_per_unit,
    }
    servo = _servo(axis).model_copy(update=simulated)
    return replace(
        axis, parameters=axis.parameters.model_copy(update=update),
        simulation=replace(simulation, admittance=servo, drive=drive),
        loop=axis.loop if delay is None else axis.loop.model_copy(update={"delay": delay}),
    )  # fmt: skip


def _declared(axis: AxisScene) -> MotionParameters:
    """Return what is declared of the velocity loop and the force sensor of an axis."""
    return cast(MotionParameters, axis.parameters.causality)


def _ideal(scene: Scene, steps: int) -> Scene:
    """Return the ideal display of a scene, with `steps` holds in one sample time."""

    def changed(axis: AxisScene) -> AxisScene:
        loop, largest = _servo(axis).loop, _declared(axis).force.range
        ideal = {"gain": _STIFFER * loop.gain, "integral_gain": 0.0, "torque_limit": None}
        known = {
            "sampling": "mean", "latency": 0, "filter": 0.0, "frozen_after": None, "offset_counts": 0.0, "range": 1e6,
            "per_count": 1e-6 * largest,
        }  # fmt: skip
        sensor = SimulatedForceSensor(sampling="mean")
        return _with(axis, known, 1e3, delay=0, loop=loop.model_copy(update=ideal), sensor=sensor)

    finer = at_rate(under(scene, _PLAIN).permitted(), steps / scene.bus.sample_time)
    bus = CanBusParameters(rate=finer.bus.rate, rpdo="event")  # a command acts at once
    return replace(finer, bus=bus, axes=tuple(map(changed, finer.axes)))


def why_no_equations(simulation: AxisSimulation) -> str:
    """Return "" if the equations describe a simulated display completely, else the name of the part that they omit."""
    servo, user = cast(AdmittanceSimulation, simulation.admittance), simulation.user
    if servo.loop.torque_limit is not None:
        return "the torque limit of the loop"
    if simulation.effects:
        return f"effect {simulation.effects[0].name}"
    if user is not None and not user.has_equations:
        return "a user-defined or recorded hand"
    return ""


def exact_motion(simulation: AxisSimulation, held: Sequence[float], sample_time_ns: int) -> Motion:
    """Return the motion of a simulated display by DOP853; its `user` is the energy through the sensor [J].

    Args:
        simulation: Simulation of the axis, without a part that `why_no_equations` names.
        held: Velocity command in each hold [m/s or rad/s].
        sample_time_ns: T [ns].

    Raises:
        InputError: scipy is missing, or the solver failed.
    """
    model = DisplayModel(simulation.plant, cast(AdmittanceSimulation, simulation.admittance), simulation.user)
    return located(model, held, sample_time_ns, "DOP853", 1e-11, 1e-14)
