"""One group of a scene in a loop without a bus: motors, the controller of the group, and a record of every SYNC.

Order and rounding are those of `DirectRig`: the true positions, the encoders' counts, the step, the torque that the
drives apply for the command.
"""

from array import array
from collections.abc import Callable, Sequence
from math import inf, sqrt
from typing import Final, NamedTuple

import numpy as np

from canhaptic.control.multi_axis.group_controller import GroupBalance, GroupController
from canhaptic.errors import ControlError
from canhaptic.lab.batch.closed_loop import LoopSettings, commanded, measured
from canhaptic.lab.loop.axis_loop import FURTHEST, DivergedError, LoopRun, Recorder
from canhaptic.lab.loop.scenes import mechanism_of_group
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.scene.parts import build_group, build_mechanism, build_plant
from canhaptic.scene.torque_history import simulation_of

_PER_MILLE: Final = 1e-3


class Motors(NamedTuple):
    """The motors of a group."""

    positions: Callable[[], Sequence[float]]  # true
    velocities: Callable[[], Sequence[float]]  # true
    encoders: Callable[[], Sequence[float]]  # the positions after the effects of encoders
    advance_to: Callable[[int, tuple[float, ...]], None]
    work: Callable[[], float]  # of all motors since the start [J]
    user_work: Callable[[], float]  # of all hands since the start [J]
    evaluations: Callable[[], int]  # of the equations of motion since the start


class GroupSync(NamedTuple):
    """One SYNC of a group; positions and torques of every motor."""

    seen: Sequence[float]  # positions as the controller saw them [m or rad]
    true: Sequence[float]  # positions [m or rad]
    held: tuple[float, ...]  # torques in the hold that ended [N or N*m]
    balance: GroupBalance
    interaction: float  # true energy that came in by motors and mover since the start [J]


def _run_group_loop(
    scene: Scene, cycles: int, take: Callable[[GroupSync], None], controller: GroupController | None = None
) -> None:
    """Run the one group of a scene.

    Args:
        scene: Scene with one group, alone.
        cycles: SYNCs.
        take: Called at every SYNC; may raise to end the run.
        controller: Controller at rest; None: that of the scene.

    Raises:
        InputError: The motors of the group are not simulated, or move with others.
        ParameterError: The group cannot be built.
        ControlError: The controller saw or computed a number that is not finite.
    """
    (group,) = scene.groups
    axes = [scene.axis(name) for name in group.axes]
    controller = controller or build_group(scene, group)
    motors, period = motors_of(scene, axes), scene.bus.sample_time_ns
    loops = [loop_of(axis, scene.bus.delay) for axis in axes]
    nothing = (0.0,) * len(axes)
    held, waiting, supplied = nothing, nothing, 0.0
    for cycle in range(cycles):
        if cycle:
            motors.advance_to(cycle * period, held)
        true = motors.positions()
        seen = [measured(loop, at) for loop, at in zip(loops, motors.encoders(), strict=True)]
        balance = controller.step(seen, held)
        supplied += balance.supplied
        take(GroupSync(seen, true, held, balance, supplied - motors.work()))
        sent = tuple([commanded(loop, torque) for loop, torque in zip(loops, balance.torques, strict=True)])
        held, waiting = (waiting, sent) if scene.bus.delay else (sent, nothing)


def loop_of(axis: AxisScene, delay: int) -> LoopSettings:
    """Loop between a motor and the controller of its group."""
    parameters, rated = axis.parameters, axis.parameters.rated_torque
    quantum = 0.0 if rated is None else rated * _PER_MILLE
    return LoopSettings(delay, parameters.counts_per_unit or 0.0, quantum, parameters.torque_limit or inf)


def motors_of(scene: Scene, axes: Sequence[AxisScene]) -> Motors:
    """Plant that a group of axes moves, at its start.

    Raises:
        InputError: The motors are not simulated, or move with others.
    """
    of, names = mechanism_of_group(scene), [axis.parameters.name for axis in axes]
    if of is None:
        return _own_plants(scene, axes)
    mechanism, place = build_mechanism(of, scene.bus.sample_time_ns), [of.axes.index(name) for name in names]
    order = [names.index(name) for name in of.axes]
    mechanism.begin(0)

    def positions() -> list[float]:
        return [mechanism.positions[at] for at in place]

    return Motors(
        positions,
        lambda: [mechanism.velocities[at] for at in place],
        positions,
        lambda now, torques: mechanism.advance_to(now, tuple([torques[at] for at in order])),
        lambda: sum(mechanism.energy(at).motor for at in range(len(place))),
        lambda: sum(mechanism.energy(at).user for at in range(len(place))),
        lambda: int(getattr(mechanism, "iterations", 0)),
    )


def _own_plants(scene: Scene, axes: Sequence[AxisScene]) -> Motors:
    plants = [build_plant(simulation_of(axis), scene.bus.sample_time_ns) for axis in axes]

    def advance(now: int, torques: tuple[float, ...]) -> None:
        for plant, torque in zip(plants, torques, strict=True):
            plant.advance_to(now, torque)

    for plant in plants:
        plant.begin(0)
    return Motors(
        lambda: [plant.position for plant in plants],
        lambda: [plant.velocity for plant in plants],
        lambda: [plant.encoder_position for plant in plants],
        advance,
        lambda: sum(plant.energy().motor for plant in plants),
        lambda: sum(plant.energy().user for plant in plants),
        lambda: sum(plant.products for plant in plants),
    )


class GroupRecorder(Recorder):
    """Records every SYNC of a group; positions and torques are of shape (n, axes).

    Args:
        axes: Number of motors.
        furthest: Distance from the origin that counts as divergence [m or rad].
        tick: Called at every SYNC.
    """

    def __init__(self, axes: int, furthest: float = FURTHEST, tick: Callable[[], None] = lambda: None) -> None:
        super().__init__()
        self._axes, self._furthest, self._tick = axes, furthest, tick
        self._seen, self._true, self._held = array("d"), array("d"), array("d")

    def take_group(self, hold: GroupSync) -> None:
        """Take one SYNC.

        Raises:
            DivergedError: A position is not finite, or farther away than any user moved it.
        """
        self.take(0.0, 0.0, sqrt(sum(torque * torque for torque in hold.held)), hold.balance.account, -hold.interaction)
        self._seen.extend(hold.seen)
        self._true.extend(hold.true)
        self._held.extend(hold.held)
        self._tick()
        if not all(abs(at) < self._furthest for at in hold.true):
            raise DivergedError(f"the group is at {tuple(hold.true)}, expected within {self._furthest:g}")

    def run(self, ended: str = "", reason: str = "") -> LoopRun:
        """Everything recorded so far; see `Recorder`."""
        seen, true, held = (np.array(flat).reshape(-1, self._axes) for flat in (self._seen, self._true, self._held))
        return super().run(ended, reason)._replace(position=seen, true_position=true, torque=held)


def render_group(scene: Scene, cycles: int, recorder: GroupRecorder) -> LoopRun:
    """Run the one group of a scene; a run that diverges or fails ends early and is marked so.

    Raises:
        InputError: The motors of the group are not simulated, or move with others.
        ParameterError: The group cannot be built.
    """
    try:
        _run_group_loop(scene, cycles, recorder.take_group)
    except DivergedError:
        return recorder.run("diverged")
    except ControlError as error:
        return recorder.run("stopped", str(error))
    return recorder.run()
