"""`python -m canhaptic`: the `canhaptic` command, where it is not on the path."""

import sys

from canhaptic.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
