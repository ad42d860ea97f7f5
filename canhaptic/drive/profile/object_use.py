"""Check of a dictionary for the use of an object by start and cycle: type, access, limits, mapping."""

from dataclasses import dataclass
from typing import Final, Literal

from canhaptic.canopen.dictionary import Dictionary, Variable
from canhaptic.canopen.objects import DataType

_INTEGERS: Final = {  # bits, signed
    DataType.BOOLEAN: (1, False),
    **{DataType[f"INTEGER{bits}"]: (bits, True) for bits in range(8, 65, 8)},
    **{DataType[f"UNSIGNED{bits}"]: (bits, False) for bits in range(8, 65, 8)},
}
_MAPPABLE_ACCESS: Final = {"RPDO": ("rw", "rww", "wo"), "TPDO": ("ro", "rw", "rwr", "const")}


@dataclass(frozen=True, slots=True)
class ObjectUse:
    """One use of an object."""

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
    """Reason why the dictionary does not allow a use, with the expected value; None where it allows it."""
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
    return None if low <= value <= high else f"limited to {low}..{high}, but {value} is to be written"


def _type_range(variable: Variable) -> tuple[int, int]:
    bits, is_signed = _INTEGERS[DataType(variable.data_type or 0)]
    if variable.data_type == DataType.BOOLEAN:
        return 0, 1
    return (-(1 << bits - 1), (1 << bits - 1) - 1) if is_signed else (0, (1 << bits) - 1)


def _type_name(data_type: int | None) -> str:
    if data_type is None:
        return "none"
    return DataType(data_type).name if data_type in DataType.__members__.values() else f"{data_type:#06x}"


def mapping_objection(
    dictionary: Dictionary, kind: Literal["RPDO", "TPDO"], index: int, data_type: DataType, subindex: int = 0
) -> str | None:
    """Return why an object cannot be part of a map that is written; None where it can."""
    variable = listed(dictionary, index, subindex)
    if variable is None:
        return "missing"
    if (text := _of_type(variable, data_type)) is not None:
        return text
    if not variable.pdo_mappable:
        return "not mappable (PDOMapping)"
    is_allowed = variable.access_type in _MAPPABLE_ACCESS[kind]
    return None if is_allowed else f"{variable.access_type}, which no {kind} can carry"
