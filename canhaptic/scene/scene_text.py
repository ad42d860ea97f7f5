"""Text of a scene file: a first one for a drive, and one with changed values.

The first scene is made from the dictionary of the drive and the texts of `starter.toml`. It is complete: values that
the dictionary states are used, all others are cautious guesses marked as such. For a simulated drive,
`simulation.drive.objects` has the values that dictionaries omit, and replaces settings that belong to another rig, such
as a communication cycle of 1 us, which a vendor's tool sets on a real drive. All values of an admittance display scale
with the torque limit, so that they fit together: a mass that the torque accelerates at 200 rad/s^2, a velocity loop of
50 Hz, and a virtual mass that is passive without a guard.

A changed value keeps comments, order and everything else of the file.
"""

import json
import math
import os
import re
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from string import Template
from typing import Final, NamedTuple

import yaml
from canopen import ObjectDictionary

from canhaptic.canopen import objects as od
from canhaptic.canopen.objects import is_writable
from canhaptic.control.passivity import LoopProperties
from canhaptic.drive.can.bus_budget import round_rate
from canhaptic.drive.can.pdo_map import standard_watchdog
from canhaptic.drive.profile import fitness
from canhaptic.drive.profile.motion_parameters import MotionParameters
from canhaptic.drive.profile.quirks import quirks_of
from canhaptic.drive.survey import Suitability, Survey, stated_value
from canhaptic.errors import DictionaryError, InputError
from canhaptic.host.adapters import ADAPTERS, WINDOW, Adapter
from canhaptic.scene.document import compose
from canhaptic.scene.hints import advised_allowance, allowance_words
from canhaptic.scene.load import scene_from_text
from canhaptic.scene.models import TO_SET, Scene
from canhaptic.scene.overrides import split_override
from canhaptic.scene.profiles import profile_values

_EVENT_TIMER: Final = 5  # subindex: of an RPDO its deadline [ms]
_DEVICE_TYPE: Final = 0x0002_0000 | od.CIA402_PROFILE  # servo drive

_Place = tuple[int, int]


def missing_values(found: Survey, sample_time: float) -> dict[str, str]:
    """Return `simulation.drive.objects` for what a simulated drive needs and an EDS does not state: key -> value.

    Args:
        found: Survey of the dictionary.
        sample_time: Time from SYNC to SYNC [s].
    """
    dictionary, fitting = found.dictionary, {}
    for place, value in {**_absent(found), **_misleading(dictionary, sample_time)}.items():
        variable, fault = dictionary.get_variable(*place), fitness.objection(dictionary, fitness.ObjectUse(*place))
        if fault is None and variable is not None and fitness.range_objection(variable, value) is None:
            fitting[_key(place)] = f"{value:#x}"
    return fitting


def _key(place: _Place) -> str:
    return f"{place[0]:#06x}" + (f".{place[1]}" if place[1] else "")


def _absent(found: Survey) -> dict[_Place, int]:
    """Return values for objects that have no value in the dictionary."""
    needed: dict[_Place, int] = {(od.DEVICE_TYPE, 0): _DEVICE_TYPE}
    if found.vendor_id is not None:
        needed[od.IDENTITY, 1] = found.vendor_id
    needed |= _cob_ids(found.dictionary)
    missing = {place: value for place, value in needed.items() if stated_value(found.dictionary, *place) is None}
    mode_bit = 1 << found.axis.causality.mode_code - 1
    if not (stated_value(found.dictionary, od.SUPPORTED_DRIVE_MODES) or 0) & mode_bit:
        missing[od.SUPPORTED_DRIVE_MODES, 0] = mode_bit
    return missing


def _cob_ids(dictionary: ObjectDictionary) -> dict[_Place, int]:
    """Return the default COB-ID of every PDO: from the predefined connection set, or disabled."""
    found: dict[_Place, int] = {}
    for first, bases in ((od.RPDO_COMMUNICATION, od.RPDO_BASE), (od.TPDO_COMMUNICATION, od.TPDO_BASE)):
        for index in _indices(dictionary, first):
            number = index - first
            found[index, 1] = bases[number] + 1 if number < len(bases) else od.COB_ID_INVALID
    return found


