"""Arguments of `canhaptic preflight`."""

import argparse

from canhaptic.cli.arguments import add_json, add_scene


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of `preflight`."""
    add_scene(parser, runs=False)
    add_json(parser)
