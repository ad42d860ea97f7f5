"""One simulated effect a file, and the table that names them; an effect no scene names is never imported."""

from typing import Final

EFFECTS: Final[dict[str, str]] = {}
"""Name in a scene -> "module:Class" of its frozen parameters."""
