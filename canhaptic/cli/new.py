"""`canhaptic new EDS --out rig.yaml`: write a commented scene to start from."""

import argparse

from can.interfaces import BACKENDS

from canhaptic.cli.check_eds import survey_of, warnings_of
from canhaptic.cli.options import check_place
from canhaptic.errors import InputError
from canhaptic.registry import nearest
from canhaptic.scene.scene_text import starter_scene
from canhaptic.view.terminal import note_file, write_file, write_line, write_note


def execute(arguments: argparse.Namespace) -> int:
    """Write the scene; return 0.

    Raises:
        DictionaryError: The dictionary cannot be read, or its drive cannot be used.
        InputError: The file exists or cannot be written, `--force-object` does not name an object, or `--interface` no
            interface of python-can.
    """
    out = arguments.out
    if out is not None:
        check_place(out, arguments.force)
    if arguments.interface is not None and arguments.interface not in BACKENDS:
        known = f"expected one of: {', '.join(sorted(BACKENDS))}{nearest(arguments.interface, BACKENDS)}"
        raise InputError(f"--interface: got {arguments.interface!r}, {known}")
    found, profile = survey_of(arguments.file, arguments.display, arguments.force_object)
    for warning in warnings_of(found):
        write_note(f"  warning: {warning}")
    text = starter_scene(
        found, simulate=arguments.simulate, drive=profile, out=out, interface=arguments.interface or "socketcan"
    )
    if out is None:
        write_line(text.removesuffix("\n"))
    else:
        write_file(out, text)
        note_file("scene", out)
    return 0
