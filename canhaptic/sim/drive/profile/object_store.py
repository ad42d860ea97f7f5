"""The object store of the simulated drive: every object of its dictionary, with access, type and range checks.

Built from any EDS or DCF. An object without a value answers "no data" (SDO abort 0x08000024): no value is invented.
Objects that the drive needs internally but its dictionary does not list are kept here too, invisible to SDO and PDO.
"""

import struct
from collections.abc import Callable, Mapping, Set
from functools import partial
from typing import Final, cast

from canhaptic.canopen import objects
from canhaptic.canopen.objects import DataType, Dictionary, SdoAbort, Variable, variables, without_flags
from canhaptic.errors import ParameterError

_Value = int | float | bytes
Check = Callable[[int], SdoAbort | None]
"""Returns the abort code for a value that cannot be stored, or None."""

_INTEGERS: Final[dict[int, tuple[int, bool]]] = {
    int(DataType[f"{kind}{8 * size}"]): (size, kind == "INTEGER")
    for kind in ("INTEGER", "UNSIGNED")
    for size in range(1, 9)
} | {DataType.BOOLEAN: (1, False)}
"""Data type -> (bytes, signed); CiA 301, 7.4."""
_REALS: Final[dict[int, struct.Struct]] = {DataType.REAL32: struct.Struct("<f"), DataType.REAL64: struct.Struct("<d")}
_PDO_CODES: Final = {(1, True): "b", (2, True): "h", (4, True): "i", (8, True): "q"}
_SIGNATURES: Final = {
    objects.STORE_PARAMETERS: int.from_bytes(b"save", "little"),
    objects.RESTORE_PARAMETERS: int.from_bytes(b"load", "little"),
}
_COUNTING_OBJECTS: Final = (range(0x1003, 0x1004), range(0x1600, 0x1800), range(0x1A00, 0x1C00))


class Entry:
    """One object (index and subindex) of the simulated drive, with its value.

    Attributes:
        size: Length [bytes]; 0 when it varies (strings, domains).
        code: `struct` code of the value in a PDO; empty when it cannot be mapped.
        low: Smallest value allowed by the type or the dictionary; a real number has none unless stated.
        high: Largest value allowed.
        value: Present value; None while the object has none.
        check: Called with a value before it is stored by SDO; returns the abort code or None.
        changed: Called after a value was stored by SDO.
        refresh: Called before a value is read by SDO.
        refused: A value within the range that the drive nevertheless rejects by SDO; None: no such value.
    """

    __slots__ = (
        *("index", "subindex", "data_type", "size", "code", "readable", "writable", "receivable", "transmittable"),
        *("low", "high", "initial", "value", "check", "changed", "refresh", "refused"),
    )

    def __init__(
        self, index: int, subindex: int, data_type: int, access: str = "rw", is_mappable: bool = False
    ) -> None:
        self.index, self.subindex, self.data_type = index, subindex, data_type
        size, is_signed = _INTEGERS.get(data_type, (0, False))
        self.low: float = -(1 << (8 * size - 1)) if is_signed else 0
        self.high: float = (1 << (8 * size - is_signed)) - 1 if data_type != DataType.BOOLEAN else 1
        self.size = size
        signed_code = _PDO_CODES.get((size, True), "") if data_type != DataType.BOOLEAN else ""
        self.code = signed_code if is_signed else signed_code.upper()
        if data_type in _REALS:
            self.size, self.low, self.high = _REALS[data_type].size, float("-inf"), float("inf")
            self.code = _REALS[data_type].format[-1]
        self.readable = access != "wo"
        self.writable = access not in ("ro", "const")
        is_dummy = index < 0x20  # a data type that an RPDO maps to skip bytes (CiA 301, 7.4.7)
        self.receivable = is_dummy or (is_mappable and access in ("rw", "rww", "wo"))
        self.transmittable = not is_dummy and is_mappable and access in ("ro", "rw", "rwr", "const")
        self.initial: _Value | None = None
        self.value: _Value | None = None
        self.check: Check | None = None
        self.changed: Callable[[], None] | None = None
        self.refresh: Callable[[], None] | None = None
        self.refused: int | None = None

    @property
    def number(self) -> int:
        """The value as an integer; 0 while there is none."""
        return self.value if isinstance(self.value, int) else 0

    def encode(self, value: _Value) -> bytes:
        """Return the bytes of a value on the bus.

        Raises:
            ValueError: The value does not fit the type.
        """
        if isinstance(value, bytes):
            return value
        try:
            if self.data_type in _REALS:
                return _REALS[self.data_type].pack(value)
            return int(value).to_bytes(self.size, "little", signed=self.low < 0)
        except (OverflowError, struct.error) as error:
            raise ValueError(f"{value} does not fit {self.size} bytes") from error

    def decode(self, content: bytes) -> _Value:
        """Return the value of bytes that have the right length."""
        if self.data_type in _REALS:
            return float(_REALS[self.data_type].unpack(content)[0])
        if self.size:
            return int.from_bytes(content, "little", signed=_INTEGERS[self.data_type][1])
        return content


