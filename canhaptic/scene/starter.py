"""Text of a starter configuration, made from the dictionary of a drive.

It is a whole scene: every key that a dictionary can supply is given, every other has a cautious value and says so.

Values that a simulated drive needs in addition to its dictionary: real drives have them, dictionaries omit them.

Some dictionaries state the settings of another rig, such as a communication cycle of 1 us; on a real drive the vendor's
tool has set them. A simulated drive gets those of this scene.

Common parts of the starter scenes of both kinds of displays: guesses of timing, and the simulated machine.

Starter configuration of an admittance display: limits, sensor, mass, certificate, simulation.

All values scale with the torque limit, so that they fit together: a mass that the torque accelerates at 200 rad/s^2, a
velocity loop of 50 Hz, and a virtual mass that is passive without a guard.
"""

import json
import math
import re
from collections.abc import Iterator
from math import pi
from pathlib import Path
from string import Template
from typing import Final

from canopen import ObjectDictionary

from canhaptic.canopen import objects as od
from canhaptic.canopen.objects import is_writable
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.drive.can.bus_budget import round_rate
from canhaptic.drive.profile.admittance_parameters import AdmittanceParameters
from canhaptic.drive.profile.fitness import (
    ObjectUse,
    listed,
    max_torque_unwritten,
    objection,
    range_objection,
    steepest_ramp,
)
from canhaptic.drive.profile.quirks import quirks_of
from canhaptic.drive.survey import Suitability, Survey, stated_value
from canhaptic.errors import DictionaryError
from canhaptic.scene.hints import advised_allowance, allowance_words
from canhaptic.scene.layout import path_for_scene
from canhaptic.scene.models import TO_SET
from canhaptic.scene.profiles import profile_values

_EVENT_TIMER: Final = 5  # subindex: of an RPDO its deadline [ms]
_DEVICE_TYPE: Final = 0x0002_0000 | od.CIA402_PROFILE  # servo drive

_Place = tuple[int, int]


def missing_values(found: Survey, sample_time: float) -> dict[str, str]:
    """Return `simulation.drive.objects` for a scene made from a dictionary: key and value as written in a scene.

    Args:
        found: Survey of the dictionary.
        sample_time: Time from SYNC to SYNC [s].
    """
    listed = found.dictionary
    values = {**_absent(found), **_misleading(listed, sample_time)}
    return {_key(place): f"{value:#x}" for place, value in values.items() if _holds(listed, place, value)}


def _holds(dictionary: ObjectDictionary, place: _Place, value: int) -> bool:
    """Whether the drive has an object of a type that can hold a value."""
    if objection(dictionary, ObjectUse(*place)) is not None:
        return False
    variable = dictionary.get_variable(*place)
    return variable is not None and range_objection(variable, value) is None


def _key(place: _Place) -> str:
    return f"{place[0]:#06x}" + (f".{place[1]}" if place[1] else "")


def _absent(found: Survey) -> dict[_Place, int]:
    """Return values for objects that have none."""
    needed: dict[_Place, int] = {(od.DEVICE_TYPE, 0): _DEVICE_TYPE}
    if found.vendor_id is not None:
        needed[od.IDENTITY, 1] = found.vendor_id
    needed |= _cob_ids(found.dictionary)
    missing = {place: value for place, value in needed.items() if stated_value(found.dictionary, *place) is None}
    mode_bit = 1 << found.axis.mode_code - 1
    if not (stated_value(found.dictionary, od.SUPPORTED_DRIVE_MODES) or 0) & mode_bit:
        missing[od.SUPPORTED_DRIVE_MODES, 0] = mode_bit
    return missing


def _cob_ids(dictionary: ObjectDictionary) -> dict[_Place, int]:
    """Return the COB-ID of every PDO as delivered: that of the predefined connection set, or disabled."""
    found: dict[_Place, int] = {}
    for first, bases in ((od.RPDO_COMMUNICATION, od.RPDO_BASE), (od.TPDO_COMMUNICATION, od.TPDO_BASE)):
        for index in _indices(dictionary, first):
            number = index - first
            found[index, 1] = bases[number] + 1 if number < len(bases) else od.COB_ID_INVALID
    return found


