"""Reader of EtherCAT slave information (ESI, ETG.2000): a dictionary as an EDS gives it, and what a start needs.

It tolerates what vendors write: numbers as `#x1A`, `0x1A`, `#x0x1A` or decimal, `DefaultData` as little-endian bytes
or `DefaultValue` and `DefaultString`, and PDOs of which no dictionary lists the maps. A file may describe several
devices, and several revisions of one device. Revisions differ in their objects and modes.
"""

import re
import xml.etree.ElementTree as ET  # expat limits the expansion of entities
from collections.abc import Iterable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, NamedTuple

from canopen.objectdictionary import ODRecord, ODVariable

from canhaptic.canopen.eds import DriveDictionary, dictionary_content, text_of
from canhaptic.canopen.objects import IDENTITY, DataType
from canhaptic.errors import DictionaryError

_NUMBER: Final = re.compile(r"0x[0-9a-f]+|-?\d+")
_BYTES: Final = re.compile(r"(?:[0-9a-fA-F]{2})+")
_TYPES: Final = {
    "BOOL": DataType.BOOLEAN, "BIT": DataType.BOOLEAN, "SINT": DataType.INTEGER8, "INT": DataType.INTEGER16,
    "DINT": DataType.INTEGER32, "LINT": DataType.INTEGER64, "USINT": DataType.UNSIGNED8, "BYTE": DataType.UNSIGNED8,
    "UINT": DataType.UNSIGNED16, "WORD": DataType.UNSIGNED16, "UDINT": DataType.UNSIGNED32,
    "DWORD": DataType.UNSIGNED32, "ULINT": DataType.UNSIGNED64, "REAL": DataType.REAL32, "LREAL": DataType.REAL64,
}  # fmt: skip
_OF_SIZE: Final = {1: DataType.BOOLEAN, 8: DataType.UNSIGNED8, 16: DataType.UNSIGNED16, 32: DataType.UNSIGNED32}
_SIGNED: Final = {DataType.INTEGER8: 8, DataType.INTEGER16: 16, DataType.INTEGER32: 32, DataType.INTEGER64: 64}
_REALS: Final = (DataType.REAL32, DataType.REAL64)
_NAMES: Final = frozenset({"Name", "Type", "GroupType", "Fmmu", "Sm", "URL", "InfoReference"})
_OF_THE_VENDOR: Final = range(0x2000, 0x6000)
_TOLD: Final = range(0x1008, 0x100B)  # name of the device, versions of hardware and software
_ASSIGNMENTS: Final = {"RxPdo": 0x1C12, "TxPdo": 0x1C13}
_MOST_ELEMENTS: Final = 255


class Startup(NamedTuple):
    """A write that the vendor wants at the start."""

    transition: str  # PS: from PRE-OP to SAFE-OP, and so on
    place: tuple[int, int]  # index, subindex
    data: bytes


class EsiDictionary(DriveDictionary):
    """Object dictionary of one device of an ESI.

    Attributes:
        identity: Vendor, product and revision.
        title: Name of the device.
        assign_activate: Value for 0x0980 that starts SYNC0; None where the file names none.
        startup: Writes that the vendor wants at the start.
        is_whole: Whether the file has a dictionary; without one only the objects of the PDOs are known.
    """

    def __init__(self, identity: tuple[int, int, int], title: str) -> None:
        super().__init__()
        self.identity, self.title = identity, title
        self.assign_activate: int | None = None
        self.startup: tuple[Startup, ...] = ()
        self.is_whole = False


def read_esi(path: str | Path, product: int | None = None, revision: int | None = None) -> EsiDictionary:
    """Return the object dictionary of a device of an ESI.

    Repeated reads of the same content return the same object, which must not be changed.

    Args:
        path: The file, or one compressed by gzip.
        product: Product code; None: the file describes one product only.
        revision: Revision number; None, or one that the file lacks: the highest up to it, else the lowest.

    Raises:
        DictionaryError: The file is missing, is no ESI, or does not describe the product.
    """
    path = Path(path)
    devices = _read(path, dictionary_content(path))
    products = sorted({device.identity[1] for device in devices})
    if product is None and len(products) > 1:
        raise DictionaryError(f"{path}: describes products {_listed(products)}; name one of them by `product`")
    found = [device for device in devices if product in (None, device.identity[1])]
    if not found:
        raise DictionaryError(f"{path}: got product {product:#x}, expected one of {_listed(products)}; get its ESI")
    found.sort(key=lambda device: device.identity[2])
    older = [device for device in found if revision is None or device.identity[2] <= revision]
    return older[-1] if older else found[0]


