"""Limits, ramps and reactions stored in a drive, which a scene may set."""

from typing import Final

DRIVE_OBJECTS: Final = {
    (0x6065, 0): "following error window [counts]; a position drive faults beyond it",
    (0x6066, 0): "following error time [ms]; for so long it may be beyond 0x6065",
    (0x607D, 1): "least position [counts]; a target below it is a fault, or cut",
    (0x607D, 2): "largest position [counts]; a target above it is a fault, or cut",
    (0x607F, 0): "largest profile speed [units of the drive]",
    (0x6080, 0): "largest motor speed [1/min]; in torque mode some drives do not look at it",
    (0x605A, 0): "quick stop: 0 coasts, 1 brakes along 0x6084, 2 along 0x6085; 5 to 8 the same, and stays enabled",
    (0x605E, 0): "reaction to a fault: 0 coasts, 1 brakes along 0x6084, 2 along 0x6085, 3 at the current limit",
    (0x6083, 0): "profile acceleration; bends a velocity that is commanded",
    (0x6084, 0): "profile deceleration; bends a velocity that is commanded",
    (0x6085, 0): "quick stop deceleration; a geared drive that brakes at its current limit may break",
    (0x60C5, 0): "largest acceleration; bends a velocity that is commanded",
    (0x60C6, 0): "largest deceleration; bends a velocity that is commanded",
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
