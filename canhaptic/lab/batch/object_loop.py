"""The loop of a port whose controller and plants are objects, as in the cycle: any scene without a bus, in Python.

The plants (`canhaptic.sim.plant`) apply all effects themselves.
"""

from collections.abc import Mapping, Sequence
from math import nan
from typing import Any, Final, NamedTuple, cast

from canhaptic.control.balance import EnergyBalance
from canhaptic.drive.profile.motion_parameters import ForceChannel, MotionParameters
from canhaptic.errors import CanHapticError, ControlError
from canhaptic.lab.batch import closed_loop
from canhaptic.lab.batch.closed_loop import CycleState, Loops, Room, Signals
from canhaptic.lab.loop.axis_loop import mechanism_moved
from canhaptic.scene.far_side import build_mechanism, build_plant
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.sim.plant.mechanism import SharedMechanism
from canhaptic.sim.plant.plant import Plant
from canhaptic.sim.plant.velocity_drive import VelocityDrivenPlant


class Motors:
    """Motors of a port, whose plants are objects of `canhaptic.sim.plant`.

    Args:
        plants: Plant of each motor, before it begins.
        sample_time_ns: Time between two SYNCs [ns].
        mechanism: Mechanism that moves all motors, if there is one.

    Attributes:
        motion: True position, velocity and force of each motor at every SYNC, if its drive shows forces.
        reason: Why the rig stops; "": it does not.
        ending: Errors that end a run.
    """

    ending: type[CanHapticError] = ControlError
    reason = ""

    def __init__(self, plants: Sequence[Any], sample_time_ns: int, mechanism: Any = None) -> None:
        self.plants: Sequence[Plant] = plants
        self.sample_time_ns, self._mechanism = sample_time_ns, mechanism
        self.has_encoders, self.motion = mechanism is None, list[Sequence[float]]()
        self._torques: Sequence[float] = [0.0] * len(plants)
        for i, plant in enumerate(plants):
            if mechanism is not None:
                plant.connect(lambda i=i: self._torques[i])
            plant.begin(0)

    def positions(self) -> list[float]:
        """Return the true positions [m or rad]."""
        return [plant.position for plant in self.plants]

    def velocities(self) -> list[float]:
        """Return the true velocities [m/s or rad/s]."""
        return [plant.velocity for plant in self.plants]

    def shown(self, positions: Sequence[float], torques: Sequence[float]) -> Sequence[float]:
        """Return the torques that the drives show with measured positions: those held in the hold that ended."""
        return torques

    def advance_to(self, now: int, torques: Sequence[float]) -> None:
        """Move to a time [ns] under constant commands."""
        self._torques = torques
        for i, plant in enumerate(self.plants):
            plant.advance_to(now, torques[i])

    def works(self) -> tuple[float, float]:
        """Return the works of all motors and of all hands since the start [J]."""
        energies = [plant.energy() for plant in self.plants]
        return sum(energy.motor for energy in energies), sum(energy.user for energy in energies)

    def evaluations(self) -> int:
        """Return the evaluations of the equations of motion since the start."""
        if self._mechanism is not None:
            return int(getattr(self._mechanism, "iterations", 0))
        return sum(plant.products for plant in self.plants)


class _Sensed:
    """Plant of a drive that takes velocities, with its encoder and its force sensor, both in whole counts."""

    def __init__(self, axis: AxisScene, sample_time_ns: int) -> None:
        given, simulation, time = axis.parameters, simulation_of(axis), sample_time_ns * 1e-9
        force, own = cast(MotionParameters, given.admittance).force, simulation.drive.display
        self._name, self._counts = given.name, given.counts_per_unit
        self._plant = plant = cast(VelocityDrivenPlant, build_plant(simulation, sample_time_ns))
        self.begin, self.advance_to, self.energy = plant.begin, plant.advance_to, plant.energy
        self._channel, self._seen = ForceChannel(force, time), nan
        self._per_count = own.force_per_count if own else force.per_count
        self._offset = own.force_offset_counts if own else force.offset_counts
        self._fastest = 2.0 * given.largest_speed * time  # [m or rad] in a hold, as in the link policy

    @property
    def position(self) -> float:
        """True position [m or rad]."""
        return self._plant.position

    @property
    def encoder_position(self) -> float:
        """Encoder reading [m or rad]."""
        return round(self._plant.encoder_position * self._counts) / self._counts

    def motion(self) -> tuple[float, float, float]:
        """Return the true position [m or rad], velocity and force [N or N*m]."""
        return self._plant.position, self._plant.velocity, self._plant.force

    def force(self) -> float:
        """Return the sensor reading [N or N*m]."""
        return self._channel.take(round(self._plant.read_force() / self._per_count + self._offset))

    def why_stopped(self, position: float) -> str:
        """Return why the rig stops at a SYNC with a measured position [m or rad]; "": it does not."""
        moved, self._seen = position - self._seen, position
        if self._channel.is_wrong:
            return f"{self._name}: the force sensor is beyond its range, or frozen"
        return f"{self._name}: the position moved faster than the speed limit" if abs(moved) > self._fastest else ""


