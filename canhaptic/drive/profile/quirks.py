"""Named deviations of real drives from CiA 301 and 402, chosen by `quirks: [...]` in an axis or by its drive profile.

Each has a twin in the simulated drive (`canhaptic.scene.simulated_defaults`), with which a whole start is tested.
"""

from collections.abc import Mapping, Sequence
from functools import cache
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
    """Whether 0x6076 is read where the dictionary lists it; False: rated_torque of the configuration alone counts."""
    writes_rated_torque: bool = False
    """Whether rated_torque of the configuration is written to a 0x6076 that is 0."""
    rated_torque_resolution: float = 1e-3
    """Newton metres per count of 0x6076."""
    torque_resolution: Annotated[float, quantity("1", ge=1e-6, le=1.0)] = 1e-3
    """Part of the rated torque per count of 0x6071, 0x6072, 0x6074 and 0x6077."""
    writes_max_torque: bool = True
    """Whether torque_limit is written to 0x6072 where the dictionary allows it; False: the master alone keeps it."""
    maps_demand: bool = True
    """Whether 0x6074 can be read back where the dictionary says so; False: 0x6077 is."""
    abort_connection_option: int = 1
    """Value of 0x6007 for a lost master: 1 fault, 2 disable voltage, 3 quick stop."""
    enable_time: Annotated[float, quantity("s", ge=0.0, le=60.0)] = 0.0
    """Time that one step of the enabling may take, where that is longer than step_timeout."""
    waits_for_following: bool = False
    """Whether the start waits for bit 12 of the statusword: the drive follows its target."""
    acts_at_once: bool = False
    """Whether a synchronous RPDO acts on arrival, though its type is confirmed: `bus.rpdo: event` says so."""
    syncs_late: int = 0
    """SYNCs after the one that follows a synchronous RPDO until it acts."""

    @property
    def torque_scale(self) -> float:
        """Torque of 1000 counts, as a fraction of the rated torque."""
        return round(1000.0 * self.torque_resolution, 9)


_QUIRKS: Final[Mapping[str, Mapping[str, Any]]] = {
    # the rated torque, 0x6076
    "rated_torque_micro": {"rated_torque_resolution": 1e-6},  # in uN*m instead of mN*m
    "rated_torque_absent": {"reads_rated_torque": False},  # listed in the dictionary, not in the drive, or meaningless
    "rated_torque_written": {"writes_rated_torque": True},  # rw and 0 until the master writes it
    # the unit of 0x6071, 0x6072, 0x6074, 0x6077
    "torque_per_cent": {"torque_resolution": 1e-2},
    "torque_per_ten_thousand": {"torque_resolution": 1e-4},
    # the limit, 0x6072; INTEGER16 instead of UNSIGNED16 needs no quirk, the type of the dictionary is used
    "max_torque_absent": {"writes_max_torque": False},  # listed in the dictionary, not in the drive
    # the read-back
    "demand_absent": {"maps_demand": False},  # 0x6074 listed as mappable, refused or never filled by the drive
    # the enabling
    "slow_enable": {"enable_time": 10.0},  # brake, commutation search: OPERATION ENABLED comes seconds after 0x0F
    "late_following": {"waits_for_following": True},  # OPERATION ENABLED at once, the torque follows later (bit 12)
    # the hold in which a torque acts
    "acts_at_once": {"acts_at_once": True},  # a synchronous RPDO acts on arrival
    "acts_a_sync_late": {"syncs_late": 1},  # a synchronous RPDO acts at the second SYNC after it
    # the rest
    "abort_disable_voltage": {"abort_connection_option": 2},  # 0x6007 takes no 1
    "abort_quick_stop": {"abort_connection_option": 3},  # 0x6007 takes neither 1 nor 2
    "manufacturer_event": {"event_transmission_type": 254},  # an RPDO takes no 255
    "no_interpolation_period": {"writes_interpolation_period": False},  # 0x60C2 is listed and refused
    "sdo_size_not_indicated": {},  # answers 0x42: always understood; named so that a simulated drive can show it
}
"""Name -> the fields that it changes."""


@cache
def quirks_of(names: Sequence[str]) -> Quirks:
    """Return the deviations of a drive; without names, those of a plain CiA 402 drive.

    Args:
        names: A tuple of names of `_QUIRKS`.

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
