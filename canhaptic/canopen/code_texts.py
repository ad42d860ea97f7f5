"""Texts for the codes of CiA 301 and IEC 61800-7-201 (CiA 402): SDO aborts, EMCY error codes, NMT, controlwords."""

from collections.abc import Mapping
from typing import Final

_SDO_ABORT_TEXTS: Final = {  # CiA 301, table 22
    0x05030000: "toggle bit not alternated",
    0x05040000: "SDO protocol timed out",
    0x05040001: "client/server command specifier not valid or unknown",
    0x05040002: "invalid block size",
    0x05040003: "invalid sequence number",
    0x05040004: "CRC error",
    0x05040005: "out of memory",
    0x06010000: "unsupported access to an object",
    0x06010001: "attempt to read a write-only object",
    0x06010002: "attempt to write a read-only object",
    0x06020000: "object does not exist in the object dictionary",
    0x06040041: "object cannot be mapped to the PDO",
    0x06040042: "number and length of the objects to be mapped would exceed the PDO length",
    0x06040043: "general parameter incompatibility",
    0x06040047: "general internal incompatibility in the device",
    0x06060000: "access failed due to a hardware error",
    0x06070010: "data type does not match, length of service parameter does not match",
    0x06070012: "data type does not match, length of service parameter too high",
    0x06070013: "data type does not match, length of service parameter too low",
    0x06090011: "subindex does not exist",
    0x06090030: "invalid value for parameter",
    0x06090031: "value of parameter written too high",
    0x06090032: "value of parameter written too low",
    0x06090036: "maximum value is less than minimum value",
    0x060A0023: "resource not available: SDO connection",
    0x08000000: "general error",
    0x08000020: "data cannot be transferred or stored to the application",
    0x08000021: "data cannot be transferred or stored to the application because of local control",
    0x08000022: "data cannot be transferred or stored to the application because of the present device state",
    0x08000023: "object dictionary dynamic generation fails or no object dictionary is present",
    0x08000024: "no data available",
}

_EMCY_TEXTS: Final = {  # CiA 301, table 26, and IEC 61800-7-201, table of error codes
    0x0000: "error reset or no error",
    0x1000: "generic error",
    0x2000: "current",
    0x2100: "current, device input side",
    0x2200: "current inside the device",
    0x2300: "current, device output side",
    0x2310: "continuous over-current",
    0x2320: "short circuit or earth leakage",
    0x3000: "voltage",
    0x3100: "mains voltage",
    0x3110: "mains over-voltage",
    0x3120: "mains under-voltage",
    0x3200: "voltage inside the device",
    0x3210: "DC link over-voltage",
    0x3220: "DC link under-voltage",
    0x3300: "output voltage",
    0x4000: "temperature",
    0x4100: "ambient temperature",
    0x4200: "device temperature",
    0x4210: "excess temperature of the device",
    0x4300: "drive temperature",
    0x4310: "excess temperature of the drive",
    0x5000: "device hardware",
    0x5100: "supply of the device hardware",
    0x5441: "contactor or brake",
    0x5530: "non-volatile memory",
    0x6000: "device software",
    0x6100: "internal software",
    0x6010: "software reset (watchdog)",
    0x6200: "user software",
    0x6300: "data set",
    0x6320: "parameter error",
    0x7000: "additional modules",
    0x7120: "motor",
    0x7121: "motor blocked",
    0x7180: "motor protection (I2t)",
    0x7300: "sensor",
    0x7305: "incremental sensor 1",
    0x7306: "incremental sensor 2",
    0x7310: "speed",
    0x7320: "position",
    0x7500: "communication",
    0x8000: "monitoring",
    0x8100: "communication",
    0x8110: "CAN overrun, objects lost",
    0x8120: "CAN in error passive mode",
    0x8130: "life guard or heartbeat error",
    0x8140: "recovered from bus off",
    0x8150: "CAN-ID collision",
    0x8200: "protocol error",
    0x8210: "PDO not processed due to length error",
    0x8220: "PDO length exceeded",
    0x8230: "DAM MPDO not processed, destination object not available",
    0x8240: "unexpected SYNC data length",
    0x8250: "RPDO timeout",
    0x8300: "torque control",
    0x8311: "excess torque",
    0x8400: "velocity speed controller",
    0x8500: "position controller",
    0x8600: "positioning controller",
    0x8611: "following error",
    0x8612: "reference limit",
    0x8700: "SYNC controller",
    0x9000: "external error",
    0xF000: "additional functions",
    0xFF00: "device-specific",
}

