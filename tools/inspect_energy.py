"""Inspects an energy log: `python tools/inspect_energy.py LOG --check 'margin >= -1 uJ'`. See --help."""

import sys

from canhaptic.cli.main import main

if __name__ == "__main__":
    sys.exit(main(["inspect", *sys.argv[1:]]))
