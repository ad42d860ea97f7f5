"""The power stage of a simulated drive in the cyclic modes 8 and 9, with a force sensor at its analog input. No bus.

In mode 9 the velocity demand approaches the target in one step per SYNC. The smaller of 0x6083 and 0x60C5 limits its
acceleration, the smaller of 0x6084 and 0x60C6 its deceleration; an object with the value 0 sets no limit.
"""

from math import inf
from typing import TYPE_CHECKING, Any, Final, cast

from canhaptic.canopen import objects
from canhaptic.canopen.objects import CYCLIC_SYNC_POSITION, CYCLIC_SYNC_VELOCITY, DataType, StatusBit
from canhaptic.errors import ParameterError
from canhaptic.sim.drive import MotionScaling, SimulatedDriveParameters, parse_place
from canhaptic.sim.drive.profile.object_store import Entry, ObjectStore
from canhaptic.sim.drive.profile.servo import SENSOR_FAULT, Servo
from canhaptic.sim.drive.profile.state_machine import STATUSWORD as STATUSWORDS
from canhaptic.sim.drive.profile.state_machine import DriveState

if TYPE_CHECKING:
    from canhaptic.sim.plant.velocity_drive import VelocityDrivenPlant

_FOLLOWS: Final = int(StatusBit.FOLLOWS_COMMAND)
_BRAKING: Final = frozenset((DriveState.QUICK_STOP_ACTIVE, DriveState.FAULT_REACTION_ACTIVE))
_STANDSTILL: Final = 2e-3  # [m/s or rad/s] at which a drive that brakes counts as still
_LONGEST_BRAKING: Final = 500_000_000  # [ns] after which it ends without standstill
_WRAP: Final = 1 << 32
_SPEEDING: Final = (objects.PROFILE_ACCELERATION, objects.MAX_ACCELERATION)
_SLOWING: Final = (objects.PROFILE_DECELERATION, objects.MAX_DECELERATION)