_EMCY_REMEDIES: Final = {  # code, or its group with zeros behind; `silence` [ms] and `skipped` are filled in
    0x2300: "check the motor and its cable for a short circuit, and lower torque_limit",
    0x3000: "check the supply of the power stage",
    0x4000: "let drive and motor cool, and lower torque_limit",
    0x7100: "check that the motor turns freely, and lower torque_limit",
    0x7300: "check the encoder and its cable",
    0x8110: "check what else loads the bus",
    0x8120: "check cable, termination and bit rate",
    0x8130: "the drive missed the heartbeat of this computer for {silence:g} ms; this computer skipped {skipped} "
    "cycles: see `canhaptic check`, host, and check the cable",
    0x8140: "check cable, termination and bit rate",
    0x8150: "another node has the same node ID; change one of them",
    0x8210: "an RPDO came with another length than the drive maps: end the other program that sends on its COB-ID",
    0x8240: "the drive waits for a SYNC with another length: set its 0x1019 to 0 (this master counts no SYNCs)",
    0x8250: "the drive missed the RPDOs of this computer; this computer skipped {skipped} cycles: see "
    "`canhaptic check`, host, and check the cable",
    0x8611: "the position was farther from its target than 0x6065 of the drive allows, for longer than 0x6066: widen "
    "them with the vendor's tool, lower acceleration_limit and speed_limit, and check what holds the motor",
    0x8612: "a target was beyond 0x607D or 0x607B of the drive: set position_low and position_high within them",
    0x8700: "the drive missed the SYNC of this computer; this computer skipped {skipped} cycles: set the drive's "
    "0x1006 (cycle period) to that of bus.rate and its 0x1019 (SYNC counter) to 0, and see `canhaptic check`, host",
}

_EMCY_MASKS: Final = (0xFFFF, 0xFFF0, 0xFF00, 0xF000)  # of an error code: itself, then ever wider groups

NMT_COMMAND_TEXTS: Final = {
    0x01: "start (operational)",
    0x02: "stop",
    0x80: "enter pre-operational",
    0x81: "reset node",
    0x82: "reset communication",
}

NMT_STATE_TEXTS: Final = {0x00: "boot-up", 0x04: "stopped", 0x05: "operational", 0x7F: "pre-operational"}

_CONTROLWORD_TEXTS: Final = (  # (mask, value, command), IEC 61800-7-201, table 28
    (0x80, 0x80, "fault reset"),
    (0x87, 0x06, "shutdown"),
    (0x8F, 0x07, "switch on"),
    (0x8F, 0x0F, "enable operation"),
    (0x86, 0x02, "quick stop"),
    (0x82, 0x00, "disable voltage"),
)


def emcy_text(code: int) -> str:
    """Text of an EMCY error code, or else of its group (0x8611 -> 0x8600 -> 0x8000)."""
    return _of_code_or_group(_EMCY_TEXTS, code) or "unknown error code"


def emcy_remedy(code: int, silence: float, skipped: int) -> str:
    """Remedy for an EMCY error code; "" where the code belongs to the drive's own manual.

    Args:
        code: Error code (0x603F).
        silence: Silence of this computer that the drive is set to tolerate [s].
        skipped: Number of SYNCs that this computer skipped.
    """
    return _of_code_or_group(_EMCY_REMEDIES, code).format(silence=silence * 1e3, skipped=skipped)


def _of_code_or_group(texts: Mapping[int, str], code: int) -> str:
    """Return the text of a code, else of the narrowest group that has one, else ""; 0 is a code of its own."""
    groups = (code & mask for mask in _EMCY_MASKS)
    return next((texts[group] for group in groups if group in texts and (group or not code)), "")


def sdo_abort_text(code: int) -> str:
    """Text of an SDO abort code."""
    return _SDO_ABORT_TEXTS.get(code, "unknown abort code")


def controlword_text(controlword: int) -> str:
    """Return the command that a controlword (0x6040) gives."""
    for mask, value, command in _CONTROLWORD_TEXTS:
        if controlword & mask == value:
            return command
    return "no command"
