"""Arguments of `canhaptic check-eds`."""

import argparse
from pathlib import Path

from canhaptic.cli.arguments import add_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of `check-eds`."""
    parser.add_argument("file", metavar="FILE", type=Path, help="object dictionary of the drive (EDS or DCF)")
    add_json(parser)
