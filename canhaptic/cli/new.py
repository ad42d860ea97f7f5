"""`canhaptic new EDS --out rig.yaml`: write a commented scene to start from."""

import argparse
import os
import secrets
from pathlib import Path
from typing import Final

from can.interfaces import BACKENDS

from canhaptic.cli.check_eds import survey_of, warnings_of
from canhaptic.cli.options import check_place, is_of_line
from canhaptic.drive.survey import Survey
from canhaptic.errors import InputError
from canhaptic.registry import nearest
from canhaptic.scene.first_contact import FELT, can_be_tried, rendered_share
from canhaptic.scene.load import scene_from_text
from canhaptic.scene.scene_text import starter_scene
from canhaptic.view.terminal import note_file, write_file, write_line, write_note

_TRIED: Final = (0.5, 0.05)
"""Speeds of a handle that meets the wall of the new scene, as fractions of its largest."""


def execute(arguments: argparse.Namespace) -> int:
    """Write the scene; return 0.

    Raises:
        DictionaryError: The dictionary cannot be read, or its drive cannot be used.
        InputError: The file exists or cannot be written, `--force-object` does not name an object, or `--interface` no
            interface of python-can.
    """
    if arguments.far_key is not None:
        _write_key(arguments.far_key)
        return 0
    if arguments.file is None:
        raise InputError("new: expected the EDS or DCF of a drive, or --far-key FILE")
    out = arguments.out
    if out is not None:
        check_place(out, arguments.force)
    if is_of_line(arguments.file):
        return _of_line(arguments)
    if arguments.interface is not None and arguments.interface not in BACKENDS:
        known = f"expected one of: {', '.join(sorted(BACKENDS))}{nearest(arguments.interface, BACKENDS)}"
        raise InputError(f"--interface: got {arguments.interface!r}, {known}")
    found, profile = survey_of(arguments.file, arguments.display, arguments.force_object)
    for warning in warnings_of(found):
        write_note(f"  warning: {warning}")
    text = starter_scene(
        found, simulate=arguments.simulate, drive=profile, out=out, interface=arguments.interface or "socketcan"
    )
    return _written(text, found, out)


def _written(text: str, found: Survey, out: Path | None) -> int:
    """Write a scene, and say what keeps its wall from being felt; return 0."""
    if out is None:
        write_line(text.removesuffix("\n"))
    else:
        write_file(out, text)
        note_file("scene", out)
    if warning := _unmeasured(text, str(found.axis.dictionary_path if out is None else out)):
        write_note(f"  warning: {warning}")
    return 0


def _write_key(path: Path) -> None:
    """Write 32 random bytes that their owner alone can read.

    Raises:
        InputError: The file exists, or cannot be written.
    """
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except OSError as error:
        raise InputError(f"{path}: cannot be made ({error.strerror}); name another file") from error
    with open(descriptor, "wb") as file:
        file.write(secrets.token_bytes(32))
    note_file("key", path)


def _of_line(arguments: argparse.Namespace) -> int:
    from canhaptic.drive.ethercat.esi_survey import surveyed

    if arguments.display is not None:
        text = "--display: got one for an ESI, expected none: configs/admittance has displays whose bus and axis lines"
        raise InputError(f"{text} may be those of configs/ethercat.yaml")
    found, out = surveyed(arguments.file), arguments.out
    interface = arguments.interface or "eth1"
    return _written(starter_scene(found, simulate=arguments.simulate, out=out, interface=interface), found, out)


def _unmeasured(text: str, place: str) -> str:
    """Return what the guesses of a scene keep from being rendered, and the cure; "" where its wall is felt."""
    axis = scene_from_text(text, place).axes[0]
    if not can_be_tried(axis):
        return ""
    most = max(rendered_share(axis, part * axis.parameters.largest_speed) for part in _TRIED)
    if most >= FELT:
        return ""
    return (
        f"nothing of this rig is measured yet: with these guesses {100.0 * most:.0f} % of the wall is rendered at most"
        "; canhaptic commission measures mass, friction, damping and timing, with which it is"
    )
