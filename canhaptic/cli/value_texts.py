"""Parsers of option values, each with an error that states the expected form."""

import argparse
import re
from collections.abc import Callable
from typing import Final

from canhaptic.cli.arguments import names, number, positive_number, seconds

_FASTEST: Final = 1e6  # [Hz]
_DIGITS: Final = re.compile(r"[0-9]{1,12}")


def length(text: str) -> float:
    """Return a tolerance [m or rad]."""
    return positive_number(text, ("m", "rad"), "tolerance", 1.0)


def budget(text: str) -> float:
    """Return a time to spend [s], 0 for none."""
    return 0.0 if text.strip() == "0" else seconds(text)


def rate(text: str) -> float:
    """Return a rate [Hz]."""
    return positive_number(text, ("Hz", "Hz"), "rate", _FASTEST)


def rates(text: str) -> list[float]:
    """Return rates [Hz] that commas separate, each once."""
    return list(dict.fromkeys(rate(one) for one in names(text)))


def delays(text: str) -> list[int]:
    """Return delays, 0 or 1 hold, that commas separate, each once."""
    given = list(dict.fromkeys(names(text)))
    if not set(given) <= {"0", "1"}:
        raise argparse.ArgumentTypeError(f"got {text!r}, expected 0 (event), 1 (synchronous) or 0,1")
    return [int(one) for one in given]


def moment(text: str) -> float:
    """Return a time of a log [s]."""
    return number(text, ("s", "s"))


def whole(least: int, most: int) -> Callable[[str], int]:
    """Parser of a whole number within limits."""

    def read(text: str) -> int:
        if not _DIGITS.fullmatch(text) or not least <= int(text) <= most:
            raise argparse.ArgumentTypeError(f"got {text!r}, expected a whole number from {least} to {most}")
        return int(text)

    return read


def samples(text: str) -> int:
    """Return the points of a Latin hypercube from `lhs:N`."""
    kind, _, points = text.partition(":")
    if kind != "lhs":
        raise argparse.ArgumentTypeError(f"got {text!r}, expected lhs:N with N from 1 to 10^8")
    return whole(1, 100_000_000)(points)


PORT: Final = whole(0, 65_535)
"""Reads the port of a page; 0 for any that is free."""
