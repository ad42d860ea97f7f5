"""Reader of object dictionaries (EDS or DCF, CiA 306) that tolerates vendors' deviations from the standard.

`canopen.import_od` raises on empty entries (`PDOMapping=`, `NrOfRXPDO=`), on Latin-1 text and on a subindex listed
before its object; it reads a hexadecimal default of a signed object as a large positive number and keeps the node ID
for which a DCF was saved. This reader also returns a `canopen.ObjectDictionary`, but

- reads UTF-8, UTF-16 (byte order mark) and Windows-1252, with keywords and sections in any case and order;
- treats an empty or unreadable entry as not given: no value, no limit, not mappable;
- reads an ARRAY as a RECORD, because `canopen` invents the subindices that an array does not list;
- drops the values of objects relative to $NODEID in a DCF saved for another node ID, and keeps the defaults;
- reads a number with letters and without prefix as hexadecimal (`FF`, `1F4`), also with a trailing `h` (`80h`);
- drops limits that contradict each other or the object's own value, and a limit of the consumer heartbeat time
  (0x1016) that leaves no room for the node ID;
- treats a value that does not fit the object's type as not given;
- adds a subindex 0 without value to a record or array that lacks it, writable if its first member is;
- fills the identity (0x1018) from [DeviceInfo] where it is 0 or not given, and [DeviceInfo] from it, so that everyone
  who asks for the identity gets the same answer;
- keeps of the limits of a COB-ID those of its identifier, without the flags (bits 29 to 31);
- leaves out a section that cannot be read: `DriveDictionary` says so, and refuses every use of its object.

An unreadable file raises `DictionaryError` with file and section.
"""

import re
import zlib
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Final, NamedTuple

from canopen.objectdictionary import ObjectDictionary, ODRecord, ODVariable, datatypes

from canhaptic.canopen.file_kinds import other_kind, other_kind_of_bytes
from canhaptic.canopen.objects import CONSUMER_HEARTBEAT_TIME, IDENTITY, without_flags
from canhaptic.errors import DictionaryError
from canhaptic.files import read_regular

_OBJECT: Final = re.compile(r"([0-9a-f]{4})(?:sub([0-9a-f]{1,2}))?")
_ALMOST: Final = re.compile(r"([0-9a-f]{4})(sub|[^0-9a-z]).*(?<!name|alue|tion|inks)", re.DOTALL)
_DOMAIN_OBJECT, _VAR, _ARRAY, _RECORD = _OBJECT_TYPES = 2, 7, 8, 9  # (CiA 301, table 42)
_BARE_HEXADECIMAL: Final = re.compile(
    r"(?=.*[a-f])\d[0-9a-f]*|(?=.*[a-f])(?:[0-9a-f]{2}|[0-9a-f]{4}|[0-9a-f]{8}|[0-9a-f]{16})|\d[0-9a-f]*h"
)
_NODE_ID: Final = re.compile(r"\+?\$(?:MY_)?NODE_?ID\+?", re.IGNORECASE)
_LARGEST: Final = 4_000_000  # [B]; the largest known dictionary has a tenth of it
_UNKNOWN: Final = -1  # subindex
_GZIP: Final = b"\x1f\x8b"
_TYPES: Final = {  # by name, for files that write UNSIGNED32 instead of 0x0007
    name.replace("_", ""): value for name, value in vars(datatypes).items() if isinstance(value, int)
}
_ACCESS: Final = ("ro", "wo", "rw", "rwr", "rww", "const")

_Sections = dict[str, dict[str, str]]


class DriveDictionary(ObjectDictionary):
    """Object dictionary whose unreadable sections are left out, but not forgotten.

    A lookup of such an object raises `DictionaryError`, since nothing is known of it. Iteration leaves it out.

    Attributes:
        left_out: (index, subindex) of each object left out -> file, section, value and remedy.
        unread: The same text for each entry of another section that was not read, such as a default; it counts as not
            given.
    """

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.left_out: dict[tuple[int, int], str] = {}
        self.unread: list[str] = []

    def get_variable(self, index: int | str, subindex: int = 0) -> ODVariable | None:
        """Return an object or one of its subindices; None if it is not listed.

        Raises:
            DictionaryError: Its section could not be read.
        """
        if (index, subindex) in self.left_out:
            raise DictionaryError(self.left_out[int(index), subindex])
        return super().get_variable(index, subindex)

    def __contains__(self, index: object) -> bool:
        if (index, 0) in self.left_out and index not in self.indices:
            raise DictionaryError(self.left_out[index, 0])  # type: ignore[index]
        return index in self.indices or index in self.names


