"""Construction of the control side of a scene: controllers of axes and groups, meters of the accounts, servo drives."""

from collections.abc import Sequence
from math import inf
from typing import TYPE_CHECKING, Any, Final, cast

from canhaptic.control.axis_meter import Accuracy, AxisMeter, SilentMeter
from canhaptic.control.environments import Environment, plain
from canhaptic.control.multi_axis import build_group_controller
from canhaptic.control.passivity import Controller, LoopProperties, build_controller
from canhaptic.control.ports import Port
from canhaptic.drive.profile.causality import IMPEDANCE
from canhaptic.errors import InputError, ParameterError
from canhaptic.registry import load
from canhaptic.scene.buses import BusParameters, kind_of, part
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.models import FAR, AxisScene, Scene
from canhaptic.scene.models import Port as PortScene
from canhaptic.units import Parameters

if TYPE_CHECKING:
    from canhaptic.control.mechanisms.kinematics import Kinematics
    from canhaptic.control.motion_checks import FrictionDeclared
    from canhaptic.control.multi_axis.group_controller import NetworkEnvironment
    from canhaptic.drive.can.link import Link
    from canhaptic.drive.ethercat.bus_cycle import EthercatBusCycle
    from canhaptic.far.parameters import FarParameters
    from canhaptic.far.port import FarPort

_OF_THE_DEVICE: Final = ("device_damping", "device_friction", "device_damping_bound", "device_friction_bound")
_SETTLED: Final = 3.0
"""Time constants after which a torque has settled, to 5 %."""
_PROGRAMS: Final = {
    "certificates": "canhaptic.control.passivity.asked_torque:GuardedProgram",
    "none": "canhaptic.control.passivity.asked_torque:UnguardedProgram",
}
"""Guard -> "module:Class" of the controller of an axis whose torques a program requests."""


def loop_as_known(axis: AxisScene) -> LoopProperties:
    """Return the loop of an axis with the encoder errors and the torque limit of its simulated motor.

    The encoder count is widened by the errors; a torque that the motor cannot reach is reduced before it is certified.
    """
    if axis.simulation is None:
        return axis.loop
    from canhaptic.scene.far_side import loop_of_simulated

    return loop_of_simulated(axis, axis.simulation)


def _accuracy_of(axis: AxisScene, passivity: ComponentSpec, together: Sequence[AxisScene]) -> Accuracy:
    """Return the accuracy of sensors and device of an axis.

    Args:
        axis: One axis.
        passivity: Passivity algorithm of the axis, or of its group.
        together: All axes of that algorithm.
    """
    loop = loop_as_known(axis)
    late = (loop.torque_window or 0.0) + (loop.current_lag or 0.0)  # beyond a hold too, where nothing is certified
    certifies = passivity.name == "guarded"
    bounds_motion = certifies and _bounds_motion(passivity.parameters, together)
    accuracy = Accuracy(
        sample_time=loop.sample_time * (1.0 + (loop.sync_jitter or 0.0)),
        position=0.5 * loop.encoder_count,
        late=0.0 if bounds_motion else late,
        late_speed=axis.parameters.largest_speed if certifies else None,
        counts_losses=bool(axis.group) or not bounds_motion,
        largest_speed=axis.parameters.largest_speed,
        largest_torque=axis.parameters.torque_limit,
        **{key: getattr(loop, key) for key in _OF_THE_DEVICE},
    )
    if axis.simulation is None:
        return accuracy
    from canhaptic.scene.far_side import with_torque_errors

    return with_torque_errors(accuracy, axis, axis.simulation)


def _bounds_motion(passivity: Parameters, together: Sequence[AxisScene]) -> bool:
    """Whether the declared hand bounds the motion inside a hold; damping and friction of the device do not."""
    force, speed = (getattr(passivity, key, None) for key in ("hand_force", "hand_speed"))
    return bool(speed or (force is not None and all(of.loop.moving_mass is not None for of in together)))


def friction_declared(axis: AxisScene) -> "FrictionDeclared | None":
    """Return the declarations against which the motion of an axis is checked; None if one is missing."""
    loop, parameters = loop_as_known(axis), axis.passivity.parameters
    force, push = (getattr(parameters, key, None) for key in ("hand_force", "hand_push"))
    if not loop.device_friction or loop.moving_mass is None or force is None:
        return None
    from canhaptic.control.motion_checks import FrictionDeclared

    return FrictionDeclared(
        loop.device_friction,
        loop.moving_mass,
        loop.sample_time,
        hand_force=force,
        hand_push=inf if push is None else push,
        count=loop.encoder_count,
        jitter=loop.sync_jitter or 0.0,
        late=(loop.torque_window or 0.0) + (loop.current_lag or 0.0),
    )


def build_axis_controller(axis: AxisScene) -> Controller:
    """Return the passivity algorithm of one torque axis around its environment.

    Raises:
        ParameterError: A value that the algorithm needs is missing, or the axis is in a group.
    """
    if axis.guard:
        kind, known = load(_PROGRAMS, axis.guard, "guard"), axis.passivity.parameters
        is_known = isinstance(known, kind.parameters_type)
        program: Controller = kind(known if is_known else kind.parameters_type(), loop_as_known(axis))
        return program
    environment = cast(Environment, axis.environment.parameters)  # every class of ENVIRONMENTS is one
    if axis.passivity.own is not None:
        controller: Controller = axis.passivity.own(environment, axis.passivity.parameters, loop_as_known(axis))
        return controller
    return build_controller(
        environment, axis.passivity.name, axis.passivity.parameters, loop_as_known(axis), axis.parameters.hold_dither
    )


