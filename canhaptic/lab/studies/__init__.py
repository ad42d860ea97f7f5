"""Studies of scenes: the variations make cases, each case a row of plain values, the rows tables and pictures."""

from typing import Any

Row = dict[str, Any]
"""Plain values by name, as `--json` prints them."""
