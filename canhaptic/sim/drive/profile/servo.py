"""The power stage of the simulated drive, without a bus: power states, cyclic torque, measurement and the motor.

`TorqueStage` applies the drive's torque limits and scales per mille of the rated torque to torque at the axis.
`TorqueMeter` measures the torque (0x6077) through a filter, with the error of a current sensor.
"""

import math
from collections.abc import Callable
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final, Protocol

from canhaptic.canopen import objects
from canhaptic.canopen.objects import CYCLIC_SYNC_TORQUE, HOMING, DataType, SdoAbort, StatusBit
from canhaptic.errors import ParameterError
from canhaptic.signals import PlantEnergy
from canhaptic.sim.drive import MotionScaling, SimulatedDriveParameters
from canhaptic.sim.drive.profile.object_store import Entry, ObjectStore
from canhaptic.sim.drive.profile.state_machine import STATUSWORD as STATUSWORDS
from canhaptic.sim.drive.profile.state_machine import DriveState, PowerCommand, StateMachine, command_of

if TYPE_CHECKING:
    from canhaptic.canopen.attached_devices import Brake
    from canhaptic.sim.drive.profile.homing import Homing
    from canhaptic.sim.drive.profile.torque_fault import FaultyTorque


class TorqueStage:
    """Limits a target torque (0x6071) to a demand (0x6074) and scales it to the axis.

    The rated torque is the one in 0x6076, so that master and drive cannot differ by a rounding; without 0x6076 it is
    the parameter itself. With a dictionary without 0x6071 the stage has no torque.

    Raises:
        ParameterError: No rated torque is stated anywhere, or it is not a whole number of counts of 0x6076.
    """

    def __init__(self, store: ObjectStore, parameters: SimulatedDriveParameters, on_change: Callable[[], None]) -> None:
        self._target = store.entry(objects.TARGET_TORQUE, DataType.INTEGER16)
        self._max_torque = store.find(objects.MAX_TORQUE)
        self._rated = store.find(objects.RATED_TORQUE)
        self._parameters = parameters
        if parameters.rated_torque is not None and self._rated is not None:
            counts = _counts(parameters) if parameters.rated_torque_stated else 0
            largest = Entry(0, 0, self._rated.data_type).high if self._rated.size else -1  # of its type
            if counts > largest:
                raise ParameterError(
                    f"rated_torque: 0x6076 of the dictionary cannot hold {counts}; correct its data type"
                )
            self._rated.initial = self._rated.value = counts
        if store.find(objects.TARGET_TORQUE) is not None and self._rated_torque() <= 0.0:
            seen = "no such object" if self._rated is None else f"value {self._rated.value!r}"
            raise ParameterError(
                f"rated_torque: got none, and the dictionary states none (0x6076: {seen}); "
                "write rated_torque of the axis: that of its motor times the transmission"
            )
        for entry in (self._max_torque, self._rated):
            if entry is not None:
                entry.changed = on_change
        self.reload()

    def _rated_torque(self) -> float:
        if self._rated is not None and self._rated.number > 0:
            return self._rated.number * self._parameters.rated_torque_resolution
        return self._parameters.rated_torque or 0.0

    def reload(self) -> None:
        """Apply rated torque and limits from the objects."""
        # [N or N*m] per count of 0x6071
        self.quantum = self._rated_torque() / round(1.0 / self._parameters.torque_resolution, 9)
        limit = float("inf")
        if self._max_torque is not None and self._max_torque.value is not None:
            limit = self._max_torque.number
        if self._parameters.torque_limit is not None and self.quantum > 0.0:
            # Tiny allowance: a limit given as a whole number of per mille must not lose one to rounding.
            limit = min(limit, int(self._parameters.torque_limit / self.quantum * (1.0 + 1e-12)))
        self._low = int(max(self._target.low, -limit))
        self._high = int(min(self._target.high, limit))

    @property
    def largest(self) -> float:
        """Largest torque that 0x6072 and the drive itself permit [N or N*m]; inf if only the type of 0x6071 limits."""
        return self._high * self.quantum if self._high < self._target.high else float("inf")

    def limit(self, target: int) -> int:
        """Return the torque demand [per mille of rated torque] for a target."""
        if target > self._high:
            return self._high
        return target if target >= self._low else self._low