def esi_devices(path: str | Path) -> tuple[EsiDictionary, ...]:
    """Return every device of an ESI, each revision of each product once; raise DictionaryError."""
    path = Path(path)
    found = {device.identity: device for device in reversed(_read(path, dictionary_content(path)))}
    return tuple(sorted(found.values(), key=lambda device: device.identity))


def _listed(numbers: list[int]) -> str:
    return ", ".join(f"{number:#x}" for number in numbers)


def without_names(path: str | Path) -> str:
    """Return an ESI without names of vendor, groups and devices, pictures, comments and serial number.

    Args:
        path: The file, or one compressed by gzip.

    Raises:
        DictionaryError: The file cannot be read, or is no XML.
    """
    path = Path(path)
    root = _parsed(path, dictionary_content(path))
    kept = {id(of) for dictionary in root.iter("Dictionary") for of in dictionary.iter()}
    for of in root.iter():
        is_name = of.tag in _NAMES and id(of) not in kept
        if is_name or of.tag == "Comment" or of.tag.startswith("Image"):
            of.text = ""
    for item in root.iter("Object"):
        index = _number(item.findtext("Index"))
        members = [item] if index in _TOLD else item.findall("Info/SubItem")[4:5] if index == IDENTITY else []
        for of in (of for member in members for of in member.iter()):
            if of.tag.startswith("Default"):
                of.text = ""
        for of in item.findall("Name") if index in _OF_THE_VENDOR else ():
            of.text = ""
    return ET.tostring(root, encoding="unicode")


def _parsed(path: Path, content: bytes) -> ET.Element:
    text = text_of(path, content)
    try:
        return ET.fromstring(re.sub(r"^\s*<\?xml[^>]*\?>", "", text))
    except ET.ParseError as error:
        raise DictionaryError(f"{path}: is no XML ({error}); give the ESI of the drive's vendor") from error


@lru_cache(maxsize=32)
def _read(path: Path, content: bytes) -> tuple[EsiDictionary, ...]:
    root = _parsed(path, content)
    if root.tag != "EtherCATInfo":
        raise DictionaryError(f"{path}: got element {root.tag!r}, expected EtherCATInfo; give the ESI of the drive")
    vendor = _number(root.findtext("Vendor/Id")) or 0
    devices = tuple(_device(path, vendor, node) for node in root.iter("Device"))
    if not devices:
        raise DictionaryError(f"{path}: describes no device; get the whole ESI from the vendor")
    return devices


def _number(text: str | None) -> int | None:
    """Return the number in a text; None where there is none."""
    text = (text or "").strip().lower().replace("#x", "0x").replace("0x0x", "0x")
    return int(text, 0 if text.startswith("0x") else 10) if _NUMBER.fullmatch(text) else None


def _device(path: Path, vendor: int, node: ET.Element) -> EsiDictionary:
    kind = node.find("Type")
    codes = [_number(None if kind is None else kind.get(key)) for key in ("ProductCode", "RevisionNo")]
    title = (node.findtext("Name") or "").strip()
    device = EsiDictionary((vendor, codes[0] or 0, codes[1] or 0), title)
    types = {(of.findtext("Name") or "").strip(): of for of in node.iter("DataType") if of.find("Name") is not None}
    for item in node.iter("Object"):
        index = _number(item.findtext("Index"))
        if index is None or not 0 < index <= 0xFFFF:
            device.unread.append(f"{path}: object {item.findtext('Index')!r}: has no index; correct the file")
        elif index not in device.indices:
            device.add_object(_object(index, item, types))
            device.is_whole = True
    for tag, assignment in _ASSIGNMENTS.items():
        _add_pdos(device, list(node.iter(tag)), assignment)
    _add_identity(device)
    modes = [_number(mode.findtext("AssignActivate")) for mode in node.iterfind("Dc/OpMode")]
    device.assign_activate = next(filter(None, modes), None)  # 0 is the mode without SYNC0, which many list first
    device.startup = tuple(_startup(node))
    return device


