"""Several buses of a rig: the keys that each may have of its own, and the parameters in effect on each."""

from typing import Annotated, Any, NamedTuple

from pydantic import Field

from canhaptic.drive.axis_parameters import BusParameters
from canhaptic.units import Name, Parameters, PrintableText, quantity

BusName = Annotated[Name, Field(pattern=r"^\S+$")]


class FurtherBus(Parameters):
    """Keys that each of several buses may have; rate, link policy and the rest are those of the first."""

    name: BusName
    """Name used in an axis's `bus`."""
    interface: PrintableText | None = None
    """python-can interface; None: that of the first bus."""
    channel: PrintableText | int | None = None
    """Channel of the interface; None: a private one for `virtual`."""
    bitrate: Annotated[int, quantity("bit/s", ge=10_000, le=1_000_000)] | None = None
    """Bit rate of classic CAN; None: that of the first bus."""
    options: dict[str, Any] | None = None
    """Further keyword arguments of `can.Bus`; None: those of the first bus."""

    def over(self, first: BusParameters) -> BusParameters:
        """Return all parameters of this bus."""
        own = {key: value for key, value in self.model_dump(exclude={"name"}).items() if value is not None}
        return first.model_copy(update={"channel": None, **own})


class NamedBus(NamedTuple):
    """One bus with the parameters in effect on it."""

    name: str  # empty where the scene has one bus without a name
    parameters: BusParameters