def left_out(dictionary: ObjectDictionary, first: int, last: int) -> dict[int, str]:
    """Return the objects `first` to `last` of which a section could not be read, and why."""
    places = getattr(dictionary, "left_out", {}).items()
    return {index: text for (index, _), text in places if first <= index <= last}


class _Source(NamedTuple):
    """A parsed file: its sections by lower-case name, and the node ID."""

    path: Path
    sections: _Sections
    node_id: int
    is_for_node: bool  # False for a DCF that was saved for another node ID
    unread: list[str]

    def fault(self, section: str, text: str) -> DictionaryError:
        return DictionaryError(f"{self.path}: [{section.upper().replace('SUB', 'sub')}]: {text}")

    def note(self, section: str, key: str, expected: str) -> None:
        """Say that an entry was not read, unless it is empty or a dash, which many tools write for none."""
        text = self.sections[section].get(key.lower(), "")
        if text.strip("-. ") and text.lower() not in ("none", "n/a", "na", "null"):
            seen = f"{key}: got {text[:60]!r}, expected {expected}; it counts as not given: correct the file"
            self.unread.append(str(self.fault(section, seen)))


def read_dictionary(path: str | Path, node_id: int) -> DriveDictionary:
    """Return the object dictionary of a drive from its EDS or DCF, for one node ID.

    `value` of a variable is the ParameterValue of a DCF, `default` its DefaultValue; both are None if not given.
    Repeated reads of the same content return the same object, which must not be changed.

    Args:
        path: An .eds or .dcf file, or one of them compressed by gzip.
        node_id: 1..127; replaces $NODEID.

    Raises:
        DictionaryError: The file is missing, or is no EDS or DCF.
    """
    path = Path(path)
    if not 1 <= node_id <= 127:
        raise DictionaryError(f"{path}: node ID {node_id} does not exist, expected 1..127")
    return _read(path, dictionary_content(path), node_id)


@lru_cache(maxsize=32)  # a scene asks four times for each drive, and a sweep has thousands of scenes
def _read(path: Path, content: bytes, node_id: int) -> DriveDictionary:
    text = text_of(path, content)
    sections = _parse(text)
    dictionary = DriveDictionary()
    saved_for = _integer(sections.get("devicecomissioning", {}).get("nodeid", ""))
    source = _Source(path, sections, node_id, saved_for in (None, node_id), dictionary.unread)
    dictionary.node_id = node_id
    _read_device(source, dictionary)
    _read_dummies(source, dictionary)
    for section in sections:
        match = _OBJECT.fullmatch(section) or _ALMOST.fullmatch(section)
        if match is None or (match.re is _OBJECT and match[2]):
            continue
        index = int(match[1], 16)
        try:
            if match.re is _ALMOST:
                raise source.fault(section, f"names no object, expected [{index:04X}] or [{index:04X}sub1]; correct it")
            dictionary.add_object(_read_object(source, section, index))
        except DictionaryError as error:
            dictionary.left_out[index, _UNKNOWN if match[2] == "sub" else 0] = str(error)
    _read_subindices(source, dictionary)
    _agree_on_identity(dictionary)
    if not any(index >= 0x1000 for index in (*dictionary, *(index for index, _ in dictionary.left_out))):
        kind = other_kind(text) or "lists no object (no section like [1000]); expected an EDS or DCF of CiA 306"
        raise DictionaryError(f"{path}: {kind}")
    return dictionary


# --- the text ---------------------------------------------------------------------------------------------------


