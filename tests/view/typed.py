"""Commands, called with the words that a user types behind them."""

import argparse
from pathlib import Path

from canhaptic.cli import decode as decode_command
from canhaptic.cli import inspect as inspect_command
from canhaptic.cli.options import add_arguments


def inspect(*words: str | Path) -> int:
    """Returns the exit status of `canhaptic inspect`."""
    parser = argparse.ArgumentParser()
    add_arguments("inspect", parser)
    return inspect_command.execute(parser.parse_args([str(word) for word in words]))


def decode(*words: str | Path) -> int:
    """Returns the exit status of `canhaptic decode`."""
    parser = argparse.ArgumentParser()
    add_arguments("decode", parser)
    return decode_command.execute(parser.parse_args([str(word) for word in words]))
