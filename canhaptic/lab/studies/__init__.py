"""Studies of scenes: variations of a scene are cases, each case gives a row of values, and rows become tables."""

from typing import Any

Row = dict[str, Any]
"""Result of one case: values by name, as `--json` prints them."""
