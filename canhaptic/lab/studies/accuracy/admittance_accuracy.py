"""The cost of accuracy on an admittance display: the simulated plant against a solver, the loop against an ideal one.

commands of the scene's own controller -> the plant of the scene                           against DOP853
every rate, algorithm, sensor and encoder -> position, energy in and out, mass felt        against the ideal display

The ideal display renders the same environment without protection at a 32nd of the sample time (20 kHz at most). Its
drive is a thousand times as stiff, its encoder a thousand times as fine, and its sensor shows the mean of each hold
without error. Its distance from an ideal display with twice its sample time estimates its own error.

The module also makes the tables of the study, for a terminal and as Markdown, and has the equations of an admittance
display and its hand, for a solver that shares no code with the simulated plant:

    M v' = c (r - v) + f_I + F - b v,   f_I' = k (r - v),   F = k_g (x - q) + d_g (w - v)
    m x'' = -F + K (x_u - x) + D (x_u' - w) + push,          E' = F v

q, v: mass on the motor's side of the sensor; x, w: mass on the hand's side; r: velocity command; f_I: integral part of
the velocity loop; F: force at the sensor. Effects and torque limits are omitted.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import cos, pi, sin
from typing import Any, Final, cast

import numpy as np

from canhaptic.axis_units import mass_unit, si
from canhaptic.control.admittance import DISPLAY_ALGORITHMS, DISPLAY_GROUP_ALGORITHMS
from canhaptic.drive.clock import WallClock
from canhaptic.drive.profile.admittance_parameters import AdmittanceParameters
from canhaptic.errors import CanHapticError, InputError, ParameterError
from canhaptic.lab.figures.figures import figures_of
from canhaptic.lab.loop.admittance_loop import AdmittanceRun, run_display
from canhaptic.lab.loop.axis_loop import Array, at_rate, display_group_under, display_under, parts_of
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.accuracy.loop_sensitivity import Variant
from canhaptic.lab.studies.accuracy.plant_solvers import Stop, holds_of
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import AxisScene, AxisSimulation, Scene
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from canhaptic.sim.plant.velocity_drive import AdmittanceSimulation, SimulatedForceSensor
from canhaptic.view.table import Table

HEADS: Final = ("changed", "to", "position", "energy", "mass felt", "given out", "guard acts", "us per\ncycle")


def display_accuracy_table(result: Row) -> Table:
    """Return one row for each change of the scene."""
    return Table("", HEADS, [_cells(row, result["unit"]) for row in result["loop"]], keys=2)


def display_heading(result: Row) -> list[str]:
    """Return the heading: the studied part, its reference, and the difference of the plant from a solver."""
    unit, reference = result["unit"], result["reference"]
    lines = [
        f"{result['scene']}, {result['axis']}: {result['holds']} sample times at {result['rate']:g} Hz, "
        f"{result['status']}",
        f"errors against an ideal display: travel {si(reference['travel'], unit)}, "
        f"energy {si(reference['energy'], 'J')}; certain to about {si(reference['apart'], unit, 2)}",
    ]
    for row in result["plant"]:
        text = row["status"]
        if row["status"] == "ok":
            energy = f", energy {si(row['energy_error'], 'J', 2)}" if "energy_error" in row else ""
            text = f"errors against DOP853: position {si(row['position_error'], unit, 2)}{energy}"
        lines.append(f"simulated plant of {row['axis']}: {text}")
    return lines


def _cells(row: Row, unit: str) -> list[str]:
    if "position_error" not in row:
        return [row["changed"], f"{row['to']}: refused", *[""] * (len(HEADS) - 2)]
    return [
        row["changed"],
        row["to"] + ("" if row["status"] == "ok" else f" (ended: {row['status'][:40]})"),
        si(row["position_error"], unit, 3),
        si(row["energy_error"], "J", 3),
        "-" if np.isnan(row["mass_felt"]) else si(row["mass_felt"], mass_unit(unit), 3),
        si(row["given_out"], "J", 3),
        f"{100.0 * row['guard_acts']:.2g} %",
        f"{row['us_per_cycle']:.0f}",
    ]


_FINEST: Final = 32
"""Largest number of holds of the ideal display in one sample time; the display that checks it has half as many."""
_FASTEST: Final = 20e3
"""Highest rate that a scene may have [Hz]."""
_STIFFER: Final = 1000.0
_PLAIN: Final = "unprotected"


def study_display(
    scene: Scene,
    name: str | None,
    duration: float | None,
    stop: Stop,
    progress: Callable[[float], None] = lambda _: None,
) -> Row:
    """Return the study of one display, or group of displays, as plain values.

    Args:
        scene: Simulated scene.
        name: Name of the axis or group; None for the first.
        duration: Length of the comparison [s]; by default 1000 sample times, or the scene's if that is shorter.
        stop: Polled before every run; true ends the study with the results so far.
        progress: Called with the completed fraction.

    Raises:
        InputError: No axis or group has this name, or it is not simulated.
    """
    parts = parts_of(scene)
    if name is not None and name not in parts:
        raise InputError(f"{scene.source}: got axis {name!r}, expected one of: {', '.join(parts)}")
    name = name or next(iter(parts))
    alone, holds, steps = parts[name], holds_of(scene, duration), _steps(scene)
    ideal = run_display(_ideal(alone, steps), holds * steps)
    nearly = run_display(_ideal(alone, steps // 2), holds * steps // 2)
    rows: list[Row] = []
    every = list(_variants(alone))
    for number, variant in enumerate(every):
        progress((1 + number) / (1 + len(every)))
        if stop():
            break
        own = round(steps * variant.sample_time_ns / alone.bus.sample_time_ns)
        rows.append(_row(variant, ideal, own, holds * steps))
    is_whole = len(rows) == len(every)
    return {
        "scene": scene.source,
        "axis": name,
        "unit": alone.axes[0].parameters.unit,
        "rate": 1.0 / scene.bus.sample_time,
        "holds": holds,
        "reference": {
            "ended": ideal.reason or ideal.ended,
            "travel": float(np.ptp(_positions(ideal), axis=0).max()),
            "energy": float(ideal.interaction[-1]),
            "apart": _apart(nearly, ideal, 2)[0],
        },
        "plant": [_plant_row(alone, axis, holds) for axis in alone.axes] if is_whole else [],
        "loop": rows,
        "status": "completed" if is_whole else "stopped",
    }


def _steps(scene: Scene) -> int:
    """Return the number of holds of the ideal display in one sample time, a power of two."""
    steps = _FINEST
    while steps > 4 and steps / scene.bus.sample_time > _FASTEST:
        steps //= 2
    return steps


def _positions(run: AdmittanceRun) -> Array:
    return run.motion[:, :, 0]


def _apart(run: AdmittanceRun, ideal: AdmittanceRun, steps: int) -> tuple[float, float]:
    """Return the largest errors of position [m or rad] and energy [J] against the ideal display, at the same times."""
    exact, energies = _positions(ideal)[::steps], ideal.interaction[::steps]
    common = min(len(exact), len(run.rows))
    position = np.abs(_positions(run)[:common] - exact[:common]).max(initial=0.0)
    return float(position), float(np.abs(run.interaction[:common] - energies[:common]).max(initial=0.0))


def _row(variant: Variant, ideal: AdmittanceRun, steps: int, whole: int) -> Row:
    """Return the row of a variant; `steps` of the `whole` holds of the ideal display make one hold of the variant."""
    row, clock = Row(changed=variant.group, to=variant.setting), WallClock()
    begin = clock.now()
    try:
        run = run_display(variant.scene, whole // steps)
    except CanHapticError as error:
        return row | {"status": f"refused: {str(error).splitlines()[0]}"}
    spent, figures = clock.now() - begin, figures_of(run, variant.scene)
    position, energy = _apart(run, ideal, steps)
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


def _plant_row(scene: Scene, axis: AxisScene, holds: int) -> Row:
    """Return the difference of the plant from a solver, under the commands of the scene's own controller."""
    simulation, name = simulation_of(axis), axis.parameters.name
    if reason := why_no_equations(simulation):
        return {"axis": name, "status": f"not compared: no equations for {reason}"}
    run, place = run_display(scene, holds), scene.axes.index(axis)
    exact = integrate(simulation, run.torque[:, place].tolist(), scene.bus.sample_time)
    row: Row = {"axis": name, "status": "ok"}
    row["position_error"] = float(np.abs(_positions(run)[:, place] - exact[:, 0]).max())
    if run.axes == 1:
        row["energy_error"] = float(np.abs(run.interaction - exact[:, 1]).max())
    return row


