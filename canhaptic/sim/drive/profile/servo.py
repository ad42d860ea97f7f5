"""The power stage of the simulated drive: states, cyclic torque, measurement, and the motor behind it. No bus."""

import math
from collections.abc import Callable
from operator import attrgetter
from typing import Any, Final, Protocol

from canhaptic.canopen.objects import (
    CONTROLWORD,
    CURRENT_ACTUAL,
    CYCLIC_SYNC_TORQUE,
    CYCLIC_SYNC_TORQUE_BIT,
    MODES_OF_OPERATION,
    MODES_OF_OPERATION_DISPLAY,
    POSITION_ACTUAL,
    QUICK_STOP_OPTION,
    STATUSWORD,
    SUPPORTED_DRIVE_MODES,
    TARGET_TORQUE,
    TORQUE_ACTUAL,
    TORQUE_DEMAND,
    TORQUE_OFFSET,
    VELOCITY_ACTUAL,
    DataType,
    SdoAbort,
    StatusBit,
)
from canhaptic.signals import PlantEnergy
from canhaptic.sim.drive.drive_parameters import SimulatedDriveParameters
from canhaptic.sim.drive.profile.drive_torque import TorqueStage
from canhaptic.sim.drive.profile.object_store import Entry, ObjectStore
from canhaptic.sim.drive.profile.state_machine import STATUSWORD as STATUSWORDS
from canhaptic.sim.drive.profile.state_machine import DriveState, PowerCommand, StateMachine, command_of
from canhaptic.sim.drive.profile.torque_meter import TorqueMeter

SENSOR_FAULT: Final = 0x7300
"""Error code (0x603F) of a position, velocity or force that is no number."""
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


