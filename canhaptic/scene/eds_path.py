"""Path of an axis's object dictionary: next to the scene, or among those of the package."""

import os
from pathlib import Path
from typing import Final

from canhaptic.package_data import shipped
from canhaptic.scene.diagnostics import Diagnostics
from canhaptic.scene.document import MarkedMapping
from canhaptic.units import shown

_SHIPPED: Final = shipped("eds")


def find_dictionary(section: MarkedMapping, faults: Diagnostics) -> MarkedMapping:
    """Return the axis's section with the path of its EDS or DCF found; a fault when there is no such file.

    A relative path is looked for next to the scene file (one given in an override: in the current folder), then in
    the `eds/` that comes with the package.
    """
    text = section.get("eds")
    if not isinstance(text, str):
        return section  # missing or of another type: noted by the model
    at = section.value_at("eds")
    folders = (at.folder, _SHIPPED)
    for folder in folders:
        if os.path.isfile(folder / text):
            found = section.copy()
            found.put("eds", str(folder / text), section.keys_at["eds"], at)
            return found
    looked = "" if Path(text).is_absolute() else f" in {' or '.join(str(folder) for folder in folders)}"
    faults.add(at, f"got {shown(text)}, no such file{looked}; give the path of the drive's EDS or DCF")
    return section


def path_for_scene(dictionary: Path, scene: Path | None) -> str:
    """Return the path with which a scene finds a dictionary.

    Args:
        dictionary: Its file, as seen from the current folder.
        scene: The file of the scene, which the path then starts from; None where that is not known: the whole path.
    """
    if scene is None:
        return str(dictionary.absolute())
    return os.path.relpath(dictionary.parent.resolve() / dictionary.name, scene.parent.resolve())