def _startup(node: ET.Element) -> Iterator[Startup]:
    for command in node.iter("InitCmd"):
        index, data = _number(command.findtext("Index")), (command.findtext("Data") or "").strip()
        if index is not None and _BYTES.fullmatch(data):
            subindex = _number(command.findtext("SubIndex")) or 0
            yield Startup((command.findtext("Transition") or "").strip(), (index, subindex), bytes.fromhex(data))


# --- objects ------------------------------------------------------------------------------------------------------


def _object(index: int, item: ET.Element, types: dict[str, ET.Element]) -> ODVariable | ODRecord:
    name, kind = (item.findtext("Name") or f"object {index:04X}").strip(), (item.findtext("Type") or "").strip()
    members = list(types[kind].findall("SubItem")) if kind in types else []
    if not members:
        return _variable(name, index, 0, kind, item, item.find("Info"))
    holder, infos = ODRecord(name, index), item.findall("Info/SubItem")
    shared = (item.findtext("Flags/PdoMapping") or "").strip()
    for subindex, title, of, flags in _members(members, types):
        place = len(holder.subindices)
        info = infos[place].find("Info") if place < len(infos) else None
        while title in holder.names:
            title = f"{title} ({subindex})"  # canopen finds members by name first
        member = _variable(title, index, subindex, of, flags, info)
        member.pdo_mappable = member.pdo_mappable or bool(shared)
        if subindex not in holder.subindices:
            holder.add_member(member)
    return holder


def _members(items: list[ET.Element], types: dict[str, ET.Element]) -> Iterator[tuple[int, str, str, ET.Element]]:
    """Yield subindex, name, type and flags of the members of a record or array."""
    for item in items:
        subindex, kind = _number(item.findtext("SubIdx")), (item.findtext("Type") or "").strip()
        name = (item.findtext("Name") or "member").strip()
        if subindex is not None and 0 <= subindex <= _MOST_ELEMENTS:
            yield subindex, name, kind, item
        elif kind in types:  # the elements of an array
            of = types[kind]
            first, count = (_number(of.findtext(f"ArrayInfo/{key}")) for key in ("LBound", "Elements"))
            for n in range(min(count or 0, _MOST_ELEMENTS)):
                yield (first or 1) + n, f"{name} {n + 1}", (of.findtext("BaseType") or "").strip(), item


def _variable(
    name: str, index: int, subindex: int, kind: str, described: ET.Element, info: ET.Element | None
) -> ODVariable:
    variable = ODVariable(name, index, subindex)
    bits = _number(described.findtext("BitSize")) or 0
    variable.data_type = _data_type(kind, bits)
    access = (described.findtext("Flags/Access") or "rw").strip().lower()
    variable.access_type = access if access in ("ro", "wo", "rw") else "rw"
    variable.pdo_mappable = bool((described.findtext("Flags/PdoMapping") or "").strip())
    variable.default = _default(variable.data_type, info)
    return variable


def _data_type(kind: str, bits: int) -> int:
    if kind.startswith(("STRING", "ARRAY [")):
        return DataType.VISIBLE_STRING if kind.startswith("STRING") else DataType.OCTET_STRING
    return _TYPES.get(kind) or _OF_SIZE.get(bits, DataType.DOMAIN)


def _default(kind: int, info: ET.Element | None) -> Any:
    """Return the default value in the type of the object; None where the file states none that fits."""
    data, text = ((None if info is None else info.findtext(key)) for key in ("DefaultData", "DefaultString"))
    content = bytes.fromhex(data.strip()) if data and _BYTES.fullmatch(data.strip()) else None
    if kind == DataType.VISIBLE_STRING:
        return text if content is None else content.rstrip(b"\0").decode("latin-1")
    if kind in _REALS or kind in (DataType.OCTET_STRING, DataType.DOMAIN):
        return None
    value = _number(None if info is None else info.findtext("DefaultValue"))
    if content is not None:
        value = int.from_bytes(content, "little")
    bits = _SIGNED.get(DataType(kind), 0)
    return value - (1 << bits) if value is not None and bits and value >> (bits - 1) == 1 else value