def controller_of(scene: Scene, port: PortScene) -> Any:
    """Return the controller of a port of a scene, at rest.

    Raises:
        ParameterError: What it renders, kinematics and axes do not fit together, or a value is missing.
    """
    (axis, *others), by = port.axes, port.passivity
    if axis.guard == FAR:
        return build_far_port(scene, axis)
    check_kinematics(port)
    if mixed := [of.parameters.name for of in others if of.parameters.causality.kind != port.causality.kind]:
        text = f"{port.name!r} renders on {axis.parameters.name}, {port.causality.kind}, and on {', '.join(mixed)}"
        raise ParameterError(f"{text}; expected axes of one kind")
    if port.causality is not IMPEDANCE:
        from canhaptic.scene.displays import display_controller

        return display_controller(port)
    if not port.section:
        return build_axis_controller(axis)
    loops = [loop_as_known(of) for of in port.axes]
    kinematics = cast("Kinematics", port.kinematics.parameters)  # every class of KINEMATICS is one
    network = cast("NetworkEnvironment", port.rendered.parameters)  # every class of NETWORKS is one
    return build_group_controller(network, kinematics, by.name, by.parameters, loops)


def check_kinematics(port: PortScene) -> None:
    """Refuse a port whose kinematics have another number of axes.

    Raises:
        ParameterError: The numbers differ.
    """
    count = getattr(port.kinematics.parameters, "axes", 1)
    if count != len(port.axes):
        names = ", ".join(axis.parameters.name for axis in port.axes)
        text = f"kinematics {port.kinematics.name!r} has {count} motor axes"
        raise ParameterError(f"{text}, expected the {len(port.axes)} of the group: {names}")


def build_ports(scene: Scene) -> list[Port]:
    """Return the ports of a scene, at rest: the axes outside groups, then the groups."""
    row, ports = len(scene.axes), list[Port]()
    for of in scene.ports:
        controller = controller_of(scene, of)
        if not of.section:
            ports.append(Port(of.name, of.places, of.places[0], controller))
            continue
        from canhaptic.control.multi_axis.group_controller import AxisGroup

        ports.append(AxisGroup(of.name, of.places, row, controller))
        row += 1
    return ports


def build_far_port(scene: Scene, axis: AxisScene) -> "FarPort":
    """Return the port of the axis that is coupled to a far side.

    Raises:
        ParameterError: A value that its certificates need is missing.
    """
    from canhaptic.far.port import FarPort

    known = axis.passivity.parameters
    if not isinstance(known, FarPort.parameters_type):
        text = f"{axis.parameters.name}: got algorithm {axis.passivity.name}, expected guarded: a far side is rendered"
        raise ParameterError(f"{text} by what is certified of the hand and the device")
    return FarPort(cast("FarParameters", scene.far), known, loop_as_known(axis))


def build_axis_meters(scene: Scene) -> list[AxisMeter]:
    """Return the meter of each axis."""
    return [_axis_meter(axis, scene) for axis in scene.axes]


def _axis_meter(axis: AxisScene, scene: Scene) -> AxisMeter:
    port = scene.port_of(axis)
    if axis.parameters.admittance is not None:
        from canhaptic.scene.displays import mass_felt

        return SilentMeter(mass_felt(axis, port))
    accuracy = _accuracy_of(axis, port.passivity, port.axes)
    rendered = cast(Environment, axis.environment.parameters)
    environment = plain(rendered) if hasattr(rendered, "contact") and not axis.guard else None
    if (declared := friction_declared(axis)) is None:
        return AxisMeter(accuracy, environment)
    from canhaptic.control.motion_checks import FrictionWatch

    return AxisMeter(accuracy, environment, FrictionWatch(declared))


def lateness_of(axis: AxisScene) -> float:
    """Return the longest time from a hold's begin until its torque has settled [s]; 0 where no torque is sent."""
    if axis.parameters.causality.holds:
        return 0.0
    return (axis.loop.torque_window or 0.0) + _SETTLED * (axis.loop.current_lag or 0.0)


def build_servo_drive(
    axis: AxisScene, line: "Link | EthercatBusCycle", bus: BusParameters, *, dry_run: bool = False
) -> Any:
    """Return the master's image of the drive of one axis, of the kind of its bus.

    Args:
        axis: The axis.
        line: The master's end of the bus.
        bus: Parameters of the bus.
        dry_run: Whether the torque sent is always 0.

    Raises:
        DictionaryError: The drive's dictionary cannot be used.
        InputError: A dry run of an admittance display.
    """
    known, dictionary = axis.parameters, axis.parameters.dictionary()
    if dry_run:
        require_torque_axis(axis)
    if not known.causality.holds:
        known = known.model_copy(update={"torque_limit": axis.loop.torque_limit})  # less if not verified
    drive_on = part(kind_of(bus), "drive")
    return drive_on(line, known, dictionary, bus, dry_run=dry_run, lateness=lateness_of(axis))


def require_torque_axis(axis: AxisScene) -> None:
    """Refuse a dry run of an axis that is an admittance display, which takes no torque from the master.

    Raises:
        InputError: It is an admittance display.
    """
    if holds := axis.parameters.causality.holds:
        text = f"{axis.parameters.name}: {axis.parameters.causality.kind} cannot run without torque: its drive holds"
        raise InputError(f"{text} {holds}; leave --no-torque out, and lower speed_limit and acceleration_limit")
