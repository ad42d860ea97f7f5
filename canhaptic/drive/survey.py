"""Judges one object dictionary before there is a configuration: fit, fit with conditions, or unfit.

`dictionary_check` judges a dictionary for a configured axis. Here nothing is configured: a value that the configuration
must supply is a condition, not a refusal. A refusal rests only on what the dictionary states.

Judgement of a dictionary for an admittance display: source of its force, and its limits.
"""

from collections.abc import Callable
from enum import Enum
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

from canopen import ObjectDictionary
from canopen.objectdictionary import ODVariable, datatypes

from canhaptic.canopen import objects as od
from canhaptic.canopen.force_node import ForceNode
from canhaptic.canopen.objects import DataType, is_writable
from canhaptic.drive.axis_parameters import AxisParameters, BusParameters
from canhaptic.drive.can.bus_budget import bus_budget
from canhaptic.drive.can.dictionary_check import check_dictionary
from canhaptic.drive.can.pdo_map import AxisMap, PdoCapability, choose_map, pdo_capabilities
from canhaptic.drive.profile.admittance_parameters import AdmittanceParameters, ForceParameters, Mode
from canhaptic.drive.profile.fitness import (
    Finding,
    ObjectUse,
    Verdict,
    limit_objection,
    listed,
    mapping_objection,
    max_torque_unwritten,
    objection,
)
from canhaptic.drive.profile.quirks import quirks_of
from canhaptic.errors import DictionaryError

_ANALOG_INPUTS: Final = ("0x3160.1", "0x2205.1", "0x2205.0", "0x207C.1")
"""Analog inputs of maxon EPOS4, Elmo Gold, ZeroErr and maxon EPOS2, as their dictionaries list them."""
_TYPES: Final = (DataType.INTEGER16, DataType.INTEGER32)
DISPLAY_KEYS: Final = (
    ("speed_limit, admittance.acceleration_limit", "largest speed and acceleration that may be commanded"),
    ("admittance.position_low, position_high", "lowest and highest position to which a command may lead"),
    ("admittance.velocity_counts", "counts of 0x60FF for 1 m/s or 1 rad/s; left out: counts of 0x6064 per second"),
    ("admittance.handle_acceleration", "largest acceleration of the handle by drive and hand: an over-estimate"),
    ("admittance.force.per_count, range, error, slew", "scale and limits of the sensor; canhaptic commission measures"),
    ("admittance.force.frozen_after", "SYNCs with one count after which the sensor counts as frozen"),
)
"""Keys of an axis that no dictionary supplies, with the reason."""
_SENSOR_NODE: Final = 9  # node ID of a sensor that is a node of its own, where the drive has no input


def _analog_input(dictionary: ObjectDictionary) -> str | None:
    """First known analog input that a TPDO of the drive can carry, as `0x3160.1`; None without one.

    The object of another make at one of these places may be another thing: it is a proposal.
    """
    for place in _ANALOG_INPUTS:
        index, _, subindex = place.partition(".")
        uses = (int(index, 16), int(subindex, 16))
        if any(mapping_objection(dictionary, "TPDO", uses[0], kind, uses[1]) is None for kind in _TYPES):
            return place
    return None


def display_of(dictionary: ObjectDictionary, mode: Mode, force_object: str | None = None) -> AdmittanceParameters:
    """Admittance display for a dictionary; its force has scale 1, and its figures are placeholders.

    Args:
        dictionary: Dictionary of the drive.
        mode: `velocity` or `position`.
        force_object: Object that shows the force; by default a known analog input of the drive, else a
            sensor with a node of its own.

    Raises:
        pydantic.ValidationError: `force_object` is no place of an object.
    """
    place = force_object or _analog_input(dictionary)
    node = ForceNode(node_id=_SENSOR_NODE) if place is None else None
    force = ForceParameters(object=place, node=node, per_count=1.0, range=1e6, slew=1.0, error=0.0)
    return AdmittanceParameters(mode=mode, handle_acceleration=1.0, force=force)


