"""Arguments of `canhaptic decode`."""

import argparse
from pathlib import Path

from canhaptic.cli.arguments import add_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of `decode`."""
    parser.add_argument("bus_log", type=Path, metavar="BUSLOG", help="candump text, BLF, TRC or ASC")
    parser.add_argument("--config", type=Path, metavar="CONFIG", help="scene file, for names, units and dictionaries")
    parser.add_argument("--from", dest="start", type=float, metavar="S", help="from this time on [s]")
    parser.add_argument("--to", dest="stop", type=float, metavar="S", help="up to this time [s]")
    parser.add_argument("--only", action="append", metavar="KIND", help="NMT, SYNC, EMCY, SDO, TPDO1, heartbeat, ...")
    add_json(parser, "one JSON object per line")
