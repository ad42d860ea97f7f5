"""Replays a recorded bus against today's master: `python tools/replay.py BUSLOG --config CONFIG`. See --help."""

import argparse
import sys

from canhaptic.errors import CanHapticError
from canhaptic.view.replay_command import add_arguments, execute


def main() -> int:
    """Returns the exit status: 0, 1 at a difference, 2 for bad input."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_arguments(parser)
    try:
        return execute(parser.parse_args())
    except CanHapticError as error:
        print(error, file=sys.stderr)
        return error.exit_status


if __name__ == "__main__":
    sys.exit(main())
