"""Compares every passivity algorithm on one scene: `python tools/compare_passivity.py CONFIG`. See --help."""

import argparse
import sys

from canhaptic.cli.compare import add_arguments, execute
from canhaptic.errors import CanHapticError


def main() -> int:
    """Returns the exit status: 0, 2 for bad input, 3 where a simulated drive or link failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_arguments(parser)
    try:
        return execute(parser.parse_args())
    except CanHapticError as error:
        print(error, file=sys.stderr)
        return error.exit_status


if __name__ == "__main__":
    sys.exit(main())
