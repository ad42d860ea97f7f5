"""The parts of one axis made from its scene: plant, controller, simulated drive, servo drive."""

from typing import TYPE_CHECKING, cast

import can

from canhaptic.canopen.eds import read_dictionary
from canhaptic.control.admittance import build_display_controller, build_display_group
from canhaptic.control.axis_meter import AxisMeter, SilentMeter
from canhaptic.control.environments.environment import Environment
from canhaptic.control.environments.plain import plain
from canhaptic.control.multi_axis import build_group_controller
from canhaptic.control.passivity import build_controller
from canhaptic.control.passivity.controller import Controller
from canhaptic.drive.axis_parameters import BusParameters
from canhaptic.drive.can.link import Link
from canhaptic.drive.can.servo_drive import ServoDrive
from canhaptic.errors import InputError, ParameterError
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.models import AxisScene, AxisSimulation, GroupScene, MechanismScene, Scene
from canhaptic.scene.sensor_errors import accuracy_of, friction_declared, loop_as_known

if TYPE_CHECKING:
    from canhaptic.control.admittance.properties import DisplayProperties
    from canhaptic.control.mechanisms.kinematics import Kinematics
    from canhaptic.control.multi_axis.axis_group import AxisGroup
    from canhaptic.control.multi_axis.group_controller import GroupController, NetworkEnvironment
    from canhaptic.sim.drive.can.drive_node import SimulatedDrive
    from canhaptic.sim.drive.drive_parameters import SimulatedDriveParameters
    from canhaptic.sim.plant.effects import Effect
    from canhaptic.sim.plant.mechanism import Mechanism, MechanismParameters
    from canhaptic.sim.plant.mechanism.shared_mechanism import MechanismMotor
    from canhaptic.sim.plant.plant import Plant


def build_plant(simulation: AxisSimulation, sample_time_ns: int, *, compiled: bool = False) -> "Plant":
    """Return the motor and user of one axis, at rest until the first SYNC with the drive enabled.

    Args:
        simulation: Plant, user and effects.
        sample_time_ns: Time between two SYNCs [ns].
        compiled: Whether holds run compiled by numba, for whole runs without a bus; not for an admittance display.
    """
    effects = [effect_of(effect) for effect in simulation.effects]
    if simulation.admittance is not None:
        from canhaptic.sim.plant.velocity_drive import AdmittancePlant

        return AdmittancePlant(
            simulation.plant, simulation.admittance, simulation.user, effects, sample_time_ns, simulation.seed,
            simulation.accuracy,
        )  # fmt: skip
    from canhaptic.sim.plant.plant import Plant

    return Plant(
        simulation.plant, simulation.user, effects, sample_time_ns, simulation.seed, simulation.accuracy,
        compiled,
    )  # fmt: skip


def effect_of(effect: ComponentSpec) -> "Effect":
    """Object of an effect's parameters."""
    return cast("Effect", effect.parameters)  # every class of EFFECTS is one


def build_axis_controller(axis: AxisScene) -> Controller:
    """Return the passivity algorithm of one axis around its environment.

    Raises:
        ParameterError: The algorithm cannot do without a value that is not given, or a group renders on the axis.
    """
    if axis.group:
        raise ParameterError(
            f"{axis.parameters.name}: group {axis.group!r} renders on this axis, expected one that renders by itself"
        )
    if axis.parameters.admittance is not None:
        return build_display_controller(
            axis.environment.parameters, axis.passivity.name, axis.passivity.parameters, display_properties(axis)
        )
    environment = cast(Environment, axis.environment.parameters)  # every class of ENVIRONMENTS is one
    if axis.passivity.own is not None:
        controller: Controller = axis.passivity.own(environment, axis.passivity.parameters, loop_as_known(axis))
        return controller
    return build_controller(environment, axis.passivity.name, axis.passivity.parameters, loop_as_known(axis))