def _indices(dictionary: ObjectDictionary, first: int) -> Iterator[int]:
    return (index for index in dictionary if first <= index < first + od.PDO_COUNT)


def _misleading(dictionary: ObjectDictionary, sample_time: float) -> dict[_Place, int]:
    """Return replacements for stated values that belong to another rig."""
    period = round(sample_time * 1e6)
    wanted: dict[_Place, int] = {(od.SYNC_COB_ID, 0): od.SYNC_FRAME_COB_ID, (od.COMMUNICATION_CYCLE_PERIOD, 0): period}
    wanted |= {(index, _EVENT_TIMER): 0 for index in _indices(dictionary, od.RPDO_COMMUNICATION)}
    return {place: value for place, value in wanted.items() if stated_value(dictionary, *place) not in (None, 0, value)}


_INERTIA: Final = 0.005  # of an admittance display, per torque limit [s^2]
_BANDWIDTH: Final = 50.0  # of its velocity loop [Hz]
_OVER: Final = 1.1  # every over-estimate
_START_SPEED: Final = 0.05  # from which a hand moves it [rad/s]
_HELD: Final = 2.0  # times M + c tau: passive without a guard
_ACCELERATION: Final = 50.0  # commanded at most [rad/s^2]
_SENSOR: Final = {"range": 2.0, "per_count": 2.0 / 16384, "error": 4e-4, "slew": 25.0}
"""Force sensor of an admittance display, as multiples of the torque limit."""

_MEAN: Final = re.compile(r"\b(mean|averaged?)\b", re.IGNORECASE)

_SCALED: Final = {
    "stiffness": 5.0,
    "damping": 0.05,
    "inertia": 0.005,
    "most_damping": 0.02,
    "most_friction": 0.05,
    "push": 1.0,
}
"""Wall and device, as multiples of the torque limit, which the wall reaches a little beyond 0.1 rad."""
_LATE: Final = {"sync_jitter": 0.05, "torque_window": 1e-4, "current_lag": 5e-4}
"""Timing of real drives, as in the text `timing` of `starter.toml`."""

_CAUTIOUS: Final = 0.05  # part of the rated torque that the first configuration allows
_GUESSED_RATED_TORQUE: Final = 1.0  # [N*m]
_GUESSED_COUNTS: Final = 65536  # per revolution
_FEWEST_COUNTS: Final = 64  # per revolution; a dictionary that states fewer states the default of an unset object
_PER_MILLE: Final = 1e-3  # one count of 0x6072
_COMMENT_COLUMN: Final = 30
_TRAILING_COMMENT: Final = re.compile(r"^( *[^#\s][^#\n]*?) +# ", re.MULTILINE)
_EDS_TOKEN: Final = "@EDS@"  # put in last: nothing else may touch a path
_FASTEST: Final = 1000.0  # [Hz]


@cache
def _texts() -> dict[str, str]:
    return tomllib.loads(Path(__file__).with_name("starter.toml").read_text(encoding="utf-8"))


def _text(name: str, **values: object) -> str:
    """Return a text of `starter.toml` with its values filled in, numbers to three digits."""
    shown = {key: f"{value:.3g}" if isinstance(value, float) else str(value) for key, value in values.items()}
    return Template(_texts()[name]).substitute(to_set=TO_SET, **shown)