class MotionServo(Servo):
    """Power stage, velocity loop and force sensor of a drive in the cyclic modes 8 and 9.

    Raises:
        ParameterError: The dictionary lacks its force object, or a torque is to be at fault.
    """

    motor: "VelocityDrivenPlant"

    def __init__(self, store: ObjectStore, motor: "VelocityDrivenPlant", parameters: SimulatedDriveParameters) -> None:
        scales = cast(MotionScaling, parameters.display)
        if parameters.fault:
            raise ParameterError("fault: an admittance display has no torque that is commanded; leave it out")
        self._target_velocity: Any = store.entry(objects.TARGET_VELOCITY, DataType.INTEGER32)
        self._target_position = store.entry(objects.TARGET_POSITION, DataType.INTEGER32)
        force = None if scales.force_object is None else store.find(*parse_place(scales.force_object))
        if force is None and scales.force_node is None:
            raise ParameterError(
                f"display.force_object: got {scales.force_object}, which the dictionary lacks; name one of its objects"
            )
        self._force, self._per_count, self._force_offset = force, scales.force_per_count, scales.force_offset_counts
        self._per_velocity_count = parameters.position_sign / (scales.velocity_counts or parameters.counts_per_unit)
        self._per_position_count = parameters.position_sign / parameters.counts_per_unit
        self._store, self._hidden_ramp = store, scales.ramp or inf
        self._velocity_offset: Any = store.optional(objects.VELOCITY_OFFSET, DataType.INTEGER32)
        self._position_offset = store.optional(objects.POSITION_OFFSET, DataType.INTEGER32)
        offsets = self._velocity_offset, self._position_offset
        self._commands: tuple[Entry, ...] = (self._target_velocity, self._target_position, *offsets)
        self._offset = 0  # of the torque that acts [per mille of the rated torque]
        self._ramped = 0.0  # velocity demanded, at the begin of this hold [m/s or rad/s]
        self._braking_since = -1
        self._setpoint: int | None = None
        self._has_taken, self._sampled_at, self._period = False, 0, 0.0
        super().__init__(store, motor, parameters)
        self.sensor_on_bus = None if scales.force_node is None else scales
        for commanded in self._commands:
            commanded.changed = self.obey

    def reset(self) -> None:
        """Return to the state after power-on: no power; the motor keeps moving."""
        for commanded in self._commands:
            commanded.value = commanded.number
        super().reset()
        self._power(self.machine.state)

    def update(self, before: DriveState | None = None) -> None:
        """Set velocity, power and statusword from state, mode and target."""
        state, command = self.machine.state, 0.0
        word = STATUSWORDS[state]
        if state is DriveState.OPERATION_ENABLED:
            mode = self._mode_shown.value
            if self._torque_offset.value != self._offset or not self.is_running:
                self._feed_forward()
            if mode == CYCLIC_SYNC_VELOCITY:
                target = self._target_velocity.value + self._velocity_offset.value  # numbers since `reset`
                command, word = self._along_ramp(target), word | _FOLLOWS
            elif mode == CYCLIC_SYNC_POSITION:
                command, word = self._interpolated(), word | _FOLLOWS
        else:
            self._setpoint, self._ramped = None, 0.0
        if before is not state:
            self._power(state)
        if command != self.torque:
            self._move()
            self.torque = command
        if word != self._statusword.value or (before is not None and before is not state):
            self._statusword.value = word
            self.has_event = True

    def _power(self, state: DriveState) -> None:
        """Switch the power stage, and record when the drive begins to brake."""
        is_braking = state in _BRAKING
        if not is_braking:
            self._braking_since = -1
        elif self._braking_since < 0:
            self._braking_since = self.now
        if self.is_running:
            self._move()
            self.motor.power(on=is_braking or state is DriveState.OPERATION_ENABLED)

    def _feed_forward(self) -> None:
        """Apply 0x60B2, and before the motor's clock starts also the torque limit 0x6072."""
        if not self.is_running:
            self.motor.limit_torque(self._stage.largest)
        offset = self._torque_offset.number
        if offset != self._offset:
            self._move()
            self._offset = offset
            self.motor.feed_forward(self._torque_sign * offset * self._stage.quantum)

    def _reload_limits(self) -> None:
        """Apply new limits and scales; the command of this hold is a velocity, which they do not change."""
        self._stage.reload()
        self.update()

    def _along_ramp(self, target: int) -> float:
        """Return the velocity demanded in this hold [m/s or rad/s]."""
        wanted, before = target * self._per_velocity_count, self._ramped
        if wanted == before or not self._period:
            return wanted
        ramps: list[Any] = [self._store.find(index) for index in (_SPEEDING if abs(wanted) > abs(before) else _SLOWING)]
        counts = min((entry.value or inf for entry in ramps if entry is not None), default=inf)  # 0 is no ramp
        most = min(counts * abs(self._per_velocity_count), self._hidden_ramp) * self._period
        if abs(wanted - before) <= most:
            return wanted
        return before + (most if wanted > before else -most)

    def _interpolated(self) -> float:
        """Return the velocity [m/s or rad/s] that leads to the target position by the next SYNC."""
        target = self._target_position.number + self._position_offset.number
        if self._setpoint is None or not self._period:
            self._setpoint = target
            return 0.0
        if self._has_taken:
            return self.torque
        before, self._setpoint = self._setpoint, target
        self._has_taken = True
        step = (target - before + _WRAP // 2) % _WRAP - _WRAP // 2
        return step * self._per_position_count / self._period

    def settle(self) -> None:
        """Make the transitions that need no command; a braking drive keeps its state until it is at rest."""
        if self._braking_since >= 0 and self.is_running:
            self._move()
            is_late = self.now - self._braking_since >= _LONGEST_BRAKING
            if abs(self.motor.velocity) > _STANDSTILL and not is_late:
                self.has_event = True  # the owner times the next look
                return
        super().settle()

    def sample(self) -> None:
        """Measure at a SYNC; in mode 8 the interpolation to the last target ends here."""
        if self._sampled_at and self.now > self._sampled_at:
            self._period = (self.now - self._sampled_at) * 1e-9
        self._sampled_at = self.now
        super().sample()
        self._has_taken = False
        self._ramped = self.torque
        if self._mode_shown.value == CYCLIC_SYNC_POSITION and self.machine.state is DriveState.OPERATION_ENABLED:
            self.torque = 0.0  # until the target of this SYNC acts
        entry = self._force
        if entry is None:
            return
        try:
            counts = round(self.motor.read_force() / self._per_count + self._force_offset)
        except (ValueError, OverflowError):
            self.fault_code = SENSOR_FAULT
            return
        if not entry.low <= counts <= entry.high:
            counts = int(entry.low if counts < entry.low else entry.high)
        entry.value = counts