# --- what is varied ---------------------------------------------------------------------------------------------------


def _variants(scene: Scene) -> Iterator[Variant]:
    """Yield the scene and its changes."""
    yield Variant("the scene", "", scene)
    for factor in (0.5, 2.0, 4.0):
        rate = factor / scene.bus.sample_time
        yield Variant("rate", f"{rate:g} Hz", at_rate(scene, rate))
    for name, changed in _under_others(scene):
        yield Variant("algorithm", name, changed)
    for sampling in ("point", "mean"):
        yield Variant("sampling", sampling, _sensed(scene, sampling=sampling))
    exact = _sensed(scene, gain=1.0, offset=0.0, drift=0.0, noise=0.0, quantum=0.0)
    yield Variant("sensor", "without errors", exact)
    finer = replace(scene, axes=tuple(_with(axis, {}, 10.0) for axis in scene.axes))
    yield Variant("encoder", "10 times finer", finer)


def _under_others(scene: Scene) -> Iterator[tuple[str, Scene]]:
    """Yield the scene with every other algorithm whose required values the scene gives."""
    own = scene.groups[0].passivity.name if scene.groups else scene.axes[0].passivity.name
    for name in DISPLAY_GROUP_ALGORITHMS if scene.groups else DISPLAY_ALGORITHMS:
        if name != own:
            try:
                yield name, _under(scene, name)
            except ParameterError:
                continue


