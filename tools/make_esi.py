"""Writes the project's own ESI of a generic CiA 402 servo on EtherCAT (ETG.2000) into eds/ethercat_servo.xml.

Its objects are those of the generic EDS: torque, velocity and position in cyclic modes, with two analog inputs.

python -m tools.make_esi           writes the file
python -m tools.make_esi --check   exits with 1 when it differs from what would be written
"""

import argparse
import sys
import xml.etree.ElementTree as ET
from typing import Final

from tools import make_eds as eds
from tools.make_eds import I8, I16, I32, RPDO_MAPS, TEXT, TPDO_MAPS, U8, U16, U32, Holder, Variable

PATH: Final = eds.PATH.with_name("ethercat_servo.xml")
VENDOR, PRODUCT, REVISION = 0xABC, 0x1234, 1
_TYPES: Final = {I8: "SINT", I16: "INT", I32: "DINT", U8: "USINT", U16: "UINT", U32: "UDINT"}
_BITS: Final = {I8: 8, I16: 16, I32: 32, U8: 8, U16: 16, U32: 32}
_CAN_ONLY: Final = (0x1005, 0x1006, 0x1014, 0x1016, 0x1017, 0x1029, 0x1200)
_OF_THE_OLDER: Final = ("1000", "1008", "1018", "1C00", "1C12", "1C13", "6040", "6041", "6064")
_MANAGERS: Final = ((0x1000, 128, 0x26, "MBoxOut"), (0x1080, 128, 0x22, "MBoxIn"), (0x1100, 4, 0x64, "Outputs"),
                    (0x1400, 8, 0x20, "Inputs"))  # fmt: skip


def _assignment(name: str, first: int) -> Holder:
    values = (first, 0, 0, 0)
    entries = {n: Variable(f"PDO {n}", U16, "rw", value, 0, 0xFFFF) for n, value in enumerate(values, 1)}
    return Holder(name, 8, {0: Variable("Number of assigned PDOs", U8, "rw", 1, 0, 4), **entries})


def _synchronization(name: str) -> Holder:
    members = {
        0: Variable("Highest sub-index supported", U8, "ro", 12),
        1: Variable("Synchronization type", U16, "rw", 1),
        2: Variable("Cycle time", U32, "rw", 1_000_000),
        4: Variable("Synchronization types supported", U16, "ro", 0x4007),
        5: Variable("Minimum cycle time", U32, "ro", 125_000),
        6: Variable("Calc and copy time", U32, "ro", 20_000),
        9: Variable("Delay time", U32, "ro", 0),
        11: Variable("SM event missed", U16, "ro", 0),
        12: Variable("Cycle time too small", U16, "ro", 0),
    }
    return Holder(name, 9, members)


def objects() -> dict[int, Variable | Holder]:
    """Returns the objects of the drive by index."""
    every = eds.communication_profile() | eds.drive_profile() | eds.motion_profile()
    found = {i: of for i, of in every.items() if i not in _CAN_ONLY}
    found = {i: of for i, of in found.items() if not (0x1400 <= i < 0x1600 or 0x1800 <= i < 0x1A00)}
    identity = found[0x1018]
    assert isinstance(identity, Holder)
    numbers = dict(enumerate((VENDOR, PRODUCT, REVISION), 1))
    members = {n: of._replace(default=numbers.get(n, of.default)) for n, of in identity.members.items()}
    managers = {n: Variable(f"Sync manager {n - 1}", U8, "ro", n) for n in (1, 2, 3, 4)}
    return dict(sorted({
        **found,
        0x1008: Variable("Manufacturer device name", TEXT, "const", "canhaptic generic CiA 402 servo on EtherCAT"),
        0x1018: identity._replace(members=members),
        0x10F1: Holder("Error settings", 9, {
            0: Variable("Highest sub-index supported", U8, "ro", 2),
            1: Variable("Local error reaction", U32, "rw", 1),
            2: Variable("Sync error counter limit", U16, "rw", 4),
        }),
        0x1C00: Holder("Sync manager type", 8, {0: Variable("Number of sync managers", U8, "ro", 4), **managers}),
        0x1C12: _assignment("RxPDO assign", 0x1600),
        0x1C13: _assignment("TxPDO assign", 0x1A00),
        0x1C32: _synchronization("SM output parameter"),
        0x1C33: _synchronization("SM input parameter"),
    }.items()))  # fmt: skip


def _put(parent: ET.Element, tag: str, text: str | None = None, **attributes: str) -> ET.Element:
    node = ET.SubElement(parent, tag, attributes)
    node.text = text
    return node


def _kind(variable: Variable) -> tuple[str, int]:
    if variable.data_type == TEXT:
        length = len(str(variable.default))
        return f"STRING({length})", 8 * length
    return _TYPES[variable.data_type], _BITS[variable.data_type]


def _describe(node: ET.Element, variable: Variable) -> None:
    """Adds type, length, and with them access and mapping."""
    kind, bits = _kind(variable)
    _put(node, "Type", kind)
    _put(node, "BitSize", str(bits))


def _flags(node: ET.Element, variable: Variable) -> None:
    flags = _put(node, "Flags")
    _put(flags, "Access", {"rww": "rw", "const": "ro"}.get(variable.access, variable.access))
    if variable.is_mappable:
        _put(flags, "PdoMapping", "T" if variable.access in ("ro", "const") else "R")


