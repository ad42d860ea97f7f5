"""The one group of a scene in kernel form: environment, algorithm and motors."""

from dataclasses import replace
from typing import Any, NamedTuple, cast

from canhaptic.control.mechanisms.kinematics import Kinematics
from canhaptic.control.multi_axis import GROUP_ALGORITHMS
from canhaptic.control.multi_axis.group_controller import NetworkEnvironment
from canhaptic.control.multi_axis.group_kernel import GroupKernel
from canhaptic.control.multi_axis.group_motion import (
    RequestedEfforts,
    World,
    motion_memory,
    motion_settings,
    why_not_world,
    world_of,
)
from canhaptic.kernels import list_of_zeros
from canhaptic.lab.batch.closed_loop import LoopSettings
from canhaptic.lab.batch.group_closed_loop import GroupRig, GroupRoom, LinearMotors
from canhaptic.lab.batch.group_events import EventMotorsPlan
from canhaptic.lab.batch.group_five_bar import FiveBarPlan
from canhaptic.lab.batch.group_loop import Motors, loop_of, motors_of
from canhaptic.lab.batch.group_motors import motors_in_loop
from canhaptic.lab.batch.signal_effects import SignalEffects
from canhaptic.lab.loop.axis_loop import FURTHEST
from canhaptic.registry import load
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.scene.parts import check_group
from canhaptic.scene.sensor_errors import loop_as_known


class GroupCase(NamedTuple):
    """One group in kernel form."""

    kernel: GroupKernel
    world: World
    settings: Any
    rig: GroupRig
    motors: LinearMotors | EventMotorsPlan | FiveBarPlan | Motors
    period: int  # [ns]
    why_not: str = ""  # reason by name why its loop cannot be compiled; "" where it can

    @property
    def is_compilable(self) -> bool:
        """Whether its loop can be compiled."""
        return not self.why_not

    def room(self) -> GroupRoom:
        """Return buffers of zeros."""
        axes = len(self.rig.loops)
        one = [list_of_zeros(axes) for _ in GroupRoom._fields]
        wish = RequestedEfforts(*(list_of_zeros(axes) for _ in range(4)))
        return GroupRoom(*one)._replace(asked=motion_memory(self.world, self.rig.true), wish=wish)  # type: ignore[arg-type]


def group_case(scene: Scene, *, explains: bool = False) -> GroupCase:
    """Return the one group of a scene.

    Args:
        scene: Scene with one group, alone.
        explains: Whether the shares of spring and damper are needed.

    Raises:
        InputError: The motors of the group are not simulated, or move with others.
        ParameterError: The group cannot be built.
    """
    (group,) = scene.groups
    check_group(group)
    axes = [scene.axis(name) for name in group.axes]
    loops = tuple(loop_as_known(axis) for axis in axes)
    environment, kinematics = (cast(Any, part.parameters) for part in (group.network, group.kinematics))
    world = world_of(cast(NetworkEnvironment, environment), cast(Kinematics, kinematics), loops)
    kernel: GroupKernel = load(GROUP_ALGORITHMS, group.passivity.name, "group algorithm").kernel
    settings = kernel.settings(world, group.passivity.parameters, loops)
    exact = tuple(loop.model_copy(update={"encoder_count": 0.0}) for loop in loops)
    time = scene.bus.sample_time
    rig = GroupRig(
        scene.bus.delay, [_with_effects(loop_of(axis, scene.bus.delay), axis, time) for axis in axes],
        [(axis.loop.device_damping or 0.0) / time for axis in axes], FURTHEST, explains, motion_settings(world, exact),
    )  # fmt: skip
    found, period = motors_in_loop(scene, axes), scene.bus.sample_time_ns
    if isinstance(found, str):
        return GroupCase(kernel, world, settings, rig, motors_of(scene, axes), period, found)
    return GroupCase(kernel, world, settings, rig, found, period, why_not_world(world))


def _with_effects(loop: LoopSettings, axis: AxisScene, sample_time: float) -> LoopSettings:
    """Loop between a motor and its controller, with the effects of its plant on torque and encoder."""
    simulation = axis.simulation
    if simulation is None:
        return loop
    return replace(loop, signals=SignalEffects.of(simulation.effects).at(sample_time, simulation.seed))