def _under(scene: Scene, name: str) -> Scene:
    if scene.groups:
        return replace(scene, groups=(display_group_under(scene.groups[0], name),))
    return replace(scene, axes=tuple(display_under(axis, name) for axis in scene.axes))


def _sensed(scene: Scene, **values: float | str) -> Scene:
    """Return a scene with other properties of the simulated sensor, whose sampling is also declared."""
    known = {key: value for key, value in values.items() if key == "sampling"}

    def changed(axis: AxisScene) -> AxisScene:
        return _with(axis, known, sensor=_simulated(axis).sensor.model_copy(update=values))

    return replace(scene, axes=tuple(map(changed, scene.axes)))


def _simulated(axis: AxisScene) -> AdmittanceSimulation:
    simulated = simulation_of(axis).admittance
    if axis.parameters.admittance is None or simulated is None:
        raise InputError(f"{axis.parameters.name}: is not an admittance display, expected one")
    return simulated


def _with(
    axis: AxisScene, known: Mapping[str, object], counts: float = 1.0, delay: int | None = None, **simulated: object
) -> AxisScene:
    """Return a display with another declared sensor, another encoder resolution, delay and simulation."""
    given, simulation, drive = axis.parameters, simulation_of(axis), simulation_of(axis).drive
    admittance = _simulated(axis).model_copy(update=simulated)
    display = cast(AdmittanceParameters, given.admittance)
    force = display.force.model_copy(update=known)
    if drive.display is not None:
        scales = {"force_per_count": force.per_count, "force_offset_counts": force.offset_counts}
        drive = drive.model_copy(update={"display": drive.display.model_copy(update=scales)})
    display = display.model_copy(update={"force": force})
    update = {"admittance": display, "counts_per_unit": counts * given.counts_per_unit}
    return replace(
        axis, parameters=given.model_copy(update=update),
        simulation=replace(simulation, admittance=admittance, drive=drive),
        loop=axis.loop if delay is None else axis.loop.model_copy(update={"delay": delay}),
    )  # fmt: skip


