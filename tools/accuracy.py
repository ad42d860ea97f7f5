"""Shows what accuracy costs in time on one scene: `python tools/accuracy.py CONFIG`. See --help."""

import sys

from canhaptic.cli.main import main

if __name__ == "__main__":
    sys.exit(main(["accuracy", *sys.argv[1:]]))
