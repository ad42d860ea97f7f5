"""What a Python program gives in place of a name of a scene: a class, an instance, a function, or a recorded motion.

A class becomes a section whose `type` (`algorithm` of an algorithm) refers to it in this process, by its name and the
hash of its source; an instance adds its values. A function becomes a method of a class that is made for it. The rows of
a motion are referred to by their hash. Another process does not have what such a reference means, and says so; `parcel`
takes along what can be imported there.
"""

import dis
import hashlib
import inspect
import io
import linecache
import pickle
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from functools import cache
from os import PathLike, fspath
from typing import Final, NamedTuple

import numpy as np

from canhaptic.control.environments import ENVIRONMENTS
from canhaptic.control.passivity import ALGORITHMS
from canhaptic.errors import InputError, cause_of
from canhaptic.own_results import GIVEN, GIVEN_MARK
from canhaptic.registry import load
from canhaptic.sim.plant.effects import EFFECTS
from canhaptic.sim.plant.user import RecordedMotion, UserParameters, checked_rows
from canhaptic.units import Parameters

_KINDS: Final = {
    "environment": "environment", "user": "hand", "effects": "effect", "passivity": "passivity algorithm",
    "sensor": "sensor",
}  # fmt: skip
"""Key of a scene -> kind of the part that a function there is."""
_OF_FUNCTIONS: Final = {
    "environment": ("canhaptic.control.environments.own_environment:Environment", "effort", ("state",)),
    "hand": ("canhaptic.sim.plant.user:OwnHand", "force", ("time", "position", "velocity")),
    "sensor": ("canhaptic.sim.plant.velocity_drive:OwnSensor", "indicates", ("time", "force")),
    "effect": ("canhaptic.sim.plant.user:ForceEffect", "force", ("time", "position", "velocity")),
    "passivity algorithm": (
        "canhaptic.control.passivity.stepped:SteppedController", "respond", ("run", "hold", "asked")
    ),
}  # fmt: skip
"""Kind of part -> its class, the method that a function becomes, and the arguments of that method."""
_ADDRESS: Final = re.compile(r" at 0x[0-9a-f]+")
_SHIPPED: Final = {place: name for table in (ENVIRONMENTS, ALGORITHMS, EFFECTS) for name, place in table.items()}


class GivenCode(NamedTuple):
    """A class that a Python program gave, or that was made for its function."""

    own: type
    source: str
    given: Callable[..., object]  # the class, or the function
    kind: str  # of a function


def plain(value: object, path: tuple[str, ...] = ()) -> object:
    """Return a value of a scene as plain values.

    Args:
        value: A plain value, a number or array of NumPy, a path, a class or an instance of the user's own, a function,
            or a recorded motion: an array, a frame, or pairs of shape (n, 2), of times [s] and positions [m or rad].
        path: Path of the value in the scene.

    Raises:
        TypeError: It is nothing of these.
    """
    if path[-1:] == ("motion",) and (hasattr(value, "to_numpy") or isinstance(value, list | tuple | np.ndarray)):
        return _motion_of(value)
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, PathLike):
        value = fspath(value)
    if isinstance(value, Mapping):
        return {key: plain(entry, (*path, str(key))) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry, path) for entry in value]
    if value is None or isinstance(value, str | int | float):
        return value
    return section_of(value, next((_KINDS[key] for key in reversed(path) if key in _KINDS), ""))


def section_of(given: object, kind: str = "") -> dict[str, object]:
    """Return the section of a scene for a class, an instance or a function that a Python program gives.

    Args:
        given: It.
        kind: Kind of the part, for a function.

    Raises:
        TypeError: It is none of these.
    """
    own = given if isinstance(given, type) else type(given)
    if inspect.isfunction(given):
        own = class_of(given, kind)
    is_algorithm = hasattr(own, "parameters_type")
    if not (is_algorithm and not isinstance(given, own)) and not issubclass(own, Parameters):
        raise TypeError(f"{own.__name__}: is no class with parameters, no instance of `Parameters` and no function")
    values = given.model_dump(mode="json") if isinstance(given, Parameters) else {}
    if isinstance(motion := getattr(given, "motion", None), RecordedMotion):
        values["motion"] = _recorded(motion.rows)
    selector = "algorithm" if is_algorithm else "type"
    if own is UserParameters:
        return values
    known = _SHIPPED.get(f"{own.__module__}:{own.__name__}")
    return {**values, selector: known or _reference(own, given if inspect.isfunction(given) else own, kind)}


def _reference(own: type, given: Callable[..., object], kind: str) -> str:
    source = _source_of(given)
    digest = hashlib.sha256(source.encode()).hexdigest()
    name, number = f"{GIVEN_MARK}{own.__name__}:{digest}", 1
    while GIVEN.setdefault(name, GivenCode(own, source, given, kind)).own is not own:  # same source, other values
        number += 1
        name = f"{GIVEN_MARK}{own.__name__}:{digest}:{number}"
    return name


