"""Arguments of `canhaptic scope`."""

import argparse
from pathlib import Path
from typing import Final

_LAST_PORT: Final = 65_535


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of `scope`."""
    parser.add_argument("log", type=Path, nargs="?", metavar="LOG", help="energy log that a run writes or will write")
    parser.add_argument("--config", type=Path, metavar="CONFIG", help="scene file that names the log (log.energy)")
    parser.add_argument("--port", type=_port, default=5006, metavar="N", help="of the page; 0 for any that is free")
    parser.add_argument("--window", type=float, default=10.0, metavar="S", help="seconds shown")
    parser.add_argument("--open", action="store_true", help="open the page in a browser")


def _port(text: str) -> int:
    if not (text.isascii() and text.isdigit()) or int(text) > _LAST_PORT:
        raise argparse.ArgumentTypeError(f"got {text!r}, expected a number from 0 to {_LAST_PORT}")
    return int(text)