def starter_scene(
    found: Survey, *, simulate: bool, drive: str | None = None, out: Path | None = None, interface: str = "socketcan"
) -> str:
    """Return the text of a scene file for one drive, which `load_scene` accepts.

    Args:
        found: Survey of the dictionary.
        simulate: Whether drive, motor and hand are simulated on a virtual bus, so that the scene runs at once.
        drive: Name of the drive profile to use; None for none.
        out: Path of the scene file, from which the path of the dictionary starts; None: that path is absolute.
        interface: python-can interface of the rig, whose adapter may be slower than the bus.

    Raises:
        DictionaryError: The drive is unfit; lists every reason.
    """
    if found.suitability is Suitability.UNFIT:
        reasons = "; ".join(f"{row.item}: {row.text}" for row in found.reasons)
        raise DictionaryError(f"{found.axis.dictionary_path} is not fit for {found.axis.causality.kind}: {reasons}")
    adapter, is_line = ADAPTERS.get(interface), hasattr(found.axis, "esi")
    dictionary, rate = found.dictionary, _rate(found, adapter)
    jitter = max(_LATE["sync_jitter"], adapter.jitter * rate if adapter else 0.0)
    quirks = () if drive is None else tuple(profile_values(drive).get("quirks", ()))
    stated, resolution = stated_value(dictionary, od.RATED_TORQUE), quirks_of(quirks).rated_torque_resolution
    rated = (stated or 0) * resolution or _GUESSED_RATED_TORQUE
    limit = _torque_limit(dictionary, rated)
    mode, timing = found.axis.admittance, (1.0 / rate, None if simulate else jitter)
    parts = _of_torque(found, limit, *timing) if mode is None else _of_motion(found, mode, limit, *timing)
    text = _text(
        "scene",
        title=_plain(f"{found.vendor} {found.product}".strip() or "A CiA 402 drive"),
        eds=_plain(str(found.axis.dictionary_path)),
        scene=_plain(str(out or "rig.yaml")),
        hint="      needs no hardware: drive, motor and hand are simulated" if simulate else "",
        bus=_line(rate, None if simulate else interface)
        if is_line
        else _bus(found, rate, adapter, interface, simulate),
        place=_text("at_position" if is_line else "at_node", eds_quoted=_EDS_TOKEN),
        identity=_identity(found, drive),
        rated=_rated_lines(dictionary, rated if stated else None),
        limit=f"{limit:g}",
        limit_note=_text("limit_written" if is_writable(dictionary, od.MAX_TORQUE, 0) else "limit_not_written"),
        read_back=parts.keys,
        watchdog="" if is_line or standard_watchdog(dictionary, found.axis_map)[0] != "none" else _text("no_watchdog"),
        rendered=parts.rendered,
        simulation=_simulation(found, rated, limit, resolution, 1.0 / rate, parts.machine) if simulate else "",
        **_count_values(dictionary),
    )
    aligned = _TRAILING_COMMENT.sub(lambda line: f"{line.group(1):<{_COMMENT_COLUMN - 2}}  # ", text)
    path = _path_for_scene(found.axis.dictionary_path, out)
    return aligned.replace(_EDS_TOKEN, json.dumps(path, ensure_ascii=False))


def _bus(found: Survey, rate: float, adapter: Adapter | None, interface: str, simulate: bool) -> str:
    return _text(
        "of_can",
        interface=_text("virtual")
        if simulate
        else _text("interface", interface=interface, channel=_channel(interface)),
        window="" if adapter is None else _text("window", window=WINDOW, round_trip=1e3 * adapter.round_trip),
        bitrate=found.bitrate,
        bitrate_note="" if found.bitrates else _text("bitrate_unlisted"),
        rate=f"{rate:g}",
        rate_note="" if rate >= _FASTEST else _text("rate_of_bus" if adapter is None else "rate_of_adapter"),
    )


def _line(rate: float, interface: str | None) -> str:
    """Return the keys of an EtherCAT line; interface None: simulated."""
    shown = "virtual        # everything inside this process" if interface is None else f"{interface} # {TO_SET}"
    return _text("of_line", interface=shown, rate=f"{rate:g}")


def _path_for_scene(dictionary: Path, scene: Path | None) -> str:
    """Return the path with which a scene file refers to a dictionary.

    Args:
        dictionary: Path of the dictionary, relative to the current folder.
        scene: Scene file, from whose folder the result starts; None: the result is absolute.
    """
    if scene is None:
        return str(dictionary.absolute())
    return os.path.relpath(dictionary.parent.resolve() / dictionary.name, scene.parent.resolve())


