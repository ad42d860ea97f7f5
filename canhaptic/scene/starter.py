"""The text of a configuration to start from, made from the dictionary of a drive.

It is a whole scene: every key that a dictionary can supply is given, every other has a cautious value and says so.
"""

import json
import math
import re
from pathlib import Path
from string import Template
from typing import Final

from canopen import ObjectDictionary

from canhaptic.canopen import objects as od
from canhaptic.canopen.dictionary import is_writable
from canhaptic.drive.can.bus_budget import round_rate
from canhaptic.drive.profile.fitness import max_torque_unwritten, steepest_ramp
from canhaptic.drive.profile.object_use import listed
from canhaptic.drive.profile.quirks import quirks_of
from canhaptic.drive.survey import Suitability, Survey, stated_value
from canhaptic.errors import DictionaryError
from canhaptic.scene.display_starter import display_axis, display_rendered, display_simulation
from canhaptic.scene.eds_path import path_for_scene
from canhaptic.scene.guesses import TO_SET
from canhaptic.scene.missing_values import missing_values
from canhaptic.scene.profiles import profile_values
from canhaptic.scene.starter_simulation import JITTER, simulated_machine

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
$identity    unit: rad               # m for a linear axis; the units below then are N, N/m, ...
    counts_per_unit: $counts   # $to_set: counts of 0x6064 per radian of the axis, gear included$counts_note
    direction: 1            # -1 if the positive direction of the drive is not that of the axis
$rated$transmission    torque_limit: $limit N*m # $to_set: the largest torque that may ever reach the hand$limit_note
$read_back$watchdog
$rendered$simulation""")

_RENDERED: Final = Template("""\
# A spring and a damper, solid below `position`. Soft, for the first contact.
environment:
  type: spring_damper_wall
  stiffness: $stiffness N*m/rad
  damping: $damping N*m*s/rad
  position: -0.05 rad

# The energy balance with a proof. It rests on what moves with the encoder at least.
passivity:
  algorithm: guarded
  moving_mass: $inertia kg*m^2   # $to_set: an under-estimate is safe, an over-estimate is not
  device_damping_bound: $most_damping N*m*s/rad # $to_set: an over-estimate is safe, an under-estimate is not
  device_friction_bound: $most_friction N*m # $to_set: the same of dry friction
$timing  hand_force: 0 N*m         # largest torque with which the hand pulls out of the contact
  hand_push: $push N*m       # $to_set: largest torque with which it pushes in
""")

_TIMING: Final = f"""\
{JITTER}\
  torque_window: 100 us    # {TO_SET}: a torque acts so long after its SYNC at the latest
  current_lag: 500 us      # {TO_SET}: time constant of the current loop at most
"""


def starter_scene(found: Survey, *, simulate: bool, drive: str | None = None, out: Path | None = None) -> str:
    """Return the text of a scene file for one drive, which `load_scene` accepts.

    Args:
        found: The survey of its dictionary.
        simulate: Adds a simulated drive, motor and hand on a virtual bus, so that it runs at once.
        drive: Name of the drive profile to use; None for none.
        out: Path of the file for the text; None where that is unknown, and the dictionary needs its whole path.

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
        simulation=_simulation(found, rated, limit) if simulate else "",
    )
    return _aligned(text).replace(_EDS_TOKEN, json.dumps(path_for_scene(found.path, out), ensure_ascii=False))


def _rendered(found: Survey, limit: float, *, simulate: bool) -> str:
    """Return environment and passivity."""
    if found.axis.admittance is not None:
        return display_rendered(found.axis.admittance, limit, 1.0 / _rate(found), simulate=simulate)
    return _RENDERED.substitute(to_set=TO_SET, **_scaled(limit), timing="" if simulate else _TIMING)


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
    transmission = "    transmission: 1         # gear ratio, where 0x6076 is the torque of the motor\n"
    return {
        "identity": _identity(found, drive),
        "counts": f"{_counts(dictionary):.10g}",
        "counts_note": _counts_note(dictionary),
        "rated": _rated_lines(dictionary, _stated_torque(dictionary, drive)),
        "transmission": transmission if od.RATED_TORQUE in dictionary else "",
        "limit_note": _limit_note(dictionary),
        "read_back": _read_back_lines(found)
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


def _simulation(found: Survey, rated: float, limit: float) -> str:
    objects = missing_values(found, 1.0 / _rate(found))
    lines = "".join(
        f"      {key}: {value}          # the dictionary gives none, or that of another rig\n"
        for key, value in objects.items()
    )
    given, display = f"    objects:\n{lines}" if objects else "", found.axis.admittance
    if display is not None:
        return display_simulation(display, given, rated, limit)
    hand = "a hand that follows a slow sine and meets the wall on the way"
    return simulated_machine(rated, given, 0.0125 * limit, 0.005 * limit, limit, hand)
