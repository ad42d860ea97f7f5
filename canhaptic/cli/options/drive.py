"""Arguments of `canhaptic drive`."""

import argparse

from canhaptic.cli.arguments import add_scene, seconds


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of `drive`."""
    add_scene(parser)
    parser.add_argument("--duration", metavar="S", type=seconds, help="how long to live [s]; by default until stopped")
