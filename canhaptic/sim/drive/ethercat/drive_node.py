"""The simulated EtherCAT drive: states of the application layer, SYNC0, watchdogs, with the CiA 402 servo behind.

At SYNC0 of its own clock it samples the position and the torque held, shows them in the inputs, and THEN acts on the
outputs that came since the SYNC0 before. It shares with the master only constants of the object dictionary.
"""

from typing import Final, NamedTuple

from canhaptic.canopen import objects
from canhaptic.canopen.objects import DataType, Dictionary
from canhaptic.signals import Truth
from canhaptic.sim.drive import SimulatedDriveParameters
from canhaptic.sim.drive.ethercat.distributed_clock import DistributedClock
from canhaptic.sim.drive.ethercat.eeprom import MAILBOXES, slave_information
from canhaptic.sim.drive.ethercat.esc import Esc
from canhaptic.sim.drive.ethercat.mailbox import Mailbox
from canhaptic.sim.drive.ethercat.process_image import ProcessImage
from canhaptic.sim.drive.profile import emergency as emcy
from canhaptic.sim.drive.profile.object_store import ObjectStore
from canhaptic.sim.drive.profile.power_stage import servo_of
from canhaptic.sim.drive.profile.reactions import Reactions
from canhaptic.sim.drive.profile.servo import Motor
from canhaptic.sim.drive.profile.state_machine import DriveState
from canhaptic.sim.drive.profile.timers import Timers

_INIT, _PRE_OP, _BOOT, _SAFE_OP, _OP = 1, 2, 3, 4, 8
_ERROR: Final = 0x10  # bit of AL status; in AL control it acknowledges
_INVALID_CHANGE, _UNKNOWN_STATE, _NO_BOOTSTRAP, _BAD_MAILBOXES = 0x11, 0x12, 0x13, 0x16
_NO_OUTPUTS, _SYNC_ERROR, _WATCHDOG, _BAD_OUTPUTS, _BAD_INPUTS = 0x19, 0x1A, 0x1B, 0x1D, 0x1E
_BAD_INPUT_MAP, _BAD_OUTPUT_MAP, _FATAL_SYNC, _NO_SYNC, _BAD_START, _BAD_CYCLE = 0x24, 0x25, 0x2C, 0x2D, 0x30, 0x35
_SYNC_MANAGER: Final = 0x1C32  # of the outputs; 0x1C33 of the inputs
_SYNC_LIMIT: Final = (0x10F1, 2)
_MISS, _HIT = 3, 1  # what a SYNC0 without new outputs adds to the counter of sync errors, and one with them takes away
_FAULT: Final = 1  # value of 0x6007; used when a dictionary has no such object
_CLOCKED, _AT_OUTPUTS = 2, 1  # values of 0x1C32:01
_FAULTY: Final = frozenset((DriveState.FAULT_REACTION_ACTIVE, DriveState.FAULT))
_NEXT: Final = {_INIT: _PRE_OP, _PRE_OP: _SAFE_OP, _SAFE_OP: _OP}
_tuple: Final = tuple.__new__


class ClockParameters(NamedTuple):
    """Clock of a simulated drive."""

    drift_ppb: int = 0  # of its rate against the host's [1e-9]
    epoch: int = 0  # local time at host time 0 [ns]
    has_servo: bool = True  # follows the reference clock


_EXACT: Final = ClockParameters()


