"""Inspects an energy log: `python tools/inspect_energy.py LOG --check 'margin >= -1 uJ'`. See --help."""

import argparse
import sys

from canhaptic.errors import CanHapticError
from canhaptic.view.inspect_command import add_arguments, execute


def main() -> int:
    """Returns the exit status: 0, 1 when a check failed, 2 for bad input."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_arguments(parser)
    try:
        return execute(parser.parse_args())
    except CanHapticError as error:
        print(error, file=sys.stderr)
        return error.exit_status


if __name__ == "__main__":
    sys.exit(main())