def _counts(parameters: SimulatedDriveParameters) -> int:
    exact = (parameters.rated_torque or 0.0) / parameters.rated_torque_resolution
    counts = round(exact)
    if abs(exact - counts) > 1e-6 * exact or counts > 0xFFFF_FFFF:
        raise ParameterError(
            f"rated_torque: got {parameters.rated_torque}, expected a whole number of "
            f"{parameters.rated_torque_resolution} (the step of 0x6076), at most {0xFFFF_FFFF} of them"
        )
    return counts


_LARGEST: Final = 0x7FFF  # 0x6077 is INTEGER16


class Motor(Protocol):
    """The plant that the drive moves: motor, load and user.

    Its optional attributes `encoder_position` and `motor_torque` are read if it has them. Otherwise the encoder, also
    with `has_ideal_encoder`, or the current loop is ideal.
    """

    @property
    def position(self) -> float:
        """True position [rad or m]."""

    @property
    def velocity(self) -> float:
        """True velocity [rad/s or m/s]."""

    def begin(self, now: int) -> None:
        """Start its clock at `now` [ns]; until then it is at rest."""

    def advance_to(self, now: int, torque: float) -> None:
        """Move to `now` [ns] under a torque [N*m or N] that was constant since the last call."""

    def energy(self) -> PlantEnergy:
        """True energies since the start."""


class TorqueMeter:
    """Measures the torque of a motor.

    0x6077 = filter(motor torque) * (1 + ripple * sin(2 pi position / pitch)). The filter is of first order, and exact
    for a torque that is constant between measurements. Without lag, ripple and current loop 0x6077 is the demand.

    Args:
        motor: Motor whose torque is measured.
        parameters: Lag and ripple.

    Attributes:
        is_ideal: Whether the measurement equals the demand.
    """

    def __init__(self, motor: Motor, parameters: SimulatedDriveParameters) -> None:
        self._motor = motor
        self._has_own_torque = getattr(motor, "motor_torque", None) is not None
        self._lag = parameters.torque_lag
        self._ripple = parameters.torque_ripple
        self.is_ideal = not (self._has_own_torque or self._lag or self._ripple)
        self._wave_number = 2.0 * math.pi / parameters.torque_ripple_pitch
        self.reset()

    def reset(self) -> None:
        """Clear the state of the measuring filter."""
        self._filtered, self._measured_at = 0.0, 0

    def counts(self, now: int, held: float, quantum: float) -> int:
        """Measured torque at `now` [ns] in counts; 0 without a rated torque, and for a torque that is not finite.

        Args:
            now: Time [ns], not before that of the last call.
            held: Torque held by the power stage [N*m or N].
            quantum: Torque of one count, with its sign [N*m or N].
        """
        torque = float(getattr(self._motor, "motor_torque")) if self._has_own_torque else held  # noqa: B009
        if self._lag:
            share = math.exp(-(now - self._measured_at) * 1e-9 / self._lag)
            torque = self._filtered = torque + (self._filtered - torque) * share
            self._measured_at = now
        try:
            if self._ripple:
                torque *= 1.0 + self._ripple * math.sin(self._wave_number * self._motor.position)
            counts = round(torque / quantum)
        except (ZeroDivisionError, ValueError, OverflowError):  # no rated torque, or a motor that has diverged
            return 0
        return max(-_LARGEST - 1, min(_LARGEST, counts))