def _ideal(scene: Scene, steps: int) -> Scene:
    """Return the ideal display of a scene, with `steps` holds in one sample time."""

    def changed(axis: AxisScene) -> AxisScene:
        loop, display = _simulated(axis).loop, cast(AdmittanceParameters, axis.parameters.admittance)
        ideal = {"gain": _STIFFER * loop.gain, "integral_gain": 0.0, "torque_limit": None}
        known = {
            "sampling": "mean", "latency": 0, "filter": 0.0, "frozen_after": None, "offset_counts": 0.0, "range": 1e6,
            "per_count": 1e-6 * display.force.range,
        }  # fmt: skip
        sensor = SimulatedForceSensor(sampling="mean")
        return _with(axis, known, 1e3, delay=0, loop=loop.model_copy(update=ideal), sensor=sensor)

    finer = at_rate(_under(scene, _PLAIN), steps / scene.bus.sample_time)
    bus = finer.bus.model_copy(update={"rpdo": "event"})  # a command acts at once
    return replace(finer, bus=bus, axes=tuple(map(changed, finer.axes)))


def why_no_equations(simulation: AxisSimulation) -> str:
    """Return "" if the equations describe a plant completely, else the name of the part that they omit."""
    display, user = simulation.admittance, simulation.user
    if display is None:
        return "no admittance display"
    if display.loop.torque_limit is not None:
        return "the torque limit of the loop"
    if simulation.effects:
        return f"effect {simulation.effects[0].name}"
    if user is not None and not user.has_equations:
        return "a user-defined or recorded hand"
    return ""


def integrate(simulation: AxisSimulation, held: Sequence[float], sample_time: float) -> Array:
    """Return position [m or rad] and energy through the sensor [J] at each SYNC, shape (len(held), 2), by DOP853.

    Args:
        simulation: Simulation of the axis.
        held: Velocity command in the hold before each SYNC [m/s or rad/s]; the first is not used.
        sample_time: T [s].

    Raises:
        InputError: `why_no_equations` names a part, or the solver failed.
    """
    from scipy.integrate import solve_ivp

    if reason := why_no_equations(simulation):
        raise InputError(f"no equations here for {reason}")
    state = np.zeros(6)  # q, v, x, w, f_I, E
    state[0] = state[2] = simulation.plant.initial_position
    state[1] = state[3] = simulation.plant.initial_velocity
    rows, rates = [state[[0, 5]]], _rates(simulation)
    for number, command in enumerate(held[1:]):
        span = (number * sample_time, (number + 1) * sample_time)
        found: Any = solve_ivp(rates, span, state, "DOP853", args=(command,), rtol=1e-11, atol=1e-14)
        if not found.success:
            raise InputError(f"DOP853: {found.message}")
        state = found.y[:, -1]
        rows.append(state[[0, 5]])
    return np.array(rows)


def _rates(simulation: AxisSimulation) -> Any:
    display, user, plant = simulation.admittance, simulation.user or UserParameters(), simulation.plant
    if display is None:
        raise InputError("no equations for an axis that is not an admittance display")
    loop, grip = display.loop, display.grip
    motion = user.sinusoid or SinusoidMotion(amplitude=0.0, frequency=1.0)
    omega = 2.0 * pi * motion.frequency

    def rates(time: float, state: Array, command: float) -> list[float]:
        q, v, x, w, integral, _ = state.tolist()
        angle = omega * time + motion.phase
        place = user.rest + motion.offset + motion.amplitude * sin(angle)
        speed = motion.amplitude * omega * cos(angle)
        force = grip.stiffness * (x - q) + grip.damping * (w - v)
        hand = user.stiffness * (place - x) + user.damping * (speed - w) + user.push
        driven = loop.gain * (command - v) + integral - plant.damping * v
        forced = (driven + force) / plant.mass, (hand - force) / grip.mass
        return [v, forced[0], w, forced[1], loop.integral_gain * (command - v), force * v]

    return rates
