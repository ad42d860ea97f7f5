"""`canhaptic new EDS --out rig.yaml`: a commented configuration to start from."""

import argparse
import sys
from pathlib import Path

from canhaptic.cli.arguments import check_folder
from canhaptic.cli.check_eds import survey_of
from canhaptic.cli.output import note_file, write_file
from canhaptic.errors import InputError
from canhaptic.scene.starter import starter_scene


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of `new`."""
    parser.add_argument("file", metavar="EDS", type=Path, help="object dictionary of the drive (EDS or DCF)")
    parser.add_argument(
        "--out",
        metavar="FILE.yaml",
        type=Path,
        help="write the scene there, with the path of the EDS as seen from there; by default it is printed, with the "
        "whole path",
    )
    parser.add_argument(
        "--simulate", action="store_true", help="with a simulated drive, motor and hand, so that it runs at once"
    )


def execute(arguments: argparse.Namespace) -> int:
    """Writes the scene; returns 0.

    Raises:
        DictionaryError: The drive cannot serve.
        InputError: The file is there already, or cannot be written.
    """
    out = arguments.out
    if out is not None:
        check_folder(out)
        if out.exists():
            raise InputError(f"{out}: is there already; name another file, or move it away first")
    found, profile = survey_of(arguments.file)
    text = starter_scene(found, simulate=arguments.simulate, drive=profile, out=out)
    if out is None:
        sys.stdout.write(text)
    else:
        write_file(out, text)
        note_file("scene", out)
    return 0
