"""Check of the options of a python-can interface, and error texts for one that cannot be opened.

Most python-can backends take `**kwargs` and ignore unknown options, so that a misspelt option would go unnoticed. The
known options are therefore read from the source code of the backend, which needs neither its driver nor its device.
"""

import ast
import importlib.util
import logging
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, Protocol

import can
from can.interfaces import BACKENDS

from canhaptic.errors import CanHapticError, InputError, LinkError
from canhaptic.registry import nearest

if TYPE_CHECKING:
    from typing_extensions import TypeIs


class BusSettings(Protocol):
    """Settings of one CAN bus, as a scene has them."""

    interface: str
    """Name of python-can's back end."""
    channel: str | int | None
    """Channel of the back end, such as can0."""
    bitrate: int
    """Bit rate [bit/s]."""
    options: dict[str, Any]
    """Further options of the back end."""
    stop_cycles: int
    """Missed cycles after which the rig stops."""

    @property
    def sample_time(self) -> float:
        """Sample time [s]."""


class LineSettings(Protocol):
    """Settings of one EtherCAT line, as a scene has them."""

    type: Literal["ethercat"]
    """Kind of bus."""
    interface: str
    """`virtual`, or a network interface."""


def is_line(bus: BusSettings | LineSettings) -> "TypeIs[LineSettings]":
    """Whether a bus is an EtherCAT line."""
    return getattr(bus, "type", "can") == "ethercat"


_OF_THE_SCENE: Final = ("interface", "channel", "bitrate")
"""Arguments of `can.Bus` that have their own key in the section `bus`."""

_REMEDIES: Final = Path(__file__).with_suffix(".toml")

logging.getLogger("can").addHandler(logging.NullHandler())  # our error names missing drivers, once


@cache
def _accepted_options(interface: str) -> frozenset[str] | None:
    """Return the keyword arguments of a backend, without those that have a key in `bus`; None if unknown.

    Args:
        interface: Name of an interface of python-can.
    """
    names = {"can_filters"}  # of every bus
    if (definition := _class_definition(*BACKENDS[interface])) is None:
        return None
    for function in (f for f in definition.body if isinstance(f, ast.FunctionDef) and f.name == "__init__"):
        arguments = (*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs)
        names.update(argument.arg for argument in arguments)
        if function.args.kwarg is not None:
            names.update(_read_from(function, function.args.kwarg.arg))
    if "timing" in names:
        names |= {"f_clock", "brp", "tseg1", "tseg2", "sjw", "nof_samples"}  # of which `can.Bus` makes it
    return frozenset(n for n in names if not n.startswith("_")) - {"self", *_OF_THE_SCENE}


def _class_definition(module: str, name: str) -> ast.ClassDef | None:
    """Find a class in the source of a module or package, without importing it; None if it is not found."""
    try:
        spec = importlib.util.find_spec(module)
    except (ImportError, ValueError):
        return None
    if spec is None or spec.origin is None:
        return None
    origin = Path(spec.origin)
    for file in sorted(origin.parent.glob("*.py")) if origin.name == "__init__.py" else [origin]:
        for node in ast.parse(file.read_text(encoding="utf-8", errors="replace")).body:
            if isinstance(node, ast.ClassDef) and node.name == name:
                return node
    return None


def _read_from(function: ast.FunctionDef, kwargs: str) -> Iterator[str]:
    """Yield the names of the options that a function reads from its `**kwargs`."""
    for node in ast.walk(function):
        match node:
            case (
                ast.Call(func=ast.Attribute(value=ast.Name(id=name)), args=[ast.Constant(value=str(key)), *_])
                | ast.Subscript(value=ast.Name(id=name), slice=ast.Constant(value=str(key)))
                | ast.Compare(left=ast.Constant(value=str(key)), comparators=[ast.Name(id=name), *_])
            ) if name == kwargs:
                yield key


_LINUX: Final = re.compile(r"v?s?l?can[0-9]+")
"""What Linux calls its CAN interfaces: a channel of `socketcan`."""


def interface_faults(bus: BusSettings) -> list[tuple[str, str]]:
    """Return (key of `bus`, text) for each interface or option that python-can would refuse or ignore."""
    if bus.interface not in BACKENDS:
        known, given = ", ".join(sorted(BACKENDS)), bus.interface
        hint = f"; for Linux's {given} set interface: socketcan and channel: {given}" if _LINUX.fullmatch(given) else ""
        return [("interface", f"got {given!r}, expected one of: {known}{hint or nearest(given, BACKENDS)}")]
    accepted = _accepted_options(bus.interface)
    faults = []
    for key in bus.options:
        if key in _OF_THE_SCENE:
            faults.append(("options", f"{key} is a key of bus itself; give it there"))
        elif accepted is not None and key not in accepted:
            listed = f"{', '.join(sorted(accepted)) or 'none'}{nearest(key, accepted)}"
            faults.append(("options", f"{bus.interface} takes no option {key!r}, expected any of: {listed}"))
    return faults


def opening_error(bus: BusSettings, channel: str | int | None, error: Exception) -> CanHapticError:
    """Return the error, with cause and remedy, for an interface that could not be opened.

    An `InputError` if the interface, its driver or library is missing; a `LinkError` if the device fails.
    """
    place = f"bus {bus.interface!r}, channel {channel!r}"
    remedies = tomllib.loads(_REMEDIES.read_text(encoding="utf-8"))
    remedy = remedies.get(bus.interface, "install what python-can needs for this interface, and plug the device in")
    remedy = str(remedy).format(channel=channel, bitrate=bus.bitrate)
    seen = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, can.CanError | OSError) and not isinstance(error, can.CanInterfaceNotImplementedError):
        return LinkError(f"{place}: cannot be opened ({seen}); {remedy}")
    lacking = isinstance(error, NameError | AttributeError)  # the library was not there when the backend was imported
    what = f"its driver library is missing: {seen}" if lacking else seen
    return InputError(f"{place}: python-can cannot use it ({what}); {remedy}; or correct bus.channel and bus.options")
