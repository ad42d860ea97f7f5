"""One group of a scene in a loop without a bus, with the names of the batch; order and rounding as in `DirectRig`.

What a figure of one axis means for a group: energies are those of all its motors and of a mover; torques are Euclidean
norms, `torque_peak` is the largest of any motor. Travel, stiffness and what is compared with a continuous run are NaN:
a group has no position.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from math import inf, nan, sqrt
from typing import Final, NamedTuple

import numpy as np

from canhaptic.control.balance import Branch
from canhaptic.control.multi_axis.group_controller import GroupBalance
from canhaptic.errors import ControlError, InputError
from canhaptic.scene.accuracy_choice import simulation_of
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.scene.parts import build_group, build_mechanism, build_plant
from canhaptic.study.batch.closed_loop import LoopSettings, commanded, measured
from canhaptic.study.batch.meter import Meter, count_branch, take_energy
from canhaptic.study.figures import CONTINUOUS, METRICS, metrics_of, sums_of
from canhaptic.study.loop import FURTHEST

_PER_MILLE: Final = 1e-3
_OUT_OF_CONTACT: Final = (Branch.FREE.value, Branch.EXIT.value)
_OF_A_POSITION: Final = ("travel", "stiffness_rendered.value", "stiffness_rendered.share", *CONTINUOUS)


class _Motors(NamedTuple):
    """What a group moves."""

    positions: Callable[[], Sequence[float]]  # true
    encoders: Callable[[], Sequence[float]]  # the same after the effects of encoders
    advance_to: Callable[[int, tuple[float, ...]], None]
    work: Callable[[], float]  # of all motors since the start [J]


def run_group(scene: Scene, cycles: int, metrics: Sequence[str] | None = None) -> dict[str, float]:
    """Returns the figures of the one group of a scene; see `run_scalar`.

    Raises:
        InputError: The motors of the group are not simulated, or move with others.
        ParameterError: The group cannot be built.
    """
    names = list(METRICS if metrics is None else metrics)
    found = {name: np.array([value]) for name, value in asdict(_metered(scene, cycles)).items()}
    own = [name for name in names if name not in _OF_A_POSITION]
    figures = metrics_of(own, {name: found[name] for name in sums_of(own)})
    return {name: float(figures[name][0]) if name in figures else nan for name in names}


def _metered(scene: Scene, cycles: int) -> Meter:
    """Returns the meter of the loop after its cycles, or when it diverged."""
    (group,), meter = scene.groups, Meter()
    axes = [scene.axis(name) for name in group.axes]
    controller, motors, period = build_group(scene, group), _motors_of(scene, axes), scene.bus.sample_time_ns
    loops = [_loop_of(axis, scene.bus.delay) for axis in axes]
    nothing = (0.0,) * len(axes)
    held, waiting, supplied = nothing, nothing, 0.0
    before: Sequence[float] = motors.positions()
    for cycle in range(cycles):
        if cycle:
            motors.advance_to(cycle * period, held)
        true = motors.positions()
        try:
            seen = [measured(loop, at) for loop, at in zip(loops, motors.encoders(), strict=True)]
            balance = controller.step(seen, held)
        except ControlError:
            meter.diverged = 1.0
            break
        supplied += balance.supplied
        meter.lost += sum(
            axis.loop.device_damping * (b - a) ** 2 / scene.bus.sample_time
            for axis, a, b in zip(axes, before, true, strict=True)
            if axis.loop.device_damping
        )
        before = true
        _take(meter, loops[0], held, supplied - motors.work(), balance)
        if not all(-FURTHEST < at < FURTHEST for at in true):
            meter.diverged = 1.0
            break
        sent = tuple([commanded(loop, torque) for loop, torque in zip(loops, balance.torques, strict=True)])
        held, waiting = (waiting, sent) if scene.bus.delay else (sent, nothing)
    return meter


def _take(meter: Meter, loop: LoopSettings, held: tuple[float, ...], interaction: float, balance: GroupBalance) -> None:
    """Takes one SYNC; see `meter.take`."""
    account, norm = balance.account, sqrt(sum(torque * torque for torque in held))
    meter.cycles += 1.0
    take_energy(loop.meter, meter, 0.0, interaction, account)
    meter.torque_peak = max(meter.torque_peak, *map(abs, held))
    meter.variation += abs(norm - meter.torque)
    meter.torque = norm
    meter.certificate = max(meter.certificate, float(account.certificate))
    count_branch(meter, account.branch)
    if account.branch not in _OUT_OF_CONTACT:
        meter.contacts += 1.0
        meter.damping += account.damping_rendered
        meter.damping_least = min(meter.damping_least, account.damping_rendered)
        meter.damping_most = max(meter.damping_most, account.damping_rendered)


def _loop_of(axis: AxisScene, delay: int) -> LoopSettings:
    parameters, rated = axis.parameters, axis.parameters.rated_torque
    quantum = 0.0 if rated is None else rated * _PER_MILLE
    return LoopSettings(delay, parameters.counts_per_unit or 0.0, quantum, parameters.torque_limit or inf)


def _motors_of(scene: Scene, axes: Sequence[AxisScene]) -> _Motors:
    names = [axis.parameters.name for axis in axes]
    shared = [of for of in scene.mechanisms if not set(of.axes).isdisjoint(names)]
    if not shared:
        plants = [build_plant(simulation_of(axis), scene.bus.sample_time_ns) for axis in axes]

        def advance(now: int, torques: tuple[float, ...]) -> None:
            for plant, torque in zip(plants, torques, strict=True):
                plant.advance_to(now, torque)

        for plant in plants:
            plant.begin(0)
        return _Motors(
            lambda: [plant.position for plant in plants],
            lambda: [plant.encoder_position for plant in plants],
            advance,
            lambda: sum(plant.energy().motor for plant in plants),
        )
    (of, *others) = shared
    if others or set(of.axes) != set(names):
        raise InputError(
            f"{scene.source}: group {scene.groups[0].name!r} moves the axes {', '.join(names)}, its mechanism "
            f"{', '.join(of.axes)}; expected the same axes: use canhaptic run, which moves all of them"
        )
    mechanism, place = build_mechanism(of, scene.bus.sample_time_ns), [of.axes.index(name) for name in names]
    order = [names.index(name) for name in of.axes]
    mechanism.begin(0)

    def positions() -> list[float]:
        return [mechanism.positions[at] for at in place]

    return _Motors(
        positions,
        positions,
        lambda now, torques: mechanism.advance_to(now, tuple([torques[at] for at in order])),
        lambda: sum(mechanism.energy(at).motor for at in range(len(place))),
    )