def _info(node: ET.Element, variable: Variable) -> None:
    if variable.default is None:
        return
    if variable.data_type == TEXT:
        _put(node, "DefaultString", str(variable.default))
        return
    number = int(str(variable.default), 0)
    _put(node, "DefaultData", (number & (1 << _BITS[variable.data_type]) - 1).to_bytes(
        _BITS[variable.data_type] // 8, "little").hex().upper())  # fmt: skip


def _add_dictionary(device: ET.Element) -> None:
    profile = _put(device, "Profile")
    _put(profile, "ProfileNo", "402")
    dictionary = _put(profile, "Dictionary")
    types, listed = _put(dictionary, "DataTypes"), _put(dictionary, "Objects")
    for data_type, name in _TYPES.items():
        node = _put(types, "DataType")
        _put(node, "Name", name)
        _put(node, "BitSize", str(_BITS[data_type]))
    for index, item in objects().items():
        node = _put(listed, "Object")
        _put(node, "Index", f"#x{index:04X}")
        _put(node, "Name", item.name)
        if isinstance(item, Variable):
            _describe(node, item)
            _info(_put(node, "Info"), item)
            _flags(node, item)
            continue
        kind = _put(types, "DataType")
        _put(kind, "Name", f"DT{index:04X}")
        _put(kind, "BitSize", str(sum(_kind(of)[1] for of in item.members.values())))
        _put(node, "Type", f"DT{index:04X}")
        info = _put(node, "Info")
        for subindex, member in sorted(item.members.items()):
            sub = _put(kind, "SubItem")
            _put(sub, "SubIdx", str(subindex))
            _put(sub, "Name", member.name)
            _describe(sub, member)
            _flags(sub, member)
            value = _put(info, "SubItem")
            _put(value, "Name", member.name)
            _info(_put(value, "Info"), member)


def _add_pdo(device: ET.Element, tag: str, index: int, entries: tuple[int, ...], manager: int | None) -> None:
    pdo = _put(device, tag, None, **({} if manager is None else {"Sm": str(manager)}))
    _put(pdo, "Index", f"#x{index:04X}")
    _put(pdo, "Name", f"{tag} {index & 0xFF}")
    known = objects()
    for entry in entries:
        variable = known[entry >> 16]
        assert isinstance(variable, Variable)
        node = _put(pdo, "Entry")
        _put(node, "Index", f"#x{entry >> 16:04X}")
        _put(node, "SubIndex", str(entry >> 8 & 0xFF))
        _put(node, "BitLen", str(entry & 0xFF))
        _put(node, "Name", variable.name)
        _put(node, "DataType", _kind(variable)[0])


def make_esi() -> str:
    """Returns the text of the file."""
    root = ET.Element("EtherCATInfo", {"Version": "1.6"})
    vendor = _put(root, "Vendor")
    _put(vendor, "Id", f"#x{VENDOR:X}")
    _put(vendor, "Name", "canhaptic")
    device = _put(_put(_put(root, "Descriptions"), "Devices"), "Device", None, Physics="YY")
    _put(device, "Type", "ethercat_servo", ProductCode=f"#x{PRODUCT:X}", RevisionNo=f"#x{REVISION:X}")
    _put(device, "Name", "generic CiA 402 servo on EtherCAT")
    _add_dictionary(device)
    for start, size, control, kind in _MANAGERS:
        _put(device, "Sm", kind, DefaultSize=str(size), StartAddress=f"#x{start:X}", ControlByte=f"#x{control:X}",
             Enable="1")  # fmt: skip
    for tag, first, maps, manager in (("RxPdo", 0x1600, RPDO_MAPS, 2), ("TxPdo", 0x1A00, TPDO_MAPS, 3)):
        for number, entries in enumerate(maps):
            _add_pdo(device, tag, first + number, entries, None if number else manager)
    mailbox = _put(device, "Mailbox")
    _put(mailbox, "CoE", None, SdoInfo="1", PdoAssign="1", PdoConfig="1", CompleteAccess="0")
    mode = _put(_put(device, "Dc"), "OpMode")
    _put(mode, "Name", "DC")
    _put(mode, "AssignActivate", "#x0300")
    ET.indent(root)
    comment = "<!-- Written by tools/make_esi.py of the canhaptic project; MIT licence. -->"
    return f'<?xml version="1.0" encoding="utf-8"?>\n{comment}\n{ET.tostring(root, encoding="unicode")}\n'


def make_two_revisions(older: int = 1, newer: int = 0x10420) -> str:
    """Returns an ESI of one product in two revisions, of which the older lists nine objects and no torque."""
    root = ET.fromstring(make_esi())
    devices = root.find("Descriptions/Devices")
    assert devices is not None
    [device] = devices
    first = ET.fromstring(ET.tostring(device))
    for node, revision in ((first, older), (device, newer)):
        kind = node.find("Type")
        assert kind is not None
        kind.set("RevisionNo", f"#x{revision:X}")
    listed = first.find("Profile/Dictionary/Objects")
    assert listed is not None
    for item in [of for of in listed if of.findtext("Index", "")[2:] not in _OF_THE_OLDER]:
        listed.remove(item)
    for pdo in [of for of in first if of.tag in ("RxPdo", "TxPdo")]:
        if any(entry.findtext("Index") == "#x6071" for entry in pdo):
            first.remove(pdo)
    devices.insert(0, first)
    return ET.tostring(root, encoding="unicode")


def main() -> int:
    """Writes or checks the file; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="only compare the file with what would be written")
    text = make_esi()
    if parser.parse_args().check:
        return 0 if PATH.is_file() and PATH.read_text(encoding="utf-8") == text else 1
    PATH.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
