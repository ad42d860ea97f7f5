"""The odd habits of drives and sensors, one at a time, and what a rig makes of each: the table of docs/drives.md."""

from collections.abc import Callable
from typing import Literal, NamedTuple

import can

from tests.drive.odd_slave import MILLISECOND, READ_ONLY, OddSensor, OddSlave

Outcome = Literal["refused", "ended", "runs"]
BEGIN, END = "<!-- habits: begin -->\n", "<!-- habits: end -->\n"


class Habit(NamedTuple):
    """One habit, and the words of the message that names it."""

    what: str
    outcome: Outcome
    words: str
    take_on: Callable[[OddSlave], object]
    rig: Literal["torque", "display", "sensor"] = "torque"


def objects(**values: str) -> Callable[[OddSlave], None]:
    """Objects as another master or a vendor's tool left them: x60b2_0="c8 00"."""

    def take_on(slave: OddSlave) -> None:
        for name, data in values.items():
            index, sub = name[1:].split("_")
            slave.objects[int(index, 16), int(sub)] = bytes.fromhex(data)

    return take_on


def sets(**values: object) -> Callable[[OddSlave], None]:
    """Attributes of the slave."""

    def take_on(slave: OddSlave) -> None:
        for name, value in values.items():
            assert hasattr(slave, name), name
            setattr(slave, name, value)

    return take_on


def both(*habits: Callable[[OddSlave], object]) -> Callable[[OddSlave], None]:
    """Several parts of one habit."""

    def take_on(slave: OddSlave) -> None:
        for habit in habits:
            habit(slave)

    return take_on


def in_motion(act: Callable[[OddSlave], object]) -> Callable[[OddSlave], None]:
    """Something that happens 20 SYNCs after the drive was enabled."""
    return sets(script={20: act})


def deaf_to(*can_ids: int) -> Callable[[OddSlave], None]:
    """Frames that it ignores from now on."""
    return sets(hears=lambda message: message.arbitration_id not in can_ids)


def sends(can_id: int, data: str, **kind: bool) -> Callable[[OddSlave], None]:
    """A frame without a request."""
    return lambda slave: slave.bus.send(
        can.Message(arbitration_id=can_id, data=bytes.fromhex(data), **{"is_extended_id": False, **kind})
    )


def sensor(**values: object) -> Callable[[OddSlave], None]:
    """Another sensor than one that answers each SYNC."""
    return sets(sensor=OddSensor(**values))  # type: ignore[arg-type]


def slow(milliseconds: int) -> Callable[[OddSlave], None]:
    """Each SDO answer that much later than its request."""
    return sets(answer_after=milliseconds * MILLISECOND)


def left_enabled(slave: OddSlave) -> None:
    """As a master that died left it."""
    slave.state, slave.nmt, slave.held, slave.target = "enabled", 0x05, 300, 300


def storm(slave: OddSlave) -> None:
    """The same EMCY over and over."""
    for _ in range(50):
        slave.emcy(0x3210)


def of_the_sensor(**values: object) -> Callable[[OddSlave], None]:
    """Attributes of its sensor."""

    def take_on(slave: OddSlave) -> None:
        for name, value in values.items():
            assert hasattr(slave.sensor, name), name
            setattr(slave.sensor, name, value)

    return take_on


def lacks(name: str) -> Callable[[OddSlave], object]:
    """An object that it should have."""
    index, sub = name[1:].split("_")
    return lambda slave: slave.objects.pop((int(index, 16), int(sub)))


def aborts(name: str, code: bytes = READ_ONLY) -> Callable[[OddSlave], None]:
    """A write that is refused."""
    index, sub = name[1:].split("_")
    return lambda slave: slave.aborts.update({(int(index, 16), int(sub)): code})


def keeps(name: str) -> Callable[[OddSlave], None]:
    """A write that is confirmed and changes nothing."""
    index, sub = name[1:].split("_")
    return lambda slave: slave.frozen.add((int(index, 16), int(sub)))


