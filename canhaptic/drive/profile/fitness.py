"""Whether an object dictionary is fit for cyclic torque, judged before any drive is asked.

A refusal rests only on what the dictionary states. An object listed without a default, and a rated torque of 0, are
`unknown`: the live value decides at the start.

Of each object that start and cycle use, type, access, limits and mapping are checked.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from math import inf
from typing import Final, Literal, NamedTuple

from canhaptic.canopen import objects as od
from canhaptic.canopen.objects import DataType, Dictionary, Variable, is_writable, without_flags
from canhaptic.drive.profile.causality import RAMPS
from canhaptic.drive.profile.quirks import quirks_of
from canhaptic.drive.profile.scaling import axis_scaling, torque_limit_per_mille
from canhaptic.drive.profile.torque_axis_parameters import TorqueAxisParameters
from canhaptic.errors import DictionaryError

_INTEGERS: Final = {  # bits, signed
    DataType.BOOLEAN: (1, False),
    **{DataType[f"INTEGER{bits}"]: (bits, True) for bits in range(8, 65, 8)},
    **{DataType[f"UNSIGNED{bits}"]: (bits, False) for bits in range(8, 65, 8)},
}


@dataclass(frozen=True, slots=True)
class ObjectUse:
    """Use of an object by the start or the cycle."""

    index: int
    subindex: int = 0
    data_type: DataType | None = None  # None: any integer that holds the values
    reads: bool = False  # by SDO
    writes: bool = False  # by SDO
    values: tuple[int, ...] = ()  # that are written


def listed(dictionary: Dictionary, index: int, subindex: int = 0) -> Variable | None:
    """Return an object of exactly this index and subindex, or None: a VAR has no subindex but 0."""
    variable = dictionary.get_variable(index, subindex)
    return variable if variable is not None and variable.subindex == subindex else None


def objection(dictionary: Dictionary, use: ObjectUse) -> str | None:
    """Return why an object of the dictionary is unfit for its use, with the expected value; None if it is fit."""
    variable = listed(dictionary, use.index, use.subindex)
    if variable is None:
        return "missing"
    return (
        _of_type(variable, use.data_type)
        or ("write-only, but it must be read" if use.reads and not variable.readable else None)
        or (f"{variable.access_type}, but it must be written" if use.writes and not variable.writable else None)
        or next((text for value in use.values if (text := _of_value(variable, value))), None)
    )


def _of_type(variable: Variable, expected: DataType | None) -> str | None:
    if expected is not None and variable.data_type != expected:
        return f"of type {_type_name(variable.data_type)}, expected {expected.name}"
    return None if variable.data_type in _INTEGERS else f"of type {_type_name(variable.data_type)}, expected an integer"


def range_objection(variable: Variable, value: int) -> str | None:
    """Return why the type of an integer object cannot hold a value; None where it can."""
    low, high = _type_range(variable)
    return None if low <= value <= high else f"limited to {low}..{high} by its type, which leaves out {value}"


def _of_value(variable: Variable, value: int) -> str | None:
    low, high = _type_range(variable)
    low = low if variable.min is None else max(low, variable.min)
    high = high if variable.max is None else min(high, variable.max)
    plain = without_flags(variable.index, variable.subindex, value)
    if plain != value and value.bit_length() > _INTEGERS[DataType(variable.data_type or 0)][0]:  # flags have bits too
        return f"of type {_type_name(variable.data_type)}, which cannot hold {value:#x}"
    return None if low <= plain <= high else f"limited to {low}..{high}, but the scene needs {plain}"


def _type_range(variable: Variable) -> tuple[int, int]:
    bits, is_signed = _INTEGERS[DataType(variable.data_type or 0)]
    return (-(1 << bits - 1), (1 << bits - 1) - 1) if is_signed else (0, (1 << bits) - 1)


def _type_name(data_type: int | None) -> str:
    if data_type is None:
        return "none"
    return DataType(data_type).name if data_type in DataType.__members__.values() else f"{data_type:#06x}"


def force_object(dictionary: Dictionary, axis: TorqueAxisParameters) -> tuple[int, int, DataType] | None:
    """Return index, subindex and type of the object that shows the force of a display; None for a sensor of its own.

    Raises:
        DictionaryError: The dictionary does not list it as INTEGER16 or INTEGER32.
    """
    if (place := axis.causality.force.place) is None:
        return None
    variable = listed(dictionary, *place)
    kind = getattr(variable, "data_type", None)
    if kind not in (DataType.INTEGER16, DataType.INTEGER32):
        seen = f"admittance.force.object {place[0]:#06x}.{place[1]:x} is not "
        seen += "in the dictionary" if variable is None else "INTEGER16 or INTEGER32"
        raise DictionaryError(
            f"{axis.name}: {axis.dictionary_path}: {seen}; set admittance.force.object to the object of the drive that "
            "holds the force"
        )
    return *place, DataType(kind)


def mapping_objection(
    dictionary: Dictionary, kind: Literal["RPDO", "TPDO"], index: int, data_type: DataType, subindex: int = 0
) -> str | None:
    """Return why an object cannot be mapped into a PDO whose mapping is configurable; None where it can."""
    variable = listed(dictionary, index, subindex)
    if variable is None:
        return "missing"
    if (text := _of_type(variable, data_type)) is not None:
        return text
    if not variable.pdo_mappable:
        return "not mappable (PDOMapping)"
    is_allowed = variable.access_type in (("rw", "rww", "wo") if kind == "RPDO" else ("ro", "rw", "rwr", "const"))
    return None if is_allowed else f"{variable.access_type}, which no {kind} can carry"


_CORRECT: Final = "correct the dictionary if the drive can"
_ALWAYS_USED: Final = (
    (ObjectUse(od.CONTROLWORD, 0, DataType.UNSIGNED16, writes=True, values=(0x00, 0x0F)), "controlword"),
    (ObjectUse(od.STATUSWORD, 0, DataType.UNSIGNED16, reads=True), "statusword"),
    (ObjectUse(od.POSITION_ACTUAL, 0, DataType.INTEGER32, reads=True), "position"),
    (ObjectUse(od.MODES_OF_OPERATION_DISPLAY, 0, DataType.INTEGER8, reads=True), "modes of operation display"),
)
MODES: Final = {
    od.CYCLIC_SYNC_POSITION: "position",
    od.CYCLIC_SYNC_VELOCITY: "velocity",
    od.CYCLIC_SYNC_TORQUE: "torque",
}


class Verdict(Enum):
    """Whether a finding permits cyclic torque, refuses it, or leaves it to the live value."""

    FIT = "fit"
    UNKNOWN = "unknown"
    REFUSED = "refused"


class Finding(NamedTuple):
    """Verdict on one statement of a dictionary."""

    item: str  # object or part, as `0x6502 supported drive modes`
    verdict: Verdict
    text: str  # value seen, value expected, what to do


def profile_findings(
    dictionary: Dictionary, axis: TorqueAxisParameters, sample_time_ns: int | None = None
) -> list[Finding]:
    """Return the findings on the CiA 402 objects of a dictionary: its fitness for cyclic torque.

    Args:
        dictionary: Dictionary of the drive.
        axis: Parameters of the axis.
        sample_time_ns: Sample time of the cycle [ns]; None if unknown.
    """
    mode = ObjectUse(od.MODES_OF_OPERATION, 0, DataType.INTEGER8, writes=True, values=(axis.causality.mode_code,))
    findings = [
        _device_type(dictionary),
        _target(dictionary, axis),
        *(_used(dictionary, use, name) for use, name in (*_ALWAYS_USED, (mode, "modes of operation"))),
        _drive_modes(dictionary, axis),
        _rated_torque(dictionary, axis),
        _max_torque(dictionary, axis),
        _abort_option(dictionary, axis),
    ]
    optional = (
        *_read_back(dictionary, axis),
        *_offsets(dictionary, axis),
        *_ramps(dictionary, axis),
        *_interpolation(dictionary, axis, sample_time_ns),
        *_drive_objects(dictionary, axis),
    )
    return findings + [finding for finding in optional if finding.verdict is Verdict.REFUSED]


def agreed_rated_torque(axis: TorqueAxisParameters, counts: int | None, resolution: float = 1e-3) -> float:
    """Return the rated torque of the axis [N*m or N] on which drive and configuration agree.

    Args:
        axis: Parameters of the axis, which may state `rated_torque`.
        counts: 0x6076 of the motor; None or 0 when the drive does not know it.
        resolution: Newton metres (or newtons) per count of 0x6076.

    Raises:
        DictionaryError: Neither knows it, or they disagree.
    """
    if not counts:
        if axis.rated_torque is None:
            seen = "is 0" if counts == 0 else "is not stated"
            text = f"0x6076 {seen} by the drive and the configuration has none"
            remedy = "set rated_torque (torque of the axis at 1000 per mille)"
            raise DictionaryError(f"{axis.name}: rated torque: {text}; {remedy}")
        return axis.rated_torque
    stated = counts * resolution * axis.transmission
    configured = axis.rated_torque
    if configured is not None and abs(configured - stated) > 1e-3 * stated:  # more than rounding
        text = f"the drive states 0x6076 = {counts}, which is {stated:g} with transmission {axis.transmission:g}"
        text = f"{axis.name}: rated_torque: got {configured:g}, but {text}"
        raise DictionaryError(f"{text}; correct one of them or leave rated_torque out")
    return stated


def stated_default(dictionary: Dictionary, index: int, subindex: int = 0) -> int | None:
    """Return the number that a dictionary states as the default of an object; None where it states none."""
    variable = dictionary.get_variable(index, subindex)
    default = None if variable is None else variable.default
    return default if isinstance(default, int) else None


def judged(dictionary: Dictionary, item: str, use: ObjectUse, hint: str, fit: str = "listed") -> Finding:
    """Return the finding of a use: fit, or the objection with a hint."""
    text = objection(dictionary, use)
    return Finding(item, Verdict.FIT, fit) if text is None else Finding(item, Verdict.REFUSED, f"{text}; {hint}")


def _used(dictionary: Dictionary, use: ObjectUse, name: str) -> Finding:
    """Finding of an object that every start and cycle uses."""
    is_listed = listed(dictionary, use.index, use.subindex) is not None
    hint = _CORRECT if is_listed else "this drive cannot be used without it"
    return judged(dictionary, f"{use.index:#06x} {name}", use, hint)


def _target(dictionary: Dictionary, axis: TorqueAxisParameters) -> Finding:
    of, limit = axis.causality, _max_torque_value(axis) or 0
    use = ObjectUse(
        of.target, 0, of.target_type, reads=True, writes=True, values=tuple(limit * sign for sign in of.extremes)
    )
    return _used(dictionary, use, f"target {MODES[of.mode_code]}")


def _read_back(dictionary: Dictionary, axis: TorqueAxisParameters) -> Iterator[Finding]:
    """Yield findings on the torques that could be read back; their type may not be that of CiA 402."""
    for index, name in axis.causality.torques:
        if index in dictionary:
            yield _used(dictionary, ObjectUse(index, 0, DataType.INTEGER16), name)


def _device_type(dictionary: Dictionary) -> Finding:
    stated = stated_default(dictionary, od.DEVICE_TYPE)
    item, use = "0x1000 device type", ObjectUse(od.DEVICE_TYPE, 0, DataType.UNSIGNED32, reads=True)
    if (found := judged(dictionary, item, use, _CORRECT)).verdict is Verdict.REFUSED:
        return found
    if stated is None:
        return Finding(item, Verdict.UNKNOWN, "not stated; read from the drive")
    if stated & 0xFFFF != od.CIA402_PROFILE:
        return Finding(item, Verdict.REFUSED, f"got {stated:#010x}, expected the low word 0x0192 of a CiA 402 drive")
    return Finding(item, Verdict.FIT, f"{stated:#010x}, a CiA 402 drive")


def _drive_modes(dictionary: Dictionary, axis: TorqueAxisParameters) -> Finding:
    stated = stated_default(dictionary, od.SUPPORTED_DRIVE_MODES)
    item = "0x6502 supported drive modes"
    use = ObjectUse(od.SUPPORTED_DRIVE_MODES, 0, DataType.UNSIGNED32, reads=True)
    found = judged(dictionary, item, use, _CORRECT)
    if od.SUPPORTED_DRIVE_MODES in dictionary and found.verdict is Verdict.REFUSED:
        return found
    if stated is None:
        text = f"not stated; read from the drive, and 0x6061 must confirm mode {axis.causality.mode_code}"
        return Finding(item, Verdict.UNKNOWN, text)
    bit, name = axis.causality.mode_code - 1, MODES[axis.causality.mode_code]
    if not stated >> bit & 1:
        return Finding(item, Verdict.REFUSED, f"got {stated:#06x}, expected bit {bit} (cyclic synchronous {name}) set")
    return Finding(item, Verdict.FIT, f"{stated:#06x}, bit {bit} is set")


def _rated_torque(dictionary: Dictionary, axis: TorqueAxisParameters) -> Finding:
    item = "0x6076 rated torque"
    stated = stated_default(dictionary, od.RATED_TORQUE)
    if not quirks_of(axis.quirks).reads_rated_torque:
        if axis.rated_torque is not None:
            return Finding(item, Verdict.UNKNOWN, f"{axis.rated_torque:g} from the configuration alone (quirks)")
        return Finding(item, Verdict.REFUSED, "not read (quirks), and the configuration has no rated_torque; set it")
    if od.RATED_TORQUE in dictionary and (text := _rated_torque_objection(dictionary, axis)) is not None:
        return Finding(item, Verdict.REFUSED, f"{text}; {_CORRECT}, or quirks: [rated_torque_absent]")
    if axis.rated_torque is not None:
        above = f"; torque_limit {axis.torque_limit:g} is above it, both at the axis (the motor's times the gear)"
        is_above = axis.admittance is None and axis.torque_limit > axis.rated_torque
        text = f"{axis.rated_torque:g} from the configuration, compared with the drive{above * is_above}"
        return Finding(item, Verdict.FIT, text)
    if od.RATED_TORQUE not in dictionary:
        return Finding(item, Verdict.REFUSED, "missing, and the configuration has no rated_torque; set it")
    seen = f"{stated} mN*m by default; the live value counts"
    return Finding(item, Verdict.UNKNOWN, seen if stated else "not stated; read from the drive, or set rated_torque")


def _max_torque(dictionary: Dictionary, axis: TorqueAxisParameters) -> Finding:
    item = "0x6072 max torque"
    if state := max_torque_unwritten(dictionary, axis):
        keeper = "the drive itself (limit_in_drive)" if axis.causality.limit_in_drive else "the master alone"
        kept = f"{state}; {keeper} keeps {axis.torque_limit:g}"
        return Finding(item, Verdict.UNKNOWN, limit_objection(dictionary, axis) or kept)
    limit, asked = _max_torque_value(axis), f"torque_limit {axis.torque_limit:g}"
    limit = limit if limit is None else written_max_torque(dictionary, axis, limit)
    use = ObjectUse(od.MAX_TORQUE, reads=True, writes=True, values=() if limit is None else (limit,))
    if (text := objection(dictionary, use)) is not None:
        hint = f"{_CORRECT}, choose another torque_limit, or quirks: [max_torque_absent]"
        return Finding(item, Verdict.REFUSED, f"{text} for {asked}; {hint}")
    return Finding(item, Verdict.FIT, f"written from {asked}")


def written_max_torque(dictionary: Dictionary, axis: TorqueAxisParameters, limit: int) -> int:
    """Return the value of 0x6072 for a limit: the drive's least where the master may keep a smaller one alone."""
    least = getattr(dictionary.get_variable(od.MAX_TORQUE), "min", None)
    return max(limit, least) if axis.limit_by_master and isinstance(least, int) else limit


