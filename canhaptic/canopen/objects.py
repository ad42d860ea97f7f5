"""Object indices, bits and codes of CiA 301 v4.2 and CiA 402 (IEC 61800-7-201), and the object dictionary protocol."""

from collections.abc import Iterator
from enum import IntEnum, IntFlag
from typing import Any, Final, Protocol

# --- CiA 301: communication profile -------------------------------------------------------------------------------
DEVICE_TYPE: Final = 0x1000
ERROR_REGISTER: Final = 0x1001
SYNC_COB_ID: Final = 0x1005
COMMUNICATION_CYCLE_PERIOD: Final = 0x1006
GUARD_TIME: Final = 0x100C
LIFE_TIME_FACTOR: Final = 0x100D
STORE_PARAMETERS: Final = 0x1010
RESTORE_PARAMETERS: Final = 0x1011
EMCY_COB_ID: Final = 0x1014
CONSUMER_HEARTBEAT_TIME: Final = 0x1016
PRODUCER_HEARTBEAT_TIME: Final = 0x1017
IDENTITY: Final = 0x1018
SYNC_COUNTER_OVERFLOW: Final = 0x1019
ERROR_BEHAVIOUR: Final = 0x1029
RPDO_COMMUNICATION: Final = 0x1400
RPDO_MAPPING: Final = 0x1600
TPDO_COMMUNICATION: Final = 0x1800
TPDO_MAPPING: Final = 0x1A00
PDO_COUNT: Final = 512  # of each direction

CIA402_PROFILE: Final = 0x0192  # low word of 0x1000 of every CiA 402 device
COB_ID_INVALID: Final = 1 << 31  # bit 31 of a PDO COB-ID: the PDO does not exist

# --- predefined connection set (CiA 301, 7.3.5) -------------------------------------------------------------------
NMT_COB_ID: Final = 0x000
SYNC_FRAME_COB_ID: Final = 0x080
EMCY_BASE: Final = 0x080
TPDO_BASE: Final = (0x180, 0x280, 0x380, 0x480)
RPDO_BASE: Final = (0x200, 0x300, 0x400, 0x500)
SDO_RESPONSE_BASE: Final = 0x580
SDO_REQUEST_BASE: Final = 0x600
HEARTBEAT_BASE: Final = 0x700

# --- CiA 402: drive profile ---------------------------------------------------------------------------------------
ABORT_CONNECTION_OPTION: Final = 0x6007
ERROR_CODE: Final = 0x603F
CONTROLWORD: Final = 0x6040
STATUSWORD: Final = 0x6041
QUICK_STOP_OPTION: Final = 0x605A
MODES_OF_OPERATION: Final = 0x6060
MODES_OF_OPERATION_DISPLAY: Final = 0x6061
POSITION_ACTUAL: Final = 0x6064
VELOCITY_ACTUAL: Final = 0x606C
TARGET_TORQUE: Final = 0x6071
MAX_TORQUE: Final = 0x6072
TORQUE_DEMAND: Final = 0x6074
RATED_CURRENT: Final = 0x6075
RATED_TORQUE: Final = 0x6076  # [mN*m]; torques are per mille of it
TORQUE_ACTUAL: Final = 0x6077
CURRENT_ACTUAL: Final = 0x6078
TARGET_POSITION: Final = 0x607A
HOME_OFFSET: Final = 0x607C
POSITION_LIMITS: Final = 0x607D
POLARITY: Final = 0x607E  # bit 7 turns the sign of the position, bit 6 that of the velocity
MAX_PROFILE_VELOCITY: Final = 0x607F
MAX_MOTOR_SPEED: Final = 0x6080
PROFILE_ACCELERATION: Final = 0x6083
PROFILE_DECELERATION: Final = 0x6084
QUICK_STOP_DECELERATION: Final = 0x6085
ENCODER_RESOLUTION: Final = 0x608F
GEAR_RATIO: Final = 0x6091
HOMING_METHOD: Final = 0x6098
HOMING_SPEEDS: Final = 0x6099  # 1: during the search for a switch; 2: for the zero
VELOCITY_UNIT: Final = 0x60A9
POSITION_OFFSET: Final = 0x60B0
VELOCITY_OFFSET: Final = 0x60B1
TORQUE_OFFSET: Final = 0x60B2
INTERPOLATION_PERIOD: Final = 0x60C2
MAX_ACCELERATION: Final = 0x60C5
MAX_DECELERATION: Final = 0x60C6
POSITIVE_TORQUE_LIMIT: Final = 0x60E0
NEGATIVE_TORQUE_LIMIT: Final = 0x60E1
DIGITAL_OUTPUTS: Final = 0x60FE  # subindex 1: the outputs; 2: which of them may be written
TARGET_VELOCITY: Final = 0x60FF
SUPPORTED_DRIVE_MODES: Final = 0x6502
AUTOZERO: Final = 0x6125  # of a CiA 404 transducer
ZERO_SIGNATURE: Final = int.from_bytes(b"zero", "little")  # value of 0x6125:01, for the same
AUTOTARE: Final = 0x6139  # of a CiA 404 transducer
TARE_SIGNATURE: Final = int.from_bytes(b"tara", "little")  # value of 0x6139:01 that takes the value of now for zero