SENSOR_FAULT: Final = 0x7300
"""Error code (0x603F) of a position, velocity or force that is not a number."""
_COUNTS: Final = 1 << 32  # 0x6064 and 0x606C are 32 bits wide and wrap, as an encoder counter does
_HALF: Final = _COUNTS // 2
_ENABLE_BIT: Final = 0x08  # of the controlword
_ENABLED: Final = DriveState.OPERATION_ENABLED
_ENABLED_WORD: Final = STATUSWORDS[_ENABLED]
_FOLLOWING_WORD: Final = _ENABLED_WORD | int(StatusBit.FOLLOWS_COMMAND)
_LIMITING_WORD: Final = _FOLLOWING_WORD | int(StatusBit.INTERNAL_LIMIT)
_POWERED: Final = frozenset(
    (DriveState.READY_TO_SWITCH_ON, DriveState.SWITCHED_ON, _ENABLED, DriveState.QUICK_STOP_ACTIVE)
)

_TURNS_POSITION: Final = 1 << 7  # in 0x607E


class _BrakedMotor:
    """A motor with a holding brake, which holds at first: meanwhile neither the motor nor its clock advances.

    Args:
        motor: The motor.
        brake: Holding brake with its delays.
    """

    def __init__(self, motor: Motor, brake: "Brake") -> None:
        self._motor = motor
        self._release, self._set = round(brake.release_time * 1e9), round(brake.set_time * 1e9)
        self._is_open = False
        self._opens, self._holds = math.inf, math.inf  # times from which it is open, and holds again [ns]
        self._seen = self._age = 0  # time of the last call, and that of the motor, which stands still meanwhile [ns]

    def command(self, now: int, *, is_open: bool) -> None:
        """Open or set the brake; it follows after its delay."""
        if is_open and not self._is_open:
            self._opens, self._holds = now + self._release, math.inf
        elif self._is_open and not is_open:
            self._holds = now + self._set
        self._is_open = is_open

    def holds(self, now: int) -> bool:
        """Whether the brake holds."""
        return not self._opens <= now < self._holds

    def begin(self, now: int) -> None:
        """Start the clock of the motor."""
        self._motor.begin(now)
        self._seen = self._age = now

    def advance_to(self, now: int, torque: float) -> None:
        """Move to `now` [ns] under a constant torque, for as long as the brake is open."""
        free = min(now, self._holds) - max(self._seen, self._opens)
        self._seen = now
        if free > 0:
            self._age += int(free)
            self._motor.advance_to(self._age, torque)


def _homing_of(store: ObjectStore, motor: Motor) -> "Homing | None":
    method = store.find(objects.HOMING_METHOD)
    if method is None or method.data_type != DataType.INTEGER8:
        return None
    from canhaptic.sim.drive.profile.homing import Homing

    return Homing(store, motor)


def _fault_of(parameters: SimulatedDriveParameters) -> "FaultyTorque | None":
    if not parameters.fault:
        return None
    from canhaptic.sim.drive.profile.torque_fault import FaultyTorque

    return FaultyTorque(parameters.fault)


