"""Survey of a drive: of its dictionary before there is a configuration, and of the limits that it holds at present.

A dictionary is usable, usable with conditions, or not usable. `check_dictionary` judges it for a configured axis. Here
nothing is configured: a value that the configuration must supply is a condition, not a refusal. A refusal rests only on
what the dictionary states. For an admittance display the source of its force and the limits in the drive are judged as
well.

`read_objects` asks a drive for its present limits, ramps and reactions, and compares them with the scene.
"""

from collections.abc import Iterator
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

from canopen import ObjectDictionary
from canopen.objectdictionary import ODVariable

from canhaptic.canopen import objects as od
from canhaptic.canopen.attached_devices import ForceNode
from canhaptic.canopen.objects import DataType, is_writable
from canhaptic.drive.axis_parameters import AxisParameters, CanBusParameters
from canhaptic.drive.can.bus_budget import bus_budget
from canhaptic.drive.can.pdo_map import (
    WATCHDOGS,
    AxisMap,
    PdoCapability,
    check_dictionary,
    choose_map,
    pdo_capabilities,
    standard_watchdog,
)
from canhaptic.drive.profile import fitness
from canhaptic.drive.profile.causality import Impedance
from canhaptic.drive.profile.drive_objects import DRIVE_OBJECTS
from canhaptic.drive.profile.fitness import Finding, Verdict, limit_objection, listed
from canhaptic.drive.profile.motion_parameters import ForceParameters, Mode, MotionParameters
from canhaptic.drive.profile.quirks import quirks_of
from canhaptic.drive.profile.torque_axis import TorqueAxis
from canhaptic.errors import DictionaryError, SdoError

_KINDS: Final[tuple[Literal["RPDO", "TPDO"], ...]] = ("RPDO", "TPDO")
_TYPES: Final = (DataType.INTEGER16, DataType.INTEGER32)

_KEYS: Final = (
    ("node_id", "as set in the drive"),
    ("unit, counts_per_unit", "position counts (0x6064) per radian or metre of the axis, gear included"),
    ("torque_limit", "the largest torque that may ever reach the hand"),
    ("direction", "-1 if drive and axis have opposite positive directions"),
)
"""Keys of every axis that no dictionary supplies, with their meaning."""


def _analog_input(dictionary: ObjectDictionary) -> str | None:
    """First known analog input that a TPDO of the drive can carry, as `0x3160.1`; None without one.

    In a drive of another make the same object may mean something else: the result is only a proposal.
    """
    for place in ("0x3160.1", "0x2205.1", "0x2205.0", "0x207C.1"):  # of maxon EPOS4, Elmo Gold, ZeroErr, maxon EPOS2
        index, _, subindex = place.partition(".")
        uses = (int(index, 16), int(subindex, 16))
        if any(fitness.mapping_objection(dictionary, "TPDO", uses[0], kind, uses[1]) is None for kind in _TYPES):
            return place
    return None


def display_of(dictionary: ObjectDictionary, mode: Mode, force_object: str | None = None) -> MotionParameters:
    """Return an admittance display for a dictionary; its scale of 1 and its other figures are placeholders.

    Args:
        dictionary: Dictionary of the drive.
        mode: `velocity` or `position`.
        force_object: Object that shows the force; by default a known analog input of the drive, else a
            sensor with a node of its own.

    Raises:
        pydantic.ValidationError: `force_object` is no object such as `0x3160.1`.
    """
    place = force_object or _analog_input(dictionary)
    node = ForceNode(node_id=9) if place is None else None  # where the drive has no input
    force = ForceParameters(object=place, node=node, per_count=1.0, range=1e6, slew=1.0, error=0.0)
    return MotionParameters(mode=mode, handle_acceleration=1.0, force=force)