class EthercatDrive:
    """One CiA 402 servo drive with its motor; a `Cable` hands it frames and time.

    Args:
        dictionary: Its object dictionary.
        motor: Motor that it drives; at rest until the first SYNC0 in OPERATION ENABLED.
        parameters: Values that the dictionary does not state.
        sample_time_ns: Interval of its cycle where SYNC0 is off [ns].
        clock: Its clock.
        has_information: Whether it answers SDO information.

    Attributes:
        store: Objects of the drive.
        servo: Power stage of the drive.
        esc: Its EtherCAT controller.
        timers: Timers of the drive's own actions.
        al_state: State of the application layer.
        holds: SYNC0s so far.

    Raises:
        ParameterError: The rated torque is unknown, or `parameters.objects` names an object that does not exist.
    """

    def __init__(
        self, dictionary: Dictionary, motor: Motor, parameters: SimulatedDriveParameters, sample_time_ns: int,
        clock: ClockParameters = _EXACT, *, has_information: bool = True,
    ) -> None:  # fmt: skip
        absent = parameters.absent_places()
        self.store = store = ObjectStore(dictionary, parameters.object_values(), absent, parameters.refused_values())
        store.guard_storage()
        self.servo = servo_of(store, motor, parameters)
        self.al_state, self.holds, self._sample_time = _INIT, 0, sample_time_ns
        self.timers = timers = Timers()
        self._outbox: list[bytes] = []
        self._clock = DistributedClock(clock.drift_ppb, clock.epoch, has_servo=clock.has_servo)
        name = store.find(0x1008)
        text = name.value.decode("latin-1") if name is not None and isinstance(name.value, bytes) else "servo drive"
        self.esc = Esc(self, self._clock, slave_information(self._identity(), text, has_information=has_information))
        self.mailbox = Mailbox(
            store, dictionary, MAILBOXES.into_size, has_information=has_information, send=self._send_mail
        )
        self._emergency = emcy.EmergencyProducer(store, self._send_emergency)
        self.image = ProcessImage(store, self.servo, parameters.syncs_late, lambda: self.al_state == _PRE_OP)
        self._shows_next_torque = parameters.torque_read_back == "after_update"
        self._sync_timer = timers.add(self._on_sync0)
        self._reactions = Reactions(self.servo, self._emergency, timers, self._sync_period, self._settle)
        self._watchdog = timers.add(self._on_silence)
        self._sync_limit = store.find(*_SYNC_LIMIT)
        self._sync_errors, self._has_outputs, self._has_synced, self._left_over = 0, False, False, False
        self._has_expired = False
        self._abort_option = store.find(objects.ABORT_CONNECTION_OPTION)
        managers = ((_SYNC_MANAGER, DataType.UNSIGNED16, n) for n in (1, 11))
        self._sync_type, self._missed = (store.optional(index, kind, n) for index, kind, n in managers)
        self._least_cycle = store.optional(_SYNC_MANAGER, DataType.UNSIGNED32, 5)
        self._show(_INIT, 0)
        self.servo.settle()
        self.servo.has_event = False

    def _identity(self) -> tuple[int, int, int, int]:
        found = [self.store.find(objects.IDENTITY, n) for n in (1, 2, 3, 4)]
        vendor, product, revision, serial = (0 if entry is None else entry.number for entry in found)
        return vendor, product, revision, serial

    # --- what a cable asks ------------------------------------------------------------------------------------------

    def advance(self, now: int) -> None:
        """Run what is due up to `now` [ns], in order of time."""
        if now >= self.timers.earliest:
            self.timers.fire(now)
        self.servo.now = self.esc.now = now

    def truth(self) -> Truth:
        """True position and energies of the motor, as of the last SYNC0 or change of torque."""
        motor = self.servo.motor
        return _tuple(Truth, (motor.position, motor.energy()))

    def inject_fault(self, code: int = 0x5000) -> None:
        """Inject a fault with an error code (0x603F), as if hardware had failed."""
        self.servo.fault_code = code
        self._reactions.follow()

    def leave_op(self, code: int = _SYNC_ERROR) -> None:
        """Fall to SAFE-OP with an AL status code, as if the firmware had found a reason."""
        if self.al_state == _OP:
            self._fall(code, emcy.COMMUNICATION)

    @property
    def state(self) -> DriveState:
        """State of the power drive system."""
        return self.servo.state

    @property
    def torque(self) -> float:
        """Torque held at the axis [N*m or N]."""
        return self.servo.torque

    # --- application layer ------------------------------------------------------------------------------------------

    def control(self, request: int) -> None:
        """Act on a write to AL control."""
        wanted, has_error = request & 0x0F, bool(self.esc.registers[0x130] & _ERROR)
        if has_error and not request & _ERROR:
            return
        if wanted not in (_INIT, _PRE_OP, _BOOT, _SAFE_OP, _OP):
            self._show(self.al_state, _UNKNOWN_STATE)
        elif code := self._refusal(wanted):
            self._show(self.al_state, code)
        else:
            self._enter(wanted)

    def _refusal(self, wanted: int) -> int:
        """Return why a state is refused as AL status code; 0 if it is not."""
        if wanted == _BOOT:
            return _NO_BOOTSTRAP
        if wanted <= self.al_state:
            return 0
        if wanted != _NEXT.get(self.al_state):
            return _INVALID_CHANGE
        if wanted == _PRE_OP:
            return 0 if self._has_mailboxes() else _BAD_MAILBOXES
        return self._refusal_of_safe_op() if wanted == _SAFE_OP else self._refusal_of_op()

    def _has_mailboxes(self) -> bool:
        first, second = self.esc.managers[:2]
        rows = ((first, MAILBOXES.out, MAILBOXES.out_size, True), (second, MAILBOXES.into, MAILBOXES.into_size, False))
        return all(
            m.is_enabled and m.is_mailbox and (m.start, m.length, m.from_master) == (start, size, from_master)
            for m, start, size, from_master in rows
        )

    def _refusal_of_safe_op(self) -> int:
        self.image.compile()
        outputs, inputs = self.esc.managers[2:]
        out, into, is_clocked = self.image.output_size, self.image.input_size, self.esc.is_clocked
        faults = {
            _BAD_OUTPUT_MAP: out < 0,
            _BAD_INPUT_MAP: into < 0,
            _BAD_OUTPUTS: (outputs.length if outputs.is_enabled else 0) != out or not outputs.from_master,
            _BAD_INPUTS: (inputs.length if inputs.is_enabled else 0) != into or inputs.from_master,
            _FATAL_SYNC: is_clocked and self._left_over,
            _BAD_CYCLE: is_clocked and self._clock.period < max(1, self._least_cycle.number),
            _BAD_START: is_clocked and self._clock.next_sync is None,
        }
        return next((code for code, is_found in faults.items() if is_found), 0)

    def _refusal_of_op(self) -> int:
        if self.esc.is_clocked and not self._has_synced:
            return _NO_SYNC
        return 0 if self._has_outputs else _NO_OUTPUTS

    def _enter(self, state: int) -> None:
        before, self.al_state = self.al_state, state
        if before == _OP and state != _OP:
            self._leave(emcy.COMMUNICATION)
        if state == _INIT:
            self._outbox.clear()
            self.mailbox.reset()
        elif before == _INIT:
            self._left_over = self.esc.is_clocked
            self.mailbox.reset()
        if state == _SAFE_OP and before == _PRE_OP:
            self._has_outputs = False
            self._sync_type.value = _CLOCKED if self.esc.is_clocked else _AT_OUTPUTS
            self._show_inputs()
        if state == _OP and before == _SAFE_OP:
            self._sync_errors = 0
            self._missed.value = 0
            if self.servo.state not in _FAULTY:
                self._emergency.withdraw(emcy.COMMUNICATION, emcy.SYNC_LOST)
            self._watch()
        self._show(state, 0)

    def _show(self, state: int, code: int) -> None:
        self.esc.set_al(state | (_ERROR if code else 0), code)

    def _fall(self, code: int, emergency: int) -> None:
        """Leave OP for SAFE-OP with an error."""
        self.al_state = _SAFE_OP
        self._show(_SAFE_OP, code)
        self._leave(emergency)

    def _leave(self, emergency: int) -> None:
        """Stop the power stage as the connection is lost; the outputs act no more."""
        self.timers.stop(self._watchdog)
        self.image.compile()
        if self.servo.is_powered:
            self._emergency.announce(emergency)
            option = self._abort_option
            if emergency == emcy.SYNC_LOST or option is None or option.value is None:
                self.servo.fault()
            else:
                self.servo.abort_connection(option.number)
            if self.servo.torque:  # 0x6007 = 0 leaves the torque; a drive out of OP has none
                self.servo.fault()
        self._reactions.follow()

    def _watch(self) -> None:
        if self.al_state == _OP and (limit := self.esc.watchdog_ns):
            self.timers.start(self._watchdog, self.esc.now + limit)
            if self._has_expired:
                self._has_expired = False
                self.esc.show_watchdog(has_expired=False)

    def _on_silence(self, due: int) -> None:
        self.servo.now, self._has_expired = due, True
        self.esc.show_watchdog(has_expired=True)
        if self.al_state == _OP:
            self._fall(_WATCHDOG, emcy.COMMUNICATION)

    # --- SYNC0 and outputs ------------------------------------------------------------------------------------------

    def clock_moved(self) -> None:
        """Note when the next SYNC0 is due by the host's time; never before the present."""
        following = self._clock.next_sync
        if following is None:
            self.timers.stop(self._sync_timer)
            self._has_synced = False
            if not self.esc.is_clocked:
                self._left_over = False
        else:
            self.timers.start(self._sync_timer, max(self.esc.now, self._clock.host(following)))

    def map_changed(self) -> None:
        """Do nothing: a cable replaces this where it keeps what follows from the maps."""

    def _on_sync0(self, due: int) -> None:
        clock, servo = self._clock, self.servo
        assert clock.next_sync is not None  # noqa: S101  # the timer runs while it is on
        clock.next_sync += clock.period
        self.timers.start(self._sync_timer, max(due + 1, clock.host(clock.next_sync)))
        self.holds += 1
        self._has_synced = True
        servo.now = due
        if self.al_state < _SAFE_OP:
            return
        is_new = self.esc.managers[2].is_fresh
        outputs = self.esc.managers[2].take() if is_new else None
        if self.al_state == _OP:
            self._count_sync(is_new=is_new)
        self._run(outputs)

    def _run(self, outputs: bytes | None) -> None:
        """Sample, show the inputs, and act on the outputs."""
        servo = self.servo
        servo.sample()
        acts = self.al_state == _OP
        if self._shows_next_torque and acts:
            self.image.take(outputs)
            servo.show_torque()
        self._show_inputs()
        if acts and not self._shows_next_torque:
            self.image.take(outputs)
        if servo.has_event or servo.fault_code:
            self._reactions.follow()

    def _show_inputs(self) -> None:
        if self.image.input_size > 0:
            self.esc.managers[3].put(self.image.show())

    def _count_sync(self, *, is_new: bool) -> None:
        """Count a SYNC0 without new outputs, and leave OP when there are too many."""
        if is_new:
            self._sync_errors = max(0, self._sync_errors - _HIT)
            return
        self._missed.value = (self._missed.number + 1) & 0xFFFF
        self._sync_errors += _MISS
        if self._sync_limit is not None and self._sync_errors > _MISS * self._sync_limit.number:
            self._fall(_SYNC_ERROR, emcy.SYNC_LOST)

    def outputs_came(self) -> None:
        """Act on outputs that have arrived whole: at the next SYNC0, or at once where it is off."""
        if self.al_state < _SAFE_OP:
            return
        self._has_outputs = True
        self._watch()
        if not self.esc.is_clocked:
            self.servo.now = self.esc.now
            self._run(self.esc.managers[2].take())

    # --- mail -------------------------------------------------------------------------------------------------------

    def mail_came(self, mail: bytes) -> None:
        """Answer a mail of the master."""
        if self.al_state != _INIT:
            self.servo.now = self.esc.now
            self.mailbox.take(mail)
            self._reactions.follow()

    def mail_taken(self) -> None:
        """Show the next mail, now that the master has read one."""
        if self._outbox:
            self.esc.send(self._outbox.pop(0))

    def _send_mail(self, mail: bytes) -> None:
        if self.esc.managers[1].is_fresh:
            self._outbox.append(mail)
        else:
            self.esc.send(mail)

    def _send_emergency(self, content: bytes) -> None:
        if self.al_state != _INIT:
            self.mailbox.send_emergency(content)

    # --- faults -----------------------------------------------------------------------------------------------------

    def _settle(self) -> None:
        self.servo.settle()
        self._reactions.follow()

    def _sync_period(self) -> int:
        return self._clock.period or self._sample_time
