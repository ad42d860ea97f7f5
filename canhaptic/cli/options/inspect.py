"""Arguments of `canhaptic inspect`."""

import argparse
from pathlib import Path

from canhaptic.cli.arguments import add_allow_code, add_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of `inspect`."""
    parser.add_argument("log", type=Path, help="an energy log (.h5), or a bus log together with --config")
    parser.add_argument("--from", dest="start", type=float, metavar="S", help="count from this time on [s]")
    parser.add_argument("--to", dest="stop", type=float, metavar="S", help="count up to this time [s]")
    add_allow_code(parser)
    add_json(parser)
    parser.add_argument(
        "--check",
        action="append",
        default=[],
        metavar="EXPRESSION",
        help="exit with 1 unless it holds: 'passive', 'margin >= -1 uJ', 'handle.deficit == 0', 'compute.p99 < 50 us'",
    )
    parser.add_argument(
        "--compare",
        type=Path,
        metavar="OTHER",
        help="exit with 1 unless the other log is the same; pictures show both",
    )
    for option, what in (("--csv", "a table of every row"), ("--parquet", "the same"), ("--mat", "the same")):
        parser.add_argument(option, type=Path, metavar="FILE", help=f"write {what}")
    for option in ("--png", "--svg"):
        parser.add_argument(option, type=Path, metavar="FILE", help="draw the run")
    parser.add_argument("--html", type=Path, metavar="FILE", help="write one self-contained interactive page")
    parser.add_argument(
        "--recompute",
        action="store_true",
        help="feed the logged inputs to the controllers again; exit with 1 unless every output is equal bit for bit",
    )
    parser.add_argument(
        "--config", type=Path, metavar="CONFIG", help="scene of the run; by default the one the log names"
    )
    parser.add_argument(
        "--bus-log",
        type=Path,
        metavar="FILE",
        help="derive the account again from the frames alone; exit with 1 unless it is that of the log bit for bit",
    )
    parser.add_argument("--repair", type=Path, metavar="FILE", help="save all that can be read into a clean log")
