"""`canhaptic configs`: list the scenes of the package and what other packages offer, or copy the scenes for editing."""

import argparse
import re
import shutil
from pathlib import Path
from typing import Final

from canhaptic.errors import InputError
from canhaptic.files import FOLDERS, shipped
from canhaptic.registry import offered, package_of
from canhaptic.view.run_lines import make_console
from canhaptic.view.table import Table
from canhaptic.view.terminal import note_file, write_json

_COMMENT: Final = "#"
_SENTENCE_END: Final = re.compile(r"\.\s+(?=[A-Z])")


def execute(arguments: argparse.Namespace) -> int:
    """List every scene with its description, and every installed plug-in; or copy all scenes."""
    if arguments.copy is not None:
        _copy(arguments.copy)
        return 0
    folder = shipped("configs")
    scenes = {path.relative_to(folder).as_posix(): _about(path) for path in sorted(folder.rglob("*.yaml"))}
    plug_ins = {kind: {name: package_of(of) for name, of in found.items()} for kind, found in offered().items()}
    if arguments.json:
        write_json({"folder": str(folder), "configs": scenes, "plug_ins": plug_ins})
        return 0
    make_console().print(Table(str(folder), ("file", "what it is"), list(scenes.items())))
    if rows := [(kind, name, package) for kind, named in plug_ins.items() for name, package in named.items()]:
        make_console().print(Table("installed plug-ins", ("kind", "name", "package"), rows))
    return 0


def _about(path: Path) -> str:
    """Return the first sentence of the comment at the top of a scene."""
    lines: list[str] = []
    for line in path.read_text(encoding="utf-8").splitlines():
        text = line.removeprefix(_COMMENT).strip()
        if not line.startswith(_COMMENT) or (lines and not text):
            break
        lines.append(text)
    return _SENTENCE_END.split(" ".join(lines))[0].rstrip(".:")


def _copy(target: Path) -> None:
    """Copy the shipped scenes and dictionaries into a folder.

    Raises:
        InputError: A copy already exists there, or cannot be written.
    """
    for folder in FOLDERS:
        if (target / folder).exists():
            raise InputError(f"{target / folder} already exists; choose another folder, or move it away first")
    try:
        for folder in FOLDERS:
            shutil.copytree(shipped(folder), target / folder)
            note_file(folder, target / folder)
    except OSError as error:
        raise InputError(f"{target}: cannot be written ({error}); name a folder that can be written") from error