HOMING: Final = 6  # value of 0x6060
CYCLIC_SYNC_POSITION: Final = 8
CYCLIC_SYNC_VELOCITY: Final = 9
CYCLIC_SYNC_TORQUE: Final = 10
CYCLIC_SYNC_TORQUE_BIT: Final = 1 << 9  # in 0x6502
SYNCHRONOUS_EVERY_SYNC: Final = 1  # PDO transmission type
EVENT_DRIVEN: Final = 255  # PDO transmission type


class NmtCommand(IntEnum):
    """NMT commands, the first byte of an NMT frame."""

    START = 0x01
    STOP = 0x02
    PRE_OPERATIONAL = 0x80
    RESET_NODE = 0x81
    RESET_COMMUNICATION = 0x82


class NmtState(IntEnum):
    """NMT states, the byte of a heartbeat."""

    BOOT_UP = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


class Controlword(IntEnum):
    """Commands of the controlword (0x6040)."""

    DISABLE_VOLTAGE = 0x00
    QUICK_STOP = 0x02
    SHUTDOWN = 0x06
    SWITCH_ON = 0x07
    ENABLE_OPERATION = 0x0F
    FAULT_RESET = 0x80


class StatusBit(IntFlag):
    """Bits of the statusword (0x6041)."""

    READY_TO_SWITCH_ON = 1 << 0
    SWITCHED_ON = 1 << 1
    OPERATION_ENABLED = 1 << 2
    FAULT = 1 << 3
    VOLTAGE_ENABLED = 1 << 4
    QUICK_STOP = 1 << 5
    SWITCH_ON_DISABLED = 1 << 6
    WARNING = 1 << 7
    REMOTE = 1 << 9
    TARGET_REACHED = 1 << 10
    INTERNAL_LIMIT = 1 << 11
    FOLLOWS_COMMAND = 1 << 12


class SdoAbort(IntEnum):
    """SDO abort codes (CiA 301, table 22)."""

    TOGGLE_BIT = 0x05030000
    TIMEOUT = 0x05040000
    COMMAND_SPECIFIER = 0x05040001
    OUT_OF_MEMORY = 0x05040005
    UNSUPPORTED_ACCESS = 0x06010000
    WRITE_ONLY = 0x06010001
    READ_ONLY = 0x06010002
    NO_OBJECT = 0x06020000
    NOT_MAPPABLE = 0x06040041
    PDO_LENGTH = 0x06040042
    PARAMETER_INCOMPATIBLE = 0x06040043
    LENGTH_TOO_HIGH = 0x06070012
    LENGTH_TOO_LOW = 0x06070013
    NO_SUBINDEX = 0x06090011
    VALUE_RANGE = 0x06090030
    VALUE_TOO_HIGH = 0x06090031
    VALUE_TOO_LOW = 0x06090032
    NOT_TRANSFERABLE = 0x08000020
    DEVICE_STATE = 0x08000022
    NO_DATA = 0x08000024


