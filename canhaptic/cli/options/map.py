"""Arguments of `canhaptic map`."""

import argparse
from pathlib import Path
from typing import Final

from canhaptic.cli.arguments import add_allow_code, add_json

JUDGEMENTS: Final = ("stable", "passive", "margin", "settled", "covered")
"""As in `study.map.z_width`, which is imported when a map is drawn."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of `map`."""
    parser.add_argument("file", metavar="FILE.h5", type=Path, help="of canhaptic sweep, finished or not")
    parser.add_argument("--png", metavar="FILE", type=Path, help="picture (.png, .svg, .pdf)")
    parser.add_argument("--html", metavar="FILE", type=Path, help="self-contained page")
    parser.add_argument("--x", metavar="KEY", help="across; by default the rate, or the first key that was varied")
    parser.add_argument("--y", metavar="KEY", help="upwards, or one line per value")
    parser.add_argument("--metric", metavar="NAME", help="one map of this figure, instead of the usual ones")
    parser.add_argument("--axis", metavar="NAME", help="of a scene with several; by default the first")
    parser.add_argument("--by", choices=JUDGEMENTS, help="what a wall must be to count; by default stable for direct")
    add_allow_code(parser)
    add_json(parser)