RATES: Final = (100.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0)
"""Rates of SYNC for which the bus load is computed [Hz]."""
MOST_AXES: Final = 16
"""Largest number of axes for which the bus load is computed."""
_BUS: Final = CanBusParameters(rate=1000.0)  # of values that depend on it: the defaults

Group = Literal["identity", "torque", "motion", "read-back", "force", "limits", "resolution", "watchdog", "PDO"]


class Suitability(Enum):
    """Verdict on a drive from its dictionary alone."""

    FIT = "usable"
    CONDITIONAL = "usable with conditions"
    UNFIT = "not usable"


class SurveyRow(NamedTuple):
    """Verdict on one object or part of a dictionary."""

    group: Group
    item: str  # as `0x6072 max torque`
    stated: str  # type, access, default, mappable: what the dictionary says
    verdict: Verdict  # fit; unknown: a condition; refused
    text: str  # what that means and what to do


class ManualKey(NamedTuple):
    """A key of the configuration that no dictionary supplies."""

    key: str  # of an axis
    reason: str


class LoadRow(NamedTuple):
    """Load of the bus by one axis with the chosen map."""

    rate: float  # [Hz]
    periodic_load: float  # part of the bus, 0 to 1
    worst_cycle: float  # [s]
    fits: bool
    axes: int  # of this kind that fit; `MOST_AXES` means that many or more


class Survey(NamedTuple):
    """All findings on one object dictionary, before a scene exists."""

    dictionary: ObjectDictionary
    axis: AxisParameters  # for which it was judged
    vendor: str
    product: str
    vendor_id: int | None
    product_code: int | None
    bitrates: tuple[int, ...]  # that the dictionary lists [bit/s], rising; empty when it lists none
    rows: tuple[SurveyRow, ...]
    manual: tuple[ManualKey, ...]
    axis_map: AxisMap | None
    bitrate: int  # of the loads [bit/s]
    loads: tuple[LoadRow, ...]

    @property
    def reasons(self) -> list[SurveyRow]:
        """Reasons for rejecting the drive."""
        return [row for row in self.rows if row.verdict is Verdict.REFUSED]

    @property
    def conditions(self) -> list[SurveyRow]:
        """Values to configure, and values that the drive itself decides at the start."""
        return [row for row in self.rows if row.verdict is Verdict.UNKNOWN]

    @property
    def suitability(self) -> Suitability:
        """Whether the drive is usable with cyclic torque: usable, usable with conditions, or not usable."""
        if self.reasons:
            return Suitability.UNFIT
        return Suitability.CONDITIONAL if self.conditions else Suitability.FIT


def survey(dictionary: ObjectDictionary, axis: AxisParameters) -> Survey:
    """Judge from its dictionary whether a drive can be used.

    Args:
        dictionary: Dictionary as read from its EDS or DCF.
        axis: Axis from `unconfigured_axis`, perhaps with the keys of a drive profile.
    """
    device = dictionary.device_information
    findings = {finding.item.split()[0]: finding for finding in check_dictionary(dictionary, axis, _BUS)}
    try:
        axis_map = choose_map(dictionary, axis)
    except DictionaryError:
        axis_map = None
    bitrates = tuple(sorted(device.allowed_baudrates))
    bitrate = max((rate for rate in bitrates if rate <= 1_000_000), default=1_000_000)
    return Survey(
        dictionary,
        axis,
        device.vendor_name or "",
        device.product_name or "",
        stated_value(dictionary, od.IDENTITY, 1) or device.vendor_number,
        stated_value(dictionary, od.IDENTITY, 2) or device.product_number,
        bitrates,
        tuple(_rows(dictionary, axis, findings, axis_map)),
        _manual_keys(dictionary, axis, axis_map),
        axis_map,
        bitrate,
        () if axis_map is None else tuple(_load(axis_map, bitrate, rate) for rate in RATES),
    )


