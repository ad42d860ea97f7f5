"""The steps of commissioning in order, and those that send no torque.

The bus is scanned by SDO, with nothing enabled, and each drive compared with the configuration. At zero torque the axis
must stay at rest, and a motion by hand checks the encoder. A silent master tests the watchdogs of the drives; a run at
zero torque times the cycle.
"""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any, Final

from canhaptic.axis_units import effort_unit
from canhaptic.canopen import objects as od
from canhaptic.commission.mass_and_friction import LEAST_JITTER
from canhaptic.commission.session import TRAVELS, OpenLoop, Session, StepVerdict
from canhaptic.commission.torque_tests import SCALE, identify_dynamics, stiff_grip, verified_axes
from canhaptic.drive.can.link import Link
from canhaptic.drive.can.servo_drive import ServoDrive
from canhaptic.drive.safety.power_states import TORQUE_FREE
from canhaptic.errors import InputError, RigError, SdoError, StartError
from canhaptic.scene.buses import PLACES, kind_of
from canhaptic.scene.models import AxisScene
from canhaptic.sim.plant.user import SinusoidMotion

_ASK_DEVICE_TYPE: Final = bytes.fromhex("40 00 10 00 00 00 00 00")


def _note(answered: set[int], node: int, _data: bytearray) -> None:
    answered.add(node)


def _scan(link: Link, known: Sequence[int], master: int) -> list[int]:
    """Return the node IDs that answer a read of 0x1000 and are not configured.

    Args:
        link: The bus.
        known: Node IDs of the configuration; they are not asked.
        master: Node ID of the master.

    Raises:
        LinkError: The bus failed.
    """
    answered: set[int] = set()
    asked = [node for node in range(1, 128) if node not in known and node != master]

    for node in asked:
        link.subscribe(od.SDO_RESPONSE_BASE + node, partial(_note, answered, node))
    try:
        for node in asked:
            link.send(od.SDO_REQUEST_BASE + node, _ASK_DEVICE_TYPE)
            # Between two questions: the answers of a slow drive must not pile up
            link.pump(link.clock.now() + 500_000)
        link.pump(link.clock.now() + 300_000_000)  # for the last of them
    finally:
        for node in asked:
            link.unsubscribe(od.SDO_RESPONSE_BASE + node)
    return sorted(answered)


def identify(session: Session) -> None:
    """Scan every bus and compare each drive with the configuration and its dictionary.

    Raises:
        StartError: A drive of the configuration does not answer.
    """
    on_can = [drive for drive in session.drives if isinstance(drive, ServoDrive)]
    for drive in session.drives:
        if drive not in on_can:
            drive.bring_up().identify()  # which also makes a drive on a line answer
    for link in {drive.link: None for drive in on_can}:
        on_link = [n for n, drive in enumerate(session.drives) if drive in on_can and drive.link is link]
        known = [session.drives[n].axis.node_id for n in on_link]
        strangers = _scan(link, known, session.drives[on_link[0]].bus.master_id)
        found = ", ".join(str(node) for node in sorted([*known, *strangers]))
        text = f"node {', '.join(map(str, strangers))} is not in the configuration: identify it before you go on"
        expected = ", ".join(map(str, sorted(known)))
        session.judged(on_link[0], "nodes on the bus", expected, found, good=not strangers, text=text)
    for axis, drive in enumerate(session.drives):
        _presence(session, axis, drive)
        _identity(session, axis, drive)
        _modes(session, axis, drive)
        _rated_torque(session, axis, drive)
        session.note_objects(axis)


def _presence(session: Session, axis: int, drive: ServoDrive) -> None:
    try:
        device_type = drive.sdo.read(od.DEVICE_TYPE)
    except SdoError as error:
        remedy = "check power, node ID, bit rate and cable"
        raise StartError(drive.axis.name, "presence", str(error), "an answer", remedy) from error
    profile = device_type & 0xFFFF
    expected, good, text = (
        f"{od.CIA402_PROFILE:#06x}",
        profile == od.CIA402_PROFILE,
        "no CiA 402 drive; check its address",
    )
    session.judged(axis, "device profile", expected, f"{profile:#06x}", good=good, text=text, fatal=True)
    place = PLACES[kind_of(drive.bus)]
    session.propose(axis, place, None, comment="this drive answered")


