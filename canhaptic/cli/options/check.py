"""Arguments of `canhaptic check`."""

import argparse

from canhaptic.cli.arguments import add_json, add_scene


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of `check`."""
    add_scene(parser, runs=False)
    parser.add_argument("--resolved", action="store_true", help="print every value in effect, as YAML")
    add_json(parser)