def _indices(dictionary: ObjectDictionary, first: int) -> Iterator[int]:
    return (index for index in dictionary if first <= index < first + od.PDO_COUNT)


def _misleading(dictionary: ObjectDictionary, sample_time: float) -> dict[_Place, int]:
    """Replacements for stated values that belong to another rig."""
    period = round(sample_time * 1e6)
    wanted: dict[_Place, int] = {(od.SYNC_COB_ID, 0): od.SYNC_FRAME_COB_ID, (od.COMMUNICATION_CYCLE_PERIOD, 0): period}
    wanted |= {(index, _EVENT_TIMER): 0 for index in _indices(dictionary, od.RPDO_COMMUNICATION)}
    return {place: value for place, value in wanted.items() if stated_value(dictionary, *place) not in (None, 0, value)}


JITTER: Final = f"  sync_jitter: 5 % # {TO_SET}: every hold lasts 1 / rate, give or take this (canhaptic commission)\n"

_SIMULATION_TEXT: Final = Template("""
# The machine behind the simulated drive. Remove this section and name the real interface under `bus`.
simulation:
$drive  plant:
    mass: $mass kg*m^2
    damping: $bearings N*m*s/rad
$between  user: # $hand
    stiffness: $stiffness N*m/rad
    damping: $hand_damping N*m*s/rad
    motion: {type: sinusoid, amplitude: $amplitude rad, frequency: $frequency Hz}
""")


def number(value: float) -> str:
    """Return a number of a starter scene: three digits are enough for a guess."""
    return f"{value:.3g}"


def simulated_machine(
    rated: str, objects: str, mass: float, bearings: float, limit: float, hand: str, between: str = "",
    motion: tuple[float, float] = (0.15, 0.5),
) -> str:  # fmt: skip
    """Return the section `simulation`.

    Args:
        rated: Line with the rated torque; "" where 0x6076 tells it.
        objects: Lines of `simulation.drive`.
        mass: Moved inertia [kg*m^2].
        bearings: Damping of the bearings [N*m*s/rad].
        limit: Torque limit, which scales the hand [N*m].
        hand: Comment on the motion of the hand.
        between: Further lines, before the hand.
        motion: Amplitude [rad] and frequency [Hz] of the hand.
    """
    return _SIMULATION_TEXT.substitute(
        drive=f"  drive:\n{rated}{objects}" if rated or objects else "",
        mass=number(mass), bearings=number(bearings), between=between, hand=hand,
        amplitude=motion[0], frequency=motion[1],
        stiffness=number(3.0 * limit), hand_damping=number(0.25 * limit),
    )  # fmt: skip


_INERTIA: Final = 0.005  # per torque limit [s^2]
_BANDWIDTH: Final = 50.0  # of the velocity loop [Hz]
_OVER: Final = 1.1  # every over-estimate
_START_SPEED: Final = 0.05  # from which a hand moves it [rad/s]
_HELD: Final = 2.0  # times M + c tau: passive without a guard
_FRICTION: Final = 0.02  # of the torque limit: dry friction
_ACCELERATION: Final = 50.0  # commanded at most [rad/s^2]
_COUNTS: Final = 16384  # of the sensor up to its range

_AXIS: Final = Template(f"""\
    speed_limit: 2 rad/s    # {TO_SET}: a handle that is faster stops the rig
    admittance:             # force in, velocity out
      mode: $mode        # $mode_note
$velocity_counts$limited      acceleration_limit: $acceleration rad/s^2
      handle_acceleration: 80 rad/s^2 # {TO_SET}: by drive and hand together, an over-estimate
      position_low: -0.5 rad # {TO_SET}: lowest and highest position to which a command may lead
      position_high: 0.5 rad # {TO_SET}
      force:
$source        per_count: $per_count N*m # {TO_SET}: negative where the sensor counts the other way
        range: $range N*m # {TO_SET}: a force beyond it stops the rig
        error: $error N*m # {TO_SET}: offset, drift, noise, quantisation (canhaptic commission)
        slew: $slew N*m/s # {TO_SET}: largest change of the force per second, an over-estimate
        frozen_after: 50    # SYNCs with one count beyond `error`, then the rig stops
""")

