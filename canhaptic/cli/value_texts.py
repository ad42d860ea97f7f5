"""Values of options from their texts, each refused with what was expected."""

import argparse
from typing import Final

from canhaptic.cli.arguments import names, positive_number, seconds

_FASTEST: Final = 1e6  # [Hz]
_LAST_PORT: Final = 65_535


def length(text: str) -> float:
    """Returns a tolerance [m or rad]."""
    return positive_number(text, ("m", "rad"), "tolerance", 1.0)


def budget(text: str) -> float:
    """Returns a time to spend [s], 0 for none."""
    return 0.0 if text.strip() == "0" else seconds(text)


def rate(text: str) -> float:
    """Returns a rate [Hz]."""
    return positive_number(text, ("Hz", "Hz"), "rate", _FASTEST)


def rates(text: str) -> list[float]:
    """Returns rates [Hz] that commas separate, each once."""
    return list(dict.fromkeys(rate(one) for one in names(text)))


def delays(text: str) -> list[int]:
    """Returns delays, 0 or 1 hold, that commas separate, each once."""
    given = list(dict.fromkeys(names(text)))
    if not set(given) <= {"0", "1"}:
        raise argparse.ArgumentTypeError(f"got {text!r}, expected 0 (event), 1 (synchronous) or 0,1")
    return [int(one) for one in given]


def port(text: str) -> int:
    """Returns the number of a port."""
    if not (text.isascii() and text.isdigit()) or int(text) > _LAST_PORT:
        raise argparse.ArgumentTypeError(f"got {text!r}, expected a number from 0 to {_LAST_PORT}")
    return int(text)


def samples(text: str) -> int:
    """Returns the points of a Latin hypercube from `lhs:N`."""
    kind, _, number = text.partition(":")
    if kind != "lhs" or not number.isdigit() or not 1 <= int(number) <= 100_000_000:
        raise argparse.ArgumentTypeError(f"got {text!r}, expected lhs:N with N from 1 to 10^8")
    return int(number)


def count(text: str) -> int:
    """Returns a whole number."""
    if not (text.isascii() and text.isdigit()) or not 0 <= int(text) <= 1_000_000_000:
        raise argparse.ArgumentTypeError(f"got {text!r}, expected a whole number from 0 to 10^9")
    return int(text)