def force_finding(dictionary: ObjectDictionary, display: AdmittanceParameters) -> Finding:
    """Finding of the dictionary about the force of a display."""
    place = display.force.place
    if place is None:
        text = "no analog input is known for this drive; name one (--force-object), or give the sensor its own node"
        return Finding("force sensor", Verdict.UNKNOWN, text)
    item = f"{place[0]:#06x}:{place[1]:02x} force"
    variable = listed(dictionary, *place)
    kind = _TYPES[1] if variable is not None and variable.data_type == _TYPES[1] else _TYPES[0]
    if (refusal := mapping_objection(dictionary, "TPDO", place[0], kind, place[1])) is not None:
        return Finding(item, Verdict.REFUSED, f"{refusal}; name an INTEGER16 or INTEGER32 that a TPDO can carry")
    return Finding(
        item, Verdict.UNKNOWN, "in the TPDO with the position: one SYNC for both; confirm that it is an input"
    )


def limit_findings(dictionary: ObjectDictionary) -> list[Finding]:
    """Limits in the drive in case a display's sensor or master is wrong, and objects that may alter its command."""
    found = []
    ramps = [index for index in (od.PROFILE_ACCELERATION, od.MAX_ACCELERATION) if listed(dictionary, index) is not None]
    stuck = [index for index in ramps if not is_writable(dictionary, index, 0)]
    listing = ", ".join(f"{index:#06x}" for index in stuck or ramps)
    if stuck:
        text = "read-only: no certificate covers a ramp inside the drive; set it with the vendor's tool"
        found.append(Finding(f"{listing} ramps", Verdict.UNKNOWN, text))
    elif ramps:
        found.append(Finding(f"{listing} ramps", Verdict.FIT, "written as steep as they go"))
    if is_writable(dictionary, od.QUICK_STOP_OPTION, 0):
        found.append(Finding("0x605a quick stop option", Verdict.FIT, "written: brakes along its ramp, then disabled"))
    else:
        text = "not writable: set it with the vendor's tool so that a quick stop brakes (2)"
        found.append(Finding("0x605a quick stop option", Verdict.UNKNOWN, text))
    return found


RATES: Final = (100.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0)
"""Rates of SYNC for which the bus load is computed [Hz]."""
MOST_AXES: Final = 16
"""Largest number of axes for which the bus load is computed."""
_BUS: Final = BusParameters(rate=1000.0)  # of values that depend on it: the defaults
_SHOWN_IF_REFUSED: Final = ("0x1006", "0x60b0", "0x60b1", "0x60b2", "0x60c2", "0x6074", "0x6077")
_INTEGER_NAMES: Final = {
    datatypes.BOOLEAN: "BOOLEAN",
    datatypes.INTEGER8: "INTEGER8",
    datatypes.INTEGER16: "INTEGER16",
    datatypes.INTEGER32: "INTEGER32",
    datatypes.UNSIGNED8: "UNSIGNED8",
    datatypes.UNSIGNED16: "UNSIGNED16",
    datatypes.UNSIGNED32: "UNSIGNED32",
}

Group = Literal["identity", "torque", "motion", "read-back", "force", "limits", "resolution", "watchdog", "PDO"]


class Suitability(Enum):
    """Verdict on a drive, from only its dictionary."""

    FIT = "fit"
    CONDITIONAL = "fit with conditions"
    UNFIT = "unfit"


class SurveyRow(NamedTuple):
    """One object or part of a dictionary."""

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
    """Findings of one dictionary."""

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
    def path(self) -> Path:
        """Path of the dictionary."""
        return self.axis.eds

    @property
    def reasons(self) -> list[SurveyRow]:
        """Reasons for rejecting the drive."""
        return [row for row in self.rows if row.verdict is Verdict.REFUSED]

    @property
    def conditions(self) -> list[SurveyRow]:
        """Settings to configure, and those that are decided by the drive at the start."""
        return [row for row in self.rows if row.verdict is Verdict.UNKNOWN]

    @property
    def suitability(self) -> Suitability:
        """The verdict."""
        if self.reasons:
            return Suitability.UNFIT
        return Suitability.CONDITIONAL if self.conditions else Suitability.FIT