_DISPLAY_RENDERED: Final = Template(f"""\
# A free mass; the rig alone has about half of it. `lower_wall` and `upper_wall` limit its way.
environment:
  type: virtual_mass
  mass: $mass kg*m^2
  damping: $damping N*m*s/rad

# $certified
passivity:
  algorithm: guarded
  drive_mass: $drive_mass kg*m^2 # {TO_SET}: all that the drive moves up to the sensor, an over-estimate
  loop_gain: $gain N*m*s/rad # {TO_SET}: 2 pi bandwidth mass, an over-estimate (canhaptic commission)
  # Over-estimates with which force and motion are compared: an offset of the sensor, or a ramp in the drive, stops it.
  # drive_friction: $friction N*m
  # drive_damping: $bearings N*m*s/rad
$integral$timing  energy_allowance: $allowance J # given out at most; motion starts with it
""")

_CERTIFIED: Final = "Every command is certified by the drive's own velocity loop, for every hand."
_UNCERTIFIED: Final = (
    "Mode 8 has an integral: nothing is certified where holds are uneven (sync_jitter); mode 9 has none."
)

_BETWEEN: Final = Template("""\
  admittance:
    loop: {gain: $gain N*m*s/rad, integral_gain: $integral N*m/rad}
    grip: {mass: $grip kg*m^2, stiffness: $grip_stiffness N*m/rad, damping: $grip_damping N*m*s/rad}
    sensor: {noise: $noise N*m}
""")


def display_axis(display: AdmittanceParameters, counts: float, limit: float, unlimited: str, steepest: float) -> str:
    """Return the keys of an axis that make it an admittance display.

    Args:
        display: Findings of the dictionary for a display.
        counts: Position counts [count/rad].
        limit: Torque limit [N*m].
        unlimited: Reason why the start writes no limit to 0x6072; "" where it does.
        steepest: Largest value that the ramps of the drive accept [counts/s^2].
    """
    named = display.force.object
    node = f"        node: {{node_id: 9}}  # {TO_SET}: the drive has no analog input that is known\n"
    why = f"keep it once torque_limit is set with the vendor's tool (0x6072 is {unlimited})"
    is_velocity = display.mode == "velocity"
    scale = f"      velocity_counts: {counts:.10g} # {TO_SET}: counts of 0x60FF for 1 rad/s of the axis\n"
    return _AXIS.substitute(
        mode=display.mode,
        mode_note="mode 9, 0x60FF" if is_velocity else "mode 8, 0x607A, which the drive interpolates",
        velocity_counts=scale if is_velocity else "",
        acceleration=number(min(_ACCELERATION, 0.99 * steepest / counts) if is_velocity else _ACCELERATION),
        limited=f"      limit_in_drive: true # {TO_SET}: {why}\n" if unlimited else "",
        source=node
        if named is None
        else f"        object: {named}    # {TO_SET}: the input to which the sensor is wired\n",
        per_count=number(2.0 * limit / _COUNTS),
        range=number(2.0 * limit),
        error=number(4e-4 * limit),
        slew=number(25.0 * limit),
    )


def display_rendered(display: AdmittanceParameters, limit: float, sample_time: float, *, simulate: bool) -> str:
    """Return environment and passivity for a torque limit [N*m] and a sample time [s]."""
    mass, gain = _INERTIA * limit, _gain(limit)
    is_position = display.mode == "position"
    line = f"  integral_gain: {number(_OVER * 10.0 * gain)} N*m/rad # {TO_SET}: position gain times loop_gain\n"
    return _DISPLAY_RENDERED.substitute(
        certified=_UNCERTIFIED if is_position and not simulate else _CERTIFIED,
        mass=number(_HELD * (mass + 1.5 * sample_time * gain)),
        damping=number(mass),
        drive_mass=number(_OVER * mass),
        gain=number(_OVER * gain),
        friction=number(_FRICTION * limit),
        bearings=number(2.0 * mass),
        integral=line if is_position else "",
        timing="" if simulate else JITTER,
        allowance=number(0.5 * _OVER * gain * sample_time * _START_SPEED**2),
    )


