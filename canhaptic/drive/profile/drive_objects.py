"""Objects stored in a drive: limits, ramps and reactions that a scene may set, and settings that it compares."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Final

Objects = Mapping[tuple[int, int], str]
"""(index, subindex) -> unit and meaning."""
Settings = dict[tuple[int, int], int]
"""(index, subindex) -> value."""


def _objects(file: str) -> Objects:
    table = tomllib.loads(Path(__file__).with_name(file).read_text(encoding="utf-8"))
    return {(int(name[:6], 16), int(name[7:] or "0")): meaning for name, meaning in table.items()}


DRIVE_OBJECTS: Final = _objects("drive_objects.toml")
"""Objects that a scene may set."""
DRIVE_SETTINGS: Final = _objects("drive_settings.toml")
"""Objects that give positions and torques their scale, sign and limits."""


def place_of(key: object, of: Objects = DRIVE_OBJECTS) -> tuple[int, int]:
    """Return (index, subindex) of `0x6065` or `0x607D.1`; raise ValueError for an object that is not in `of`."""
    text = f"{key:#x}" if isinstance(key, int) else str(key)
    index, _, subindex = text.partition(".")
    try:
        place = int(index, 16), int(subindex or "0", 16)
    except ValueError:
        place = 0, 0
    if place not in of:
        names = ", ".join(f"0x{i:04X}" + (f".{sub}" if sub else "") for i, sub in of)
        raise ValueError(f"got {text}, expected one of: {names}")
    return place


def settings_of(text: str | None) -> Settings:
    """Return the settings in a text such as `0x6075=5000 0x608F.1=65536`; raise ValueError for any other text."""
    settings: Settings = {}
    for part in (text or "").split():
        name, _, value = part.partition("=")
        place = place_of(name, DRIVE_SETTINGS)
        try:
            settings[place] = int(value, 0)
        except ValueError:
            raise ValueError(f"got {part}, expected an object and its value, as in 0x6075=5000") from None
    return settings


def settings_text(settings: Settings) -> str:
    """Return settings as a text that `settings_of` reads."""
    named = ((f"0x{index:04X}" + (f".{sub}" if sub else ""), value) for (index, sub), value in settings.items())
    return " ".join(f"{name}={value}" for name, value in named)