def largest_value(dictionary: Dictionary, index: int) -> int:
    """Return the largest value that the dictionary allows an object."""
    stated = getattr(dictionary.get_variable(index), "max", None)
    return stated if isinstance(stated, int) else 0xFFFF_FFFF  # of an UNSIGNED32


def steepest_ramp(dictionary: Dictionary) -> float:
    """Return the steepest ramp that every ramp object of a drive allows [counts/s^2]; infinite without ramps."""
    return min((largest_value(dictionary, index) for index in RAMPS if is_writable(dictionary, index, 0)), default=inf)


def _drive_objects(dictionary: Dictionary, axis: TorqueAxisParameters) -> Iterator[Finding]:
    written = axis.written_objects.items()
    uses = [ObjectUse(*place, reads=True, writes=True, values=(value,)) for place, value in written]
    if axis.brake is not None and axis.brake.output is not None:
        uses.append(ObjectUse(od.DIGITAL_OUTPUTS, 1, DataType.UNSIGNED32, reads=True, writes=True))
    for use in uses:
        yield judged(dictionary, f"{use.index:#06x}:{use.subindex:02x}", use, "correct drive_objects, or brake")


def _ramps(dictionary: Dictionary, axis: TorqueAxisParameters) -> list[Finding]:
    """Return a refusal where ramps in the drive alter the velocities that may be commanded."""
    mode = axis.causality
    if mode.followed_acceleration is None:
        return []
    asked = (value or inf for (index, _), value in axis.written_objects.items() if index in RAMPS)  # 0 limits nothing
    steepest = min([steepest_ramp(dictionary), *asked]) / abs(mode.velocity_counts or axis.counts_per_unit)
    if steepest >= mode.followed_acceleration:
        return []
    unit = f"{axis.unit}/s^2"
    text = f"take {steepest:.3g} {unit} at most, expected admittance.acceleration_limit {mode.followed_acceleration:g}"
    hint = "no certificate covers a ramp inside the drive; lower acceleration_limit"
    return [Finding("0x60c5 ramps", Verdict.REFUSED, f"{text} {unit}; {hint}, or correct the limits in the dictionary")]


