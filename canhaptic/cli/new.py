"""`canhaptic new EDS > rig.yaml`: a commented configuration to start from."""

import argparse
import sys
from pathlib import Path

from canhaptic.cli.check_eds import survey_of
from canhaptic.dictionary import read_dictionary
from canhaptic.scene.starter import starter_scene


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of `new`."""
    parser.add_argument("file", metavar="EDS", type=Path, help="object dictionary of the drive (EDS or DCF)")
    parser.add_argument(
        "--simulate", action="store_true", help="with a simulated drive, motor and hand, so that it runs at once"
    )


def execute(arguments: argparse.Namespace) -> int:
    """Prints the scene; fails when the drive cannot serve."""
    found, profile = survey_of(arguments.file)
    dictionary = read_dictionary(arguments.file, 1)
    sys.stdout.write(starter_scene(found, dictionary, simulate=arguments.simulate, drive=profile))
    return 0