def display_properties(axis: AxisScene) -> "DisplayProperties":
    """Declared properties of an admittance display.

    Raises:
        ParameterError: A limit without which nothing may move is missing, or the axis is no admittance display.
    """
    given, display = axis.parameters, axis.parameters.admittance
    if display is None:
        raise ParameterError(f"{given.name}: has no `admittance`; expected an admittance display")
    if "speed_limit" not in given.model_fields_set or display.acceleration_limit is None:
        missing = "admittance.acceleration_limit" if display.acceleration_limit is None else "speed_limit"
        raise ParameterError(f"{given.name}: {missing}: missing; an admittance display needs it, add it")
    from canhaptic.control.admittance.properties import DisplayProperties

    force, time = display.force, axis.loop.sample_time
    counts = given.counts_per_unit
    quantum = 1.0 / (counts * time) if display.mode == "position" else 1.0 / (display.velocity_counts or counts)
    return DisplayProperties(
        sample_time=time, jitter=axis.loop.sync_jitter or 0.0,
        delay=axis.loop.delay, sampling=force.sampling, latency=force.latency, filter=force.filter,
        force_slew=force.slew, handle_acceleration=display.handle_acceleration, force_error=force.error,
        encoder_count=1.0 / counts, speed_quantum=quantum, speed_limit=given.speed_limit,
        acceleration_limit=display.acceleration_limit, torque_limit=given.torque_limit,
        **({} if display.position_low is None else {"position_low": display.position_low}),
        **({} if display.position_high is None else {"position_high": display.position_high}),
    )  # fmt: skip


def build_axis_controllers(scene: Scene) -> list[Controller]:
    """Return one controller for each axis that renders by itself; those of groups are in `build_axis_groups`."""
    return [build_axis_controller(axis) for axis in scene.axes if not axis.group]


def build_axis_groups(scene: Scene) -> "list[AxisGroup]":
    """Return the groups of a scene, at rest."""
    if not scene.groups:
        return []
    from canhaptic.control.multi_axis.axis_group import AxisGroup

    return [
        AxisGroup(group.name, places, build_group(scene, group))
        for group, places in zip(scene.groups, group_places(scene), strict=True)
    ]


def group_places(scene: Scene) -> list[tuple[int, ...]]:
    """Return the places of the axes of each group among the axes of the scene."""
    places = {axis.parameters.name: place for place, axis in enumerate(scene.axes)}
    return [tuple(places[name] for name in group.axes) for group in scene.groups]


def build_axis_meters(scene: Scene) -> list[AxisMeter]:
    """Return the meter of each axis."""
    algorithms = {group.name: group.passivity.name for group in scene.groups}
    return [_axis_meter(axis, algorithms.get(axis.group, axis.passivity.name)) for axis in scene.axes]


def _axis_meter(axis: AxisScene, algorithm: str) -> AxisMeter:
    if axis.parameters.admittance is not None:
        return SilentMeter()
    environment = None if axis.group else plain(cast(Environment, axis.environment.parameters))
    if (declared := friction_declared(axis)) is None:
        return AxisMeter(accuracy_of(axis, algorithm), environment)
    from canhaptic.control.friction_watch import FrictionWatch

    return AxisMeter(accuracy_of(axis, algorithm), environment, FrictionWatch(declared))


def build_group(scene: Scene, group: GroupScene) -> "GroupController":
    """Return the controller of one group.

    Raises:
        ParameterError: Network, kinematics and axes do not fit together, or a value is missing.
    """
    if any(scene.axis(name).parameters.admittance is not None for name in group.axes):
        return _build_display_group(scene, group)
    check_group(group)
    loops = [loop_as_known(scene.axis(name)) for name in group.axes]
    kinematics = cast("Kinematics", group.kinematics.parameters)  # every class of KINEMATICS is one
    network = cast("NetworkEnvironment", group.network.parameters)  # every class of NETWORKS is one
    return build_group_controller(network, kinematics, group.passivity.name, group.passivity.parameters, loops)


def check_group(group: GroupScene) -> None:
    """Refuse a group whose parts do not fit its axes.

    Raises:
        ParameterError: They do not.
    """
    kinematics = cast("Kinematics", group.kinematics.parameters)
    if kinematics.axes != len(group.axes):
        raise ParameterError(
            f"kinematics {group.kinematics.name!r} has {kinematics.axes} motor axes, expected the {len(group.axes)} of "
            f"the group: {', '.join(group.axes)}"
        )