def _identity(session: Session, axis: int, drive: ServoDrive) -> None:
    """Compare 0x1018 with the configuration's values, or else with the dictionary's."""
    information = drive.dictionary.device_information
    for key, subindex, demanded, of_dictionary in (
        ("vendor_id", 1, drive.axis.vendor_id, information.vendor_number),
        ("product_code", 2, drive.axis.product_code, information.product_number),
    ):
        item = key.replace("_", " ")
        try:
            found = drive.sdo.read(od.IDENTITY, subindex)
        except SdoError:
            session.found(axis, item, "", "not readable", StepVerdict.UNKNOWN)
            continue
        wanted = demanded if demanded is not None else of_dictionary
        if not wanted:
            session.found(axis, item, "not given", f"{found:#010x}", StepVerdict.MEASURED)
        else:
            text = "the EDS belongs to another drive: use the one for this drive and firmware"
            session.judged(axis, item, f"{wanted:#010x}", f"{found:#010x}", good=found == wanted, text=text)
        if demanded is None and found:
            session.propose(axis, key, found, comment="refuses another drive at this node ID")


def _modes(session: Session, axis: int, drive: ServoDrive) -> None:
    try:
        modes = drive.sdo.read(od.SUPPORTED_DRIVE_MODES)
    except SdoError:
        text = "is 0x6060 = 10 accepted?"
        return session.found(axis, "modes (0x6502)", "cst", "not readable", StepVerdict.UNKNOWN, text)
    known = ("pp", "vl", "pv", "tq", "", "hm", "ip", "csp", "csv", "cst")
    names = ", ".join(name for bit, name in enumerate(known) if name and modes >> bit & 1)
    serves = bool(modes & od.CYCLIC_SYNC_TORQUE_BIT)
    text = "no cyclic synchronous torque: other firmware, or another drive"
    session.judged(axis, "modes (0x6502)", "cst", names, good=serves, text=text, fatal=True)


def _rated_torque(session: Session, axis: int, drive: ServoDrive) -> None:
    parameters = drive.axis
    unit = effort_unit(parameters.unit)
    configured = "" if parameters.rated_torque is None else f"{parameters.rated_torque:g} {unit}"
    try:
        counts = drive.sdo.read(od.RATED_TORQUE)
    except SdoError:
        counts = 0
    if not counts:
        text = "only the configuration says what 1000 per mille is; see the torque scale below"
        return session.found(axis, "rated torque (0x6076)", configured, "0 or not readable", StepVerdict.UNKNOWN, text)
    of_motor = counts * drive.quirks.rated_torque_resolution
    at_axis = of_motor * parameters.transmission
    found = f"{at_axis:g} {unit}" + (f" ({of_motor:g} N*m at the motor)" if parameters.transmission != 1.0 else "")
    same = parameters.rated_torque is None or abs(at_axis - parameters.rated_torque) <= 0.01 * parameters.rated_torque
    text = "correct rated_torque or transmission: every torque is wrong by this ratio"
    session.judged(axis, "rated torque (0x6076)", configured, found, good=same, text=text)


STANDSTILL: Final = "standstill at zero torque"
"""Name of the step in the report."""
_LONGEST_REACH: Final = 20.0  # of a simulated hand [s]
_REACH_RATE: Final = 0.6  # [Hz]
_DRIFT: Final = 0.25
"""Part of the travel, and of 20 mm or mrad, by which an axis without torque may drift within a second."""
_FEWEST_COUNTS: Final = 200  # half a per cent


def stand_still(session: Session, axis: int) -> bool:
    """Enable the drive with zero torque; return False when the axis moves by itself.

    Raises:
        RigError: Drive or link failed.
    """
    name, unit = session.axes[axis].parameters.name, session.axes[axis].parameters.unit
    law = session.play(axis, [0.0], session.cycles(1.0), travels=_DRIFT)  # [s] that an axis must stand still
    if not law.positions:  # the operator stopped it
        session.not_tried(STANDSTILL, [axis])
        return False
    drift = abs(law.positions[-1] - law.positions[0])
    swing = max(law.positions) - min(law.positions)
    still = drift <= max(_DRIFT * min(session.travels[axis], 0.02), 2.0 * session.count(axis))
    text = f"{name} moves without torque: gravity, a wrong drive offset, or somebody pushes"
    if session.weight(axis):
        text = f"{name} moves under the weight that it holds: a wrong brake.holds_weight, or somebody pushes"
    found = f"{drift:.3g} {unit}, noise {swing:.3g}"
    session.judged(axis, STANDSTILL, "", found, good=still, text=text, fatal=True)
    return still