def survey(dictionary: ObjectDictionary, axis: AxisParameters) -> Survey:
    """Findings of a dictionary.

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
    rows = (
        *_identity(dictionary, findings),
        *_command(dictionary, axis, findings),
        *_measured(dictionary, axis, axis_map),
        *_limits(dictionary, axis, findings),
        *_resolution(dictionary),
        *_watchdog(dictionary, findings),
        *(_as_found(dictionary, "limits", f) for place, f in findings.items() if place[:6] in _SHOWN_IF_REFUSED),
        *_pdos(dictionary, findings),
    )
    return Survey(
        dictionary,
        axis,
        device.vendor_name or "",
        device.product_name or "",
        stated_value(dictionary, od.IDENTITY, 1) or device.vendor_number,
        stated_value(dictionary, od.IDENTITY, 2) or device.product_number,
        bitrates,
        rows,
        _manual_keys(dictionary, axis),
        axis_map,
        bitrate,
        () if axis_map is None else tuple(_load(axis_map, bitrate, rate) for rate in RATES),
    )


def unconfigured_axis(eds: str | Path, **values: Any) -> AxisParameters:
    """Axis with a dictionary and perhaps a profile; node ID, scale and limit are placeholders of 1."""
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
    """Return `UNSIGNED16 rw, default 1000, mappable`."""
    variable = _variable(dictionary, index, subindex)
    if variable is None:
        return "not listed"
    parts = [f"{_type_name(variable.data_type)} {variable.access_type}"]
    if isinstance(variable.value, int):
        parts.append(f"value {_number(index, variable.value)}")
    elif isinstance(variable.default, int):
        parts.append(f"default {_number(index, variable.default)}")
    if variable.pdo_mappable:
        parts.append("mappable")
    return ", ".join(parts)


def _type_name(data_type: int | None) -> str:
    return "no type" if data_type is None else _INTEGER_NAMES.get(data_type, f"type {data_type:#06x}")


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
        is_right = _is_right(index, saved, mode)
        verdict = Verdict.FIT if is_right else Verdict.UNKNOWN
        text = f"{saved:#x} when this file was saved, {'as needed' if is_right else 'not fit'}; the drive is asked"
    return SurveyRow(group, finding.item, _describe(dictionary, index), verdict, text)


def _is_right(index: int, saved: int, mode: int) -> bool:
    """Whether a value that a DCF saved is as needed; `mode` is the axis's."""
    if index == od.SUPPORTED_DRIVE_MODES:
        return bool(saved >> mode - 1 & 1)
    return index != od.DEVICE_TYPE or saved & 0xFFFF == od.CIA402_PROFILE


def _as_found(dictionary: ObjectDictionary, group: Group, finding: Finding) -> SurveyRow:
    """Return the row of a finding as it is: a saved value does not change it."""
    return SurveyRow(
        group, finding.item, _describe(dictionary, int(finding.item[:6], 16)), finding.verdict, finding.text
    )


# --- the groups ---------------------------------------------------------------------------------------------------


def _identity(dictionary: ObjectDictionary, findings: dict[str, Finding]) -> list[SurveyRow]:
    return [
        _judged(dictionary, "identity", findings["0x1000"]),
        _row(dictionary, "identity", "vendor ID", od.IDENTITY, Verdict.FIT, "compared when vendor_id is set", 1),
        _row(dictionary, "identity", "product code", od.IDENTITY, Verdict.FIT, "compared when product_code is set", 2),
    ]


def _command(dictionary: ObjectDictionary, axis: AxisParameters, findings: dict[str, Finding]) -> list[SurveyRow]:
    group: Group = "torque" if axis.admittance is None else "motion"
    places = ("0x6040", "0x6041", f"{axis.target:#06x}", "0x6064", "0x6502", "0x6060", "0x6061")
    return [_judged(dictionary, group, findings[place], axis.mode_code) for place in places]


def _measured(dictionary: ObjectDictionary, axis: AxisParameters, axis_map: AxisMap | None) -> list[SurveyRow]:
    """Return the torque read back, or the force and the limits of an admittance display."""
    display = axis.admittance
    if display is None:
        return [_read_back(dictionary, axis_map)]
    force, place = force_finding(dictionary, display), display.force.place
    stated = "a node of its own" if place is None else _describe(dictionary, *place)
    limits = [_as_found(dictionary, "limits", finding) for finding in limit_findings(dictionary)]
    return [SurveyRow("force", force.item, stated, force.verdict, force.text), *limits]