def display_simulation(display: AdmittanceParameters, objects: str, rated: str, limit: float) -> str:
    """Return the simulated rig; `objects` and `rated` are lines of `simulation.drive`."""
    mass, gain = _INERTIA * limit, _gain(limit)
    between = _BETWEEN.substitute(
        gain=number(gain),
        integral=number(10.0 * gain if display.mode == "position" else 0.0),
        grip=number(0.15 * mass),
        grip_stiffness=number(1e4 * mass),
        grip_damping=number(10.0 * mass),
        noise=number(5e-5 * limit),
    )
    return simulated_machine(rated, objects, mass, mass, limit, "a hand that moves to and fro", between, (0.1, 2.0))


def _gain(limit: float) -> float:
    return 2.0 * pi * _BANDWIDTH * _INERTIA * limit


_CAUTIOUS: Final = 0.05  # part of the rated torque that the first configuration allows
_GUESSED_RATED_TORQUE: Final = 1.0  # [N*m]
_GUESSED_COUNTS: Final = 65536  # per revolution
_FEWEST_COUNTS: Final = 64  # per revolution; a dictionary that states fewer states the default of an unset object
_PER_MILLE: Final = 1e-3  # one count of 0x6072
_COMMENT_COLUMN: Final = 30
_TRAILING_COMMENT: Final = re.compile(r"^( *[^#\s][^#\n]*?) +# ", re.MULTILINE)
_EDS_TOKEN: Final = "@EDS@"  # put in last: nothing else may touch a path
_FASTEST: Final = 1000.0  # [Hz]

_TEXT: Final = Template("""\
# $title
#
# Written by `canhaptic new` from $eds.
# Every line marked $to_set holds a guess: put the value of your rig there and take the mark away. Real drives do not
# run before.
#
#     canhaptic check $scene    what would be done, and whether the drive is fit for it
#     canhaptic run $scene$hint
#
# Plain numbers are SI. A text may carry a unit (1 kHz, 0.5 N*m, 50 us), which is checked for dimension.

duration: 10 s

bus:
$bus
  bitrate: $bitrate bit/s$bitrate_note
  rate: $rate Hz$rate_note
  rpdo: synchronous         # a command acts at the next SYNC: exact energy, one sample late

axes:
  - name: axis1
    node_id: 1              # $to_set: as set in the drive
    eds: $eds_quoted
$identity    unit: rad               # $to_set: m for a linear axis; the units below then are N, N/m, ...
    counts_per_unit: $counts   # $to_set: counts of 0x6064 per radian of the axis, gear included$counts_note
    direction: 1            # $to_set: -1 if the positive direction of the drive is not that of the axis
    position_reference: at_start # $to_set: absolute, index_home, at_start (0 where power came on) or sensor
$rated$transmission    torque_limit: $limit N*m # $to_set: the largest torque that may ever reach the hand$limit_note
    torque_verified: no     # $to_set: weight, balance or mass (canhaptic commission); no: a hundredth of the limit
$read_back$watchdog
$rendered$simulation""")

_RENDERED: Final = Template("""\
# A spring and a damper, solid below `position`. Soft, for the first contact.
environment:
  type: spring_damper_wall
  stiffness: $stiffness N*m/rad
  damping: $damping N*m*s/rad
  position: -0.05 rad      # $to_set: where the wall lies, from the zero of the encoder

# The energy balance with a proof. It rests on what moves with the encoder at least.
passivity:
  algorithm: guarded
  moving_mass: $inertia kg*m^2   # $to_set: an under-estimate is safe, an over-estimate is not
  device_damping_bound: $most_damping N*m*s/rad # $to_set: an over-estimate is safe, an under-estimate is not
  device_friction_bound: $most_friction N*m # $to_set: the same of dry friction
$timing  hand_force: 0 N*m         # $to_set: largest torque with which the hand pulls out of the contact
  hand_push: $push N*m       # $to_set: largest torque with which it pushes in
  energy_allowance: $allowance uJ # $allowed
""")

