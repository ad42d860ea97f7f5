"""Limits, ramps and reactions stored in a drive, which a scene may set."""

import tomllib
from pathlib import Path
from typing import Final

DRIVE_OBJECTS: Final[dict[tuple[int, int], str]] = {
    (int(name[:6], 16), int(name[7:] or "0")): meaning
    for name, meaning in tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")).items()
}
"""(index, subindex) -> unit and meaning."""


def place_of(key: object) -> tuple[int, int]:
    """Return (index, subindex) of `0x6065` or `0x607D.1`; raise ValueError for any other object."""
    text = f"{key:#x}" if isinstance(key, int) else str(key)
    index, _, subindex = text.partition(".")
    try:
        place = int(index, 16), int(subindex or "0", 16)
    except ValueError:
        place = 0, 0
    if place not in DRIVE_OBJECTS:
        names = ", ".join(f"0x{i:04X}" + (f".{sub}" if sub else "") for i, sub in DRIVE_OBJECTS)
        raise ValueError(f"got {text}, expected one of: {names}")
    return place
