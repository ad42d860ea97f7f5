"""Texts for the codes of CiA 301 and IEC 61800-7-201 (CiA 402): SDO aborts, EMCY error codes, NMT, controlwords."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Final

_TEXTS: Final[dict[str, dict[int, str]]] = {
    kind: {int(code, 16): text for code, text in texts.items()}
    for kind, texts in tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")).items()
}
NMT_COMMAND_TEXTS: Final = _TEXTS["nmt_command"]
NMT_STATE_TEXTS: Final = _TEXTS["nmt_state"]
_CONTROLWORD_TEXTS: Final = (  # (mask, value, command), IEC 61800-7-201, table 28
    (0x80, 0x80, "fault reset"),
    (0x87, 0x06, "shutdown"),
    (0x8F, 0x07, "switch on"),
    (0x8F, 0x0F, "enable operation"),
    (0x86, 0x02, "quick stop"),
    (0x82, 0x00, "disable voltage"),
)


def emcy_text(code: int) -> str:
    """Return the text of an EMCY error code, else of its group (0x8611 -> 0x8600 -> 0x8000)."""
    return _of_code_or_group(_TEXTS["emergency"], code) or "unknown error code"


def emcy_remedy(code: int, silence: float, skipped: int, watched: str, guarding: str) -> str:
    """Return the remedy for an EMCY error code; "" for a code that only the drive's manual explains.

    Args:
        code: Error code (0x603F).
        silence: Timeout of the drive for frames of this computer [s].
        skipped: Number of SYNCs that this computer skipped.
        watched: Frames that the drive's watchdog awaits, in words.
        guarding: Life guarding that the start found, in words.
    """
    text = _of_code_or_group(_TEXTS["remedy"], code)
    return text.format(silence=silence * 1e3, skipped=skipped, watched=watched, guarding=guarding)


def _of_code_or_group(texts: Mapping[int, str], code: int) -> str:
    """Return the text of a code, else of the narrowest group with a text, else ""; code 0 belongs to no group."""
    groups = (code & mask for mask in (0xFFFF, 0xFFF0, 0xFF00, 0xF000))  # itself, then wider
    return next((texts[group] for group in groups if group in texts and (group or not code)), "")


def sdo_abort_text(code: int) -> str:
    """Return the text of an SDO abort code."""
    return _TEXTS["sdo_abort"].get(code, "unknown abort code")


def controlword_text(controlword: int) -> str:
    """Return the name of the command in a controlword (0x6040)."""
    texts = (command for mask, value, command in _CONTROLWORD_TEXTS if controlword & mask == value)
    return next(texts, "no command")