def _read_back(dictionary: ObjectDictionary, axis_map: AxisMap | None) -> SurveyRow:
    stated = f"0x6074 {_describe(dictionary, od.TORQUE_DEMAND)}; 0x6077 {_describe(dictionary, od.TORQUE_ACTUAL)}"
    texts = {
        "demand": (Verdict.FIT, "0x6074 in the TPDO: the energy of every hold is exact"),
        "actual": (
            Verdict.UNKNOWN,
            "0x6077 in the TPDO: a measured torque at one instant of the hold; its difference from the torque that "
            "was sent bounds the error of the energy",
        ),
        "none": (Verdict.UNKNOWN, "no torque can be mapped: the energy is computed from the torque sent"),
    }
    if axis_map is None:
        return SurveyRow("read-back", "torque read back", stated, Verdict.FIT, "no map was found, see below")
    return SurveyRow("read-back", "torque read back", stated, *texts[axis_map.read_back])


def _limits(dictionary: ObjectDictionary, axis: AxisParameters, findings: dict[str, Finding]) -> list[SurveyRow]:
    limit, rated = _variable(dictionary, od.MAX_TORQUE), _variable(dictionary, od.RATED_TORQUE)
    quirks, state = quirks_of(axis.quirks), max_torque_unwritten(dictionary, axis)
    if limit is None or state:
        text = f"{state}; torque_limit is kept by the master alone: set a limit in the drive with the vendor's tool"
        text = limit_objection(dictionary, axis) or text
        rows = [_row(dictionary, "limits", "max torque", od.MAX_TORQUE, Verdict.UNKNOWN, text)]
    elif (refusal := findings["0x6072"]).verdict is Verdict.REFUSED:
        rows = [_as_found(dictionary, "limits", refusal)]
    elif limit.min:
        text = f"at least {limit.min} per mille: torque_limit is at least {limit.min / 1000:g} of the rated torque"
        rows = [_row(dictionary, "limits", "max torque", od.MAX_TORQUE, Verdict.UNKNOWN, text)]
    else:
        text = "written from torque_limit and read back"
        rows = [_row(dictionary, "limits", "max torque", od.MAX_TORQUE, Verdict.FIT, text)]
    value = stated_value(dictionary, od.RATED_TORQUE)
    if rated is not None and findings["0x6076"].verdict is Verdict.REFUSED:
        verdict, text = Verdict.REFUSED, findings["0x6076"].text
    elif axis.rated_torque is not None:
        verdict, text = Verdict.FIT, f"{axis.rated_torque:g} from the configuration"
    elif rated is None or not quirks.reads_rated_torque:
        verdict, text = Verdict.UNKNOWN, "not listed; rated_torque must be set"
    elif not value:
        verdict, text = Verdict.UNKNOWN, "no value; read from the drive, and rated_torque must be set if that is 0"
    else:
        verdict, text = Verdict.FIT, "read from the drive; its live value counts"
    rows.append(_row(dictionary, "limits", "motor rated torque", od.RATED_TORQUE, verdict, text))
    rows.append(
        _row(dictionary, "limits", "motor rated current", od.RATED_CURRENT, Verdict.FIT, "for information; not used")
    )
    return rows


def _resolution(dictionary: ObjectDictionary) -> list[SurveyRow]:
    encoder = "for orientation; counts_per_unit is the configuration's, confirmed by hand motion"
    gear = "for orientation; the gear belongs in counts_per_unit and transmission"
    return [
        _row(dictionary, "resolution", "encoder increments", od.ENCODER_RESOLUTION, Verdict.FIT, encoder, 1),
        _row(dictionary, "resolution", "gear, motor revolutions", od.GEAR_RATIO, Verdict.FIT, gear, 1),
    ]