class _OfMode(NamedTuple):
    """What a scene has for the mode of its drive: by torque limit [N*m], sample time [s], jitter (None: simulated)."""

    keys: str  # of the axis
    rendered: str  # environment and passivity
    machine: dict[str, object]  # values of the simulated machine


def _of_torque(found: Survey, limit: float, time: float, jitter: float | None) -> _OfMode:
    machine = {
        "mass": 0.0125 * limit, "bearings": 0.005 * limit, "between": "", "amplitude": "0.15", "frequency": "0.5",
        "hand": "a hand that follows a slow sine and meets the wall on the way",
    }  # fmt: skip
    return _OfMode(_read_back(found), _wall(limit, time, jitter), machine)


def _of_motion(found: Survey, given: MotionParameters, limit: float, time: float, jitter: float | None) -> _OfMode:
    mass, gain = _INERTIA * limit, _gain(limit)
    loop = {"gain": gain, "integral": 10.0 * gain if given.mode == "position" else 0.0, "noise": 5e-5 * limit}
    grip = {"grip": 0.15 * mass, "grip_stiffness": 1e4 * mass, "grip_damping": 10.0 * mass}
    machine: dict[str, object] = {
        "mass": mass, "bearings": mass, "between": _text("display_machine", **loop, **grip), "amplitude": "0.1",
        "frequency": "2.0", "hand": "a hand that moves to and fro",
    }  # fmt: skip
    keys = _motion_keys(found, given, limit, has_mean=jitter is None)
    return _OfMode(keys, _virtual_mass(given, limit, time, jitter), machine)


def _wall(limit: float, time: float, jitter: float | None) -> str:
    values = {key: _round(part * limit) for key, part in _SCALED.items()}
    loop = LoopProperties(
        sample_time=time, delay=1, moving_mass=values["inertia"], device_damping_bound=values["most_damping"],
        device_friction_bound=values["most_friction"], **({} if jitter is None else {**_LATE, "sync_jitter": jitter}),
    )  # fmt: skip
    energy, timing = advised_allowance(loop, 0.0), "" if jitter is None else _text("timing", jitter=100.0 * jitter)
    allowed = allowance_words(energy, loop, "rad")
    return _text("wall", **values, timing=timing, allowance=1e6 * energy, allowed=allowed)


def _virtual_mass(given: MotionParameters, limit: float, sample_time: float, jitter: float | None) -> str:
    mass, gain = _INERTIA * limit, _gain(limit)
    is_position = given.mode == "position"
    return _text(
        "display_rendered",
        certified=_text("uncertified" if is_position and jitter is not None else "certified"),
        mass=_HELD * (mass + 1.5 * sample_time * gain),
        damping=mass,
        drive_mass=_OVER * mass,
        gain=_OVER * gain,
        friction=0.02 * limit,
        bearings=2.0 * mass,
        integral=_text("integral_gain", gain=_OVER * 10.0 * gain) if is_position else "",
        timing="" if jitter is None else _text("jitter", jitter=100.0 * jitter),
        allowance=0.5 * _OVER * gain * sample_time * _START_SPEED**2,
    )


def _motion_keys(found: Survey, given: MotionParameters, limit: float, *, has_mean: bool) -> str:
    """Return the keys of an axis that make it an admittance display; `has_mean`: of a sensor that shows means."""
    counts, dictionary = _counts(found.dictionary), found.dictionary
    unlimited, steepest = fitness.max_torque_unwritten(dictionary, found.axis), fitness.steepest_ramp(dictionary)
    named, is_velocity = given.force.object, given.mode == "velocity"
    has_mean = has_mean or (given.force.place is not None and _is_mean(dictionary, *given.force.place))
    return _text(
        "display",
        mode=given.mode,
        mode_note="mode 9, 0x60FF" if is_velocity else "mode 8, 0x607A, which the drive interpolates",
        velocity_counts=_text("velocity_counts", counts=f"{counts:.10g}") if is_velocity else "",
        acceleration=min(_ACCELERATION, 0.99 * steepest / counts) if is_velocity else _ACCELERATION,
        limited=_text("limit_in_drive", unlimited=unlimited) if unlimited else "",
        source=_text("force_of_node") if named is None else _text("force_of_object", object=named),
        sampling="mean" if has_mean else _text("point"),
        **{key: part * limit for key, part in _SENSOR.items()},
    )