def move_by_hand(session: Session, axis: int) -> None:
    """Compare a distance moved by hand with the encoder reading; the drive holds zero torque meanwhile.

    A simulated hand moves the handle by a given distance, which the plant measures.

    Raises:
        RigError: Drive or link failed.
    """
    parameters, is_twin = session.axes[axis].parameters, session.scene.simulated
    name, unit, distance = parameters.name, parameters.unit, _FEWEST_COUNTS * session.count(axis)
    if is_twin:
        enough = max(1.25 * distance, TRAVELS[unit])
        distance = session.dialogue.number(f"{name}: how far is the simulated hand to move?", unit, enough) or 0.0
        if not distance:
            return session.not_tried("encoder", [axis])
        if not session.agreed(f"{name}: the hand moves. Start now?", "encoder", [axis]):
            return
    with session.rig_of(with_hand=True, hand=partial(_reaching, distance=distance) if is_twin else None):
        law, moved = _moved(session, axis, distance)
    if not law.positions:
        return session.not_tried("encoder", [axis])
    measured = law.positions[-1] - law.positions[0]
    asked = f"{name}: distance moved, with its sign?"
    stated = moved if is_twin else session.dialogue.number(asked, unit, None)
    counts = abs(measured) * parameters.counts_per_unit
    if not stated or counts < _FEWEST_COUNTS:
        text = f"the encoder moved by {counts:.0f} counts, at least {_FEWEST_COUNTS} and a measured distance are needed"
        return session.found(axis, "encoder", "", f"{measured:.4g} {unit}", StepVerdict.UNKNOWN, text)
    session.encoder_ratios[axis] = abs(measured / stated)
    _judge(session, axis, measured / stated)


def _moved(session: Session, axis: int, distance: float) -> tuple[OpenLoop, float | None]:
    """Return the record of a motion by hand, and how far a simulated hand moved [m or rad]."""
    begin: list[float] = []
    session.truths = ()

    def reached() -> bool:
        truth = session.truth(axis)
        if truth is not None and not begin:
            begin.append(truth)
        return truth is not None and abs(truth - begin[0]) >= abs(distance)

    ready, longest = reached, _LONGEST_REACH
    if not session.scene.simulated:
        name, unit = session.axes[axis].parameters.name, session.axes[axis].parameters.unit
        asked = f"{name}: move the handle by {distance:.2g} {unit} or more, a distance that you can measure"
        asked = f"{asked}, in the direction that is to be positive; hold it there and press Enter"
        ready, longest = session.dialogue.until_ready(asked, 1), 120.0  # [s] that a person may take
    law = session.play(axis, (), session.cycles(longest), ready)
    truth = session.truth(axis)
    return law, None if truth is None or not begin else truth - begin[0]


def _reaching(axis: AxisScene, distance: float) -> object:
    """Return a simulated hand that moves the handle by a distance [m or rad], with its sign, and beyond."""
    if (simulation := axis.simulation) is None:
        return None
    grip = stiff_grip(axis, simulation)
    speed = 0.25 * (axis.parameters.speed_limit or math.inf)
    rate = min(_REACH_RATE, speed / (3.0 * math.pi * abs(distance)))
    motion = SinusoidMotion(amplitude=1.5 * distance, frequency=rate)
    return grip.model_copy(update={"motion": motion})


def _judge(session: Session, axis: int, ratio: float) -> None:
    parameters = session.axes[axis].parameters
    right = ratio > 0.0
    direction = parameters.direction if right else -parameters.direction
    text = "the encoder counts the other way"
    session.judged(axis, "encoder direction", str(parameters.direction), str(direction), good=right, text=text)
    session.propose(axis, "direction", None if right else direction, comment="from a distance moved by hand")
    counts = parameters.counts_per_unit * abs(ratio)
    same = abs(abs(ratio) - 1.0) <= 0.02  # a hand with a ruler
    text = f"every position is wrong by {abs(ratio):.4g}; gear, counts per turn or 0x608F"
    unit = f"count/{parameters.unit}"
    configured, found = f"{parameters.counts_per_unit:g} {unit}", f"{counts:.6g} {unit}"
    session.judged(axis, "encoder counts", configured, found, good=same, text=text)
    text = "agrees with a distance moved by hand" if same else "from a distance moved by hand; round it to the data"
    session.propose(axis, "counts_per_unit", None if same else counts, unit, text)
    session.propose(axis, "unit", None, comment="the unit of the distance moved by hand")


