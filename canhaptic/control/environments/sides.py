"""Common part of environments with a surface: its solid side, and a storage that stays on that side."""

from typing import Literal

Side = Literal["below", "above"]
"""Where a wall is solid: below its position (q < q_w, eq. 12) or above it."""


def is_beyond(position: float, surface: float, is_below: bool) -> bool:
    """Return True where a position is inside a wall with its surface at `surface` [m or rad] (eq. 12)."""
    return position < surface if is_below else position > surface


def kept_on_side(state: float, true: float) -> float:
    """Return the state [m or rad], or 0 where it lies across the surface from the true one."""
    return state if state * true >= 0.0 else 0.0