def _build_display_group(scene: Scene, group: GroupScene) -> "GroupController":
    axes = [scene.axis(name) for name in group.axes]
    others = [axis.parameters.name for axis in axes if axis.parameters.admittance is None]
    if others:
        raise ParameterError(
            f"group {group.name!r} has admittance displays and {', '.join(others)}, which is none; expected one kind"
        )
    check_group(group)
    properties, kinematics = (
        [display_properties(axis) for axis in axes],
        cast("Kinematics", group.kinematics.parameters),
    )
    return build_display_group(
        group.network.parameters, group.passivity.name, group.passivity.parameters, properties, kinematics
    )


def build_mechanism(of: MechanismScene, sample_time_ns: int) -> "Mechanism":
    """Return a simulated mechanism, at rest until the last of its drives is enabled.

    Raises:
        ParameterError: It cannot be in the pose of its parameters.
    """
    parameters = cast("MechanismParameters", of.mechanism.parameters)  # every class of MECHANISMS is one
    return parameters.build(of.hand, sample_time_ns, of.substeps)


def build_servo_drive(axis: AxisScene, link: Link, bus: BusParameters, *, dry_run: bool = False) -> ServoDrive:
    """Return the master's picture of the drive of one axis.

    Raises:
        InputError: A dry run of an admittance display.
    """
    dictionary = read_dictionary(axis.parameters.eds, axis.parameters.node_id)
    if dry_run:
        require_torque_axis(axis)
    if axis.parameters.admittance is None:
        return ServoDrive(link, axis.parameters, dictionary, bus, dry_run=dry_run)
    from canhaptic.drive.can.display_drive import DisplayDrive

    return DisplayDrive(link, axis.parameters, dictionary, bus)


def require_torque_axis(axis: AxisScene) -> None:
    """Refuse a dry run of an axis that takes no torque from the master.

    Raises:
        InputError: It is an admittance display.
    """
    if axis.parameters.admittance is not None:
        raise InputError(
            f"{axis.parameters.name}: an admittance display has no run without torque: its drive holds a velocity of 0 "
            "with all the torque it has; leave --no-torque out, and lower speed_limit and admittance.acceleration_limit"
        )


def build_simulated_drive(
    axis: AxisScene, simulation: AxisSimulation, bus: can.BusABC, sample_time_ns: int
) -> "SimulatedDrive":
    """Return the drive of one axis with motor and user behind it; it reads its dictionary itself."""
    from canhaptic.sim.drive.can.drive_node import SimulatedDrive

    plant = build_plant(simulation, sample_time_ns)
    node_id, eds = axis.parameters.node_id, axis.parameters.eds
    return SimulatedDrive(bus, node_id, eds, plant, simulation.drive, sample_time_ns)


def build_mechanism_drive(
    axis: AxisScene,
    parameters: "SimulatedDriveParameters",
    motor: "MechanismMotor",
    bus: can.BusABC,
    sample_time_ns: int,
) -> "SimulatedDrive":
    """Return the drive of one axis that moves a mechanism with others."""
    from canhaptic.sim.drive.can.drive_node import SimulatedDrive

    node_id, eds = axis.parameters.node_id, axis.parameters.eds
    drive = SimulatedDrive(bus, node_id, eds, motor, parameters, sample_time_ns)
    servo = drive.servo
    motor.connect(lambda: servo.torque)
    return drive


def shared_motors(scene: Scene) -> "dict[str, MechanismMotor]":
    """Return the motors of all simulated mechanisms, by the name of their axis."""
    from canhaptic.sim.plant.mechanism.shared_mechanism import SharedMechanism

    motors: dict[str, MechanismMotor] = {}
    for of in scene.mechanisms:
        shared = SharedMechanism(build_mechanism(of, scene.bus.sample_time_ns), len(of.axes))
        motors.update(zip(of.axes, shared.motors, strict=True))
    return motors