def late_once(slave: OddSlave) -> None:
    """One TPDO beyond its window."""
    slave.script = {20: sets(tpdo_after=7 * MILLISECOND), 21: sets(tpdo_after=200_000)}


DRIVE = {(0x1000, 0): bytes.fromhex("92 01 02 00"), (0x1800, 2): b"\1"}
INPUTS = {(0x1000, 0): bytes.fromhex("91 01 04 00"), (0x1800, 2): b"\1"}
LATER = "as soon after SYNC as before: what comes may answer an older SYNC"
HABITS = [
    # --- found before any torque ---
    Habit("is not there", "refused", "no answer", sets(is_deaf_to_sdo=True)),
    Habit("has no node ID (LSS)", "refused", "a node without a node ID (LSS)", sets(unconfigured=True)),
    Habit("is no CiA 402 drive", "refused", "0x1000 = 0x00030191", objects(x1000_0="91 01 03 00")),
    Habit("has no torque mode", "refused", "bit 9", objects(x6502_0="6d 00 00 00")),
    Habit("keeps its mode", "refused", "0x6061 = 0", sets(refuses_mode=True)),
    Habit("sends no heartbeat", "refused", "no heartbeat", sets(has_heartbeat=False)),
    Habit("ignores NMT", "refused", "OPERATIONAL", deaf_to(0x000)),
    Habit(
        "is in a fault",
        "refused",
        "FAULT with error code 0x603F = 0x3210",
        both(sets(state="fault"), objects(x603f_0="10 32")),
    ),
    Habit("has STO open", "refused", "check the safety inputs (STO)", sets(sto=True)),
    Habit("ignores its RPDO", "refused", "enable", deaf_to(0x205)),
    Habit("sends no TPDO", "refused", "sends no TPDO on SYNC", sets(tpdo_every=1 << 60)),
    Habit("sends a TPDO of another length", "refused", "no TPDO 0x185 of the right length", sets(tpdo_length=7)),
    Habit("sends every second TPDO", "refused", "TPDO 0x185: no answer to one of two SYNCs", sets(tpdo_every=2)),
    Habit("sends its TPDO 0.7 cycles late", "refused", "0x185", sets(tpdo_after=7 * MILLISECOND)),
    Habit(
        "sends its TPDO 1.2 cycles late",
        "refused",
        "TPDO 0x185: process data that answer no SYNC, or an older one",
        sets(tpdo_after=12 * MILLISECOND),
    ),
    Habit(
        "sends its TPDO 2.3 cycles late",
        "refused",
        "TPDO 0x185: process data that answer no SYNC, or an older one",
        sets(tpdo_after=23 * MILLISECOND),
    ),
    Habit("is not there", "refused", "force sensor of handle: read 0x1000:00", sensor(is_absent=True), "sensor"),
    Habit("is a drive", "refused", "0x1000 has the low word 402", of_the_sensor(objects=DRIVE), "sensor"),
    Habit("is no transducer", "refused", "0x1000 has the low word 401", of_the_sensor(objects=INPUTS), "sensor"),
    Habit("keeps its transmission type", "refused", "write 0x1800:02", of_the_sensor(refuses=(0x1800,)), "sensor"),
    Habit("refuses the tare", "refused", "write 0x6139:01", of_the_sensor(refuses=(0x6139,)), "sensor"),
    Habit("sends nothing", "refused", "no frame 0x1a1 of the force sensor", of_the_sensor(inhibit=1 << 60), "sensor"),
    Habit(
        "sends every 4 ms by itself",
        "refused",
        "frame 0x1a1 of the force sensor: process data that answer no SYNC",
        sensor(every=4 * MILLISECOND),
        "sensor",
    ),
    Habit(
        "has an inhibit time of 50 ms",
        "refused",
        "frame 0x1a1 of the force sensor: no answer to one of two SYNCs",
        sensor(inhibit=50 * MILLISECOND),
        "sensor",
    ),
    Habit(
        "sends a frame of another length",
        "refused",
        "no frame 0x1a1 of the force sensor of the right length",
        sensor(length=2),
        "sensor",
    ),
    Habit(
        "shows a force at rest",
        "refused",
        "let go of the handle",
        of_the_sensor(counts=200, ignores_tare=True),
        "sensor",
    ),
    Habit("answers after 0.35 s", "refused", "0.35 s, expected within 0.3 s (sdo_timeout)", slow(350)),
    Habit("answers after 0.8 s", "refused", "0.8 s, expected within 0.3 s (sdo_timeout)", slow(800)),
    Habit(
        "answers after 1.5 s",
        "refused",
        "answers to SDO requests after 1.5 s, expected within 0.3 s (sdo_timeout)",
        slow(1500),
    ),
    Habit("answers with only the bytes needed", "refused", "no answer of 8 bytes, but one of 6", sets(answer_length=5)),
    Habit(
        "shows its mode when it is enabled only",
        "refused",
        "within 1 s (step_timeout); the drive refuses the mode; check its licence, firmware and settings (quirks: mode",
        sets(shows_mode_when_enabled=True),
    ),
    Habit("sends an EMCY 0x8220 at each RPDO", "refused", "longer than the drive maps", sets(emcy_of_rpdo=0x8220)),
    Habit("refuses the TPDO map", "refused", "PDO map", aborts("x1a00_2")),
    Habit("keeps its transmission type", "refused", "Transmission type", keeps("x1400_2")),
    Habit("keeps another torque limit", "refused", "0x6072", keeps("x6072_0")),
    Habit("refuses the watchdog", "refused", "watchdog", aborts("x1016_1")),
    Habit("keeps 0x6007", "refused", "0x6007", keeps("x6007_0")),
    Habit("refuses 0x60C2", "refused", "no_interpolation_period", aborts("x60c2_1")),
    Habit("has another rated torque", "refused", "rated_torque: got 10", objects(x6076_0="98 3a 00 00")),
    Habit("keeps a target torque", "refused", "0x6071", both(objects(x6071_0="64 00"), keeps("x6071_0"))),
    Habit(
        "adds a 0x60B2 that no dictionary lists",
        "refused",
        "0x60b2:00 = 200, not in the dictionary",
        objects(x60b2_0="c8 00"),
    ),
    Habit(
        "adds a 0x60B0 that no dictionary lists",
        "refused",
        "0x60b0:00 = 200, not in the dictionary",
        objects(x60b0_0="c8 00 00 00"),
        "display",
    ),
    Habit("is of another vendor", "refused", "0x1018:01 = 0x1", objects(x1018_1="01 00 00 00")),
    Habit("is another product", "refused", "0x1018:02 = 0x7", objects(x1018_2="07 00 00 00")),
    Habit("has no heartbeat (0x1017)", "refused", "0x1017", lacks("x1017_0")),
    Habit("rounds the heartbeat's period", "refused", "0x1017", both(objects(x1017_0="64 00"), keeps("x1017_0"))),
    Habit("keeps 0x60C2", "refused", "0x60c2:01", both(objects(x60c2_1="05"), keeps("x60c2_1"))),
    Habit("keeps the COB-ID of its RPDO", "refused", "0x1400:01", keeps("x1400_1")),
    Habit(
        "reads an SDO in blocks alone",
        "refused",
        "aborted with 0x05040001",
        lambda slave: slave.no_read.update({(0x1000, 0): bytes.fromhex("01 00 04 05")}),
    ),
    Habit(
        "keeps a 0x60B0 that its dictionary lists",
        "refused",
        "0x60b0",
        both(objects(x60b0_0="c8 00 00 00"), keeps("x60b0_0")),
        "display",
    ),
    Habit("demands 0x1006", "refused", "set the drive's 0x1006 (cycle period)", sets(needs_period=True)),
    Habit("demands a SYNC counter", "refused", "0x1019", sets(needs_counter=True)),
    Habit(
        "says that it demands a SYNC counter",
        "refused",
        "set its 0x1019 to 0",
        both(sets(needs_period=True), sets(period_fault=0x8240)),
    ),
    Habit("shares its node ID with another node", "refused", "two nodes have the node ID 5", sets(answers=2)),
    # --- endures ---
    Habit("left an inhibit time of 30 ms", "runs", "", objects(x1800_3="2c 01")),
    Habit("left its life guarding armed", "runs", "", objects(x100c_0="64 00", x100d_0="03")),
    Habit("boots 3 s late", "runs", "", sets(boots_at=3000 * MILLISECOND)),
    Habit("was left enabled with a torque", "runs", "", left_enabled),
    Habit("loses each third SDO request", "runs", "", sets(lost_requests=3)),
    Habit("is in NMT stopped at first", "runs", "", sets(nmt=0x04)),
    Habit("answers late in the cycle", "runs", "", sets(tpdo_after=4 * MILLISECOND)),
    Habit("sends each TPDO twice", "runs", "", sets(tpdo_copies=2)),
    Habit("sends an EMCY 0x0000", "runs", "", in_motion(lambda slave: slave.emcy(0x0000))),
    Habit(
        "remote and 29-bit frames",
        "runs",
        "",
        in_motion(both(sends(0x185, "", is_remote_frame=True), sends(0x185, "00", is_extended_id=True))),
    ),
    Habit("sends every second TPDO from then on", "ended", "FRAMES_LOST", in_motion(sets(tpdo_every=2))),
    Habit("sends a TPDO 0.7 cycles late, once", "runs", "", late_once),
    Habit("answers no SDO expedited", "runs", "", sets(segments=True)),
    Habit("sends SDO answers without a request", "runs", "", in_motion(OddSlave.answers_stale)),
    Habit("toggles bit 7 of its heartbeat", "runs", "", sets(beat_bits=0x80)),
    Habit("left its TPDO at another COB-ID", "runs", "", objects(x1800_1="c5 01 00 00")),
    Habit("sends an event TPDO too", "runs", "", in_motion(sends(0x285, "37 12"))),
    Habit("counts over the end of 0x6064", "runs", "", sets(position=(1 << 31) - 60, speed=1)),
    Habit("shows bit 12 never", "runs", "", sets(statusword=0x0210)),
    Habit("shows its limit (bit 11), with 0x6074", "runs", "", in_motion(sets(statusword=0x1A10))),
    Habit("shows never that the bus commands it (bit 9)", "runs", "", sets(statusword=0x1010)),
    Habit("shows a warning and vendor bits", "runs", "", in_motion(sets(statusword=0xD290))),
    Habit("left an offset in 0x60B1", "runs", "", objects(x60b1_0="c8 00 00 00"), "display"),
    # --- ends while it runs ---
    Habit("becomes 1.2 cycles late", "ended", LATER, in_motion(sets(tpdo_after=12 * MILLISECOND))),
    Habit("becomes 2.3 cycles late", "ended", LATER, in_motion(sets(tpdo_after=23 * MILLISECOND))),
    Habit(
        "becomes 1.2 cycles late",
        "ended",
        f"0x1a1 of the force sensor {LATER}",
        in_motion(of_the_sensor(delay=12 * MILLISECOND)),
        "sensor",
    ),
    Habit("freezes", "ended", "shows the same count for too long", in_motion(of_the_sensor(counts=100)), "sensor"),
    Habit("is overloaded", "ended", "beyond the range of its sensor", in_motion(of_the_sensor(counts=40000)), "sensor"),
    Habit("holds its torque", "ended", "holds an old torque", in_motion(sets(is_stuck=True))),
    Habit("sends an EMCY of two bytes", "ended", "EMCY 0x3210", in_motion(sends(0x085, "10 32"))),
    Habit("sends a boot-up and goes on", "ended", "left NMT OPERATIONAL", in_motion(sends(0x705, "00"))),
    Habit("stops quickly by itself", "ended", "left OPERATION ENABLED", in_motion(sets(state="quick stop"))),
    Habit(
        "is commanded by the bus no more", "ended", "no longer obeys the bus (bit 9", in_motion(sets(statusword=0x1010))
    ),
    Habit("falls back to SWITCHED ON", "ended", "left OPERATION ENABLED", in_motion(sets(state="on"))),
    Habit("falls silent", "ended", "heartbeat stopped", in_motion(sets(has_heartbeat=False))),
    Habit("sends no more TPDOs", "ended", "no TPDO for too many SYNCs", in_motion(sets(tpdo_every=1 << 60))),
    Habit("loses all RPDOs", "ended", "its RPDOs are lost", in_motion(deaf_to(0x205))),
    Habit("sends an EMCY", "ended", "EMCY 0x3210 DC link over-voltage", in_motion(lambda slave: slave.emcy(0x3210))),
    Habit("sends a storm of EMCYs", "ended", "EMCY 0x3210", in_motion(storm)),
    Habit("faults", "ended", "EMCY 0x7120 motor", in_motion(lambda slave: slave.fault(0x7120))),
    Habit("faults without an EMCY", "ended", "the drive is in FAULT", in_motion(sets(state="fault"))),
    Habit("is disabled by STO", "ended", "left OPERATION ENABLED", in_motion(sets(state="disabled"))),
    Habit("resets itself", "ended", "left NMT OPERATIONAL", in_motion(both(sends(0x705, "00"), sets(nmt=0x7F)))),
    Habit("goes to NMT stopped", "ended", "left NMT OPERATIONAL", in_motion(both(sets(nmt=0x04), sends(0x705, "04")))),
    Habit(
        "misses guard requests of another master",
        "ended",
        "guarding that another master left armed may have run out (its 0x100C and 0x100D show none)",
        in_motion(lambda slave: slave.fault(0x8130)),
    ),
    Habit("jumps by a metre", "ended", "moved faster than the speed limit", in_motion(sets(speed=100_000))),
    Habit("follows no more", "ended", "bit 12", in_motion(sets(statusword=0x0210))),
    Habit("is pushed by a hand while it starts", "runs", "", sets(speed=5000, is_pushed_until="enabled"), "display"),
    Habit(
        "has a narrow window of the following error",
        "ended",
        "0x6065",
        in_motion(lambda slave: slave.fault(0x8611)),
        "display",
    ),
    Habit(
        "has limits of its own of the position",
        "ended",
        "0x607D",
        in_motion(lambda slave: slave.fault(0x8612)),
        "display",
    ),
    Habit(
        "dies",
        "ended",
        "without frame 0x1a1 of the force sensor",
        in_motion(of_the_sensor(is_absent=True)),
        "sensor",
    ),
    Habit("another master sends SYNC", "ended", "SYNC (COB-ID 0x080)", in_motion(sends(0x080, ""))),
    Habit("another master sends RPDOs", "ended", "RPDO of handle", in_motion(sends(0x205, "0f 00 64 00"))),
]


def table() -> str:
    """The lists of docs/drives.md, one for each outcome."""
    whose = {"torque": "", "display": "drive of a display ", "sensor": "force sensor "}
    titles = {
        "refused": "Refused, before any torque",
        "ended": "Ended, with zero torque and the drive disabled",
        "runs": "Endured, and counted where it can be",
    }
    lists = {key: "; ".join(f"{whose[h.rig]}{h.what}" for h in HABITS if h.outcome == key) for key in titles}
    return "\n".join(f"- **{title}**: {lists[key]}." for key, title in titles.items()) + "\n"