def _watchdog(dictionary: ObjectDictionary, findings: dict[str, Finding]) -> list[SurveyRow]:
    rows = [_judged(dictionary, "watchdog", findings["0x1017"])]
    refused = objection(dictionary, ObjectUse(od.CONSUMER_HEARTBEAT_TIME, 1, reads=True, writes=True))
    if refused is not None:
        state = "not listed" if refused == "missing" else refused
        text = f"{state}: the drive cannot notice a killed master; only watchdog: false continues, at your own risk"
        verdict = Verdict.UNKNOWN
    else:
        verdict, text = Verdict.FIT, "armed at the start: the drive notices a killed master"
    rows.append(_row(dictionary, "watchdog", "consumer heartbeat time", od.CONSUMER_HEARTBEAT_TIME, verdict, text, 1))
    rows.append(_as_found(dictionary, "watchdog", findings["0x6007"]))
    return rows


def _pdos(dictionary: ObjectDictionary, findings: dict[str, Finding]) -> list[SurveyRow]:
    rows = []
    kinds: tuple[Literal["RPDO", "TPDO"], ...] = ("RPDO", "TPDO")
    for kind in kinds:
        capabilities = pdo_capabilities(dictionary, kind)
        verdict = Verdict.FIT if capabilities else Verdict.REFUSED
        text = "" if capabilities else f"the dictionary describes no {kind}"
        rows.append(SurveyRow("PDO", f"{kind}s", _counted(capabilities), verdict, text))
    finding = findings["PDO"]
    rows.append(SurveyRow("PDO", "map", "", finding.verdict, finding.text))
    return rows


def _counted(capabilities: list[PdoCapability]) -> str:
    """Return `25: 1 writable (8 entries), 24 fixed`."""
    if not capabilities:
        return "none"
    writable = [c for c in capabilities if c.fixed is None]
    rooms = sorted({c.room for c in writable})
    entries = f" ({'-'.join(str(room) for room in {rooms[0]: 0, rooms[-1]: 0})} entries)" if rooms else ""
    return f"{len(capabilities)}: {len(writable)} writable{entries}, {len(capabilities) - len(writable)} fixed"


# --- what follows ---------------------------------------------------------------------------------------------------


def _manual_keys(dictionary: ObjectDictionary, axis: AxisParameters) -> tuple[ManualKey, ...]:
    keys = [
        ManualKey("node_id", "as set in the drive"),
        ManualKey("unit, counts_per_unit", "position counts (0x6064) per radian or metre of the axis, gear included"),
        ManualKey("torque_limit", "the largest torque that may ever reach the hand"),
        ManualKey("direction", "-1 if drive and axis have opposite positive directions"),
    ]
    needs: tuple[tuple[str, str, Callable[[], bool]], ...] = (
        (
            "rated_torque",
            "torque of the axis at 1000 per mille; 0x6076 does not state it",
            lambda: axis.rated_torque is None and not stated_value(dictionary, od.RATED_TORQUE),
        ),
        ("transmission", "gear ratio, where 0x6076 is the motor's torque", lambda: od.RATED_TORQUE in dictionary),
        (
            "watchdog: false",
            "the drive has no 0x1016; accept it knowingly or choose another drive",
            lambda: not is_writable(dictionary, od.CONSUMER_HEARTBEAT_TIME, 1),
        ),
        (
            "admittance.limit_in_drive: true",
            "once torque_limit is set in it",
            lambda: bool(limit_objection(dictionary, axis)),
        ),
        (
            "demand_reported",
            "before or after: whether the TPDO shows the hold that ended",
            lambda: axis.admittance is None,
        ),
    )
    keys += [] if axis.admittance is None else [ManualKey(*row) for row in DISPLAY_KEYS]
    return (*keys, *(ManualKey(key, reason) for key, reason, needed in needs if needed()))


def _load(axis_map: AxisMap, bitrate: int, rate: float) -> LoadRow:
    bus = BusParameters(rate=rate, bitrate=bitrate)
    one = bus_budget(bus, [axis_map])
    axes = 0
    while axes < MOST_AXES and bus_budget(bus, [axis_map] * (axes + 1)).fits:
        axes += 1
    return LoadRow(rate, one.periodic_load, one.worst_cycle, one.fits, axes)
