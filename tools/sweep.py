"""Judges many scenes that differ in some keys: `python tools/sweep.py CONFIG --vary KEY=VALUES`. See --help."""

import sys

from canhaptic.cli.main import main

if __name__ == "__main__":
    sys.exit(main(["sweep", *sys.argv[1:]]))
