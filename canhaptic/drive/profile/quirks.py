"""Named deviations of real drives from CiA 301 and 402, chosen by `quirks: [...]` in an axis or by its drive profile.

The simulated drive can show each of them (`canhaptic.scene.far_side`), which tests a whole start with it.
"""

import tomllib
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Final

from canhaptic.errors import ParameterError
from canhaptic.registry import nearest
from canhaptic.units import Parameters, quantity


class Quirks(Parameters):
    """Deviations of a drive; the defaults are CiA 301/402 as printed."""

    event_transmission_type: int = 255
    """Type of an event-driven RPDO: 255 (device profile) or 254 (manufacturer)."""
    writes_interpolation_period: bool = True
    """Whether 0x60C2 is written where the dictionary allows it; some drives want it for cyclic modes."""
    reads_rated_torque: bool = True
    """Whether 0x6076 is read where the dictionary lists it; False: only rated_torque of the configuration counts."""
    writes_rated_torque: bool = False
    """Whether rated_torque of the configuration is written to a 0x6076 that is 0."""
    rated_torque_resolution: float = 1e-3
    """Newton metres per count of 0x6076."""
    torque_resolution: Annotated[float, quantity("1", ge=1e-6, le=1.0)] = 1e-3
    """Part of the rated torque per count of 0x6071, 0x6072, 0x6074 and 0x6077."""
    writes_max_torque: bool = True
    """Whether torque_limit is written to 0x6072 where the dictionary allows it; False: the master alone keeps it."""
    maps_demand: bool = True
    """Whether 0x6074 is read back where the dictionary allows it; False: 0x6077 is used."""
    abort_connection_option: int = 1
    """Value of 0x6007 for a lost master: 1 fault, 2 disable voltage, 3 quick stop."""
    enable_time: Annotated[float, quantity("s", ge=0.0, le=60.0)] = 0.0
    """Time that one step of the enabling may take, where that is longer than step_timeout."""
    waits_for_following: bool = False
    """Whether the start waits for bit 12 of the statusword: the drive follows its target."""
    shows_mode_when_enabled: bool = False
    """Whether 0x6061 follows 0x6060 only in OPERATION ENABLED: the mode is confirmed there, at zero torque."""
    acts_at_once: bool = False
    """Whether a synchronous RPDO acts on arrival although its type is confirmed; declare `bus.rpdo: event` then."""
    syncs_late: int = 0
    """SYNCs by which a synchronous RPDO acts later than at the next SYNC."""

    @property
    def torque_scale(self) -> float:
        """Torque of 1000 counts, as a fraction of the rated torque."""
        return round(1000.0 * self.torque_resolution, 9)


_TABLE: Final = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
_QUIRKS: Final[Mapping[str, Mapping[str, Any]]] = {name: of["master"] for name, of in _TABLE.items()}
TWINS: Final[Mapping[str, Mapping[str, Any]]] = {name: of["twin"] for name, of in _TABLE.items()}
"""Quirk -> keys of `simulation.drive`."""


@cache
def quirks_of(names: Sequence[str]) -> Quirks:
    """Return the deviations of a drive; without names, of a plain CiA 402 drive.

    Args:
        names: Names in `quirks.toml`, as a tuple.

    Raises:
        ParameterError: No deviation of that name is known, or two contradict each other.
    """
    changes: dict[str, Any] = {}
    origins: dict[str, str] = {}
    for name in names:
        if name not in _QUIRKS:
            known = f"{', '.join(sorted(_QUIRKS))}{nearest(name, _QUIRKS)}"
            raise ParameterError(f"quirks: got {name!r}, expected any of: {known}")
        for key, value in _QUIRKS[name].items():
            if changes.get(key, value) != value:
                raise ParameterError(f"quirks: {origins[key]!r} and {name!r} contradict each other; keep one")
            changes[key], origins[key] = value, name
    return Quirks(**changes)
