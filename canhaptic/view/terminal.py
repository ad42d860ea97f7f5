"""Safe terminal output: control characters in texts from files and drives are shown, not sent."""

from itertools import chain
from typing import Final

_STEERING: Final = chain(
    (code for code in range(0x20) if chr(code) not in "\t\n"),
    range(0x7F, 0xA0),  # delete, and the control characters of Latin-1
    (0x200E, 0x200F, 0x2028, 0x2029, *range(0x202A, 0x202F), *range(0x2066, 0x206A)),  # line ends, order of writing
    range(0xD800, 0xE000),  # of a path that is no UTF-8: cannot be written at all
)
_SHOWN: Final = {code: f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" for code in _STEERING}


def visible(text: str) -> str:
    r"""Return a text with what would steer a terminal written out: escape as `\x1b`; lines and tabs stay."""
    return text if text.isprintable() else text.translate(_SHOWN)