def _parse(text: str) -> _Sections:
    """Return the entries of each section, with names and keys in lower case and without comments and stray lines."""
    sections: _Sections = {}
    entries: dict[str, str] | None = None
    for line in text.splitlines():
        line = line.strip()
        if line.startswith("[") and "]" in line:
            entries = sections.setdefault(line[1 : line.index("]")].strip().lower(), {})
        elif entries is not None and "=" in line and not line.startswith((";", "#")):
            key, _, value = line.partition("=")
            entries[key.strip().lower()] = re.split(r"\s;", value, maxsplit=1)[0].strip()
    return sections


def dictionary_content(path: Path) -> bytes:
    """Return the bytes of an EDS or DCF.

    Raises:
        DictionaryError: The path is not a regular file, is larger than any dictionary, or cannot be read.
    """
    try:
        return read_regular(path, _LARGEST)
    except OSError as error:
        text = f"cannot be read ({error.strerror}); give the path of the drive's EDS or DCF"
        raise DictionaryError(f"{path}: {text}") from error


def text_of(path: Path, content: bytes) -> str:
    """Return the text of a file in any of the usual encodings, also compressed by gzip; raise DictionaryError."""
    if content.startswith(_GZIP):
        try:
            content = zlib.decompressobj(wbits=31).decompress(content, _LARGEST)
        except zlib.error as error:
            raise DictionaryError(f"{path}: is compressed (gzip) and damaged ({error}); get it again") from error
    if kind := other_kind_of_bytes(content):
        raise DictionaryError(f"{path}: {kind}")
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return content.decode("utf-16", errors="replace")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", errors="replace")


def _integer(text: str) -> int | None:
    """Return the number in a text, in the notations of CiA 306 (decimal, 0x, octal with leading 0) or of vendors.

    None if unreadable. A text with letters and without prefix is a number only if it begins with a digit or has the
    length of 1, 2, 4 or 8 bytes, so that a word is not read as a number.
    """
    text = re.split(r"//|#", text, maxsplit=1)[0].replace(" ", "").lower()
    octal = re.fullmatch(r"0+([0-7]+)", text)
    if _BARE_HEXADECIMAL.fullmatch(text):
        return int(text.removesuffix("h"), 16)
    try:
        return int(octal[1], 8) if octal else int(text, 0)
    except ValueError:
        return None


# --- the device ---------------------------------------------------------------------------------------------------


def _read_device(source: _Source, dictionary: ObjectDictionary) -> None:
    entries = source.sections.get("deviceinfo", {})
    device = dictionary.device_information
    for rate in (10, 20, 50, 125, 250, 500, 800, 1000):
        if _integer(entries.get(f"baudrate_{rate}", "")):
            device.allowed_baudrates.add(rate * 1000)
    device.vendor_name, device.product_name = entries.get("vendorname") or None, entries.get("productname") or None
    device.vendor_number = _integer(entries.get("vendornumber", ""))
    device.product_number = _integer(entries.get("productnumber", ""))


def _agree_on_identity(dictionary: DriveDictionary) -> None:
    """Let [DeviceInfo] and the identity object name the same vendor and product; where both do, the object is right."""
    device = dictionary.device_information
    for subindex, key in ((1, "vendor_number"), (2, "product_number")):
        held = getattr(dictionary.indices.get(IDENTITY), "subindices", {}).get(subindex)
        if held is None:
            continue
        number = held.value or held.default or getattr(device, key)
        if number and (number := _held_by(held, number)) is not None:
            setattr(device, key, number)
            held.default = held.default or number
            held.value = held.value or (None if held.value is None else number)


def _read_dummies(source: _Source, dictionary: ObjectDictionary) -> None:
    """Add the dummy objects (data types) that an RPDO may map to skip bytes (CiA 301, 7.4.7)."""
    entries = source.sections.get("dummyusage", {})
    for data_type in range(1, 8):
        if _integer(entries.get(f"dummy{data_type:04}", "")) == 1:
            dummy = ODVariable(f"Dummy{data_type:04}", data_type)
            dummy.data_type, dummy.access_type, dummy.pdo_mappable = data_type, "const", True
            dictionary.add_object(dummy)


# --- the objects --------------------------------------------------------------------------------------------------


