"""Arguments of `canhaptic configs`."""

import argparse
from pathlib import Path

from canhaptic.cli.arguments import add_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of `configs`."""
    parser.add_argument(
        "--copy", metavar="FOLDER", type=Path, help="put configs/ and eds/ into FOLDER; nothing there is overwritten"
    )
    add_json(parser)