_TIMING: Final = f"""\
{JITTER}\
  torque_window: 100 us    # {TO_SET}: a torque acts so long after its SYNC at the latest
  current_lag: 500 us      # {TO_SET}: time constant of the current loop at most
"""


def starter_scene(found: Survey, *, simulate: bool, drive: str | None = None, out: Path | None = None) -> str:
    """Return the text of a scene file for one drive, which `load_scene` accepts.

    Args:
        found: Survey of the dictionary.
        simulate: Whether a simulated drive, motor and hand on a virtual bus are added, so that it runs at once.
        drive: Name of the drive profile to use; None for none.
        out: Path of the file for the text; None where it is unknown, so that the dictionary needs its whole path.

    Raises:
        DictionaryError: The drive cannot serve; lists every reason.
    """
    if found.suitability is Suitability.UNFIT:
        reasons = "; ".join(f"{row.item}: {row.text}" for row in found.reasons)
        kind = "cyclic torque" if found.axis.admittance is None else "an admittance display"
        raise DictionaryError(f"{found.path} is not fit for {kind}: {reasons}")
    rated = _stated_torque(found.dictionary, drive) or _GUESSED_RATED_TORQUE
    limit = _torque_limit(found.dictionary, rated)
    text = _TEXT.substitute(
        to_set=TO_SET,
        title=_plain(f"{found.vendor} {found.product}".strip() or "A CiA 402 drive"),
        eds=_plain(str(found.path)),
        eds_quoted=_EDS_TOKEN,
        scene=_plain(str(out or "rig.yaml")),
        hint="      needs no hardware: drive, motor and hand are simulated" if simulate else "",
        **_bus_values(found, simulate),
        **_axis_values(found, drive, limit),
        limit=f"{limit:g}",
        rendered=_rendered(found, limit, simulate=simulate),
        simulation=_simulation(found, rated, limit, _resolution_of(drive)) if simulate else "",
    )
    return _aligned(text).replace(_EDS_TOKEN, json.dumps(path_for_scene(found.path, out), ensure_ascii=False))


def _rendered(found: Survey, limit: float, *, simulate: bool) -> str:
    """Return environment and passivity."""
    if found.axis.admittance is not None:
        return display_rendered(found.axis.admittance, limit, 1.0 / _rate(found), simulate=simulate)
    values = _scaled(limit)
    late = {} if simulate else {"sync_jitter": 0.05, "torque_window": 1e-4, "current_lag": 5e-4}
    loop = LoopProperties(
        sample_time=1.0 / _rate(found),
        delay=1,
        moving_mass=float(values["inertia"]),
        device_damping_bound=float(values["most_damping"]),
        device_friction_bound=float(values["most_friction"]),
        **late,
    )
    energy = advised_allowance(loop, 0.0)
    return _RENDERED.substitute(
        to_set=TO_SET, **values, timing="" if simulate else _TIMING,
        allowance=number(1e6 * energy), allowed=allowance_words(energy, loop, "rad"),
    )  # fmt: skip


def _bus_values(found: Survey, simulate: bool) -> dict[str, str]:
    rate = _rate(found)
    return {
        "bus": _bus(simulate),
        "bitrate": str(found.bitrate),
        "bitrate_note": "" if found.bitrates else f"    # {TO_SET}: the dictionary lists none; as set in the drive",
        "rate": f"{rate:g}",
        "rate_note": "" if rate >= _FASTEST else "    # the fastest that fits the bus at this bit rate",
    }


