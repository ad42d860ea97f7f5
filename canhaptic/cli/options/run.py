"""Arguments of `canhaptic run`."""

import argparse
from pathlib import Path

from canhaptic.cli.arguments import add_json, add_scene, seconds


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of `run`."""
    add_scene(parser)
    parser.add_argument("--duration", metavar="S", type=seconds, help="length of the run [s]; by default the scene's")
    parser.add_argument(
        "--pace",
        choices=("real", "free"),
        help="wall-clock pace, or as fast as the machine allows in lock-step; by default free where all is simulated",
    )
    parser.add_argument("--log", metavar="FILE.h5", type=Path, help="energy log (HDF5)")
    parser.add_argument("--bus-log", metavar="FILE.log", type=Path, help="bus log (candump text)")
    parser.add_argument("--png", metavar="FILE", type=Path, help="picture of the run (.png, .svg, .pdf)")
    parser.add_argument(
        "--strict", action="store_true", help="exit with 1 unless every account says that the run was passive"
    )
    add_json(parser)