def _source_of(given: Callable[..., object]) -> str:
    """Return the source of a class or function; of a class that has none, as in a notebook, that of its methods.

    A function that was typed where Python keeps no source has its instructions.
    """
    file = given.__code__.co_filename if inspect.isfunction(given) else ""
    if not file or linecache.getlines(file):  # else Python would take the lines of another file
        with suppress(OSError, TypeError):
            return inspect.getsource(given)
    if isinstance(given, type):
        own = [of for of in vars(given).values() if inspect.isfunction(of) and of.__module__ == given.__module__]
        defaults = {name: field.default for name, field in getattr(given, "model_fields", {}).items()}
        return "\n".join((_ADDRESS.sub("", repr(defaults)), *map(_source_of, own)))
    instructions = io.StringIO()
    dis.dis(given, file=instructions)
    return _ADDRESS.sub("", instructions.getvalue())


@cache
def class_of(function: Callable[..., object], kind: str) -> type:
    """Return a class whose method is a function; further arguments of the function are its parameters.

    Raises:
        TypeError: It cannot be such a part, or has other arguments.
    """
    if kind not in _OF_FUNCTIONS:
        raise TypeError(f"{function.__name__}: a function can be an {', a '.join(_KINDS.values())}")
    base, method, words = _OF_FUNCTIONS[kind]
    own, of = load({kind: base}, kind, kind), inspect.signature(function).parameters
    named = {key: one.default for key, one in list(of.items())[len(words) :]}
    if len(of) < len(words) or inspect.Parameter.empty in named.values():
        text = f"{function.__name__}({', '.join(of)}): expected {method}({', '.join(words)})"
        raise TypeError(f"{text}, and further arguments, the parameters of the {kind}, with a value each")
    body: dict[str, object] = {"__module__": function.__module__, "__doc__": function.__doc__}
    if kind == "passivity algorithm":
        body["parameters_type"] = load({kind: "canhaptic.control.damping:DamperVelocity"}, kind, kind)
        sampled_kernel = load({kind: "canhaptic.control.passivity.unprotected:sampled_kernel"}, kind, kind)
        body["kernel"] = sampled_kernel(function)
        return type(function.__name__, (own,), body)

    def called(self: object, *values: float) -> object:
        return function(*values, **{key: getattr(self, key) for key in named})

    called.__name__ = method
    body |= {method: called, "__annotations__": dict.fromkeys(named, float), **named}
    made: type = type(own)(function.__name__, (own,), body)
    return made


def _motion_of(value: object) -> dict[str, object]:
    table = np.asarray(getattr(value, "to_numpy", lambda: value)(), dtype=float)
    if table.ndim != 2 or table.shape[1] != 2:
        text = f"got an array of shape {table.shape}, expected (n, 2): times [s] and positions [m or rad]"
        raise TypeError(f"{text}; numpy.column_stack((time, position)) makes one of two columns")
    try:
        rows = checked_rows((f"row {number}", *row) for number, row in enumerate(table.tolist()))
    except ValueError as error:
        raise TypeError(str(error)) from error
    return _recorded(rows)


def _recorded(rows: tuple[tuple[float, float], ...]) -> dict[str, object]:
    name = f"{GIVEN_MARK}motion:{hashlib.sha256(np.array(rows).tobytes()).hexdigest()}"
    GIVEN[name] = rows
    return {"type": "recorded", "file": name}


def sources_of(references: Iterable[str]) -> dict[str, str]:
    """Return the source of each reference to code that a Python program gave."""
    return {name: GIVEN[name].source for name in references if isinstance(GIVEN.get(name), GivenCode)}


def parcel(overrides: Iterable[str], where: str) -> bytes:
    """Return what overrides refer to, for another process on this computer, which passes it to `unpack`.

    Args:
        overrides: Overrides of a scene.
        where: What the process is for, in an error.

    Raises:
        InputError: Another process could not import a class or function.
    """
    text = "\n".join(overrides)
    items: list[tuple[str, object]] = []
    for name, of in GIVEN.items():
        if name not in text:
            continue
        if isinstance(of, GivenCode):
            module = sys.modules.get(of.given.__module__)
            try:
                pickle.dumps(of.given)
            except (pickle.PicklingError, AttributeError, TypeError):
                module = None
            if not getattr(module, "__file__", None):
                text = f"{of.own.__name__}: is defined in a notebook or within a function, where {where} cannot find it"
                raise InputError(f"{text}; define it in a file of its own, and import it from there")
        items.append((name, of._replace(own=object) if isinstance(of, GivenCode) else of))
    return pickle.dumps(items)


def unpack(parcelled: bytes) -> None:
    """Take what `parcel` of another process has.

    Raises:
        InputError: A class or function cannot be imported.
    """
    try:
        items = pickle.loads(parcelled) if parcelled else []
    except Exception as error:  # importing own code may raise anything
        text = "what the program gave cannot be imported in another process"
        raise InputError(f"{text} ({cause_of(error)}); define it in a file of its own") from error
    for name, of in items:
        if isinstance(of, GivenCode):
            of = of._replace(own=of.given if isinstance(of.given, type) else class_of(of.given, of.kind))
        GIVEN.setdefault(name, of)
