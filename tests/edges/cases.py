"""What drive, bus, another node or own code may do in the middle of a run, with the right end of each.

A case ends with its `StopReason`, or goes on to the last cycle, and sends its last torque so many SYNCs later.
"""

import struct
from collections.abc import Callable
from typing import Any, NamedTuple

import can

from canhaptic.drive.safety.link_policy import StopReason
from tests.edges.short_run import Deed, Edge


def nothing(edge: Edge) -> None:
    """Nothing happens."""


class Case(NamedTuple):
    """What is done, and how the run has to end."""

    kind: str  # of which one case is in `make test`
    reason: StopReason | None  # None: it goes on
    syncs: int | None  # SYNCs from the deed to the last torque; None where it goes on
    deed: Deed = nothing
    each: Deed = nothing
    changes: tuple[str, ...] = ()
    cycles: int = 60
    name: str = "demo.yaml"
    own: bool = False  # whether the environment is own code in a process


# --- frames that somebody in between changes --------------------------------------------------------------------------


def tpdo(change: Callable[[int, int, int], tuple[int, int, int]]) -> Deed:
    """From now on the master gets another statusword, position [counts] or torque [per mille]."""

    def deed(edge: Edge) -> None:
        def changed(message: can.Message) -> can.Message:
            if message.arbitration_id == edge.tpdo:
                size = len(message.data)  # without a torque where none is read back
                word, position, torque = change(*struct.unpack("<Hih", message.data.ljust(8, b"\0")))
                position = (position + 2**31) % 2**32 - 2**31
                message.data = bytearray(struct.pack("<Hih", word, position, torque)[:size])
            return message

        edge.far.on_send = changed

    return deed


def once(change: Callable[[int, int, int], tuple[int, int, int]]) -> Deed:
    """As `tpdo`, for one frame."""
    left = [True]

    def changing(*seen: int) -> tuple[int, int, int]:
        if left:
            left.clear()
            return change(*seen)
        return seen  # type: ignore[return-value]

    def deed(edge: Edge) -> None:
        left[:] = [True]
        tpdo(changing)(edge)

    return deed


def bits(clear: int = 0, put: int = 0) -> Callable[[int, int, int], tuple[int, int, int]]:
    return lambda word, position, torque: (word & ~clear | put, position, torque)


def jumps(counts: int) -> Deed:
    """The encoder is off by so many counts from now on."""
    return tpdo(lambda word, position, torque: (word, position + counts, torque))


def kept(message: can.Message | None, *can_ids: int, is_dropped: bool = True) -> can.Message | None:
    return None if message is not None and (message.arbitration_id in can_ids) == is_dropped else message


def lost(*, to_drive: bool = False, to_master: bool = False, only: Callable[[Edge], int] | None = None) -> Deed:
    """Frames are lost on their way: all, or those of one COB-ID."""

    def deed(edge: Edge) -> None:
        def dropped(message: can.Message) -> can.Message | None:
            return None if only is None or message.arbitration_id == only(edge) else message

        if to_drive:
            edge.far.on_receive = dropped
        if to_master:
            edge.far.on_send = dropped

    return deed


def content_late(by: int) -> Deed:
    """Each TPDO has the content of an earlier one; `by` 0: of the first for ever."""

    def deed(edge: Edge) -> None:
        contents: list[bytes] = []

        def late(message: can.Message) -> can.Message | None:
            if message.arbitration_id == edge.tpdo:
                contents.append(bytes(message.data))
                if by and len(contents) <= by:
                    return None
                message.data = bytearray(contents[-1 - by] if by else contents[0])
            return message

        edge.far.on_send = late

    return deed


def shortened(is_whole: Callable[[int], bool]) -> Deed:
    """TPDOs have two bytes too few, but for the n-th ones that are whole."""

    def deed(edge: Edge) -> None:
        count = [0]

        def cut(message: can.Message) -> can.Message:
            if message.arbitration_id == edge.tpdo:
                count[0] += 1
                if not is_whole(count[0]):
                    message.data, message.dlc = message.data[:6], 6
            return message

        edge.far.on_send = cut

    return deed


def twice(edge: Edge) -> None:
    """Every frame of the drive reaches the master twice."""
    send = edge.far.send

    def sent(message: can.Message, timeout: float | None = None) -> None:
        send(message, timeout)
        send(message, timeout)

    edge.far.send = sent


