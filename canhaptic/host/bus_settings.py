"""Settings of a scene for this computer: its buses and the number of drives on each. The models of a scene fit."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol


class BusSettings(Protocol):
    """Settings of one CAN bus."""

    @property
    def interface(self) -> str:
        """Name of python-can's back end."""

    @property
    def channel(self) -> str | int | None:
        """Channel of the back end, such as can0."""

    @property
    def bitrate(self) -> int:
        """Bit rate [bit/s]."""

    @property
    def options(self) -> Mapping[str, Any]:
        """Further options of the back end."""

    @property
    def sample_time(self) -> float:
        """Sample time [s]."""

    @property
    def stop_cycles(self) -> int:
        """Missed cycles after which the rig stops."""


class _NamedBusSettings(Protocol):
    """A bus with the name that axes use for it."""

    @property
    def name(self) -> str:
        """Empty where the rig has one bus only."""

    @property
    def parameters(self) -> BusSettings:
        """Its settings."""


class _AxisPlace(Protocol):
    """The bus of one axis."""

    @property
    def bus(self) -> str:
        """Name of the bus."""


class RigSettings(Protocol):
    """All buses of a rig and the axes on them."""

    @property
    def buses(self) -> Sequence[_NamedBusSettings]:
        """All buses."""

    @property
    def axes(self) -> Sequence[_AxisPlace]:
        """All axes."""