def unconfigured_axis(eds: str | Path, **values: Any) -> AxisParameters:
    """Return an axis for a dictionary, with further values; node ID, scale and limit are placeholders of 1."""
    return AxisParameters(name="drive", node_id=1, eds=Path(eds), counts_per_unit=1.0, torque_limit=1.0, **values)


# --- what an object states --------------------------------------------------------------------------------------


def _variable(dictionary: ObjectDictionary, index: int, subindex: int = 0) -> ODVariable | None:
    variable: ODVariable | None = dictionary.get_variable(index, subindex)
    return variable


def stated_value(dictionary: ObjectDictionary, index: int, subindex: int = 0) -> int | None:
    """Return the value of a DCF, else the default; None when the dictionary gives neither."""
    variable = _variable(dictionary, index, subindex)
    values = () if variable is None else (variable.value, variable.default)
    return next((value for value in values if isinstance(value, int)), None)


def _describe(dictionary: ObjectDictionary, index: int, subindex: int = 0) -> str:
    """Describe an object, as `UNSIGNED16 rw, default 1000, mappable`."""
    variable = _variable(dictionary, index, subindex)
    if variable is None:
        return "not listed"
    kind = variable.data_type
    names_it = kind is not None and DataType.BOOLEAN <= kind <= DataType.UNSIGNED32  # the first seven
    name = "no type" if kind is None else DataType(kind).name if names_it else f"type {kind:#06x}"
    parts = [f"{name} {variable.access_type}"]
    if isinstance(variable.value, int):
        parts.append(f"value {_number(index, variable.value)}")
    elif isinstance(variable.default, int):
        parts.append(f"default {_number(index, variable.default)}")
    if variable.pdo_mappable:
        parts.append("mappable")
    return ", ".join(parts)


def _number(index: int, value: int) -> str:
    return f"{value:#x}" if index in (od.DEVICE_TYPE, od.IDENTITY, od.SUPPORTED_DRIVE_MODES) else str(value)


def _row(
    dictionary: ObjectDictionary, group: Group, name: str, index: int, verdict: Verdict, text: str, subindex: int = 0
) -> SurveyRow:
    place = f"{index:#06x}" + (f":{subindex:02x}" if subindex else "")
    return SurveyRow(group, f"{place} {name}", _describe(dictionary, index, subindex), verdict, text)


def _judged(dictionary: ObjectDictionary, group: Group, finding: Finding, mode: int = 0) -> SurveyRow:
    """Return the row of a finding of `fitness`; the value saved in a DCF counts where there is no default."""
    index = int(finding.item[:6], 16)
    verdict, text = finding.verdict, finding.text
    saved = stated_value(dictionary, index)
    if verdict is Verdict.UNKNOWN and saved is not None:
        is_right = index != od.DEVICE_TYPE or saved & 0xFFFF == od.CIA402_PROFILE
        if index == od.SUPPORTED_DRIVE_MODES:
            is_right = bool(saved >> mode - 1 & 1)
        verdict = Verdict.FIT if is_right else Verdict.UNKNOWN
        text = f"{saved:#x} when this file was saved, {'as needed' if is_right else 'not fit'}; the drive is asked"
    return SurveyRow(group, finding.item, _describe(dictionary, index), verdict, text)


def _as_found(dictionary: ObjectDictionary, group: Group, finding: Finding) -> SurveyRow:
    """Return the row of a finding that does not depend on the value saved in a DCF."""
    return SurveyRow(group, finding.item, _describe(dictionary, int(finding.item[:6], 16)), *finding[1:])


# --- the groups ---------------------------------------------------------------------------------------------------