def twin(edge: Edge) -> None:
    """Each TPDO is followed by another, of a drive that is at rest elsewhere."""
    send = edge.far.send

    def sent(message: can.Message, timeout: float | None = None) -> None:
        send(message, timeout)
        if message.arbitration_id == edge.tpdo:
            edge.sends(edge.tpdo, struct.pack("<Hih", 0x1237, 60_000, 0))

    edge.far.send = sent


def other_node(edge: Edge) -> None:
    """The drive's TPDO has the COB-ID of another node."""

    def renamed(message: can.Message) -> can.Message:
        message.arbitration_id += message.arbitration_id == edge.tpdo
        return message

    edge.far.on_send = renamed


def refuses(is_refused: Callable[[int], bool]) -> Deed:
    """The interface refuses the n-th frame of the master, from 1 on."""

    def deed(edge: Edge) -> None:
        count = [0]

        def sent(message: can.Message) -> can.Message:
            count[0] += 1
            if is_refused(count[0]):
                raise can.CanOperationError("No buffer space available", 105)
            return message

        edge.master.on_send = sent

    return deed


def unreadable(edge: Edge) -> None:
    """The interface is down: reading fails."""

    def down(timeout: float | None = None) -> None:
        raise can.CanOperationError("Network is down", 100)

    edge.master.recv = down


# --- what other nodes send --------------------------------------------------------------------------------------------


def frame(base: int, *data: int, count: int = 1, of_drive: bool = True, **kind: bool) -> Deed:
    """Somebody sends a frame, with the COB-ID of the drive or another."""

    def deed(edge: Edge) -> None:
        for _ in range(count):
            edge.sends(base + (edge.drive.node_id if of_drive else 0), data, **kind)

    return deed


def sdo(index: int, value: int, size: int, sub: int = 0) -> Deed:
    command = {1: 0x2F, 2: 0x2B, 4: 0x23}[size]
    return lambda edge: frame(0x600, *struct.pack("<BHBi", command, index, sub, value))(edge)


def rpdo(word: int, target: int) -> Deed:
    return frame(0x200, *struct.pack("<Hh", word, target))


def nmt(command: int, *, to_all: bool = False) -> Deed:
    return lambda edge: edge.sends(0, (command, 0 if to_all else edge.drive.node_id))


def own_heartbeat(edge: Edge) -> None:
    """Somebody sends the heartbeat of this master."""
    [can_id] = {one.can_id for one in edge.frames if one.can_id > 0x700} or {0x77E}
    edge.sends(can_id, (5,))


# --- the drive --------------------------------------------------------------------------------------------------------


def fault(code: int) -> Deed:
    return lambda edge: edge.drive.inject_fault(code)


def reboots(edge: Edge) -> None:
    edge.drive._power_on(edge.experiment.clock.now())


def disabled(edge: Edge) -> None:
    edge.drive.servo.machine.disable_voltage()
    edge.drive.servo.update()


def quick_stopped(edge: Edge) -> None:
    edge.drive.servo.machine.quick_stop(2)
    edge.drive.servo.update()


# --- the controller ---------------------------------------------------------------------------------------------------


class Own:
    """A controller in the place of another: gives another torque, or raises."""

    def __init__(self, inner: Any, torque: Callable[[], float]) -> None:
        self._inner, self._torque = inner, torque

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def step(self, position: float, torque: float) -> Any:
        return self._inner.step(position, torque)._replace(torque=self._torque())


def raises() -> float:
    raise ZeroDivisionError("own")


def controller(torque: Callable[[], float]) -> Deed:
    def deed(edge: Edge) -> None:
        port = edge.experiment.cycle.ports[0]
        port.controller = Own(port.controller, torque)

    return deed


# --- a display, own code, the operator --------------------------------------------------------------------------------


def force(change: Callable[[int], int]) -> Deed:
    """The master gets another count of the force sensor."""
    return tpdo(lambda word, position, count: (word, position, change(count)))


def ends(edge: Edge) -> None:
    assert edge.experiment.code is not None
    edge.experiment.code._process.kill()
    edge.experiment.code._process.wait()


def stops(edge: Edge) -> None:
    edge.wants_stop = True


