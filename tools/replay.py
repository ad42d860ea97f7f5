"""Replays a recorded bus against today's master: `python tools/replay.py BUSLOG --config CONFIG`. See --help."""

import sys

from canhaptic.cli.main import main

if __name__ == "__main__":
    sys.exit(main(["replay", *sys.argv[1:]]))