class SensedMotors(Motors):
    """Drives that take velocities and show forces."""

    ending = CanHapticError

    def __init__(self, axes: Sequence[AxisScene], sample_time_ns: int) -> None:
        self._each = [_Sensed(axis, sample_time_ns) for axis in axes]
        super().__init__(self._each, sample_time_ns)

    def shown(self, positions: Sequence[float], torques: Sequence[float]) -> Sequence[float]:
        """Return minus the forces of the sensors; see `Motors.shown`."""
        forces = [-each.force() for each in self._each]
        for each, position in zip(self._each, positions, strict=True):
            self.reason = each.why_stopped(position) or self.reason
        self.motion.extend(each.motion() for each in self._each)
        return forces

    def advance_to(self, now: int, torques: Sequence[float]) -> None:
        """Move to a time [ns] under constant commands.

        Raises:
            ControlError: The rig stopped at the SYNC before.
        """
        if self.reason:
            raise ControlError(self.reason)
        super().advance_to(now, torques)


def motors_of(scene: Scene, axes: Sequence[AxisScene]) -> Motors:
    """Return the motors of a port as objects: one plant for each, or one mechanism.

    Args:
        scene: Scene with only this port.
        axes: Axes of the port.

    Raises:
        InputError: The motors are not simulated, or their mechanism also moves other axes.
    """
    of, time = mechanism_moved(scene), scene.bus.sample_time_ns
    if of is None:
        return Motors([build_plant(simulation_of(axis), time) for axis in axes], time)
    shared = SharedMechanism(build_mechanism(of, time), len(axes))
    motors = [shared.motors[of.axes.index(axis.parameters.name)] for axis in axes]
    return Motors(motors, time, shared.mechanism)


class ObjectControl(NamedTuple):
    """A controller as an object, at rest, with its motors."""

    world: Any  # environment of which figures are computed
    controller: Any  # of one motor (`passivity.Controller`), or of several (`multi_axis.GroupController`)
    motors: Motors
    loops: Loops  # of each motor
    is_together: bool = False  # whether the controller takes and returns sequences


def respond_as_object(control: ObjectControl, room: Room, place: CycleState) -> EnergyBalance:
    """Replace `closed_loop.respond`: step the object with what the drives show."""
    torques = control.motors.shown(room.seen, room.held)
    if control.is_together:
        hold = control.controller.step(room.seen, torques)
        account, room.commands[:] = hold.account, hold.torques
    else:
        account = control.controller.step(room.seen[0], torques[0])
        room.commands[0] = account.torque
    place.supplied += account.supplied
    return cast(EnergyBalance, account)


def move_objects(motors: Motors, room: Room, each: range, cycle: int) -> bool:
    """Replace `closed_loop.move_motors` for plants as objects, which apply all effects themselves."""
    motors.advance_to(cycle * motors.sample_time_ns, room.acting)
    return True


def object_position_of(motors: Motors, i: int) -> float:
    """Replace `closed_loop.position_of` for plants as objects."""
    return motors.plants[i].position


def object_encoder(motors: Motors, i: int, signals: Signals, cycle: int, position: float) -> float:
    """Replace `closed_loop.encoder` for plants as objects."""
    return motors.plants[i].encoder_position if motors.has_encoders else position


def object_work_of(motors: Motors, work: float) -> float:
    """Replace `closed_loop.work_of` by the energies that the plants report."""
    work = 0.0
    for plant in motors.plants:
        work += plant.energy().motor
    return work


OBJECTS: Final[Mapping[object, object]] = {
    closed_loop.move_motors: move_objects, closed_loop.position_of: object_position_of,
    closed_loop.encoder: object_encoder, closed_loop.work_of: object_work_of,
}  # fmt: skip
"""Replacements of functions of the loop for plants as objects."""
