"""Arguments of `canhaptic design`."""

import argparse
from typing import Final

from canhaptic.cli.arguments import add_json, add_scene

TOLERANCE: Final = 0.05
MARGIN: Final = 0.2
"""As in `study.design.wall`, which is imported when the search begins."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of `design`."""
    add_scene(parser)
    parser.add_argument(
        "--margin", metavar="PART", type=float, default=MARGIN, help="part by which both could be larger; default 0.2"
    )
    parser.add_argument(
        "--tolerance", metavar="PART", type=float, default=TOLERANCE, help="between asked and rendered; default 0.05"
    )
    parser.add_argument("--engine", choices=("auto", "numba", "python"), default="auto", help="of the trials")
    add_json(parser)