def _is_mean(dictionary: ObjectDictionary, index: int, subindex: int) -> bool:
    variable = dictionary.get_variable(index, subindex)
    return variable is not None and _MEAN.search(variable.name) is not None


def _gain(limit: float) -> float:
    return 2.0 * math.pi * _BANDWIDTH * _INERTIA * limit


def _plain(text: str) -> str:
    """Return a text as part of a comment: on one line, printable."""
    return "".join(letter if letter.isprintable() else " " for letter in text)


def _round(value: float) -> float:
    return float(f"{value:.3g}")


def _rate(found: Survey, adapter: Adapter | None = None) -> float:
    """Return the highest round rate [Hz] up to 1 kHz at which one axis fits the bus, and the adapter keeps up."""
    worst = max((load.worst_cycle for load in found.loads), default=0.0)
    limits = [_FASTEST, *([1.0 / worst] if worst else []), *([adapter.fastest] if adapter else [])]
    return round_rate(min(limits))


def _channel(interface: str) -> str:
    return ADAPTERS[interface].channel if interface in ADAPTERS else "can0"


def _identity(found: Survey, drive: str | None) -> str:
    lines = "" if drive is None else _text("profile", drive=drive)
    if found.vendor_id and fitness.listed(found.dictionary, od.IDENTITY, 1) is not None:
        lines += _text("vendor_id", vendor_id=f"{found.vendor_id:#x}")
    return lines


def _counts(dictionary: ObjectDictionary) -> float:
    """Return counts per radian: increments per revolution (0x608F) times gear (0x6091), or a guess."""
    revolutions = stated_value(dictionary, od.ENCODER_RESOLUTION, 2) or 1
    gear = (stated_value(dictionary, od.GEAR_RATIO, 1) or 1) / (stated_value(dictionary, od.GEAR_RATIO, 2) or 1)
    stated = _stated_counts(dictionary)
    counts = _GUESSED_COUNTS if stated is None else stated / revolutions * gear
    return float(f"{counts / (2.0 * math.pi):.8g}")


def _stated_counts(dictionary: ObjectDictionary) -> int | None:
    """Return the increments of 0x608F; None if absent, or so few that the object was never set."""
    increments = stated_value(dictionary, od.ENCODER_RESOLUTION, 1)
    return increments if increments is not None and increments >= _FEWEST_COUNTS else None


def _count_values(dictionary: ObjectDictionary) -> dict[str, str]:
    stated = _stated_counts(dictionary)
    note = _text("counts_stated" if stated else "counts_guessed", increments=stated or _GUESSED_COUNTS)
    transmission = _text("transmission") if od.RATED_TORQUE in dictionary else ""
    return {"counts": f"{_counts(dictionary):.10g}", "counts_note": note, "transmission": transmission}


def _rated_lines(dictionary: ObjectDictionary, stated: float | None) -> str:
    if od.RATED_TORQUE not in dictionary:
        return _text("rated_torque_absent", torque=f"{_GUESSED_RATED_TORQUE:g}")
    return _text("rated_torque_read", seen=f"{stated:g} N*m here" if stated else "no value here")


def _torque_limit(dictionary: ObjectDictionary, rated: float) -> float:
    """Return a cautious torque limit [N*m] within the range that the dictionary gives for 0x6072."""
    variable = dictionary.get_variable(od.MAX_TORQUE, 0)
    limit = _CAUTIOUS * rated
    if variable is not None and variable.writable:
        least, most = variable.min or 0, math.inf if variable.max is None else variable.max
        limit = min(max(limit, least * _PER_MILLE * rated), most * _PER_MILLE * rated)
    return _round(limit)


