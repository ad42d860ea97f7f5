"""Arguments of `canhaptic replay`."""

import argparse
from pathlib import Path

from canhaptic.cli.arguments import add_allow_code, add_json, add_overrides


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of `replay`."""
    parser.add_argument("bus_log", type=Path, metavar="BUSLOG", help="candump text, BLF, TRC or ASC")
    parser.add_argument("--config", type=Path, metavar="CONFIG", required=True, help="scene of the recorded run")
    add_overrides(parser)
    parser.add_argument("--realtime", action="store_true", help="keep the pace of the recording")
    parser.add_argument(
        "--from-sync", action="store_true", help="leave the start of the drives out, even if it was recorded"
    )
    parser.add_argument("--account", action="store_true", help="print the energy account of the replayed run, too")
    add_allow_code(parser)
    add_json(parser)
