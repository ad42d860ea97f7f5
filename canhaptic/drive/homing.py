"""Homing of one drive in its own homing mode (IEC 61800-7-201, 0x6060 = 6); the drive is stopped however it ends.

The drive moves by itself: its generator and its loops make the torque, within 0x6072. The master starts it by bit 4 of
the controlword, watches it at each SYNC, and disables it at the end. Every torque that is sent is 0.
"""

from collections.abc import Callable
from typing import Final, NamedTuple

from canopen import ObjectDictionary

from canhaptic.canopen import objects as od
from canhaptic.canopen.objects import StatusBit, is_writable
from canhaptic.drive.axis_parameters import AxisParameters, CanBusParameters
from canhaptic.drive.can.bus_cycle import can_buses
from canhaptic.drive.can.link import Link
from canhaptic.drive.can.servo_drive import CanBringUp, ServoDrive
from canhaptic.drive.rig import Rig
from canhaptic.drive.safety.link_policy import StopReason
from canhaptic.drive.safety.power_states import ENABLED_MASK, ENABLED_VALUE
from canhaptic.errors import InputError, RigError, StartStoppedError

METHODS: Final = {
    1: "it moves towards smaller counts to the negative limit switch, then back to the next index",
    2: "it moves towards larger counts to the positive limit switch, then back to the next index",
    17: "it moves towards smaller counts to the negative limit switch, then back to its edge",
    18: "it moves towards larger counts to the positive limit switch, then back to its edge",
    33: "it moves towards smaller counts to the next index",
    34: "it moves towards larger counts to the next index",
    35: "nothing should move, the present position becomes the home position",
    37: "nothing should move, the present position becomes the home position",
}
"""Homing method -> motion of the axis; no other method is offered."""
_COUNTS_PER_SECOND: Final = 0x00B50300  # value of 0x60A9: increments (0xB5) per second (0x03), without a prefix
_START: Final = int(od.Controlword.ENABLE_OPERATION) | 1 << 4
_HALT: Final = int(od.Controlword.ENABLE_OPERATION) | 1 << 8
_ATTAINED: Final = 1 << 12 | int(StatusBit.TARGET_REACHED)  # in homing mode
_SETTLED: Final = 100_000_000  # [ns] after which a drive has taken an older result out of its statusword
_HALTED: Final = 120_000_000  # [ns] after which it has halted


class HomingOrder(NamedTuple):
    """Settings of a homing, as requested on the command line."""

    method: int  # 0x6098
    speeds: tuple[float, float]  # 0x6099:01 and :02 [m/s or rad/s]
    timeout: float  # [s]


class HomingDrive(ServoDrive):
    """A drive in homing mode; `torque_limit` of its axis is the limit of the homing.

    Raises:
        InputError: The drive cannot be homed with this order.
    """

    def __init__(
        self, link: Link, axis: AxisParameters, dictionary: ObjectDictionary, bus: CanBusParameters, order: HomingOrder
    ) -> None:
        self.order = order
        require_homing(axis, dictionary, order)
        super().__init__(link, axis, dictionary, bus)

    @property
    def takes_limit(self) -> bool:
        """Whether the start writes the limit of the torque (0x6072) into the drive."""
        return self.quirks.writes_max_torque and is_writable(self.dictionary, od.MAX_TORQUE)

    @property
    def mode_code(self) -> int:
        """Value of 0x6060 for the drive's mode."""
        return od.HOMING

    def bring_up(self) -> CanBringUp:
        """Return the steps that start the drive in homing mode."""
        return _HomingBringUp(self)

    def watch_statusword(self) -> None:
        """Watch only the state and bit 9 (remote): bits 10, 12 and 13 have other meanings in homing mode."""
        remote = self.statusword & int(StatusBit.REMOTE)
        self._watched, self._expected = ENABLED_MASK | remote, ENABLED_VALUE | remote

    def fault(self, now: int) -> StopReason:
        """Return the reason to stop; a jump to the new zero is none."""
        self._step = 0.0
        return super().fault(now)

    def _applied_per_mille(self, reported: int) -> int:
        """Torque of the hold that ended: the drive's own, which follows from no command."""
        return reported


class _HomingBringUp(CanBringUp):
    _drive: HomingDrive

    def _mode(self) -> None:
        """Write method and speeds, compare the unit of the velocity, then select the mode."""
        drive, order = self._drive, self._drive.order
        with self.step("velocity unit"):
            unit = self._read_if_there(od.VELOCITY_UNIT)
        if unit != _COUNTS_PER_SECOND and (unit is not None or od.VELOCITY_UNIT in drive.dictionary):
            seen = "no answer" if unit is None else f"{unit:#010x}"
            raise self.refusal("velocity unit", f"0x60A9: {seen}", f"counts per second ({_COUNTS_PER_SECOND:#010x})")
        for subindex, speed in enumerate(order.speeds, 1):
            self._write_confirmed("homing", od.HOMING_SPEEDS, subindex, round(speed * drive.axis.counts_per_unit))
        self._write_confirmed("homing", od.HOMING_METHOD, 0, order.method)
        super()._mode()