def _read_object(source: _Source, section: str, index: int) -> ODVariable | ODRecord:
    entries = source.sections[section]
    name = entries.get("parametername") or f"object {index:04X}"
    object_type = _integer(entries.get("objecttype", ""))
    if object_type not in _OBJECT_TYPES:
        has_members = "subnumber" in entries or any(s.startswith(f"{section}sub") for s in source.sections)
        object_type = _RECORD if has_members else _VAR
    if object_type in (_VAR, _DOMAIN_OBJECT):
        return _read_variable(source, section, index, 0, name)
    holder = ODRecord(name, index)
    if count := _integer(entries.get("compactsubobj", "")):
        _read_compact(source, section, holder, min(count, 254))
    return holder


def _read_compact(source: _Source, section: str, holder: ODRecord, count: int) -> None:
    """Add the subindices 1..count that `CompactSubObj` describes in one entry (CiA 306, 4.6.4)."""
    _add_count(holder, "ro", count)
    names = source.sections.get(f"{section}name", {})
    values = source.sections.get(f"{section}value", {})
    for subindex in range(1, count + 1):
        name = names.get(str(subindex)) or f"{holder.name} {subindex}"
        member = _read_variable(source, section, holder.index, subindex, name)
        if str(subindex) in values:
            member.default = _value(source, member, values[str(subindex)])
        holder.add_member(member)


def _read_subindices(source: _Source, dictionary: DriveDictionary) -> None:
    for section, entries in source.sections.items():
        match = _OBJECT.fullmatch(section)
        if match is None or match[2] is None:
            continue
        index, subindex = int(match[1], 16), int(match[2], 16)
        holder = dictionary.get(index)
        if holder is None:
            missing = f"belongs to no object; section [{index:04X}] is missing: correct the file"
            reason = dictionary.left_out.get((index, 0), str(source.fault(section, missing)))
            dictionary.left_out.setdefault((index, subindex), reason)
            continue
        if not isinstance(holder, ODVariable):
            name = entries.get("parametername") or f"subindex {subindex}"
            if name in holder.names and holder.names[name].subindex != subindex:
                name = f"{name} ({subindex})"  # canopen finds members by name first: a name must be one member
            try:
                holder.add_member(_read_variable(source, section, index, subindex, name))
            except DictionaryError as error:
                dictionary.left_out[index, subindex] = str(error)
    for holder in dictionary.values():
        if not isinstance(holder, ODVariable) and (holder.index, 0) not in dictionary.left_out:
            _complete(source, holder)


def _complete(source: _Source, holder: ODRecord) -> None:
    """Add a missing subindex 0, of which only the drive knows the value; say where an entry of a PDO is missing."""
    if holder.subindices and 0 not in holder.subindices:
        first = holder.subindices[min(holder.subindices)]
        _add_count(holder, "rw" if first.writable else "ro")
    if holder.index & ~0x1FF in (0x1600, 0x1A00) and (gap := set(range(1, max(holder, default=0))) - set(holder)):
        text = f"subindex {min(gap)} is missing between others; this PDO may not be usable: correct the file"
        source.unread.append(str(source.fault(f"{holder.index:04X}", text)))


def _add_count(holder: ODRecord, access: str, count: int | None = None) -> None:
    number = ODVariable("NrOfObjects", holder.index, 0)
    number.data_type, number.access_type, number.default = datatypes.UNSIGNED8, access, count
    holder.add_member(number)


def _read_variable(source: _Source, section: str, index: int, subindex: int, name: str) -> ODVariable:
    entries = source.sections[section]
    variable = ODVariable(name, index, subindex)
    variable.data_type = _data_type(source, section)
    access = entries.get("accesstype", "").lower()
    # Not given: only the drive can tell, so nothing may be refused for it.
    variable.access_type = access if access in _ACCESS else "rw"
    if access not in _ACCESS:
        source.note(section, "AccessType", "one of " + ", ".join(_ACCESS))
    variable.pdo_mappable = _is_set(source, section, "PDOMapping")
    low, high = (_stated(source, section, variable, key) for key in ("LowLimit", "HighLimit"))
    default_text, value_text = entries.get("defaultvalue", ""), entries.get("parametervalue", "")
    variable.relative = _NODE_ID.search(default_text) is not None
    variable.default = _stated(source, section, variable, "DefaultValue")
    if source.is_for_node or not variable.relative or _NODE_ID.search(value_text):
        variable.value = _stated(source, section, variable, "ParameterValue")
    _set_limits(variable, low, high)
    return variable