_MARGIN: Final = 2.0
_SILENCES: Final = 3  # of the longest silence that the drives are configured to bear


def pull_the_master(session: Session) -> None:
    """Enable every drive at zero torque, fall silent, and check whether they leave OPERATION ENABLED by themselves.

    Raises:
        RigError: Drive or link failed in another way than the silence provokes.
    """
    asked = "watchdog: the drives are enabled at zero torque, then the master stops sending. Start now?"
    axes = range(len(session.axes))
    if not session.agreed(asked, "watchdog", axes, "a killed master may leave a torque on"):
        return
    rig = session.rig
    rig.start()
    try:
        _hold_weights(session)
        silence = _SILENCES * max(drive.bus.master_silence_ns for drive in session.drives)
        for bus in rig.buses:
            bus.pump(bus.clock.now() + silence)
        for axis in axes:
            _judge_watchdog(session, axis)
    finally:
        _end(session)


def _hold_weights(session: Session) -> None:
    """Send the declared weights of axes that hang, which their drives hold until their watchdogs set the brakes."""
    weights = [session.weight(axis) for axis in range(len(session.axes))]
    if any(weights):
        for _ in range(session.scene.bus.delay + 2):
            session.rig.sync()
            session.rig.write_torques(weights)


def _judge_watchdog(session: Session, axis: int) -> None:
    drive = session.drives[axis]
    limit = f"within {_SILENCES * drive.bus.master_silence_ns / 1e6:g} ms"
    try:
        state = drive.read_state()
    except SdoError as error:
        return session.found(axis, "watchdog", limit, "no answer", StepVerdict.FAILED, str(error))
    stopped = state in TORQUE_FREE
    emergency = f", {drive.emergency}" if drive.emergency is not None else ""
    text = "a killed master leaves its torque on: set axes[].watchdog, 0x1016 and 0x6007, or a relay"
    found = f"{state.value}{emergency}"
    session.judged(axis, "watchdog", limit, found, good=stopped, text=text, fatal=True)


def _end(session: Session) -> None:
    """Disable the drives that are still enabled, and reset the faults that this test caused, if the person agrees."""
    try:
        session.rig.stop(ramp=False)
    except RigError as error:
        session.dialogue.tell(f"  {error}")
    if session.dialogue.confirm("watchdog: reset the faults caused by this test (this enables no drive)?"):
        session.rig.reset_faults()


_LARGEST_PHASE: Final = 0.2
"""Part of the sample time by which a frame may miss its phase; with more, it or the write frame passes SYNC0."""
_COUNTS_OF_LINKS: Final = ("missed_tpdos", "late", "error_frames")


def time_the_cycle(session: Session, seconds: float) -> None:
    """Run the whole rig at zero torque; report frame counts and, at real pace, cycle times.

    Raises:
        RigError: Drive or link failed.
    """
    before = session.rig.link_statistics()
    lines: list[Any] = [bus for bus in session.rig.buses if bus.clock_leader]
    errors = [list[int]() for _ in lines]

    def noted() -> bool:
        for line, of in zip(lines, errors, strict=True):
            of.append(abs(line.lock.error))
        return False

    cycle = session.run([OpenLoop() for _ in session.axes], session.cycles(seconds), noted)
    statistics = session.rig.link_statistics()
    for line, of in zip(lines, errors, strict=True):
        _judge_phase(session, line.bus.phase, of)
    counted = {"skipped_syncs": statistics["skipped_syncs"]}  # counted from the start of a run
    counted |= {name: statistics.get(name, 0) for name in ("unanswered", "low_counter")}
    old_and_new = {name: (before.get(name, 0), statistics.get(name, 0)) for name in _COUNTS_OF_LINKS}
    lost = counted | {name: new - old for name, (old, new) in old_and_new.items()}
    words = ", ".join(f"{name.replace('_', ' ')} {count:g}" for name, count in lost.items() if count > 0)
    clean, found = not words, f"{cycle.cycles} cycles, {words or 'no frame lost'}"
    text = "see `canhaptic check` (bus load, host) and `canhaptic check --host`; try bus.realtime"
    session.judged(0, "cycle", f"{1.0 / session.sample_time:g} Hz", found, good=clean, text=text)
    _propose_jitter(session, cycle.timing["wakeup_lateness"].maximum * 1e-9 / session.sample_time)
    if session.experiment.pace == "free":
        text = "simulated drives without a clock of their own"
        return session.found(0, "timing", "", "lock-step", StepVerdict.UNKNOWN, text)
    for name, histogram in cycle.timing.items():
        p50, p99 = histogram.quantile(0.5) * 1e6, histogram.quantile(0.99) * 1e6
        found = f"p50 {p50:.0f} us, p99 {p99:.0f} us"
        session.found(0, name.replace("_", " "), "", found, StepVerdict.MEASURED)