def require_homing(axis: AxisParameters, dictionary: ObjectDictionary, order: HomingOrder) -> None:
    """Refuse an order that the drive cannot follow safely, before anything is sent.

    Raises:
        InputError: The order is refused; the text names place, value and remedy.
    """
    name = axis.name
    if axis.causality.holds:
        raise InputError(f"{name}: {axis.causality.kind} is not homed here; home it with the vendor's tool")
    if not axis.watchdog:
        raise InputError(f"{name}: watchdog: false: a killed program would leave the axis moving; set watchdog: true")
    if order.method not in METHODS:
        known = ", ".join(map(str, METHODS))
        raise InputError(f"--method: got {order.method}, expected one of {known}; for others use the vendor's tool")
    for place in ((od.HOMING_METHOD, 0), (od.HOMING_SPEEDS, 1), (od.HOMING_SPEEDS, 2)):
        if not is_writable(dictionary, *place):
            where = f"{place[0]:#06x}:{place[1]:02x}"
            text = f"{axis.eds} lists no writable {where}, so the drive cannot be homed over the bus"
            raise InputError(f"{name}: {text}; home it with the vendor's tool")
    for speed in order.speeds:
        if not (0.0 < speed <= axis.largest_speed and 1 <= round(speed * axis.counts_per_unit) < 1 << 31):
            limit = f"at most {axis.largest_speed:g} {axis.unit}/s (speed_limit), at least one count per second"
            raise InputError(f"--speed: got {speed:g} {axis.unit}/s, expected {limit}")
    if not 0.0 < order.timeout <= 600.0:
        raise InputError(f"--timeout: got {order.timeout:g} s, expected more than 0, at most 600 s")


def home(drive: HomingDrive, stopped: Callable[[], bool]) -> tuple[int, int] | None:
    """Home one drive and leave it disabled.

    Returns:
        0x6064 before and after; None where it was stopped.

    Raises:
        StartError: A step was not confirmed; nothing moved.
        RigError: The drive showed an error, took too long or moved too fast, or the rig failed on the way.
    """
    rig = Rig(can_buses(drive.link, [drive], drive.bus), [drive], drive.bus)
    try:
        rig.start()
    except StartStoppedError:
        return None
    try:
        before = drive.position_counts
        problem = _await_home(rig, drive, stopped)
        drive.controlword = _HALT
        end = rig.clock.now() + _HALTED
        while rig.clock.now() < end:
            _cycle(rig)
        after = drive.position_counts
        rig.stop()
    except BaseException:
        rig.stop(ramp=False)
        raise
    if problem:
        raise RigError(f"{drive.axis.name}: {problem}; it was halted and disabled", rig.records)
    return None if problem is None else (before, after)


def _await_home(rig: Rig, drive: HomingDrive, stopped: Callable[[], bool]) -> str | None:
    """Start the homing; return "" once it is attained, None if it was stopped, else the problem in words."""
    order, rate = drive.order, drive.axis.counts_per_unit
    most = 2.0 * max(order.speeds) * rig.bus.sample_time + 2.0 / rate
    last, fast = _cycle(rig), 0
    is_new = order.method in (35, 37) or drive.statusword & _ATTAINED != _ATTAINED  # an older result may show again
    begin = rig.clock.now()
    drive.controlword = _START
    while not stopped():
        position = _cycle(rig)
        fast, last = fast + 1 if abs(position - last) > most * rig.periods else 0, position
        if fast >= 5:  # in a row: the new zero makes one step
            return "it moved more than twice as fast as asked: 0x6099 is not in counts per second, or a force moves it"
        is_attained, elapsed = drive.statusword & _ATTAINED == _ATTAINED, rig.clock.now() - begin
        is_new = is_new or not is_attained
        if elapsed < _SETTLED:
            continue
        if drive.statusword & (1 << 13):
            return f"homing error (bit 13 of the statusword {drive.statusword:#06x}) with method {order.method}"
        if is_attained and is_new:
            return ""
        if elapsed > order.timeout * 1e9:
            return f"no home within {order.timeout:g} s (statusword {drive.statusword:#06x}); check method and switches"
    return None


def _cycle(rig: Rig) -> float:
    """Exchange process data once, with zero torque; return the position [m or rad]."""
    [sample] = rig.sync()
    rig.write_torques([0.0])
    return sample.position
