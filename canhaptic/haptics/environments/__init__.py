"""One virtual environment a file, and the table that names them."""

from typing import Final

ENVIRONMENTS: Final[dict[str, str]] = {
    "spring_damper_wall": "canhaptic.haptics.environments.spring_damper_wall:SpringDamperWall",
}
"""Name in a scene -> "module:Class"; the class is the parameter model and the environment in one."""