def _rows(
    dictionary: ObjectDictionary, axis: AxisParameters, findings: dict[str, Finding], axis_map: AxisMap | None
) -> Iterator[SurveyRow]:
    row, judged, as_found = partial(_row, dictionary), partial(_judged, dictionary), partial(_as_found, dictionary)
    yield judged("identity", findings["0x1000"])
    yield row("identity", "vendor ID", od.IDENTITY, Verdict.FIT, "compared when vendor_id is set", 1)
    yield row("identity", "product code", od.IDENTITY, Verdict.FIT, "compared when product_code is set", 2)
    for place in ("0x6040", "0x6041", f"{axis.causality.target:#06x}", "0x6064", "0x6502", "0x6060", "0x6061"):
        yield judged(axis.causality.commands, findings[place], axis.causality.mode_code)
    yield _read_back(dictionary, axis_map) if axis.admittance is None else _force(dictionary, axis.admittance)
    yield from _ramps_and_quick_stop(dictionary, axis.causality)
    yield row("limits", "max torque", od.MAX_TORQUE, *_max_torque(dictionary, axis, findings["0x6072"]))
    yield row("limits", "motor rated torque", od.RATED_TORQUE, *_rated_torque(dictionary, axis, findings["0x6076"]))
    yield row("limits", "motor rated current", od.RATED_CURRENT, Verdict.FIT, "for information; not used")
    text = "for orientation; counts_per_unit is the configuration's, confirmed by hand motion"
    yield row("resolution", "encoder increments", od.ENCODER_RESOLUTION, Verdict.FIT, text, 1)
    text = "for orientation; the gear belongs in counts_per_unit and transmission"
    yield row("resolution", "gear, motor revolutions", od.GEAR_RATIO, Verdict.FIT, text, 1)
    yield judged("watchdog", findings["0x1017"])
    watchdog = _watchdog(dictionary, axis_map)
    yield row("watchdog", "consumer heartbeat time", od.CONSUMER_HEARTBEAT_TIME, *watchdog, 1)
    yield as_found("watchdog", findings["0x6007"])
    for place, finding in findings.items():
        if place[:6] in ("0x1006", "0x60b0", "0x60b1", "0x60b2", "0x60c2", "0x6074", "0x6077"):  # shown if refused
            yield as_found("limits", finding)
    for kind in _KINDS:
        capabilities = list(pdo_capabilities(dictionary, kind))
        judgement = (Verdict.FIT, "") if capabilities else (Verdict.REFUSED, f"the dictionary describes no {kind}")
        yield SurveyRow("PDO", f"{kind}s", _counted(capabilities), *judgement)
    yield SurveyRow("PDO", "map", "", *findings["PDO"][1:])


def _force(dictionary: ObjectDictionary, display: MotionParameters) -> SurveyRow:
    place = display.force.place
    if place is None:
        text = "no analog input is known for this drive; name one (--force-object), or give the sensor its own node"
        return SurveyRow("force", "force sensor", "a node of its own", Verdict.UNKNOWN, text)
    variable = listed(dictionary, *place)
    kind = _TYPES[1] if variable is not None and variable.data_type == _TYPES[1] else _TYPES[0]
    verdict, text = (
        Verdict.UNKNOWN,
        "in the TPDO with the position, sampled by the same SYNC; confirm that it is an analog input",
    )
    if (refusal := fitness.mapping_objection(dictionary, "TPDO", place[0], kind, place[1])) is not None:
        verdict, text = Verdict.REFUSED, f"{refusal}; name an INTEGER16 or INTEGER32 that a TPDO can carry"
    item = f"{place[0]:#06x}:{place[1]:02x} force"
    return SurveyRow("force", item, _describe(dictionary, *place), verdict, text)