class Servo:
    """Power stage of a simulated drive with its motor: state machine, torque and measurement.

    Args:
        store: Object store.
        motor: Motor of the drive; at rest until the first SYNC in OPERATION ENABLED.
        parameters: Scales and limits.

    Attributes:
        now: Present time [ns]; set by the owner.
        demand: Present torque demand [per mille of rated torque].
        torque: Torque at the axis for that demand [N*m or N].
        has_event: Whether the statusword changed since the owner last cleared this.
        was_reset: Whether a fault was reset since the owner last cleared this.
        fault_code: Code of a fault that the power stage detected, for the owner to announce; 0 for none.
        sensor_on_bus: Scales of a force sensor with its own node; None without one.
    """

    sensor_on_bus: MotionScaling | None = None

    def __init__(self, store: ObjectStore, motor: Motor, parameters: SimulatedDriveParameters) -> None:
        brake = parameters.brake
        self._brake = None if brake is None else _BrakedMotor(motor, brake)
        self._host_brake = brake if brake is not None and brake.by == "host" else None
        self._outputs = store.find(objects.DIGITAL_OUTPUTS, 1)
        self.motor, self._mover = motor, self._brake or motor
        self.machine = StateMachine()
        self.now = self._moved_to = 0
        self.is_running = False
        self.demand, self.torque = 0, 0.0
        self._counts_per_unit = parameters.position_sign * parameters.counts_per_unit
        self._polarity, self._is_turned = store.find(objects.POLARITY), False
        self._rounds = parameters.encoder == "round"
        is_ideal = getattr(motor, "has_ideal_encoder", not hasattr(motor, "encoder_position"))
        self._read_encoder: Callable[[Motor], float] | None = None if is_ideal else attrgetter("encoder_position")
        self._controlword = store.entry(objects.CONTROLWORD, DataType.UNSIGNED16)
        self._statusword = store.entry(objects.STATUSWORD, DataType.UNSIGNED16)
        self._mode = store.entry(objects.MODES_OF_OPERATION, DataType.INTEGER8)
        self._hides_mode = parameters.mode_when_enabled
        self._mode_shown = store.entry(objects.MODES_OF_OPERATION_DISPLAY, DataType.INTEGER8)
        self._supported_modes = store.find(objects.SUPPORTED_DRIVE_MODES)
        self._quick_stop_option = store.optional(objects.QUICK_STOP_OPTION, DataType.INTEGER16)
        self._target: Any = store.entry(objects.TARGET_TORQUE, DataType.INTEGER16)
        self._torque_offset: Any = store.optional(objects.TORQUE_OFFSET, DataType.INTEGER16)
        self._torque_demand = store.optional(objects.TORQUE_DEMAND, DataType.INTEGER16)
        self._torque_actual = store.optional(objects.TORQUE_ACTUAL, DataType.INTEGER16)
        self._current_actual = store.optional(objects.CURRENT_ACTUAL, DataType.INTEGER16)
        self._position = store.entry(objects.POSITION_ACTUAL, DataType.INTEGER32)
        self.velocity_entry = store.optional(objects.VELOCITY_ACTUAL, DataType.INTEGER32)
        self.measures_velocity = False
        self._stage = TorqueStage(store, parameters, self._reload_limits)
        self._meter = TorqueMeter(motor, parameters)
        self._fault = _fault_of(parameters)
        self._applied = 0  # per mille: of the torque that acts
        self._torque_sign = parameters.direction * (-1 if parameters.reversed == "torque" else 1)  # of 0x6071
        self._enable_delay = round(parameters.enable_delay * 1e9)
        self._follow_delay = round(parameters.follow_delay * 1e9)
        self._homing, self._zero = _homing_of(store, motor), 0  # encoder count at which 0x6064 is 0
        self._connect()
        self.reset()

    def _connect(self) -> None:
        for commanded in (self._controlword, self._mode, self._target, self._torque_offset):
            commanded.changed = self.obey
        if self._polarity is not None:
            self._polarity.changed = self._turn
        if self._brake is not None and self._outputs is not None:
            self._outputs.changed = self._work_brake
        self._mode.check = self._check_mode
        measured = (self._position, self._torque_demand, self._torque_actual, self._current_actual)
        for entry in (*measured, self.velocity_entry):
            entry.refresh = self.measure

    def reset(self) -> None:
        """Return to the state after power-on: no torque; the motor keeps moving."""
        self._move()
        self._turn()
        self.machine.reset()
        self.demand, self._applied, self.torque = 0, 0, 0.0
        self.was_reset = False
        self.fault_code = 0
        for commanded in (self._controlword, self._mode, self._target, self._torque_offset):
            commanded.value = commanded.number
        shows = not self._hides_mode and self._check_mode(self._mode.number) is None
        self._mode_shown.value = self._mode.number if shows else 0
        self._statusword.value = STATUSWORDS[self.machine.state]
        self._stage.reload()
        self._meter.reset()
        self._enabling_word: object = None  # controlword of the last obedience that ended in OPERATION ENABLED
        self._enabling_since = self._enabled_since = -1  # [ns]; -1: not
        self.has_event = True
        self.measure()

    @property
    def state(self) -> DriveState:
        """State of the power drive system."""
        return self.machine.state

    @property
    def is_powered(self) -> bool:
        """Whether power is on or about to be, so that a lost connection affects the drive."""
        return self.machine.state in _POWERED

    def obey(self) -> None:
        """Act on the present controlword, mode and target torque."""
        machine, word, mode = self.machine, self._controlword.value, self._mode.value
        before = machine.state
        if before is not _ENABLED or word != self._enabling_word:  # the word that enabled the operation keeps it so
            machine.obey(self._delayed(self._controlword.number), self._quick_stop_option.number)
            self._enabling_word = word if machine.state is _ENABLED else None
            if before is DriveState.FAULT and machine.state is not before:
                self.was_reset = True
        shown = mode if not self._hides_mode or machine.state is _ENABLED else 0
        if shown != self._mode_shown.value and self._check_mode(self._mode.number) is None:
            self._mode_shown.value = shown
        self.update(before)

    def _delayed(self, controlword: int) -> int:
        """The controlword, without the command to enable until the enable delay has passed."""
        if not self._enable_delay:
            return controlword
        is_asked = command_of(controlword) is PowerCommand.ENABLE_OPERATION
        if not is_asked or self.machine.state not in (DriveState.READY_TO_SWITCH_ON, DriveState.SWITCHED_ON):
            self._enabling_since = -1
            return controlword
        if self._enabling_since < 0:
            self._enabling_since = self.now
        is_due = self.now - self._enabling_since >= self._enable_delay
        return controlword if is_due else controlword & ~_ENABLE_BIT

    def _follows(self) -> bool:
        """Whether the follow delay has passed, so that the torque follows its target; for OPERATION ENABLED only."""
        if self._enabled_since < 0:
            self._enabled_since = self.now
        return self.now - self._enabled_since >= self._follow_delay

    def update(self, before: DriveState | None = None) -> None:
        """Set torque demand and statusword from state, mode and target.

        Args:
            before: State before a change; None when only the torque may differ.
        """
        state, demand = self.machine.state, 0
        if state is not _ENABLED:
            word = STATUSWORDS[state]
            self._enabled_since = -1
            if self._homing is not None:
                self._homing.leave()
            if self._brake is not None and state is DriveState.SWITCHED_ON and not self._brake.holds(self.now):
                demand = self.demand  # a drive that works its brake holds the axis until the brake does
        else:
            word = _ENABLED_WORD
            if self._mode_shown.value == CYCLIC_SYNC_TORQUE and (not self._follow_delay or self._follows()):
                target: int = self._target.value + self._torque_offset.value  # numbers since `reset`
                demand = self._stage.limit(target)
                word = _FOLLOWING_WORD if demand == target else _LIMITING_WORD
            elif self._homing is not None and self._mode_shown.value == HOMING:
                demand, word = self._home(self._homing)
        applied = demand
        if self._fault is not None and state is _ENABLED:
            demand, applied = self._fault.act(self.now, demand, self._stage.quantum)
        if demand != self.demand or applied != self._applied:
            self._move()
            self.demand, self._applied = demand, applied
            self.torque = self._torque_sign * applied * self._stage.quantum
        if word != self._statusword.value or (before is not None and before is not state):
            self._statusword.value = word
            self.has_event = True
            self._work_brake()

    def _home(self, homing: "Homing") -> tuple[int, int]:
        """Return torque demand and statusword of the homing mode, and move the zero once the home is found."""
        per_unit, velocity = self._counts_per_unit, self.motor.velocity
        encoder = self._zero + self._position.number
        force = homing.step(self.now, encoder, velocity * per_unit, self._controlword.number)
        if homing.zero != self._zero:
            self._zero = homing.zero
            self._position.value = encoder - self._zero
        demand = self._stage.limit(round(force / per_unit / (self._torque_sign * self._stage.quantum)))
        return demand, _ENABLED_WORD | homing.bits

    def settle(self) -> None:
        """Make the transitions that need no command."""
        before = self.machine.state
        self.machine.settle(self._quick_stop_option.number)
        self.update(before)

    def fault(self) -> None:
        """Begin the fault reaction: torque or velocity 0 at once."""
        before = self.machine.state
        self.machine.fault()
        self.update(before)

    def abort_connection(self, option: int) -> None:
        """React to a lost connection as 0x6007 demands: 0 nothing, 2 disable voltage, 3 quick stop, else fault."""
        before = self.machine.state
        if option == 0 or not self.is_powered:
            return
        if option == 2:
            self.machine.disable_voltage()
        elif option == 3 and before is _ENABLED:
            self.machine.quick_stop(self._quick_stop_option.number)
        elif option != 3:
            self.machine.fault()
        self.update(before)

    # --- measurement ------------------------------------------------------------------------------------------------

    def sample(self) -> None:
        """Measure at a SYNC; the first SYNC in OPERATION ENABLED starts the motor's clock."""
        motor, now, encoder = self.motor, self.now, self._read_encoder
        if self._brake is not None:
            self._work_brake()
        if self.is_running:
            self._mover.advance_to(now, self.torque)
        elif self.machine.state is _ENABLED:
            self._mover.begin(now)
            self.is_running = True
            if self._fault is not None:
                self._fault.begin(now)
        self._moved_to = now
        self._count(self._position, motor.position if encoder is None else encoder(motor), self._zero)
        if self.measures_velocity:
            self._count(self.velocity_entry, motor.velocity)
        if self._homing is not None and self._mode_shown.value == HOMING:
            self.update()
        self.show_torque()
        if self._fault is not None:
            self.update()

    def _work_brake(self) -> None:
        """Open or set the brake as its output, or the state of the drive, demands now."""
        if self._brake is None:
            return
        is_open = self.machine.state is _ENABLED
        if self._host_brake is not None and self._outputs is not None:
            outputs = self._outputs.number
            is_open = self._host_brake.outputs(outputs, is_open=True) == outputs
        self._brake.command(self.now, is_open=is_open)

    def show_torque(self) -> None:
        """Update 0x6074 from the present demand, 0x6077 and 0x6078 from the measurement; current equals torque."""
        self._torque_demand.value = measured = self.demand
        if self._fault is not None or not self._meter.is_ideal:
            measured = self._meter.counts(self.now, self.torque, self._torque_sign * self._stage.quantum)
        self._torque_actual.value = self._current_actual.value = measured

    def measure(self) -> None:
        """Measure now, for an SDO upload or an event-driven TPDO."""
        self._move()
        motor, encoder = self.motor, self._read_encoder
        self._count(self._position, motor.position if encoder is None else encoder(motor), self._zero)
        self._count(self.velocity_entry, motor.velocity)
        self.show_torque()

    def _move(self) -> None:
        if self.is_running and self.now != self._moved_to:
            self._mover.advance_to(self.now, self.torque)
            self._moved_to = self.now

    def _turn(self) -> None:
        """Turn the sign of positions where bit 7 of the polarity changed."""
        is_turned = self._polarity is not None and bool(self._polarity.number & _TURNS_POSITION)
        if is_turned is not self._is_turned:
            self._is_turned, self._counts_per_unit = is_turned, -self._counts_per_unit

    def _count(self, entry: Entry, value: float, zero: int = 0) -> None:
        """Write a position or velocity in counts; one that is not finite is a fault, and the object keeps its value."""
        try:
            counts = round(value * self._counts_per_unit) if self._rounds else math.floor(value * self._counts_per_unit)
        except (ValueError, OverflowError):
            self.fault_code = SENSOR_FAULT
            counts = entry.number + zero
        counts -= zero
        entry.value = counts if -_HALF <= counts < _HALF else (counts + _HALF) % _COUNTS - _HALF

    def _check_mode(self, mode: int) -> SdoAbort | None:
        """Refuse modes that 0x6502 does not list (mode m: bit m - 1); mode 0 is none. Without 0x6502: mode 10 only."""
        listed = objects.CYCLIC_SYNC_TORQUE_BIT if self._supported_modes is None else self._supported_modes.number
        if mode == 0 or (mode > 0 and listed >> (mode - 1) & 1):
            return None
        return SdoAbort.VALUE_RANGE

    def _reload_limits(self) -> None:
        self._stage.reload()
        self._move()
        self.torque = self._torque_sign * self._applied * self._stage.quantum
        self.update()