def _axis_values(found: Survey, drive: str | None, limit: float) -> dict[str, str]:
    dictionary, display = found.dictionary, found.axis.admittance
    transmission = f"    transmission: 1         # {TO_SET}: gear ratio, where 0x6076 is the torque of the motor\n"
    return {
        "identity": _identity(found, drive),
        "counts": f"{_counts(dictionary):.10g}",
        "counts_note": _counts_note(dictionary),
        "rated": _rated_lines(dictionary, _stated_torque(dictionary, drive)),
        "transmission": transmission if od.RATED_TORQUE in dictionary else "",
        "limit_note": _limit_note(dictionary),
        "read_back": f"    speed_limit: 20 rad/s    # {TO_SET}: a handle that is faster stops the rig\n"
        + _read_back_lines(found)
        if display is None
        else display_axis(
            display, _counts(dictionary), limit, max_torque_unwritten(dictionary, found.axis), steepest_ramp(dictionary)
        ),
        "watchdog": _watchdog_lines(dictionary),
    }


def _aligned(text: str) -> str:
    """The text with its value comments aligned."""
    return _TRAILING_COMMENT.sub(lambda found: f"{found.group(1):<{_COMMENT_COLUMN - 2}}  # ", text)


def _plain(text: str) -> str:
    """Return a text for a comment: one line, printable."""
    return "".join(letter if letter.isprintable() else " " for letter in text)


def _round(value: float) -> float:
    return float(f"{value:.3g}")


def _bus(simulate: bool) -> str:
    if simulate:
        return "  interface: virtual        # everything inside this process; on the rig: socketcan, pcan, kvaser, ..."
    lines = (
        f"  interface: socketcan      # {TO_SET}: any python-can interface, see configs/interfaces",
        f"  channel: can0             # {TO_SET}",
    )
    return "\n".join(lines)


def _rate(found: Survey) -> float:
    """Return the highest round rate [Hz] up to 1 kHz at which one axis fits the bus."""
    worst = max((load.worst_cycle for load in found.loads), default=0.0)
    return round_rate(min(_FASTEST, 1.0 / worst)) if worst else _FASTEST


def _identity(found: Survey, drive: str | None) -> str:
    lines = []
    if drive is not None:
        lines.append(f"    drive: {drive}            # profile in configs/drives: what is known of this make")
    if found.vendor_id and listed(found.dictionary, od.IDENTITY, 1) is not None:
        lines.append(f"    vendor_id: {found.vendor_id:#x}         # 0x1018:01; the start refuses any other make")
    return "".join(f"{line}\n" for line in lines)


def _counts(dictionary: ObjectDictionary) -> float:
    """Return counts per radian: increments per revolution (0x608F) times gear (0x6091), or a guess."""
    revolutions = stated_value(dictionary, od.ENCODER_RESOLUTION, 2) or 1
    gear = (stated_value(dictionary, od.GEAR_RATIO, 1) or 1) / (stated_value(dictionary, od.GEAR_RATIO, 2) or 1)
    stated = _stated_counts(dictionary)
    counts = _GUESSED_COUNTS if stated is None else stated / revolutions * gear
    return float(f"{counts / (2.0 * math.pi):.8g}")


def _stated_counts(dictionary: ObjectDictionary) -> int | None:
    """Return the increments of 0x608F; None where absent, or the 1 of an object that was never set."""
    increments = stated_value(dictionary, od.ENCODER_RESOLUTION, 1)
    return increments if increments is not None and increments >= _FEWEST_COUNTS else None


def _counts_note(dictionary: ObjectDictionary) -> str:
    increments = _stated_counts(dictionary)
    if increments:
        return f"\n                              # here from 0x608F = {increments} and the gear of 0x6091"
    return f"\n                              # here {_GUESSED_COUNTS:g} counts per revolution, a guess"


def _stated_torque(dictionary: ObjectDictionary, drive: str | None) -> float | None:
    """Return the rated torque that the dictionary states [N*m]; None when it has none or a value of zero."""
    counts = stated_value(dictionary, od.RATED_TORQUE)
    return counts * _resolution_of(drive) if counts else None


