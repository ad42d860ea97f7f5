"""One scene at a time, with the names of the batch: for scenes that do not fit it, and as its reference.

One loop with a record of every SYNC, by Python or compiled; the choice for a study, and the note about it.

One group compiled with its motors, with a record of every SYNC; see `compiled_loops`.

One group of a scene in a loop without a bus, with the names of the batch.

Figures of one axis apply to a group as follows: energies are those of all its motors and of a mover; torques are
Euclidean norms, `torque_peak` is the largest of any motor. Travel, stiffness and comparisons with a continuous run are
NaN: a group has no position.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import lru_cache
from math import inf, nan
from typing import Any, Final

import numpy as np

from canhaptic.control.balance import EnergyBalance
from canhaptic.control.environments.environment import plain
from canhaptic.control.multi_axis.group_controller import GroupBalance
from canhaptic.control.multi_axis.group_kernel import GroupHold, GroupKernel
from canhaptic.control.multi_axis.group_motion import GroupMotion
from canhaptic.errors import CanHapticError, ControlError
from canhaptic.kernels import Matrix, new, with_quick_fields
from canhaptic.kernels.records import bound
from canhaptic.lab.batch.cases import NotBatchableError, why_not_compiled
from canhaptic.lab.batch.closed_loop import LoopSettings, Signals
from canhaptic.lab.batch.engine import ChosenEngine
from canhaptic.lab.batch.group_loop import (
    GroupCase,
    GroupMeter,
    GroupRecorder,
    GroupRig,
    GroupRoom,
    GroupSync,
    LinearMotors,
    Motors,
    arrive,
    group_case,
    move_motors,
    render_group,
    run_group,
    step,
    take_group,
)
from canhaptic.lab.batch.plants import PlantValues
from canhaptic.lab.figures.figures import CONTINUOUS, METRICS, last_rows, metrics_of, sums_of, sums_of_continuous
from canhaptic.lab.figures.meter import Meter, MeterSettings, compare, take
from canhaptic.lab.loop.axis_loop import (
    FURTHEST,
    Array,
    DivergedError,
    LoopCase,
    LoopRun,
    Recorder,
    loop_case,
    plant_parts,
    render,
)
from canhaptic.lab.reference import ContinuousReference, continuous_reference
from canhaptic.scene.models import Scene
from canhaptic.sim.plant.direct_rig import DirectRig

_OF_A_SUBSTEP: Final = 4
"""Cost of a substep, whose force is found by a secant, over that of a cycle."""


def render_by(
    engine: ChosenEngine, case: LoopCase, cycles: int, recorder: Recorder | None = None,
    progress: Callable[[], None] | None = None,
) -> LoopRun:  # fmt: skip
    """Run a case as `loop.render` does; `LoopRun.engine` names the engine, and why it differs from the requested one.

    Args:
        engine: "python" gives the bits of the path over CAN; "numba" differs from it by rounding, and runs in Python
            what cannot be compiled.
        case: Case to run.
        cycles: SYNCs.
        recorder: Defines divergence; 1 km by default.
        progress: Called once per cycle.

    Raises:
        EventLimitError: The plant had more events in one sample time than allowed.
        ParameterError: The algorithm needs a value that its loop does not give.
    """
    if engine == "python":
        return render(case, cycles, recorder, progress)
    reason = why_not_compiled(case)
    if not reason:
        from canhaptic.lab.batch.compiled_loops import render_compiled

        try:
            return render_compiled(case, cycles, recorder or Recorder(), progress)
        except NotBatchableError as error:
            reason = str(error)
    return render(case, cycles, recorder, progress)._replace(engine=f"python: {reason}")


def work_of(case: LoopCase, cycles: int) -> float:
    """Cost of a run, in cycles of a light plant."""
    if case.simulation is None:
        return 0.0
    plant = PlantValues(case.simulation, case.sample_time_ns).scene()
    if not plant.efforts:
        return cycles
    accuracy = case.simulation.accuracy
    return float(cycles * _OF_A_SUBSTEP * (accuracy.substeps if accuracy else 1))


_BOOKED: Final = len(EnergyBalance._fields)
_BRANCH, _CERTIFICATE = (EnergyBalance._fields.index(name) for name in ("branch", "certificate"))


def keep_group(rig: GroupRig, room: GroupRoom, meter: GroupMeter, rows: Matrix, hold: GroupHold) -> None:
    """Replace `take_group`: write a row, first the energy received, then each motor, then the account."""
    row, account, motors = rows[int(meter.figures.cycles)], hold.account, len(room.held)
    meter.figures.cycles += 1.0
    row[0] = meter.supplied - meter.work
    for i in range(motors):
        row[1 + i], row[1 + motors + i], row[1 + 2 * motors + i] = room.seen[i], room.true[i], room.held[i]
    at = 1 + 3 * motors
    row[at], row[at + 1], row[at + 2], row[at + 3] = account.torque, account.h_i, account.h_pas, account.h_m
    row[at + 4], row[at + 5], row[at + 6], row[at + 7] = account.h_r, account.h_s, account.h_dis, account.gen
    row[at + 8], row[at + 9], row[at + 10] = account.deficit, account.leak, account.paid
    row[at + 11], row[at + 12] = account.branch, account.damping_rendered
    row[at + 13], row[at + 14] = account.certificate, account.state


def render_group_by(engine: ChosenEngine, scene: Scene, cycles: int, recorder: GroupRecorder) -> LoopRun:
    """Run the one group of a scene; see `render_group` and `scalar.render_by`.

    Raises:
        InputError: The motors of the group are not simulated, or move with others.
        ParameterError: The group cannot be built.
    """
    if engine == "python":
        return render_group(scene, cycles, recorder)
    case = group_case(scene)
    if case.why_not:
        return render_group(scene, cycles, recorder)._replace(engine=f"python: {case.why_not}")
    from canhaptic.lab.batch.compiled_loops import run_compiled

    motors = len(case.rig.loops)
    rows = np.empty((cycles, 1 + 3 * motors + _BOOKED))
    meter = run_compiled(case._replace(rig=case.rig._replace(furthest=inf)), cycles, rows, {take_group: keep_group})
    return _recorded(rows[: int(meter.figures.cycles)], motors, recorder, is_whole=meter.figures.cycles == cycles)


def _recorded(rows: Array, motors: int, recorder: GroupRecorder, *, is_whole: bool) -> LoopRun:
    """Record made of rows."""
    for interaction, *numbers in rows.tolist():
        seen, true, held = (numbers[i * motors : (i + 1) * motors] for i in range(3))
        booked = numbers[3 * motors :]
        booked[_BRANCH], booked[_CERTIFICATE] = int(booked[_BRANCH]), int(booked[_CERTIFICATE])
        balance = GroupBalance((), new(EnergyBalance, booked), ())
        try:
            recorder.take_group(GroupSync(seen, true, tuple(held), balance, interaction))
        except DivergedError:
            return recorder.run("diverged")._replace(engine="numba")
    run = recorder.run() if is_whole else recorder.run("stopped", "a position or a torque is not finite")
    return run._replace(engine="numba")


_OF_A_POSITION: Final = ("travel", "stiffness_rendered.value", "stiffness_rendered.share", *CONTINUOUS)


def group_meter(case: GroupCase, cycles: int, engine: ChosenEngine = "python") -> GroupMeter:
    """Return the sums of a loop after its cycles, or when it diverged.

    Args:
        case: Case of the group, compiled where it can be.
        cycles: SYNCs.
        engine: Python takes every case.
    """
    if engine == "numba" and case.is_compilable:
        from canhaptic.lab.batch.compiled_loops import run_compiled

        return run_compiled(case, cycles, np.empty((0, 0)), {})
    meter, memory = GroupMeter(), with_quick_fields(case.kernel.memory(case.world, case.settings))
    motors, rig, replaced = _in_python(case)
    run = _python_loop(case.kernel, tuple(replaced.items()))
    fixed = (with_quick_fields(part) for part in (case.world, case.settings))
    try:
        run(*fixed, case.kernel.state(), memory, rig, motors, case.room(), GroupMotion(), meter, [], cycles)
    except CanHapticError:  # of a mechanism that is pushed where it cannot move
        meter.figures.diverged = 1.0
    return meter


def _in_python(case: GroupCase) -> tuple[Any, GroupRig, dict[object, object]]:
    """The motors at their start, their loop to the controller, and the replacements in it."""
    motors = case.motors
    if isinstance(motors, LinearMotors):
        return motors._replace(state=list(motors.state)), case.rig, {}
    if not isinstance(motors, Motors):
        return motors.made(listed=True), case.rig, motors.replacements()
    bare = [replace(loop, signals=Signals()) for loop in case.rig.loops]  # the plants have them
    return motors, case.rig._replace(loops=bare), {move_motors: _Moved(motors, case.period)}


@lru_cache(maxsize=16)
def _python_loop(kernel: GroupKernel, replaced: tuple[tuple[object, object], ...]) -> Callable[..., None]:
    found: Callable[..., None] = bound(run_group, {step: kernel.step, **dict(replaced)})
    return found


class _Moved:
    """Replaces `move_motors` for motors that do not move by one flow."""

    def __init__(self, motors: Motors, period: int) -> None:
        self._motors, self._period, self._done = motors, period, 0.0

    def __call__(self, _motors: Motors, room: GroupRoom, cycle: int) -> float:
        """Move them to a SYNC; return the work that they did in that hold [J]."""
        motors = self._motors
        if cycle:
            motors.advance_to(cycle * self._period, tuple(room.held))
        for i, at in enumerate(motors.positions()):
            arrive(room, i, at, cycle)
        room.read[:] = motors.encoders()
        before, self._done = self._done, motors.work()
        return self._done - before


def group_figures(meter: GroupMeter, metrics: Sequence[str] | None = None) -> dict[str, float]:
    """Figures from sums; NaN for those that need a position."""
    names, sums = list(METRICS if metrics is None else metrics), meter.figures
    own = [name for name in names if name not in _OF_A_POSITION]
    figures = metrics_of(own, {name: np.array([getattr(sums, name)]) for name in sums_of(own)})
    return {name: float(figures[name][0]) if name in figures else nan for name in names}


def run_scalar(scene: Scene, cycles: int, metrics: Sequence[str] | None = None) -> dict[str, float]:
    """Return the figures of one scene by the names of `METRICS`.

    Args:
        scene: Scene with a simulated first axis, which is run; or with one group of axes.
        cycles: SYNCs.
        metrics: Names of `ALL`; None for `METRICS`, which need no continuous run.

    Raises:
        InputError: The axis is not simulated, or a continuous run is requested and it has none.
        ParameterError: The algorithm needs a value that its loop does not give.
    """
    if scene.groups:
        return group_figures(group_meter(group_case(scene), cycles), metrics)
    axis = scene.axes[0]
    case, names, continuous = loop_case(axis, scene), list(METRICS if metrics is None else metrics), None
    if any(name in CONTINUOUS for name in names):
        plant, user, effects, seed = plant_parts(axis)
        step = scene.bus.sample_time_ns
        continuous = continuous_reference(case.environment, plant, user, effects, step, cycles, seed)
    return run_case(case, cycles, names, continuous)


def run_case(
    case: LoopCase, cycles: int, metrics: Sequence[str] | None = None, continuous: ContinuousReference | None = None
) -> dict[str, float]:
    """Return the figures of one loop by the names of `METRICS`; see `run_scalar`."""
    meter = _metered(case, cycles, continuous)
    names = list(METRICS if metrics is None else metrics)
    found = asdict(meter)
    if continuous is not None:
        found |= sums_of_continuous(continuous, len(continuous.position), case.sample_time_ns * 1e-9)
    sums = {name: np.array([found[name]]) for name in sums_of(names)}
    return {name: float(values[0]) for name, values in metrics_of(names, sums).items()}


def _metered(case: LoopCase, cycles: int, continuous: ContinuousReference | None = None) -> Meter:
    """Return the meter of a loop after its cycles, or when it diverged."""
    plant, controller, loop, meter = case.make_plant(), case.controller(), loop_settings(case, cycles), Meter()
    environment = plain(case.environment)
    expected = (
        None if continuous is None else zip(continuous.position.tolist(), continuous.torque.tolist(), strict=True)
    )

    def step(position: float, held: float) -> EnergyBalance:
        true_position = plant.position
        if expected is not None:
            compare(meter, true_position, held, *next(expected))
        balance = controller.step(position, held)
        cycle, interaction = int(meter.cycles), 0.0 - plant.energy().motor
        take(environment, loop.meter, meter, cycle, position, true_position, held, interaction, balance)
        if not -loop.furthest < true_position < loop.furthest:
            raise DivergedError(f"the axis is at {true_position:g}")
        return balance

    rig = DirectRig(
        plant, step, case.sample_time_ns, case.delay, case.counts_per_unit, case.torque_quantum, case.torque_limit
    )
    try:
        rig.run(cycles)
    except ControlError:
        meter.diverged = 1.0
    return meter


def loop_settings(case: LoopCase, cycles: int) -> LoopSettings:
    """Loop between plant and controller in a run of some cycles."""
    period = case.sample_time_ns * 1e-9
    meter = MeterSettings(float(last_rows(cycles, period).start), case.device_damping / period, case.device_friction)
    return LoopSettings(
        case.delay, case.counts_per_unit or 0.0, case.torque_quantum or 0.0, case.torque_limit or inf, FURTHEST, meter
    )