def max_torque_unwritten(dictionary: Dictionary, axis: TorqueAxisParameters) -> str:
    """Return why the start writes no limit to 0x6072; "" where it does."""
    variable = dictionary.get_variable(od.MAX_TORQUE, 0)
    if variable is None:
        return "not listed"
    if not quirks_of(axis.quirks).writes_max_torque:
        return "not written (quirks)"
    return "" if variable.writable else "read-only"


def limit_objection(dictionary: Dictionary, axis: TorqueAxisParameters) -> str:
    """Return why nothing in the drive limits the torque of an admittance display, with the remedy; "" otherwise."""
    state = max_torque_unwritten(dictionary, axis)
    if not state or axis.causality.limit_in_drive or not axis.causality.needs_limit:
        return ""
    remedy = "set torque_limit in the drive with the vendor's tool and say so with admittance.limit_in_drive: true"
    return f"{state}; {remedy}; an admittance display on a real interface is refused without it"


def _max_torque_value(axis: TorqueAxisParameters) -> int | None:
    """Value of 0x6072; None without a rated torque."""
    rated = axis.rated_torque
    return None if rated is None else torque_limit_per_mille(axis.torque_limit, axis_scaling(axis, rated).rated_torque)


def _rated_torque_objection(dictionary: Dictionary, axis: TorqueAxisParameters) -> str | None:
    """Return why 0x6076 cannot be read, or its type cannot hold the configured value; None if both are possible."""
    variable = listed(dictionary, od.RATED_TORQUE)
    text = objection(dictionary, ObjectUse(od.RATED_TORQUE, reads=True))
    if text is not None or variable is None or axis.rated_torque is None:
        return text
    resolution = quirks_of(axis.quirks).rated_torque_resolution
    return range_objection(variable, round(axis.rated_torque / axis.transmission / resolution))


