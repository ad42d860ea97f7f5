"""Arguments of `canhaptic compare`."""

import argparse
from pathlib import Path
from typing import Final

from canhaptic.cli.arguments import add_json, add_scene, names, positive_number, seconds

_FASTEST: Final = 1e6  # [Hz]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of `compare`."""
    add_scene(parser)
    parser.add_argument("--algorithms", metavar="A,B,...", type=names, help="which; by default every one")
    parser.add_argument("--duration", metavar="S", type=seconds, help="length of each run [s]; by default the scene's")
    parser.add_argument(
        "--rate", metavar="HZ", type=_rate, help="another rate than the scene's, also beyond what a bus could carry"
    )
    parser.add_argument("--can", action="store_true", help="over the whole CAN path instead of without a bus")
    parser.add_argument("--png", metavar="FILE", type=Path, help="picture of the comparison (.png, .svg, .pdf)")
    add_json(parser)


def _rate(text: str) -> float:
    return positive_number(text, ("Hz", "Hz"), "rate", _FASTEST)
