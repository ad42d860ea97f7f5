"""Writes the project's own dictionaries of generic CiA 402 servos (CiA 306) into eds/.

cia402_servo.eds       cyclic torque
cia402_admittance.eds  cyclic position, velocity and torque, with two analog inputs

python tools/make_eds.py           writes the files
python tools/make_eds.py --check   exits with 1 when a file differs from what would be written
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

_FOLDER: Final = Path(__file__).resolve().parents[1] / "eds"
PATH: Final = _FOLDER / "cia402_servo.eds"
ADMITTANCE_PATH: Final = _FOLDER / "cia402_admittance.eds"

I8, I16, I32, U8, U16, U32, TEXT = 0x02, 0x03, 0x04, 0x05, 0x06, 0x07, 0x09
_VAR, _ARRAY, _RECORD = 7, 8, 9
_MANDATORY: Final = (0x1000, 0x1001, 0x1018)
_INVALID: Final = 0x8000_0000  # a PDO that does not exist until its COB-ID is written


class Variable(NamedTuple):
    """One variable; a default of None means that the dictionary cannot know it."""

    name: str
    data_type: int
    access: str = "ro"
    default: int | str | None = None
    low: int | None = None
    high: int | None = None
    is_mappable: bool = False


class Holder(NamedTuple):
    """An array or record: subindex -> variable."""

    name: str
    object_type: int
    members: dict[int, Variable]


def _count(number: int, access: str = "const", high: int | None = None) -> Variable:
    limits = (None, None) if high is None else (0, high)
    return Variable("Highest sub-index supported", U8, access, number, *limits)


def _array(name: str, *members: Variable, access: str = "const") -> Holder:
    return Holder(name, _ARRAY, {0: _count(len(members), access), **dict(enumerate(members, 1))})


def _record(name: str, *members: Variable) -> Holder:
    return Holder(name, _RECORD, {0: _count(len(members)), **dict(enumerate(members, 1))})


def _communication(kind: str, number: int, base: int, transmission_type: int) -> Holder:
    offset = base + 0x100 * number + (0 if number == 0 else _INVALID)
    members = {
        0: _count(5),
        1: Variable("COB-ID used by PDO", U32, "rw", f"$NODEID+0x{offset:08X}"),
        2: Variable("Transmission type", U8, "rw", transmission_type, 0, 255),
        3: Variable("Inhibit time", U16, "rw", 0),
        5: Variable("Event timer", U16, "rw", 0),
    }
    if kind == "RPDO":
        del members[3]
    return Holder(f"{kind} {number + 1} communication parameter", _RECORD, members)


def _mapping(kind: str, number: int, *entries: int) -> Holder:
    slots = [Variable(f"Mapped object {i}", U32, "rw", _hex(value, 8)) for i, value in enumerate(_padded(entries), 1)]
    count = Variable("Number of mapped objects", U8, "rw", len(entries), 0, 8)
    return Holder(f"{kind} {number + 1} mapping parameter", _RECORD, {0: count, **dict(enumerate(slots, 1))})


def _padded(entries: tuple[int, ...]) -> list[int]:
    return [*entries, *[0] * (8 - len(entries))]


def _hex(value: int, digits: int) -> str:
    return f"0x{value:0{digits}X}"


CONTROLWORD, STATUSWORD, MODE, MODE_DISPLAY = 0x60400010, 0x60410010, 0x60600008, 0x60610008
POSITION, VELOCITY, TARGET_TORQUE, MAX_TORQUE = 0x60640020, 0x606C0020, 0x60710010, 0x60720010
TORQUE_DEMAND, TORQUE, CURRENT, DC_LINK, ERROR = 0x60740010, 0x60770010, 0x60780010, 0x60790020, 0x603F0010

RPDO_MAPS: Final = ((CONTROLWORD, TARGET_TORQUE), (CONTROLWORD, MODE), (MAX_TORQUE,), ())
TPDO_MAPS: Final = (
    (STATUSWORD, POSITION, TORQUE_DEMAND),
    (POSITION, VELOCITY),
    (TORQUE, CURRENT),
    (ERROR, MODE_DISPLAY, DC_LINK),
)


def communication_profile() -> dict[int, Variable | Holder]:
    """Returns the objects of CiA 301 by index."""
    error_fields = [Variable(f"Standard error field {i}", U32) for i in range(1, 9)]
    history = {0: Variable("Number of errors", U8, "rw", 0), **dict(enumerate(error_fields, 1))}
    objects: dict[int, Variable | Holder] = {
        0x1000: Variable("Device type", U32, "ro", _hex(0x00020192, 8)),
        0x1001: Variable("Error register", U8, "ro", 0, is_mappable=True),
        0x1003: Holder("Pre-defined error field", _ARRAY, history),
        0x1005: Variable("COB-ID SYNC message", U32, "rw", _hex(0x80, 8)),
        0x1006: Variable("Communication cycle period", U32, "rw", 0),
        0x1008: Variable("Manufacturer device name", TEXT, "const", "canhaptic generic CiA 402 servo"),
        0x1009: Variable("Manufacturer hardware version", TEXT, "const", "simulated"),
        0x100A: Variable("Manufacturer software version", TEXT, "const", "1.0"),
        0x1014: Variable("COB-ID EMCY", U32, "rw", "$NODEID+0x00000080"),
        0x1016: _array("Consumer heartbeat time", *[Variable(f"Node {i}", U32, "rw", 0) for i in (1, 2)]),
        0x1017: Variable("Producer heartbeat time", U16, "rw", 0),
        0x1018: _record(
            "Identity object",
            Variable("Vendor-ID", U32, "ro", 0),
            Variable("Product code", U32, "ro", 402),
            Variable("Revision number", U32, "ro", _hex(0x00010000, 8)),
            Variable("Serial number", U32, "ro", 0),
        ),
        0x1029: _array("Error behaviour", Variable("Communication error", U8, "rw", 0, 0, 2)),
        0x1200: _record(
            "SDO server parameter",
            Variable("COB-ID client to server", U32, "ro", "$NODEID+0x00000600"),
            Variable("COB-ID server to client", U32, "ro", "$NODEID+0x00000580"),
        ),
    }
    for number, (rpdo, tpdo) in enumerate(zip(RPDO_MAPS, TPDO_MAPS, strict=True)):
        objects[0x1400 + number] = _communication("RPDO", number, 0x200, 255)
        objects[0x1600 + number] = _mapping("RPDO", number, *rpdo)
        objects[0x1800 + number] = _communication("TPDO", number, 0x180, 1)
        objects[0x1A00 + number] = _mapping("TPDO", number, *tpdo)
    return objects


def drive_profile() -> dict[int, Variable | Holder]:
    """Returns the objects of a CiA 402 drive with cyclic torque by index."""
    return {
        0x6007: Variable("Abort connection option code", I16, "rw", 1, 0, 3),
        0x603F: Variable("Error code", U16, "ro", 0, is_mappable=True),
        0x6040: Variable("Controlword", U16, "rww", 0, is_mappable=True),
        0x6041: Variable("Statusword", U16, "ro", is_mappable=True),
        0x605A: Variable("Quick stop option code", I16, "rw", 2, 0, 8),
        0x605B: Variable("Shutdown option code", I16, "rw", 0, 0, 1),
        0x605C: Variable("Disable operation option code", I16, "rw", 1, 0, 1),
        0x605D: Variable("Halt option code", I16, "rw", 1, 1, 4),
        0x605E: Variable("Fault reaction option code", I16, "rw", 2, 0, 4),
        0x6060: Variable("Modes of operation", I8, "rww", 0, 0, 10, is_mappable=True),
        0x6061: Variable("Modes of operation display", I8, "ro", 0, is_mappable=True),
        0x6064: Variable("Position actual value", I32, "ro", is_mappable=True),
        0x606C: Variable("Velocity actual value", I32, "ro", is_mappable=True),
        0x6071: Variable("Target torque", I16, "rww", 0, is_mappable=True),
        0x6072: Variable("Max torque", U16, "rww", 1000, is_mappable=True),
        0x6074: Variable("Torque demand", I16, "ro", is_mappable=True),
        0x6075: Variable("Motor rated current", U32, "rw"),
        0x6076: Variable("Motor rated torque", U32, "rw"),
        0x6077: Variable("Torque actual value", I16, "ro", is_mappable=True),
        0x6078: Variable("Current actual value", I16, "ro", is_mappable=True),
        0x6079: Variable("DC link circuit voltage", U32, "ro", 48000, is_mappable=True),
        0x608F: _array(
            "Position encoder resolution",
            Variable("Encoder increments", U32, "rw"),
            Variable("Motor revolutions", U32, "rw"),
        ),
        0x6091: _array(
            "Gear ratio", Variable("Motor revolutions", U32, "rw", 1), Variable("Shaft revolutions", U32, "rw", 1)
        ),
        0x60C2: _record(
            "Interpolation time period",
            Variable("Interpolation time period value", U8, "rw", 1),
            Variable("Interpolation time index", I8, "rw", -3, -128, 63),
        ),
        0x6502: Variable("Supported drive modes", U32, "ro", _hex(0x200, 8)),
    }


def motion_profile() -> dict[int, Variable | Holder]:
    """Returns what a drive for admittance displays has besides, or in place of the same."""
    return {
        0x2205: _array(
            "Analog input",
            Variable("Analog input 1", I16, "ro", is_mappable=True),
            Variable("Analog input 2", I16, "ro", is_mappable=True),
        ),
        0x607A: Variable("Target position", I32, "rww", 0, is_mappable=True),
        0x6083: Variable("Profile acceleration", U32, "rww", 10000, is_mappable=True),
        0x6084: Variable("Profile deceleration", U32, "rww", 10000, is_mappable=True),
        0x6085: Variable("Quick stop deceleration", U32, "rww", 10000, is_mappable=True),
        0x60B1: Variable("Velocity offset", I32, "rww", 0, is_mappable=True),
        0x60B2: Variable("Torque offset", I16, "rww", 0, is_mappable=True),
        0x60C5: Variable("Max acceleration", U32, "rww", _hex(0xFFFFFFFF, 8), is_mappable=True),
        0x60C6: Variable("Max deceleration", U32, "rww", _hex(0xFFFFFFFF, 8), is_mappable=True),
        0x60F4: Variable("Following error actual value", I32, "ro", is_mappable=True),
        0x60FF: Variable("Target velocity", I32, "rww", 0, is_mappable=True),
        0x6502: Variable("Supported drive modes", U32, "ro", _hex(0x380, 8)),
    }


def _variable_lines(section: str, variable: Variable) -> Iterator[str]:
    yield f"[{section}]"
    yield f"ParameterName={variable.name}"
    yield f"ObjectType=0x{_VAR:X}"
    yield f"DataType=0x{variable.data_type:04X}"
    if variable.low is not None:
        yield f"LowLimit={variable.low}"
    if variable.high is not None:
        yield f"HighLimit={variable.high}"
    yield f"AccessType={variable.access}"
    if variable.default is not None:
        yield f"DefaultValue={variable.default}"
    yield f"PDOMapping={int(variable.is_mappable)}"
    yield ""


def _object_lines(index: int, item: Variable | Holder) -> Iterator[str]:
    if isinstance(item, Variable):
        yield from _variable_lines(f"{index:04X}", item)
        return
    yield from (f"[{index:04X}]", f"ParameterName={item.name}", f"ObjectType=0x{item.object_type:X}")
    yield from (f"SubNumber={len(item.members)}", "")
    for subindex, member in sorted(item.members.items()):
        yield from _variable_lines(f"{index:04X}sub{subindex:X}", member)


def _list_lines(section: str, indices: list[int]) -> Iterator[str]:
    yield f"[{section}]"
    yield f"SupportedObjects={len(indices)}"
    yield from (f"{number}=0x{index:04X}" for number, index in enumerate(indices, 1))
    yield ""


_HEAD: Final = """\
[FileInfo]
FileName=cia402_servo.eds
FileVersion=1
FileRevision=0
EDSVersion=4.0
Description=Generic CiA 402 servo drive for cyclic synchronous torque
CreationTime=09:00AM
CreationDate=11-20-2026
CreatedBy=canhaptic
ModificationTime=09:00AM
ModificationDate=11-20-2026
ModifiedBy=canhaptic