def _is_set(source: _Source, section: str, key: str) -> bool:
    text = source.sections[section].get(key.lower(), "")
    number = {"true": 1, "yes": 1, "false": 0, "no": 0}.get(text.lower(), _integer(text))
    if number is None:
        source.note(section, key, "0 or 1")
    return bool(number)


def _stated(source: _Source, section: str, variable: ODVariable, key: str) -> Any:
    """Return the value of an entry; None, with a note, if it does not fit the type of the object."""
    value = _value(source, variable, source.sections[section].get(key.lower(), ""))
    if value is None and variable.data_type in (*datatypes.NUMBER_TYPES, datatypes.BOOLEAN):
        source.note(section, key, "a number of the type of the object")
    return value


def _set_limits(variable: ODVariable, low: Any, high: Any) -> None:
    """Set the limits of a number, except limits that contradict each other or the object's value."""
    if variable.data_type not in datatypes.NUMBER_TYPES:
        return
    plain = partial(without_flags, variable.index, variable.subindex)
    low, high = (None if limit is None else plain(limit) for limit in (low, high))
    if low is not None and high is not None and low > high:
        return
    held = [plain(value) for value in (variable.default, variable.value) if value is not None]
    is_consumer = variable.index == CONSUMER_HEARTBEAT_TIME and variable.subindex > 0
    excludes_nodes = is_consumer and high is not None and high <= 0xFFFF
    if low is not None and all(value >= low for value in held):
        variable.min = low
    if high is not None and not excludes_nodes and all(value <= high for value in held):
        variable.max = high


def _data_type(source: _Source, section: str) -> int:
    """Return the CiA 301 data type; DOMAIN (opaque bytes) for a vendor type that the file does not define."""
    entries = source.sections[section]
    data_type = _integer(entries.get("datatype", ""))
    if data_type is None:
        data_type = _TYPES.get(re.sub(r"[\s_-]", "", re.split(r"//|#", entries.get("datatype", ""))[0]).upper())
    if data_type is None:
        if _integer(entries.get("objecttype", "")) == _DOMAIN_OBJECT:
            return datatypes.DOMAIN
        seen = repr(entries["datatype"]) if "datatype" in entries else "no entry"
        raise source.fault(
            section, f"DataType: got {seen}, expected 0x0006, UNSIGNED16 or another type; correct the file"
        )
    if data_type > datatypes.UNSIGNED64:  # defined by the file itself, as [A0] with its type in [A0sub1]
        defined = source.sections.get(f"{data_type:x}sub1", {}).get("defaultvalue", "")
        data_type = _integer(defined) or datatypes.DOMAIN
    return data_type


def _value(source: _Source, variable: ODVariable, text: str) -> Any:
    """Return the value in a text as int, float, str or bytes, by the variable's type; None if unreadable."""
    data_type = variable.data_type
    if not text:
        return None
    if data_type in (datatypes.VISIBLE_STRING, datatypes.UNICODE_STRING):
        return text
    try:
        if data_type in datatypes.FLOAT_TYPES:
            return float(text)
        if data_type in (datatypes.OCTET_STRING, datatypes.DOMAIN):
            return bytes.fromhex(text)
    except ValueError:
        return None
    number = _number(text, source.node_id)
    return None if number is None else _held_by(variable, number)


def _held_by(variable: ODVariable, number: int) -> int | None:
    """Return the number with the same bits in the variable's type; None if it does not fit."""
    if variable.data_type not in (*datatypes.INTEGER_TYPES, datatypes.BOOLEAN):
        return None
    bits = 1 if variable.data_type == datatypes.BOOLEAN else len(variable)
    if not -(1 << (bits - 1)) <= number < (1 << bits):
        return None
    number &= (1 << bits) - 1
    is_negative = variable.data_type in datatypes.SIGNED_TYPES and number >> (bits - 1)
    return number - (1 << bits) if is_negative else number


def _number(text: str, node_id: int) -> int | None:
    relative, count = _NODE_ID.subn("", text.replace(" ", ""))
    offset = _integer(relative) if relative or not count else 0
    return offset + node_id if count and offset is not None else offset
