"""Compares every passivity algorithm on one scene: `python tools/compare_passivity.py CONFIG`. See --help."""

import sys

from canhaptic.cli.main import main

if __name__ == "__main__":
    sys.exit(main(["compare", *sys.argv[1:]]))