class DataType(IntEnum):
    """Data types of objects (CiA 301, table 44)."""

    BOOLEAN = 0x01
    INTEGER8 = 0x02
    INTEGER16 = 0x03
    INTEGER32 = 0x04
    UNSIGNED8 = 0x05
    UNSIGNED16 = 0x06
    UNSIGNED32 = 0x07
    REAL32 = 0x08
    VISIBLE_STRING = 0x09
    OCTET_STRING = 0x0A
    UNICODE_STRING = 0x0B
    DOMAIN = 0x0F
    INTEGER24 = 0x10
    REAL64 = 0x11
    INTEGER40 = 0x12
    INTEGER48 = 0x13
    INTEGER56 = 0x14
    INTEGER64 = 0x15
    UNSIGNED24 = 0x16
    UNSIGNED40 = 0x18
    UNSIGNED48 = 0x19
    UNSIGNED56 = 0x1A
    UNSIGNED64 = 0x1B


_FLAGS: Final = 0xE000_0000
"""Bits 29 to 31 of a COB-ID: 29-bit frame; no RTR, or sends SYNC; does not exist (CiA 301, 7.5.2)."""
_ONE_COB_ID: Final = frozenset({SYNC_COB_ID, 0x1012, EMCY_COB_ID})
_PARAMETERS: Final = {0x1200: (1, 2), 0x1400: (1,), 0x1800: (1,)}  # of SDO servers and clients, RPDOs, TPDOs


def without_flags(index: int, subindex: int, value: Any) -> Any:
    """Return the identifier if the object is a COB-ID, else the value: a limit of a COB-ID does not mean its flags."""
    first = 0x1200 if 0x1200 <= index < 0x1300 else index & ~0x1FF
    is_cob_id = index in _ONE_COB_ID or subindex in _PARAMETERS.get(first, ())
    return value & ~_FLAGS if is_cob_id and isinstance(value, int) else value


class Variable(Protocol):
    """One object, or one subindex of it (CiA 306)."""

    name: str
    index: int
    subindex: int
    data_type: int | None
    """A `DataType`; None if the file does not state it."""
    access_type: str
    """ro, wo, rw, rwr, rww or const."""
    default: Any
    value: Any
    """ParameterValue of a DCF; None if not given."""
    min: int | None
    max: int | None
    pdo_mappable: bool

    @property
    def readable(self) -> bool:
        """Whether the object may be read by SDO."""

    @property
    def writable(self) -> bool:
        """Whether the object may be written by SDO."""


class Dictionary(Protocol):
    """Object dictionary of one drive, by index."""

    def __contains__(self, index: int, /) -> bool:
        """Whether an object is listed."""

    def __iter__(self) -> Iterator[int]:
        """Yield the indices."""

    def __getitem__(self, index: int, /) -> Any:
        """Return an object: a `Variable`, or an entry with `subindices`."""

    def get_variable(self, index: int, subindex: int = 0) -> Variable | None:
        """Return an object or one of its subindices; None if it is not listed."""


def variables(dictionary: Dictionary) -> Iterator[Variable]:
    """Yield every simple object, and every subindex of the others."""
    for index in dictionary:
        item = dictionary[index]
        members = getattr(item, "subindices", None)
        yield from (item,) if members is None else members.values()


def is_writable(dictionary: Dictionary, index: int, subindex: int = 0) -> bool:
    """Return whether the dictionary lists the object as writable."""
    variable = dictionary.get_variable(index, subindex)
    return variable is not None and bool(variable.writable)