def _ramps_and_quick_stop(dictionary: ObjectDictionary, mode: Impedance | MotionParameters) -> Iterator[SurveyRow]:
    """Yield verdicts on objects that may alter a command of this mode, and on the drive's own quick stop."""
    speeding = od.PROFILE_ACCELERATION, od.MAX_ACCELERATION
    ramps = [index for index in speeding if index in mode.ramps and listed(dictionary, index) is not None]
    stuck = [index for index in ramps if not is_writable(dictionary, index, 0)]
    listing = ", ".join(f"{index:#06x}" for index in stuck or ramps)
    text = "read-only: no certificate covers a ramp inside the drive; set it with the vendor's tool"
    judgement = (Verdict.UNKNOWN, text) if stuck else (Verdict.FIT, "written as steep as they go")
    if ramps:
        yield _as_found(dictionary, "limits", Finding(f"{listing} ramps", *judgement))
    if not mode.quick_stop:
        return
    judgement = Verdict.UNKNOWN, "not writable: set it with the vendor's tool so that a quick stop brakes (2)"
    if is_writable(dictionary, od.QUICK_STOP_OPTION, 0):
        judgement = Verdict.FIT, "written: brakes along its ramp, then disabled"
    yield _row(dictionary, "limits", "quick stop option", od.QUICK_STOP_OPTION, *judgement)


def _read_back(dictionary: ObjectDictionary, axis_map: AxisMap | None) -> SurveyRow:
    stated = f"0x6074 {_describe(dictionary, od.TORQUE_DEMAND)}; 0x6077 {_describe(dictionary, od.TORQUE_ACTUAL)}"
    if axis_map is None:
        return SurveyRow("read-back", "torque read-back", stated, Verdict.FIT, "no map was found, see below")
    text = {
        "demand": "0x6074 (demand), in the TPDO: the energy of every hold is exact",
        "actual": "0x6077 (measured), in the TPDO, one sample per cycle; any difference from the commanded "
        "torque adds to the uncertainty of the account",
        "none": "no torque can be mapped: the energy is computed from the torque sent",
    }[axis_map.read_back]
    verdict = Verdict.FIT if axis_map.read_back == "demand" else Verdict.UNKNOWN
    return SurveyRow("read-back", "torque read-back", stated, verdict, text)


def _max_torque(dictionary: ObjectDictionary, axis: AxisParameters, found: Finding) -> tuple[Verdict, str]:
    limit, state = _variable(dictionary, od.MAX_TORQUE), fitness.max_torque_unwritten(dictionary, axis)
    if limit is None or state:
        text = (
            f"{state}, so only the master enforces torque_limit; also set a limit in the drive with the vendor's tool"
        )
        return Verdict.UNKNOWN, limit_objection(dictionary, axis) or text
    if found.verdict is Verdict.REFUSED:
        return found.verdict, found.text
    if limit.min:
        text = f"at least {limit.min} per mille: torque_limit is at least {limit.min / 1000:g} of the rated torque"
        return Verdict.UNKNOWN, text
    return Verdict.FIT, "written from torque_limit and read back"


def _rated_torque(dictionary: ObjectDictionary, axis: AxisParameters, found: Finding) -> tuple[Verdict, str]:
    is_listed = _variable(dictionary, od.RATED_TORQUE) is not None
    if is_listed and found.verdict is Verdict.REFUSED:
        return found.verdict, found.text
    if axis.rated_torque is not None:
        return Verdict.FIT, f"{axis.rated_torque:g} from the configuration"
    if not is_listed or not quirks_of(axis.quirks).reads_rated_torque:
        return Verdict.UNKNOWN, "not listed; rated_torque must be set"
    if not stated_value(dictionary, od.RATED_TORQUE):
        return Verdict.UNKNOWN, "not stated here; the run asks the drive. Set rated_torque if the drive answers 0"
    return Verdict.FIT, "read from the drive; its live value counts"


def _watchdog(dictionary: ObjectDictionary, axis_map: AxisMap | None) -> tuple[Verdict, str]:
    means, lacks = standard_watchdog(dictionary, axis_map)
    if means != "none":
        return Verdict.FIT, f"armed at the start: the drive notices a killed master {WATCHDOGS[means]}"
    text = f"{lacks}: the drive cannot notice a killed master; only watchdog: false continues, at your own risk"
    return Verdict.UNKNOWN, text