R = StopReason
DISPLAY = "admittance/virtual_mass.yaml"
FRICTION = ("passivity.drive_friction=0.5 N", "passivity.drive_damping=2.2 N*s/m")
STALLS = "{stall: [{begin: 2, duration: 60 ms, every: 75 ms}]}"
LOSSY = ("axes.0.energy_uncertainty_limit=none", "axes.0.energy_loss_limit=none")
ACTUAL, UNREAD = ("axes.0.read_back=actual",), ("axes.0.read_back=none",)
CASES: dict[str, Case] = {
    # the drive
    "EMCY": Case("EMCY", R.EMERGENCY, 1, frame(0x80, 0x10, 0x23, 1, 0, 0, 0, 0, 0)),
    "EMCY of one byte": Case("EMCY", R.EMERGENCY, 1, frame(0x80, 0x10)),
    "EMCY 0x5441 and disabled": Case("EMCY", R.EMERGENCY, 1, fault(0x5441)),
    "EMCY 0xFF10, 20 a cycle": Case("EMCY", R.EMERGENCY, 2, each=frame(0x80, 0x10, 0xFF, 1, 0, 0, 0, 0, 0, count=20)),
    "EMCY 0x0000, 20 a cycle": Case("EMCY", None, None, each=frame(0x80, 0, 0, 0, 0, 0, 0, 0, 0, count=20)),
    "EMCY of another node": Case(
        "EMCY", None, None, each=frame(0x80 + 99, 0x10, 0x23, 1, 0, 0, 0, 0, 0, of_drive=False)
    ),
    "fault of the drive": Case("drive", R.EMERGENCY, 1, fault(0x2310)),
    "statusword of a fault, once": Case("statusword", R.DRIVE_FAULT, 1, once(lambda w, p, t: (0x0238, p, t))),
    "disable voltage": Case("drive", R.STATE_LEFT, 1, disabled),
    "quick stop": Case("drive", R.STATE_LEFT, 1, quick_stopped),
    "bit 9 gone": Case("statusword", R.STATE_LEFT, 1, tpdo(bits(clear=0x200))),
    "bit 4 gone": Case("statusword", None, None, tpdo(bits(clear=0x10))),
    "bit 12 gone": Case("statusword", R.NOT_FOLLOWING, 3, tpdo(bits(clear=0x1000))),
    "bit 11, demand read back": Case("statusword", None, None, tpdo(bits(put=0x800))),
    "bit 11, nothing read back": Case("statusword", R.TORQUE_LIMITED, 3, tpdo(bits(put=0x800)), changes=UNREAD),
    "statusword of another state, once": Case("statusword", R.STATE_LEFT, 1, once(lambda w, p, t: (0x0250, p, t))),
    "bit 12 gone, once": Case("statusword", None, None, once(bits(clear=0x1000))),
    "reboot": Case("drive", R.NMT_STATE_LEFT, 1, reboots),
    "boot-up of a twin": Case("twin", R.NMT_STATE_LEFT, 1, frame(0x700, 0)),
    "boot-ups of a twin": Case("twin", R.NMT_STATE_LEFT, 3, each=frame(0x700, 0)),
    "heartbeat of a twin in pre-operational": Case("twin", R.NMT_STATE_LEFT, 1, frame(0x700, 0x7F)),
    "heartbeats of a twin in operational": Case("twin", None, None, each=frame(0x700, 5)),
    "TPDO of a twin, out of the window": Case(
        "twin", R.TPDO_CONTRADICTED, 21, each=frame(0x180, 0x50, 2, 0, 0, 0, 0, 0, 0)
    ),
    "TPDO of a twin, in the window": Case("twins", R.TPDO_CONTRADICTED, 4, twin),
    # a second master
    **{
        f"NMT {word}{' to all' if to_all else ''}": Case("NMT", R.SECOND_MASTER, 1, nmt(command, to_all=to_all))
        for word, command in {
            "stop": 2,
            "pre-operational": 0x80,
            "reset node": 0x81,
            "reset communication": 0x82,
        }.items()
        for to_all in (False, True)
    },
    "SYNC of another": Case("second master", R.SECOND_MASTER, 1, frame(0x80, of_drive=False)),
    "SYNCs of another": Case("second master", R.SECOND_MASTER, 2, each=frame(0x80, of_drive=False)),
    "quick stop by RPDO": Case("second master", R.SECOND_MASTER, 1, rpdo(0x0B, 0)),
    "RPDO of 900": Case("second master", R.SECOND_MASTER, 1, rpdo(0x0F, 900)),
    "RPDOs of 900": Case("second master", R.SECOND_MASTER, 2, each=rpdo(0x0F, 900)),
    "SDO controlword 0": Case("foreign SDO", R.SECOND_MASTER, 1, sdo(0x6040, 0, 2)),
    "SDO target 900": Case("foreign SDO", R.SECOND_MASTER, 1, sdo(0x6071, 900, 2)),
    "SDO targets 900": Case("foreign SDO", R.SECOND_MASTER, 2, each=sdo(0x6071, 900, 2)),
    "SDO mode 8": Case("foreign SDO", R.SECOND_MASTER, 1, sdo(0x6060, 8, 1)),
    "SDO limit 2000": Case("foreign SDO", R.SECOND_MASTER, 1, sdo(0x6072, 2000, 2)),
    "SDO RPDO off": Case("foreign SDO", R.SECOND_MASTER, 1, sdo(0x1400, -0x7FFFFDFF, 4, 1)),
    "SDO watchdog off": Case("foreign SDO", R.SECOND_MASTER, 1, sdo(0x1016, 0, 4, 1)),
    "heartbeat of another master": Case("second master", R.SECOND_MASTER, 2, each=own_heartbeat),
    # the cable
    "cut both ways": Case("cable", R.TPDO_LOST, 3, lost(to_drive=True, to_master=True)),
    "cut to the drive": Case("cable", R.TPDO_LOST, 3, lost(to_drive=True)),
    "cut to the master": Case("cable", R.TPDO_LOST, 3, lost(to_master=True)),
    "SYNC lost": Case("cable", R.TPDO_LOST, 3, lost(to_drive=True, only=lambda edge: 0x80)),
    "TPDO gone": Case("TPDO", R.TPDO_LOST, 3, lost(to_master=True, only=lambda edge: edge.tpdo)),
    "TPDO of another node": Case("TPDO", R.TPDO_LOST, 3, other_node),
    "TPDO short": Case("TPDO", R.TPDO_LOST, 3, shortened(lambda n: False)),
    "TPDO short every other time": Case(
        "losses", R.FRAMES_LOST, 49, shortened(lambda n: n % 2 == 0), changes=LOSSY, cycles=300
    ),
    "TPDO whole once in 20": Case("losses", R.FRAMES_LOST, 3, shortened(lambda n: n % 20 == 0), changes=LOSSY),
    "TPDO whole once in 20, account not to be known": Case(
        "losses",
        R.ENERGY_UNCERTAIN,
        3,
        shortened(lambda n: n % 19 == 0),
        changes=("bus.loss_limit=1", "axes.0.energy_uncertainty_limit=0.1 W"),
        cycles=300,
    ),
    **{
        f"torque read back {word}, {read_back}": Case(
            "torque",
            R.TORQUE_CONTRADICTED,
            20,
            tpdo(change),
            changes=(f"axes.0.read_back={read_back}", *LOSSY),
            cycles=300,
        )
        for word, change in {
            "doubled": lambda w, p, t: (w, p, 2 * t),
            "negated": lambda w, p, t: (w, p, -t),
            "and 10 N": lambda w, p, t: (w, p, t + 1000),
            "320 N": lambda w, p, t: (w, p, 32_000),
        }.items()
        for read_back in ("demand", "actual")
    },
    "RPDO lost, demand read back": Case(
        "RPDO", R.COMMAND_LOST, 21, lost(to_drive=True, only=lambda edge: edge.rpdo), cycles=300
    ),
    "RPDO lost, actual read back": Case(
        "RPDO", R.COMMAND_LOST, 28, lost(to_drive=True, only=lambda edge: edge.rpdo), changes=ACTUAL, cycles=300
    ),
    "RPDO lost, nothing read back": Case(
        "RPDO", R.EMERGENCY, 99, lost(to_drive=True, only=lambda edge: edge.rpdo), changes=UNREAD, cycles=600
    ),
    "heartbeat of the drive lost": Case(
        "heartbeat",
        R.HEARTBEAT_LOST,
        83,
        lost(to_master=True, only=lambda edge: 0x700 + edge.drive.node_id),
        cycles=600,
    ),
    "heartbeat of the master lost": Case(
        "heartbeat", R.EMERGENCY, 83, lost(to_drive=True, only=lambda edge: 0x77E), cycles=600
    ),
    "ENOBUFS once": Case("interface", None, None, refuses(lambda n: n == 1)),
    "ENOBUFS every other frame": Case("interface", None, None, refuses(lambda n: n % 2 == 0)),
    "ENOBUFS twice": Case("interface", R.SEND_FAILED, 0, refuses(lambda n: n <= 2)),
    "ENOBUFS 40 times": Case("interface", R.SEND_FAILED, 1, refuses(lambda n: n <= 40)),
    "ENOBUFS for ever": Case("interface", R.SEND_FAILED, None, refuses(lambda n: True)),
    "interface down": Case("interface", R.SEND_FAILED, 0, unreadable),
    # what frames say
    "position 1 count further": Case("position", None, None, jumps(1)),
    "position 9 counts further": Case("position", None, None, jumps(9)),
    "position 1 mm further": Case("position", None, None, jumps(1000)),
    "position 50 mm back": Case("position", R.POSITION_JUMP, 1, jumps(-50_000)),
    "position 50 mm further": Case("position", R.POSITION_JUMP, 1, jumps(50_000)),
    "position 2^30 further": Case("position", R.POSITION_JUMP, 1, jumps(2**30)),
    "position 2^31 further": Case("position", R.POSITION_JUMP, 1, jumps(2**31)),
    "every frame twice": Case("bus", None, None, twice),
    "50 frames a cycle": Case("bus", None, None, each=frame(1, *bytes(8), count=50, of_drive=False)),
    "20,000 frames at once": Case("bus", None, None, frame(0x7F0, *bytes(8), count=20_000, of_drive=False)),
    "extended identifiers": Case("bus", None, None, each=frame(0x180, *bytes(8), count=50, is_extended_id=True)),
    "error frames": Case(
        "bus",
        None,
        None,
        each=frame(0x20000004 & 0x7FF, 0, 0x30, 0, 0, 0, 0, 0, 0, of_drive=False, is_error_frame=True),
    ),
    "content late by one SYNC": Case("late", None, None, content_late(1)),
    "content late by five SYNCs": Case("late", R.TORQUE_CONTRADICTED, 66, content_late(5), cycles=300),
    "the same content for ever": Case("late", R.COMMAND_LOST, 21, content_late(0), cycles=300),
    # own code
    "NaN": Case("controller", R.CONTROLLER, 1, controller(lambda: float("nan"))),
    "an exception": Case("controller", R.EXCEPTION, 1, controller(raises)),
    "1e300": Case("controller", R.ENERGY_LOST, 14, controller(lambda: 1e300)),
    "own code that ends": Case("controller", R.OWN_CODE_LATE, 1, ends, own=True),
    # the computer and its operator
    "stop of the operator": Case("operator", R.OPERATOR, 1, stops),
    "more SYNCs skipped than sent": Case(
        "host",
        R.SYNCS_SKIPPED,
        64,
        controller(lambda: 1.0),
        changes=("bus.rate=40", f"simulation.bus={STALLS}", "axes.0.energy_loss_limit=none"),
        cycles=300,
    ),
    # a display: its encoder, its force sensor
    "position of a display 1.9 mm further": Case("display", R.FORCE_CONTRADICTED, 1, jumps(1900), name=DISPLAY),
    "position of a display 2.1 mm further": Case("display", R.POSITION_JUMP, 1, jumps(2100), name=DISPLAY),
    "force beyond the range": Case("display", R.FORCE_RANGE, 1, force(lambda count: 32_000), name=DISPLAY),
    "force frozen": Case(
        "display",
        R.FORCE_FROZEN,
        21,
        force(lambda count: 500),
        changes=("axes.0.admittance.force.frozen_after=20",),
        name=DISPLAY,
    ),
    "force of the other sign": Case(
        "display", R.FORCE_CONTRADICTED, 31, force(lambda count: -count), changes=FRICTION, cycles=100, name=DISPLAY
    ),
    "a tenth of the force": Case(
        "display", R.FORCE_CONTRADICTED, 54, force(lambda count: count // 10), cycles=100, name=DISPLAY
    ),
    "velocities lost": Case(
        "display", R.EMERGENCY, 99, lost(to_drive=True, only=lambda edge: edge.rpdo), cycles=1000, name=DISPLAY
    ),
}