# --- PDOs ---------------------------------------------------------------------------------------------------------


def _add_pdos(device: EsiDictionary, pdos: list[ET.Element], assignment: int) -> None:
    """Add the maps that a file states as PDOs only, and which of them are assigned."""
    assigned = []
    for pdo in pdos:
        index = _number(pdo.findtext("Index"))
        if index is None:
            continue
        entries = [_entry(entry) for entry in pdo.findall("Entry")]
        if index not in device.indices:
            is_fixed = pdo.get("Fixed", "0") in ("1", "true")
            device.add_object(_list_of(f"PDO {index:04X}", index, entries, DataType.UNSIGNED32, is_fixed))
        for entry in pdo.findall("Entry"):
            _add_mapped(device, entry, assignment)
        if pdo.get("Sm") is not None:
            assigned.append(index)
    if pdos and assignment not in device.indices:
        device.add_object(_list_of("PDO assignment", assignment, assigned, DataType.UNSIGNED16, False))


def add_process_data(device: EsiDictionary, pdos: Iterable[tuple[int, list[int], bool]], *, is_output: bool) -> None:
    """Add the PDOs of a device that lists nothing else.

    Args:
        device: The device.
        pdos: Index, mappings (UNSIGNED32) and whether it is assigned, of each PDO.
        is_output: Whether they are RxPDOs.
    """
    assigned = []
    for index, mappings, is_assigned in pdos:
        if index not in device.indices:
            device.add_object(_list_of(f"PDO {index:04X}", index, mappings, DataType.UNSIGNED32, True))
            assigned += [index] * is_assigned
    place = _ASSIGNMENTS["RxPdo" if is_output else "TxPdo"]
    if place not in device.indices:
        device.add_object(_list_of("PDO assignment", place, assigned, DataType.UNSIGNED16, False))


def _entry(entry: ET.Element) -> int:
    index, subindex, bits = (_number(entry.findtext(key)) or 0 for key in ("Index", "SubIndex", "BitLen"))
    return (index & 0xFFFF) << 16 | (subindex & 0xFF) << 8 | bits & 0xFF


def _list_of(name: str, index: int, values: list[int], kind: DataType, is_fixed: bool) -> ODRecord:
    holder, access = ODRecord(name, index), "ro" if is_fixed else "rw"
    for subindex, value in enumerate([len(values), *values]):
        member = ODVariable("count" if subindex == 0 else f"entry {subindex}", index, subindex)
        member.data_type, member.access_type = DataType.UNSIGNED8 if subindex == 0 else kind, access
        member.default = value
        holder.add_member(member)
    return holder


def _add_mapped(device: EsiDictionary, entry: ET.Element, assignment: int) -> None:
    """Add an object that a PDO maps and no dictionary describes."""
    mapping = _entry(entry)
    index, subindex, bits = mapping >> 16, mapping >> 8 & 0xFF, mapping & 0xFF
    if index == 0 or index in device.indices or subindex:
        return
    kind, name = (entry.findtext("DataType") or "").strip(), entry.findtext("Name") or ""
    variable = ODVariable(name.strip() or f"object {index:04X}", index, 0)
    variable.data_type, variable.pdo_mappable = _data_type(kind, bits), True
    variable.access_type = "rw" if assignment == _ASSIGNMENTS["RxPdo"] else "ro"
    device.add_object(variable)


def _add_identity(device: EsiDictionary) -> None:
    """Fill the identity object, of which many dictionaries state no values, from the device."""
    holder = device.indices.get(IDENTITY)
    if not isinstance(holder, ODRecord):
        holder = _list_of("Identity", IDENTITY, list(device.identity), DataType.UNSIGNED32, True)
        device.indices.pop(IDENTITY, None)
        device.add_object(holder)
    for subindex, number in enumerate(device.identity, 1):
        member = holder.subindices.get(subindex)
        if member is not None:
            member.default = number