def _counted(capabilities: list[PdoCapability]) -> str:
    """Count PDOs, as `25: 1 writable (8 entries), 24 fixed`."""
    if not capabilities:
        return "none"
    writable = [c for c in capabilities if c.fixed is None]
    rooms = sorted({c.room for c in writable})
    entries = f" ({'-'.join(str(room) for room in {rooms[0]: 0, rooms[-1]: 0})} entries)" if rooms else ""
    return f"{len(capabilities)}: {len(writable)} writable{entries}, {len(capabilities) - len(writable)} fixed"


# --- what follows ---------------------------------------------------------------------------------------------------


def _manual_keys(dictionary: ObjectDictionary, axis: AxisParameters, axis_map: AxisMap | None) -> tuple[ManualKey, ...]:
    knows_rated_torque = axis.rated_torque is not None or stated_value(dictionary, od.RATED_TORQUE)
    has_watchdog = standard_watchdog(dictionary, axis_map)[0] != "none"
    text = "the drive has no 0x1016, no 0x100C, and no timer of its RPDO; accept it knowingly or choose another drive"
    needs = (
        (not knows_rated_torque, "rated_torque", "torque of the axis at 1000 per mille; 0x6076 does not state it"),
        (od.RATED_TORQUE in dictionary, "transmission", "gear ratio, where 0x6076 is the motor's torque"),
        (not has_watchdog, "watchdog: false", text),
        (limit_objection(dictionary, axis), "admittance.limit_in_drive: true", "once torque_limit is set in it"),
        (axis.causality.torques, "demand_reported", "before or after: whether the TPDO shows the hold that ended"),
    )
    rows = *_KEYS, *axis.causality.by_hand
    return tuple(ManualKey(*row) for row in (*rows, *(row for is_needed, *row in needs if is_needed)))


def _load(axis_map: AxisMap, bitrate: int, rate: float) -> LoadRow:
    bus = CanBusParameters(rate=rate, bitrate=bitrate)
    one = bus_budget(bus, [axis_map])
    axes = next((n for n in range(MOST_AXES) if not bus_budget(bus, [axis_map] * (n + 1)).fits), MOST_AXES)
    return LoadRow(rate, one.periodic_load, one.worst_cycle, one.fits, axes)


_ON_LOSS: Final = (
    """NMT state after a lost master: 0 pre-operational, 1 as before, 2 stopped; 0x6007 decides on the torque"""
)


def read_objects(drive: TorqueAxis) -> Iterator[Finding]:
    """Yield a finding for each listed object that a drive has; raise SdoError where it does not answer."""
    asked = drive.axis.written_objects
    for place, meaning in {**DRIVE_OBJECTS, (od.ERROR_BEHAVIOUR, 1): _ON_LOSS}.items():
        try:
            value = drive.sdo.read(*place)
        except SdoError as error:
            if error.code is None:
                raise
            continue
        cut_off = _end_cut_off(drive, place, value)
        text = f"{value}" + (f", the start writes {asked[place]}" if place in asked else "")
        verdict = Verdict.UNKNOWN if cut_off else Verdict.FIT
        yield Finding(drive.sdo.describe(*place), verdict, f"{text}: {cut_off or meaning}")


def _end_cut_off(drive: TorqueAxis, place: tuple[int, int], value: int) -> str:
    """Return which limit of the scene a position limit of the drive cuts off; "" where it cuts none."""
    axis = drive.axis
    if place[0] != od.POSITION_LIMITS or place in axis.written_objects:
        return ""
    counts = sorted(axis.direction * end * axis.counts_per_unit for end in axis.causality.ends)
    beyond = [end for end in counts if (end < value if place[1] == 1 else end > value)]
    if not beyond or not any(drive.sdo.read(place[0], sub) for sub in (1, 2)):  # both 0: no limits
        return ""
    return f"admittance.position_low or position_high is at {beyond[0]:.0f}; widen it (drive_objects) or the scene"
