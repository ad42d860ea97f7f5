"""The buses of a scene: `bus` is one, or a list of several that share one SYNC index, each named by its axes."""

from collections import Counter
from typing import Annotated, Any, Final, NamedTuple

from pydantic import Field

from canhaptic.drive.axis_parameters import BusParameters
from canhaptic.registry import nearest
from canhaptic.scene.diagnostics import Diagnostics
from canhaptic.scene.document import MarkedList, MarkedMapping
from canhaptic.scene.section import read_mapping, read_section
from canhaptic.units import Parameters, quantity, shown

BusName = Annotated[str, Field(min_length=1, max_length=40, pattern=r"^\S+$")]
BUS_KEY: Final = "bus"
"""Of an axis: the name of its bus, where there are several."""
_EXPECTED: Final = "keys and values, or a list of such for several buses"


class NamedBus(NamedTuple):
    """One bus with everything that holds for it."""

    name: str  # empty where the scene has one bus without a name
    parameters: BusParameters


class BusTitle(Parameters):
    """What a bus of several has beside its parameters."""

    name: BusName
    """By which an axis's `bus` names it."""


class FurtherBus(Parameters):
    """What a bus of several may have of its own; rate, link policy and the rest are those of the first."""

    name: BusName
    """By which an axis's `bus` names it."""
    interface: str | None = None
    """python-can interface; None: that of the first bus."""
    channel: str | int | None = None
    """Channel of the interface; None: a private one for `virtual`."""
    bitrate: Annotated[int, quantity("bit/s", ge=10_000, le=1_000_000)] | None = None
    """Bit rate of classic CAN; None: that of the first bus."""
    options: dict[str, Any] | None = None
    """Further keyword arguments of `can.Bus`; None: those of the first bus."""

    def beside(self, first: BusParameters) -> BusParameters:
        """Returns all parameters of this bus."""
        own = {key: value for key, value in self.model_dump(exclude={"name"}).items() if value is not None}
        return first.model_copy(update={"channel": None, **own})


class BusSections(NamedTuple):
    """The buses as a scene has them."""

    name: str  # of the first
    first: BusParameters
    further: tuple[FurtherBus, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all, in order."""
        return (self.name, *(bus.name for bus in self.further))


def read_buses(sections: MarkedMapping, faults: Diagnostics) -> BusSections | None:
    """Returns the buses of a scene; None when they have faults, which are all noted."""
    value = sections.get(BUS_KEY)
    if not isinstance(value, MarkedList):
        section = read_mapping(value, sections.value_at(BUS_KEY), faults, _EXPECTED)
        first = None if section is None else read_section(BusParameters, section, faults)
        return None if first is None else BusSections("", first, ())
    if not value:
        faults.add(value.mark, "got an empty list, expected at least one bus")
        return None
    before = len(faults)
    entries = [read_mapping(entry, at, faults, "name, interface, channel, ...") for entry, at in value.items_at()]
    head, *tail = entries
    first = None if head is None else read_section(BusParameters, head.without("name"), faults, also=("name",))
    title = None if head is None else read_section(BusTitle, head.only(BusTitle.model_fields), faults)
    further = [_read_further(entry, faults) for entry in tail if entry is not None]
    if len(faults) > before or first is None or title is None:
        return None
    buses = BusSections(title.name, first, tuple(bus for bus in further if bus is not None))
    _check_distinct(buses, value, faults)
    return buses if len(faults) == before else None


def _read_further(entry: MarkedMapping, faults: Diagnostics) -> FurtherBus | None:
    common = [key for key in entry if key in BusParameters.model_fields and key not in FurtherBus.model_fields]
    for key in common:
        faults.add(entry.keys_at[key], "holds for all buses of the rig; give it in the first one")
    return read_section(FurtherBus, entry.without(*common), faults)


def _check_distinct(buses: BusSections, entries: MarkedList, faults: Diagnostics) -> None:
    parameters = [buses.first, *(bus.beside(buses.first) for bus in buses.further)]
    for index, entry in enumerate(entries):
        if buses.names.index(buses.names[index]) < index:
            faults.add(entry.value_at("name"), f"got {buses.names[index]!r}, which is the name of another bus already")
    places = [(bus.interface, str(bus.channel)) for bus in parameters]
    for index, (entry, bus) in enumerate(zip(entries, parameters, strict=True)):
        before = places.index(places[index])
        if before < index and (bus.channel is not None or bus.interface != "virtual"):
            faults.add(
                entry.value_at("channel"),
                f"interface {bus.interface!r}, channel {shown(bus.channel)} is bus {buses.names[before]!r} already; "
                "give each bus its own channel",
            )
    if len({bus.interface == "virtual" for bus in parameters}) > 1:
        which = next(index for index, bus in enumerate(parameters) if bus.interface == "virtual")
        faults.add(
            entries[which].value_at("interface"),
            "got 'virtual' beside a bus of another interface; either all buses are inside this process, or none",
        )


def bus_of_axis(section: MarkedMapping, names: tuple[str, ...], faults: Diagnostics) -> str:
    """Returns the name of the bus that an axis is on; a fault is noted when it names none of them."""
    named = section.get(BUS_KEY)
    if named is None and len(names) == 1:
        return names[0]
    if isinstance(named, str) and named in names:
        return named
    known = ", ".join(name for name in names if name)
    if named is None:
        faults.add(section.value_at(BUS_KEY), f"missing, expected the name of the axis's bus: one of {known}")
    elif not known:
        faults.add(section.value_at(BUS_KEY), f"got {shown(named)}, but the scene's bus has no name; leave it out")
    else:
        near = nearest(str(named), names)
        faults.add(section.value_at(BUS_KEY), f"got {shown(named)}, expected one of: {known}{near}")
    return names[0]


def check_every_bus_has_an_axis(
    names: tuple[str, ...], used: list[str], sections: MarkedMapping, faults: Diagnostics
) -> None:
    """Notes every bus that no axis is on."""
    count = Counter(used)
    for index, name in enumerate(names):
        if not count[name]:
            at = bus_section(sections, index).value_at("name")
            faults.add(at, f"no axis is on bus {name!r}; name it in `bus` of an axis, or leave it out")


def bus_section(sections: MarkedMapping, index: int) -> MarkedMapping:
    """Returns the section of one bus as written."""
    value = sections[BUS_KEY]
    section: MarkedMapping = value[index] if isinstance(value, MarkedList) else value
    return section
