"""Shows what accuracy costs in time on one scene: `python tools/accuracy.py CONFIG`. See --help."""

import argparse
import sys

from canhaptic.cli.accuracy import add_arguments, execute
from canhaptic.errors import CanHapticError


def main() -> int:
    """Returns the exit status: 0, 2 for bad input, 130 or 143 after a signal."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_arguments(parser)
    try:
        return execute(parser.parse_args())
    except CanHapticError as error:
        print(error, file=sys.stderr)
        return error.exit_status


if __name__ == "__main__":
    sys.exit(main())