def _judge_phase(session: Session, phase: float, errors: Sequence[int]) -> None:
    """Judge by how much the frames of a line missed their phase after SYNC0 [ns]."""
    if not errors:  # stopped before the first cycle
        return
    part = sorted(errors)[len(errors) * 99 // 100] * 1e-9 / session.sample_time
    text = "frames come near the edge of their hold: see `canhaptic check --host`, try bus.realtime, or lower bus.rate"
    wanted = f"{phase:.0%} of the sample time after SYNC0"
    session.judged(0, "phase of the frames", wanted, f"p99 {part:.2%} off", good=part <= _LARGEST_PHASE, text=text)


def _propose_jitter(session: Session, latest: float) -> None:
    """Propose the jitter of a hold, as a fraction of the sample time.

    Args:
        session: Session with its axes.
        latest: Largest lateness of a SYNC [sample times]; 0 where time is virtual.
    """
    for axis, scene in enumerate(session.axes):
        jitter = max(LEAST_JITTER, _MARGIN * latest)
        if session.experiment.pace == "free":
            jitter = scene.loop.sync_jitter or LEAST_JITTER
        comment = f"at least 1 %, or {_MARGIN:g} times the largest lateness of a SYNC in this run"
        session.propose(axis, "passivity.sync_jitter", jitter, "1", comment)


REQUIRED: Final = (STANDSTILL, "torque sign", SCALE, "moving mass", "compliant shaft", "torque lag", "watchdog")
"""Items that must be verified on every axis before its scene may run."""


def commission(session: Session, timing_duration: float) -> None:
    """Run every step that the person agrees to; the findings are in `session.report`.

    Args:
        session: Commissioning session.
        timing_duration: Duration of the timed run at zero torque [s].

    Raises:
        RigError: Drive or link failed; torque is zero, every drive that answers is disabled.
        InputError: A simulated mechanism couples the axes.
    """
    if session.scene.mechanisms:
        text = "commissioning tests one axis at a time, and this simulated mechanism couples them"
        remedy = "leave `mechanisms` out and give every axis a `simulation` of its own"
        raise InputError(f"{session.scene.source}: {text}; {remedy}")
    tell = session.dialogue.tell
    with session.rig_of(with_hand=False):
        if not _stands_still(session):
            return
    tell("3 of 6: the encoder, moved by hand (zero torque)")
    for axis in range(len(session.axes)):
        if not session.stop_requested():
            move_by_hand(session, axis)
    tell("4 of 6: first torque")
    firsts = verified_axes(session)
    with session.rig_of(with_hand=False):
        for axis, first in firsts.items():
            if not session.stop_requested():
                identify_dynamics(session, axis, first.mass)
        if session.stop_requested():
            return
        tell("5 of 6: the watchdog (zero torque)")
        pull_the_master(session)
        if session.stop_requested():
            return
        tell(f"6 of 6: the cycle, for {timing_duration:g} s (zero torque)")
        time_the_cycle(session, timing_duration)


def _stands_still(session: Session) -> bool:
    """Whether every drive is the configured one and stays at rest at zero torque."""
    session.dialogue.tell("1 of 6: who is on the bus (no torque, nothing enabled)")
    identify(session)
    if session.report.failed or session.stop_requested():
        return False
    names = ", ".join(axis.parameters.name for axis in session.axes)
    asked = f"{names}: hands off, clear of the machine. Enable the drives at zero torque?"
    if not session.agreed(asked, STANDSTILL, [0]):
        return False
    session.dialogue.tell("2 of 6: standing still at zero torque")
    still = [not session.stop_requested() and stand_still(session, axis) for axis in range(len(session.axes))]
    return all(still) and not session.stop_requested()