[DeviceInfo]
VendorName=canhaptic
VendorNumber=0
ProductName=generic CiA 402 servo
ProductNumber=402
RevisionNumber=0x00010000
OrderCode=cia402_servo
BaudRate_10=0
BaudRate_20=1
BaudRate_50=1
BaudRate_125=1
BaudRate_250=1
BaudRate_500=1
BaudRate_800=1
BaudRate_1000=1
SimpleBootUpMaster=0
SimpleBootUpSlave=1
Granularity=8
DynamicChannelsSupported=0
GroupMessaging=0
NrOfRXPDO=4
NrOfTXPDO=4
LSS_Supported=0

[DummyUsage]
Dummy0001=0
Dummy0002=1
Dummy0003=1
Dummy0004=1
Dummy0005=1
Dummy0006=1
Dummy0007=1

[Comments]
Lines=3
Line1=Written by tools/make_eds.py of the canhaptic project; MIT licence.
Line2=Objects without DefaultValue are known to the rig alone: rated torque and current, encoder resolution.
Line3=Only cyclic synchronous torque is supported (0x6502 = 0x200).
"""


def make_eds() -> str:
    """Returns the text of the dictionary for cyclic torque."""
    return _text(_HEAD, communication_profile() | drive_profile())


def make_admittance_eds() -> str:
    """Returns the text of the dictionary for admittance displays."""
    head = _HEAD.replace("cia402_servo", "cia402_admittance").replace("ProductNumber=402", "ProductNumber=403")
    head = head.replace("for cyclic synchronous torque", "for admittance displays")
    head = head.replace(
        "Only cyclic synchronous torque is supported (0x6502 = 0x200).", "Modes 8, 9, 10 (0x6502 = 0x380)."
    )
    return _text(head, communication_profile() | drive_profile() | motion_profile())


def _text(head: str, unsorted: dict[int, Variable | Holder]) -> str:
    objects = dict(sorted(unsorted.items()))
    manufacturer = [index for index in objects if 0x2000 <= index < 0x6000]
    optional = [index for index in objects if index not in (*_MANDATORY, *manufacturer)]
    lines = [
        *_list_lines("MandatoryObjects", list(_MANDATORY)),
        *_list_lines("OptionalObjects", optional),
        *_list_lines("ManufacturerObjects", manufacturer),
    ]
    for index, item in objects.items():
        lines += _object_lines(index, item)
    return head + "\n" + "\n".join(lines).rstrip("\n") + "\n"


def main() -> int:
    """Writes or checks the files; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="only compare the files with what would be written")
    texts = {PATH: make_eds(), ADMITTANCE_PATH: make_admittance_eds()}
    if parser.parse_args().check:
        return 0 if all(path.is_file() and path.read_text(encoding="utf-8") == texts[path] for path in texts) else 1
    for path, text in texts.items():
        path.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