class Motor(Protocol):
    """The plant that the drive moves: motor, load and user.

    A motor with `encoder_position` or `motor_torque` is read there; one without, or with `has_ideal_encoder`, has an
    encoder, or a current loop, without effects.
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


class Servo:
    """Power stage and motor.

    Args:
        store: The objects.
        motor: Motor of the drive; at rest until the first SYNC that finds operation enabled.
        parameters: Scales and limits.

    Attributes:
        now: Present time [ns]; set by the owner.
        demand: Torque demand in force [per mille of rated torque].
        torque: The same at the axis [N*m or N].
        has_event: The statusword changed since the owner last cleared this.
        was_reset: A fault was reset since the owner last cleared this.
        fault_code: Code of a fault that the stage itself detected, for the owner to announce; 0 for none.
    """

    def __init__(self, store: ObjectStore, motor: Motor, parameters: SimulatedDriveParameters) -> None:
        self.motor = motor
        self.machine = StateMachine()
        self.now = 0
        self.is_running = False
        self._moved_to = 0
        self.demand, self.torque = 0, 0.0
        self._counts_per_unit = parameters.position_sign * parameters.counts_per_unit
        self._rounds = parameters.encoder == "round"
        is_ideal = getattr(motor, "has_ideal_encoder", not hasattr(motor, "encoder_position"))
        self._read_encoder: Callable[[Motor], float] | None = None if is_ideal else attrgetter("encoder_position")
        self._controlword = store.entry(CONTROLWORD, DataType.UNSIGNED16)
        self._statusword = store.entry(STATUSWORD, DataType.UNSIGNED16)
        self._mode = store.entry(MODES_OF_OPERATION, DataType.INTEGER8)
        self._mode_display = store.entry(MODES_OF_OPERATION_DISPLAY, DataType.INTEGER8)
        self._supported_modes = store.find(SUPPORTED_DRIVE_MODES)
        self._quick_stop_option = store.optional(QUICK_STOP_OPTION, DataType.INTEGER16)
        self._target: Any = store.entry(TARGET_TORQUE, DataType.INTEGER16)
        self._torque_offset: Any = store.optional(TORQUE_OFFSET, DataType.INTEGER16)
        self._torque_demand = store.optional(TORQUE_DEMAND, DataType.INTEGER16)
        self._torque_actual = store.optional(TORQUE_ACTUAL, DataType.INTEGER16)
        self._current_actual = store.optional(CURRENT_ACTUAL, DataType.INTEGER16)
        self._position = store.entry(POSITION_ACTUAL, DataType.INTEGER32)
        self.velocity_entry = store.optional(VELOCITY_ACTUAL, DataType.INTEGER32)
        self.measures_velocity = False
        self._stage = TorqueStage(store, parameters, self._reload_limits)
        self._meter = TorqueMeter(motor, parameters)
        self._torque_sign = parameters.torque_sign
        self._enable_delay = round(parameters.enable_delay * 1e9)
        self._follow_delay = round(parameters.follow_delay * 1e9)
        self._connect()
        self.reset()

    def _connect(self) -> None:
        for commanded in (self._controlword, self._mode, self._target, self._torque_offset):
            commanded.changed = self.obey
        self._mode.check = self._check_mode
        measured = (self._position, self._torque_demand, self._torque_actual, self._current_actual)
        for entry in (*measured, self.velocity_entry):
            entry.refresh = self.measure

    def reset(self) -> None:
        """Return to the state after power-on: no torque; the motor moves on."""
        self._move()
        self.machine.reset()
        self.demand, self.torque = 0, 0.0
        self.was_reset = False
        self.fault_code = 0
        for commanded in (self._controlword, self._mode, self._target, self._torque_offset):
            commanded.value = commanded.number
        self._mode_display.value = self._mode.number if self._check_mode(self._mode.number) is None else 0
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
        """Whether power is about to be on or is on, so that a lost connection affects the drive."""
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
        if mode != self._mode_display.value and self._check_mode(self._mode.number) is None:
            self._mode_display.value = mode
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
        """Whether the torque follows its target already; only asked in OPERATION ENABLED."""
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
        else:
            word = _ENABLED_WORD
            if self._mode_display.value == CYCLIC_SYNC_TORQUE and (not self._follow_delay or self._follows()):
                target: int = self._target.value + self._torque_offset.value  # numbers since `reset`
                demand = self._stage.limit(target)
                word = _FOLLOWING_WORD if demand == target else _LIMITING_WORD
        if demand != self.demand:
            self._move()
            self.demand, self.torque = demand, self._torque_sign * demand * self._stage.quantum
        if word != self._statusword.value or (before is not None and before is not state):
            self._statusword.value = word
            self.has_event = True

    def settle(self) -> None:
        """Make the transitions that need no command."""
        self.machine.settle(self._quick_stop_option.number)
        self.update()

    def fault(self) -> None:
        """Begin the fault reaction: torque 0 at once."""
        self.machine.fault()
        self.update()

    def abort_connection(self, option: int) -> None:
        """React to a lost connection as 0x6007 asks: 0 nothing, 2 disable voltage, 3 quick stop, else fault."""
        if option == 0 or not self.is_powered:
            return
        if option == 2:
            self.machine.disable_voltage()
        elif option == 3 and self.machine.state is _ENABLED:
            self.machine.quick_stop(self._quick_stop_option.number)
        elif option != 3:
            self.machine.fault()
        self.update()

    # --- measurement ------------------------------------------------------------------------------------------------

    def sample(self) -> None:
        """Measure at a SYNC; the first one that finds operation enabled starts the motor's clock."""
        motor, now, encoder = self.motor, self.now, self._read_encoder
        if self.is_running:
            motor.advance_to(now, self.torque)
        elif self.machine.state is _ENABLED:
            motor.begin(now)
            self.is_running = True
        self._moved_to = now
        self._count(self._position, motor.position if encoder is None else encoder(motor))
        if self.measures_velocity:
            self._count(self.velocity_entry, motor.velocity)
        self.show_torque()

    def show_torque(self) -> None:
        """Update 0x6074 from the demand in force, 0x6077 and 0x6078 from the measurement; current equals torque."""
        self._torque_demand.value = measured = self.demand
        if not self._meter.is_ideal:
            measured = self._meter.counts(self.now, self.torque, self._torque_sign * self._stage.quantum)
        self._torque_actual.value = self._current_actual.value = measured

    def measure(self) -> None:
        """Measure now, for an SDO upload or an event-driven TPDO."""
        self._move()
        motor, encoder = self.motor, self._read_encoder
        self._count(self._position, motor.position if encoder is None else encoder(motor))
        self._count(self.velocity_entry, motor.velocity)
        self.show_torque()

    def _move(self) -> None:
        if self.is_running and self.now != self._moved_to:
            self.motor.advance_to(self.now, self.torque)
            self._moved_to = self.now

    def _count(self, entry: Entry, value: float) -> None:
        """Write a position or velocity in counts; one that is not finite is a fault, and the object keeps its value."""
        try:
            counts = round(value * self._counts_per_unit) if self._rounds else math.floor(value * self._counts_per_unit)
        except (ValueError, OverflowError):
            self.fault_code = SENSOR_FAULT
            counts = entry.number
        entry.value = counts if -_HALF <= counts < _HALF else (counts + _HALF) % _COUNTS - _HALF

    def _check_mode(self, mode: int) -> SdoAbort | None:
        """Refuse modes that 0x6502 does not list: mode m is its bit m - 1, 0 is no mode. A drive without it has 10."""
        listed = CYCLIC_SYNC_TORQUE_BIT if self._supported_modes is None else self._supported_modes.number
        if mode == 0 or (mode > 0 and listed >> (mode - 1) & 1):
            return None
        return SdoAbort.VALUE_RANGE

    def _reload_limits(self) -> None:
        self._stage.reload()
        self._move()
        self.torque = self._torque_sign * self.demand * self._stage.quantum
        self.update()
