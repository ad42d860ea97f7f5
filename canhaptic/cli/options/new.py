"""Arguments of `canhaptic new`."""

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of `new`."""
    parser.add_argument("file", metavar="EDS", type=Path, help="object dictionary of the drive (EDS or DCF)")
    parser.add_argument(
        "--out",
        metavar="FILE.yaml",
        type=Path,
        help="write the scene there, with the path of the EDS as seen from there; by default it is printed, with the "
        "whole path",
    )
    parser.add_argument(
        "--simulate", action="store_true", help="with a simulated drive, motor and hand, so that it runs at once"
    )