def _abort_option(dictionary: Dictionary, axis: TorqueAxisParameters) -> Finding:
    item = "0x6007 abort connection option"
    variable = listed(dictionary, od.ABORT_CONNECTION_OPTION)
    if variable is None or not variable.writable:
        state = "not listed" if variable is None else "read-only"
        text = f"{state}: what a lost master does is set with the vendor's tool; it must end in zero torque"
        return Finding(item, Verdict.UNKNOWN, text)
    option = quirks_of(axis.quirks).abort_connection_option
    use = ObjectUse(od.ABORT_CONNECTION_OPTION, reads=True, writes=True, values=(option,))
    fit = f"written: a lost master is a fault ({option})" if option == 1 else "written"
    found = judged(dictionary, item, use, f"{_CORRECT}, or see the quirks abort_...", fit)
    return found if axis.watchdog else Finding(item, Verdict.FIT, fit)


def _offsets(dictionary: Dictionary, axis: TorqueAxisParameters) -> Iterator[Finding]:
    for index in axis.causality.offsets:
        if index in dictionary:
            use = ObjectUse(index, reads=True, writes=is_writable(dictionary, index, 0), values=(0,))
            yield judged(dictionary, f"{index:#06x} offset", use, _CORRECT)


def _interpolation(dictionary: Dictionary, axis: TorqueAxisParameters, sample_time_ns: int | None) -> Iterator[Finding]:
    """Yield findings on both parts of 0x60C2, which is optional."""
    place = od.INTERPOLATION_PERIOD
    if not quirks_of(axis.quirks).writes_interpolation_period or not is_writable(dictionary, place, 1):
        return
    period = None if sample_time_ns is None else decimal_period(sample_time_ns)
    value, exponent = ((), (-3,)) if period is None else ((period[0],), (period[1],))  # without a period milliseconds
    uses = [ObjectUse(place, 1, reads=True, values=value)]
    if is_writable(dictionary, place, 2):
        uses.append(ObjectUse(place, 2, reads=True, values=exponent))
    for use in uses:
        item, hint = f"{place:#06x}:{use.subindex:02x} interpolation period", f"{_CORRECT}, or quirks: "
        yield judged(dictionary, item, use, f"{hint}[no_interpolation_period]")


def decimal_period(sample_time_ns: int) -> tuple[int, int] | None:
    """Return (value, exponent) of 0x60C2 for a sample time; None if no value of one byte has it exactly."""
    for exponent in (-3, -4, -5, -6):  # some drives take milliseconds alone
        value, rest = divmod(sample_time_ns, 10 ** (9 + exponent))
        if rest == 0 and 1 <= value <= 255:
            return value, exponent
    return None