def _resolution_of(drive: str | None) -> float:
    names = () if drive is None else tuple(profile_values(drive).get("quirks", ()))
    return quirks_of(names).rated_torque_resolution


def _rated_lines(dictionary: ObjectDictionary, stated: float | None) -> str:
    if od.RATED_TORQUE not in dictionary:
        return (
            f"    rated_torque: {_GUESSED_RATED_TORQUE:g} N*m     # {TO_SET}: torque of the axis at 1000 per mille of "
            "0x6071; the drive has no 0x6076\n"
        )
    seen = f"{stated:g} N*m here" if stated else "no value here"
    return (
        f"    # rated_torque: 1 N*m       # of the axis at 1000 per mille. Left out: read from 0x6076 ({seen}).\n"
        "                              # Given: compared with 0x6076 at the start, and needed when that is 0\n"
    )


def _torque_limit(dictionary: ObjectDictionary, rated: float) -> float:
    """Return a cautious torque limit [N*m] that a 0x6072 with limits of its own takes."""
    variable = dictionary.get_variable(od.MAX_TORQUE, 0)
    limit = _CAUTIOUS * rated
    if variable is not None and variable.writable:
        least, most = variable.min or 0, math.inf if variable.max is None else variable.max
        limit = min(max(limit, least * _PER_MILLE * rated), most * _PER_MILLE * rated)
    return _round(limit)


def _limit_note(dictionary: ObjectDictionary) -> str:
    if is_writable(dictionary, od.MAX_TORQUE, 0):
        return "\n                              # also written to 0x6072"
    return "\n                              # no writable 0x6072: limit the current in the drive as well"


def _read_back_lines(found: Survey) -> str:
    read_back = "none" if found.axis_map is None else found.axis_map.read_back
    notes = {
        "demand": "demand            # 0x6074: the energy of every hold is exact",
        "actual": "actual            # 0x6077, measured: the energy has an error; 0x6074 cannot be mapped",
        "none": "none              # no torque can be mapped: the energy is that of the torque sent",
    }
    lines = f"    read_back: {notes[read_back]}\n"
    if read_back != "none":
        lines += f"    demand_reported: before # {TO_SET}: before or after the update at SYNC\n"
    return lines


def _watchdog_lines(dictionary: ObjectDictionary) -> str:
    if is_writable(dictionary, od.CONSUMER_HEARTBEAT_TIME, 1):
        return ""
    return "    watchdog: false         # the drive has no writable 0x1016: a killed master leaves the torque on\n"


def _scaled(limit: float) -> dict[str, str]:
    """Return environment and mass such that the torque limit is met a little beyond 0.1 rad of penetration."""
    return {
        "stiffness": f"{5.0 * limit:.3g}",
        "damping": f"{0.05 * limit:.3g}",
        "inertia": f"{0.005 * limit:.3g}",
        "most_damping": f"{0.02 * limit:.3g}",
        "most_friction": f"{0.05 * limit:.3g}",
        "push": f"{limit:.3g}",
    }


def _simulation(found: Survey, rated: float, limit: float, resolution: float) -> str:
    """Return the section; `rated` [N*m] is the motor's, in 0x6076 where the drive has it, so that a gear may follow."""
    objects, line = missing_values(found, 1.0 / _rate(found)), f"    rated_torque: {rated:g} N*m\n"
    if od.RATED_TORQUE in found.dictionary:
        line = ""
        if not stated_value(found.dictionary, od.RATED_TORQUE):
            objects[_key((od.RATED_TORQUE, 0))] = str(round(rated / resolution))
    lines = "".join(
        f"      {key}: {value}          # the dictionary gives none, or that of another rig\n"
        for key, value in objects.items()
    )
    given, display = f"    objects:\n{lines}" if objects else "", found.axis.admittance
    if display is not None:
        return display_simulation(display, given, line, limit)
    hand = "a hand that follows a slow sine and meets the wall on the way"
    return simulated_machine(line, given, 0.0125 * limit, 0.005 * limit, limit, hand)