def _read_back(found: Survey) -> str:
    read_back = "none" if found.axis_map is None else found.axis_map.read_back
    reported = "" if read_back == "none" else _text("demand_reported")
    return _text("speed_limit") + _text(f"read_back_{read_back}") + reported


def _simulation(
    found: Survey, rated: float, limit: float, resolution: float, time: float, machine: dict[str, object]
) -> str:
    """Return the section `simulation`; `rated` [N*m] is the motor's rated torque, in 0x6076 if the drive has it."""
    objects, drive = missing_values(found, time), _text("rated_torque", torque=f"{rated:g}")
    if od.RATED_TORQUE in found.dictionary:
        drive = ""
        if not stated_value(found.dictionary, od.RATED_TORQUE):
            objects[_key((od.RATED_TORQUE, 0))] = str(round(rated / resolution))
    if objects:
        drive += "    objects:\n" + "".join(_text("object", key=key, value=value) for key, value in objects.items())
    given = f"  drive:\n{drive}" if drive else ""
    return _text("machine", drive=given, stiffness=3.0 * limit, hand_damping=0.25 * limit, **machine)


# --- changed values ---------------------------------------------------------------------------------------------------

_COMMENT: Final = re.compile(r"[ \t]*(#.*)?$", re.MULTILINE)


class Change(NamedTuple):
    """New value or comment for one entry of a scene."""

    path: tuple[str, ...]  # keys, and indices or names of list entries
    value: str | None  # as YAML; None: an entry that is written keeps its value, and a missing one is not added
    comment: str | None = None  # replaces the comment of the line; None: kept


def edited_scene(scene: Scene, changes: Sequence[Change], place: str, *, allow_code: bool = False) -> str:
    """Return the text of a scene with its overrides and further changes written into it.

    Args:
        scene: Scene as loaded.
        changes: Changes, applied in order.
        place: File that the text is for; relative paths start from it.
        allow_code: As for `load_scene`.

    Raises:
        InputError: The edited text would not mean the changed scene.
        SceneError: The changed scene is wrong.
    """
    overrides = [Change(*split_override(text)) for text in scene.overrides]
    text = edited_text(scene.text, [*overrides, *changes, *_kept_apart(scene.text, changes)])
    typed = [f"{'.'.join(_quoted(change.path))}={change.value}" for change in changes if change.value is not None]
    expected = scene_from_text(scene.text, place, [*scene.overrides, *typed], allow_code=allow_code)
    if scene_from_text(text, place, allow_code=allow_code).resolved() != expected.resolved():
        raise InputError(f"{scene.source}: cannot be edited line by line: anchors, or values over several lines; "
                         "write each value of each axis where it belongs, on a line of its own")  # fmt: skip
    return text


def _kept_apart(text: str, changes: Sequence[Change]) -> Iterator[Change]:
    """Yield the old value of each key that an axis merges (`<<`) from an axis whose value changes."""
    axes = _child(compose(text), "axes")
    changed = [change.path[1:] for change in changes if change.path[:1] == ("axes",) and change.value is not None]
    given = [path for path in changed if _child(_child(axes, path[0]), "<<") is None]  # in a mapping that others merge
    for n, axis in enumerate(axes.value if isinstance(axes, yaml.SequenceNode) else ()):
        names = (str(n), getattr(_child(axis, "name"), "value", ""))
        own = {path[1:] for path in changed if path[0] in names}
        for name, *key in given if _child(axis, "<<") is not None else ():
            if len(key) == 1 and tuple(key) not in own and _child(axis, key[0]) is None:
                before = _child(_child(axes, name), key[0])
                value = "null" if before is None else text[before.start_mark.index : before.end_mark.index]
                yield Change(("axes", str(n), key[0]), value)


