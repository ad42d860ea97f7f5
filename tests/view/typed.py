"""Commands, called with the words that a user types behind them."""

import argparse
from pathlib import Path

from canhaptic.cli import decode as decode_command
from canhaptic.cli import inspect as inspect_command
from canhaptic.cli.options import OPTIONS


def inspect(*words: str | Path) -> int:
    """Returns the exit status of `canhaptic inspect`."""
    parser = argparse.ArgumentParser()
    OPTIONS["inspect"](parser)
    return inspect_command.execute(parser.parse_args([str(word) for word in words]))


def decode(*words: str | Path) -> int:
    """Returns the exit status of `canhaptic decode`."""
    parser = argparse.ArgumentParser()
    OPTIONS["decode"](parser)
    return decode_command.execute(parser.parse_args([str(word) for word in words]))
