"""Folders of the files in the package: `configs/` and `eds/`, in the source tree or as installed."""

import sysconfig
from pathlib import Path
from typing import Final

FOLDERS: Final = ("configs", "eds")

_TREE: Final = Path(__file__).resolve().parent.parent


def shipped(folder: str) -> Path:
    """Folder of that name: next to the package in a source tree, else where its wheel put it.

    Args:
        folder: One of `FOLDERS`.
    """
    beside = _TREE / folder
    installed = Path(sysconfig.get_path("data")) / "share" / "canhaptic" / folder
    of_target = _TREE / "share" / "canhaptic" / folder  # pip install --target
    return next((place for place in (beside, installed, of_target) if place.is_dir()), installed)