def edited_text(text: str, changes: Iterable[Change]) -> str:
    """Return YAML text with changes applied in order.

    Raises:
        InputError: A path leads to a whole section, or below a single value.
    """
    for change in changes:
        node: yaml.Node | None = compose(text)
        for depth, part in enumerate(change.path):
            child = _child(node, part)
            if child is None:
                text = text if change.value is None else _inserted(text, node, change.path[depth:], change)
                break
            node = child
        else:
            text = _replaced(text, node, change)
    return text


def is_written(text: str, path: Iterable[str]) -> bool:
    """Return whether YAML text has an entry at a path."""
    node: yaml.Node | None = compose(text)
    for part in path:
        node = _child(node, part)
    return node is not None


def _quoted(path: Iterable[str]) -> list[str]:
    return [f'"{part}"' if "." in part else part for part in path]


def _child(node: yaml.Node | None, part: str) -> yaml.Node | None:
    """Return the entry of a mapping by key, or of a list by index or `name`; None if there is none."""
    if isinstance(node, yaml.MappingNode):
        return next((value for key, value in node.value if key.value == part), None)
    if isinstance(node, yaml.SequenceNode):
        if part.isdigit():
            return node.value[int(part)] if int(part) < len(node.value) else None
        return next((item for item in node.value if getattr(_child(item, "name"), "value", None) == part), None)
    return None


def _replaced(text: str, node: yaml.Node | None, change: Change) -> str:
    """Return the text with another value, and another comment if the value ends its line."""
    if not isinstance(node, yaml.ScalarNode):
        raise InputError(f"{'.'.join(change.path)}: is a whole section; put it into the scene's file first")
    begin, end = node.start_mark.index, node.end_mark.index
    value = text[begin:end] if change.value is None else change.value
    behind = _COMMENT.match(text, end)
    if change.comment is None or behind is None:
        return text[:begin] + value + text[end:]
    after = _after_comment(text, behind.end(), node.start_mark.column)
    line = text[text.rfind("\n", 0, begin) + 1 : begin] + value
    width = behind.start(1) - text.rfind("\n", 0, end) - 1 if behind[1] else 0
    return (
        f"{text[: begin - len(line) + len(value)]}{line:<{max(width, len(line) + 2)}}# {change.comment}{text[after:]}"
    )


def _after_comment(text: str, end: int, column: int) -> int:
    """Return the end of a comment that continues on further lines: pure comments, right of a column."""
    while following := re.compile(rf"\n {{{column + 1},}}#.*").match(text, end):
        end = following.end()
    return end


def _inserted(text: str, node: yaml.Node | None, path: Sequence[str], change: Change) -> str:
    """Return the text with a new entry behind the last one of a mapping."""
    if not isinstance(node, yaml.MappingNode) or not node.value:
        raise InputError(f"{'.'.join(change.path)}: cannot be written there; give {path[0]} in the scene's file first")
    key, *below = path
    if node.flow_style:
        inside = "".join(f"{{{part}: " for part in below) + str(change.value) + "}" * len(below)
        begin = node.start_mark.index + 1
        return f"{text[:begin]}{key}: {inside}, {text[begin:]}"
    first, last = node.value[0][0], node.value[-1][0]
    behind = _COMMENT.search(text, max(last.end_mark.index, _end(node)))
    end = _after_comment(text, len(text) if behind is None else behind.end(), first.start_mark.column + 4)
    indents = [" " * (first.start_mark.column + 2 * depth) for depth in range(len(path))]
    lines = [f"{indent}{part}:" for indent, part in zip(indents, path, strict=True)]
    comment = f"  # {change.comment}" if change.comment else ""
    return "\n".join([text[:end].removesuffix("\n"), *lines[:-1], f"{lines[-1]} {change.value}{comment}"]) + (
        text[end:] or "\n"
    )


def _end(node: yaml.Node) -> int:
    """Return where the last value of a node ends; YAML's own end of a block includes the comments behind it."""
    if not isinstance(node, yaml.CollectionNode) or node.flow_style or not node.value:
        return int(node.end_mark.index)
    last = node.value[-1]
    return _end(last[1] if isinstance(node, yaml.MappingNode) else last)
