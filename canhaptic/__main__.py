"""`python -m canhaptic`: the same as the command `canhaptic`, for shells that do not find it."""

import sys

from canhaptic.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