def refuse_unless(accepts: Callable[[int], object], abort: SdoAbort = SdoAbort.VALUE_RANGE) -> Check:
    """Return a check that answers a written value with the abort code unless `accepts` returns True for it."""
    return lambda value: None if accepts(value) else abort


class ObjectStore:
    """Every object of one simulated drive.

    Args:
        dictionary: Dictionary as read from its EDS or DCF.
        values: Initial values by (index, subindex), which replace those of the dictionary.
        absent: (index, subindex or None for all) of objects that the dictionary lists and the drive lacks.
        refused: (index, subindex) -> value that the drive rejects by SDO.

    Raises:
        ParameterError: `values` names an object that the dictionary lacks, or a value that does not fit.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        values: Mapping[tuple[int, int], int | float | str],
        absent: Set[tuple[int, int | None]] = frozenset(),
        refused: Mapping[tuple[int, int], int] | None = None,
    ) -> None:
        self._entries: dict[tuple[int, int], Entry] = {}
        self._hidden: dict[tuple[int, int], Entry] = {}
        for variable in variables(dictionary):
            place = (variable.index, variable.subindex)
            if not absent or not {place, (variable.index, None)} & absent:
                self._entries[place] = _entry(variable)
        self._indices = {index for index, _ in self._entries}
        self._fill_counts()
        for place, value in values.items():
            self._override(place, value)
        for place, number in (refused or {}).items():
            if place in self._entries:
                self._entries[place].refused = number
        self.reset()

    def entry(self, index: int, data_type: int, subindex: int = 0) -> Entry:
        """Return an object of the dictionary; if the dictionary lacks it, an object internal to the drive.

        Raises:
            ParameterError: Its data type in the dictionary is not the one that the drive uses.
        """
        found = self._entries.get((index, subindex))
        if found is not None and found.data_type != data_type:
            raise ParameterError(
                f"object 0x{index:04X}.{subindex}: got data type 0x{found.data_type:04X} in the dictionary, "
                f"expected 0x{data_type:04X} as the drive has it; correct the dictionary"
            )
        return self.optional(index, data_type, subindex)

    def optional(self, index: int, data_type: int, subindex: int = 0) -> Entry:
        """Return an object as `entry` does; if its type in the dictionary differs, an object internal to the drive.

        The object of the dictionary then has no effect; the master needs none of these objects to run.
        """
        found = self._entries.get((index, subindex))
        if found is not None and found.data_type == data_type:
            return found
        return self._hidden.setdefault((index, subindex), Entry(index, subindex, data_type, access="ro"))

    def find(self, index: int, subindex: int = 0) -> Entry | None:
        """Return an object of the dictionary, or None."""
        return self._entries.get((index, subindex))

    def indices(self) -> list[int]:
        """Return the indices of all objects of the dictionary, in order."""
        return sorted(self._indices)

    def subindices(self, index: int) -> list[int]:
        """Return the subindices of an object of the dictionary, in order."""
        return sorted(subindex for at, subindex in self._entries if at == index)

    def reset(self, indices: range = range(0x10000)) -> None:
        """Set the objects of a range of indices to their initial values."""
        for entry in (*self._entries.values(), *self._hidden.values()):
            if entry.index in indices:
                entry.value = entry.initial

    def read(self, index: int, subindex: int) -> bytes | SdoAbort:
        """Bytes of an SDO upload, or its abort code."""
        entry = self._entries.get((index, subindex))
        if entry is None:
            return self._absent(index)
        if not entry.readable:
            return SdoAbort.WRITE_ONLY
        if entry.refresh is not None:
            entry.refresh()
        return SdoAbort.NO_DATA if entry.value is None else entry.encode(entry.value)

    def may_write(self, index: int, subindex: int) -> SdoAbort | None:
        """Abort code for an object that cannot be written at all, or None."""
        entry = self._entries.get((index, subindex))
        if entry is None:
            return self._absent(index)
        return None if entry.writable else SdoAbort.READ_ONLY

    def write(self, index: int, subindex: int, content: bytes) -> SdoAbort | None:
        """Store the value of an SDO download; return its abort code, or None."""
        if (abort := self.may_write(index, subindex)) is not None:
            return abort
        entry = self._entries[index, subindex]
        if entry.size and len(content) != entry.size:
            return SdoAbort.LENGTH_TOO_HIGH if len(content) > entry.size else SdoAbort.LENGTH_TOO_LOW
        value = entry.decode(content)
        if not isinstance(value, bytes):
            refusal = _refusal(entry, value)
            if refusal is not None:
                return refusal
        entry.value = value
        if entry.changed is not None:
            entry.changed()
        return None

    def guard_storage(self) -> None:
        """Restrict 0x1010 and 0x1011 to their signatures (CiA 301, 7.5.2.13-14); they keep their capability values."""
        for index, signature in _SIGNATURES.items():
            for entry in [e for (i, subindex), e in self._entries.items() if i == index and subindex]:
                entry.check = refuse_unless(signature.__eq__, SdoAbort.NOT_TRANSFERABLE)
                entry.changed = partial(setattr, entry, "value", entry.initial)

    def _absent(self, index: int) -> SdoAbort:
        return SdoAbort.NO_SUBINDEX if index in self._indices else SdoAbort.NO_OBJECT

    def _fill_counts(self) -> None:
        """Set subindex 0 of arrays and records to the highest subindex if the dictionary states no value."""
        highest_of = {index: subindex for index, subindex in sorted(self._entries) if subindex}
        for index, highest in highest_of.items():
            count = self._entries.get((index, 0))
            if count is not None and count.initial is None and not any(index in r for r in _COUNTING_OBJECTS):
                count.initial = highest

    def _override(self, place: tuple[int, int], value: int | float | str) -> None:
        name = f"objects.0x{place[0]:04X}.{place[1]}"
        entry = self._entries.get(place)
        if entry is None:
            raise ParameterError(f"{name}: got {value!r}, but the dictionary lists no such object; remove the entry")
        entry.initial = _typed(entry.data_type, value)
        try:
            entry.encode(cast(_Value, entry.initial))  # no type takes None
        except (ValueError, TypeError) as error:
            raise ParameterError(f"{name}: got {value!r}, expected a value of type 0x{entry.data_type:04X}") from error


def _refusal(entry: Entry, value: int | float) -> SdoAbort | None:
    """Abort code for a number that cannot be stored, or None."""
    plain = without_flags(entry.index, entry.subindex, value)
    if not plain <= entry.high:
        return SdoAbort.VALUE_TOO_HIGH
    if plain < entry.low:
        return SdoAbort.VALUE_TOO_LOW
    if value == entry.refused:
        return SdoAbort.VALUE_RANGE
    return None if entry.check is None else entry.check(int(value))


def _entry(variable: Variable) -> Entry:
    data_type = variable.data_type if variable.data_type is not None else DataType.DOMAIN
    entry = Entry(variable.index, variable.subindex, data_type, variable.access_type, variable.pdo_mappable)
    if entry.size:
        entry.low = entry.low if variable.min is None else max(entry.low, variable.min)
        entry.high = entry.high if variable.max is None else min(entry.high, variable.max)
    entry.initial = _typed(data_type, variable.default if variable.value is None else variable.value)
    return entry


def _typed(data_type: int, value: int | float | str | bytes | None) -> _Value | None:
    """Value of a dictionary or scene in the type of the store; None when it has another type."""
    if isinstance(value, str):
        value = value.encode("utf-16-le" if data_type == DataType.UNICODE_STRING else "latin-1", errors="replace")
    if data_type in _INTEGERS:
        return int(value) if isinstance(value, int) else None
    if data_type in _REALS:
        return float(value) if isinstance(value, int | float) else None
    return value if isinstance(value, bytes) else None
