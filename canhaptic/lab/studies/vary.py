"""Varied keys of a sweep (`parse_vary`), and its scenes by global index (`Points`).

    KEY=LOW:HIGH:N            N values, evenly spaced          KEY=LOW:HIGH:log:N     evenly spaced in the logarithm
    KEY=A,B,C                 exactly these, of any type

For example `environment.stiffness=1e2:1e6:log:40`, `bus.rate=40,1 kHz`, `bus.rpdo=event,synchronous`. Numbers are in SI
or have a unit, as in a scene, which checks the dimension. The scenes are the grid of all values.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from canhaptic.errors import InputError
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.scene.document import Diagnostics, parse_yaml
from canhaptic.units import parse_unit

_MOST_VALUES: Final = 1_000_000
"""Largest number of values of one key."""
Value = float | str
"""A number in SI, or the YAML text of anything else."""

_SPACINGS: Final = ("lin", "log")
_LARGEST_INTEGER: Final = 2.0**53
_NUMBER: Final = re.compile(r"[-+]?(?:\d[\d_]*\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_SHAPES: Final = "expected LOW:HIGH:N, LOW:HIGH:log:N, or values with commas"


@dataclass(frozen=True, slots=True)
class Varied:
    """One key of a scene and the values it takes.

    Attributes:
        key: Path in the scene, as for `--set`.
        values: All values.
        unit: Unit as the user typed it; "" for SI.
        spacing: Spacing of a range; "list" for values given one by one.
    """

    key: str
    values: tuple[Value, ...]
    unit: str
    spacing: Literal["list", "lin", "log"]

    @property
    def is_number(self) -> bool:
        """Whether every value is a number."""
        return all(isinstance(value, float) for value in self.values)

    @property
    def ends(self) -> tuple[Value, ...]:
        """Values to be checked: the ends of a range, which decide for the values between, or all values of a list."""
        if self.spacing == "list":
            return self.values
        return tuple(dict.fromkeys((self.values[0], self.values[-1])))

    def yaml(self, value: Value, *, with_unit: bool = False) -> str:
        """Return a value as YAML text for an override, in SI; `with_unit`: in the typed unit, so that it is checked."""
        if isinstance(value, str):
            return value
        if with_unit and self.unit:
            return f'"{value / parse_unit(self.unit)[0]!r} {self.unit}"'
        return repr(int(value) if value.is_integer() and abs(value) < _LARGEST_INTEGER else value)

    def __str__(self) -> str:
        """Return the key and its values in one line, with six digits."""
        if self.spacing == "list":
            return f"{self.key}={','.join(short(value) for value in self.values)}"
        return f"{self.key}={short(self.values[0])}:{short(self.values[-1])}:{self.spacing}:{len(self.values)}"


def parse_vary(text: str) -> Varied:
    """Return the varied key of a `--vary` option.

    Raises:
        InputError: The text has none of the forms above, or a number, spacing or count is out of range.
    """
    key, equals, rest = text.partition("=")
    key, rest = key.strip(), rest.strip()
    if not equals or not key or not rest:
        raise _refused(text, "got no KEY=VALUES", _SHAPES)
    parts = _split(rest, ":")
    if len(parts) > 1 and _number(parts[0]) is not None:
        return _range(text, key, parts)
    items = [item.strip() for item in _split(rest, ",")]
    if not all(items):
        raise _refused(text, "got an empty value", "remove the comma too many")
    return _list(text, key, items)


def ranged(key: str, low: float, high: float, count: int, spacing: Literal["lin", "log"] = "lin") -> Varied:
    """Return a key with evenly spaced values, ends included, in SI.

    Raises:
        InputError: The ends are not finite and rising, or the count is out of range.
    """
    return Varied(key, _spaced(f"{key}={low:g}:{high:g}", low, high, count, spacing), "", spacing)


def listed(key: str, values: object) -> Varied:
    """Return a key with values given in Python: a number in SI, a text as after `KEY=`, or a list or array of them.

    Raises:
        InputError: The values have none of these forms, or there are none.
    """
    if isinstance(values, str):
        return parse_vary(f"{key}={values}")
    given = values.tolist() if isinstance(values, np.ndarray | np.generic) else values
    items = list(given) if isinstance(given, list | tuple | range) else [given]
    if not items or not all(_is_value(item) for item in items):
        text = f"{values!r}"[:80]
        raise _refused(
            f"{key}=...",
            f"got {text}",
            "expected a number, a text such as '1:10:5', or a list of them; an object of your own goes into `changes`",
        )
    if any(isinstance(item, str) for item in items):
        return _list(key, key, [str(item) for item in items])
    numbers: list[Any] = items
    return Varied(key, tuple(dict.fromkeys(float(item) for item in numbers)), "", "list")


def _is_value(item: object) -> bool:
    """Return whether a value of Python is a finite number or a text that is not empty."""
    if isinstance(item, str):
        return bool(item.strip())
    return isinstance(item, int | float | np.number) and not isinstance(item, bool) and math.isfinite(item)


def _refused(text: str, seen: str, remedy: str) -> InputError:
    return InputError(f"--vary {text}: {seen}; {remedy}")


def _range(text: str, key: str, parts: list[str]) -> Varied:
    spacing: Literal["lin", "log"] = "lin"
    words = [part.strip() for part in parts[2:]]
    if words and words[0] in _SPACINGS:
        spacing = "log" if words.pop(0) == "log" else "lin"
    low, high = _number(parts[0]), _number(parts[1])
    if low is None or high is None or len(words) > 1:
        raise _refused(text, f"cannot read the range {':'.join(parts)!r}", _SHAPES)
    if low[1] and high[1] and low[1] != high[1]:
        raise _refused(text, f"got the units {low[1]!r} and {high[1]!r}", "give both ends in one unit")
    if not words:
        raise _refused(text, "has no number of values", "add :N")
    unit, [count] = high[1] or low[1], words
    if not count.isascii() or not count.isdigit():
        raise _refused(text, f"got {count!r} for the number of values", _SHAPES)
    scale = parse_unit(unit)[0] if unit else 1.0
    values = _spaced(text, low[0] * scale, high[0] * scale, int(count), spacing)
    return Varied(key, values, unit, spacing)


def _spaced(text: str, low: float, high: float, count: int, spacing: str) -> tuple[float, ...]:
    if not 2 <= count <= _MOST_VALUES:
        raise _refused(text, f"got {count} values", f"expected 2 to {_MOST_VALUES}")
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise _refused(text, f"got {low:g} to {high:g}", "expected finite ends, the lower one first")
    if spacing == "log" and not low > 0.0:
        raise _refused(text, f"got {low:g} as the lower end", "a logarithmic range begins above 0; use lin, or list 0")
    shares = (i / (count - 1) for i in range(1, count - 1))
    if spacing == "log":
        return (low, *(low * math.pow(high / low, share) for share in shares), high)
    return (low, *(low + (high - low) * share for share in shares), high)


def _list(text: str, key: str, items: list[str]) -> Varied:
    read = [_number(item) for item in items]
    numbers = [number for number in read if number is not None]
    if len(numbers) < len(items):
        return Varied(key, tuple(dict.fromkeys(_plain(text, item) for item in items)), "", "list")
    units = {unit for _, unit in numbers if unit}
    values = [number * (parse_unit(unit)[0] if unit else 1.0) for number, unit in numbers]
    if not all(math.isfinite(value) for value in values):
        raise _refused(text, "got a number that is not finite", "give finite values")
    if len({parse_unit(unit)[1] for unit in units}) > 1:
        raise _refused(text, f"got the units {', '.join(sorted(units))}", "give values of one dimension")
    return Varied(key, tuple(dict.fromkeys(values)), min(units, default=""), "list")


def _plain(text: str, item: str) -> str:
    """Return the text of a value, after checking that it is valid YAML."""
    faults = Diagnostics()
    parse_yaml(item, f"--vary {text}", faults, lined=False)
    faults.raise_if_any()
    return item


def _number(text: str) -> tuple[float, str] | None:
    """Return (number, unit) of `1e3` or `1 kHz`; None when it is not a number with a known unit."""
    text = text.strip().strip("\"'")
    match = _NUMBER.match(text)
    if match is None:
        return None
    unit = text[match.end() :].strip()
    try:
        if unit:
            parse_unit(unit)
    except ValueError:
        return None
    return float(match.group(0).replace("_", "")), unit


def _split(text: str, separator: str) -> list[str]:
    """Split outside of brackets and quotes."""
    parts, depth, quote = [""], 0, ""
    for letter in text:
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "\"'":
            quote = letter
        depth += (letter in "[{") - (letter in "]}") if not quote else 0
        if letter == separator and not depth and not quote:
            parts.append("")
        else:
            parts[-1] += letter
    return parts


def short(value: Value) -> str:
    """Return a value as text, a number with six digits."""
    return value if isinstance(value, str) else f"{value:.6g}"


CONTROLLER: Final = "controller"
"""Varied key for the passivity algorithm; each point is run under every algorithm."""
_MOST_SCENES: Final = 100_000_000
Column = Array | list[Value]
"""Values of one key for consecutive scenes: numbers, or YAML texts."""

_SEED_STEP: Final = 0x9E3779B97F4A7C15
_MIX: Final = ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB))


@dataclass(frozen=True, slots=True)
class Points:
    """The points of a sweep: the varied values of every scene, by its global index.

    Attributes:
        varied: Keys with their values; the last key changes fastest.
    """

    varied: tuple[Varied, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values of each key."""
        return tuple(len(varied.values) for varied in self.varied)

    def __len__(self) -> int:
        return math.prod(self.shape)

    def numbers(self, key: str) -> NDArray[np.intp]:
        """Return, for every scene, the index of its value among the values of a key, shape (n,)."""
        place = [varied.key for varied in self.varied].index(key)
        return np.unravel_index(np.arange(len(self)), self.shape)[place]

    def columns(self, start: int, stop: int) -> dict[str, "Column"]:
        """Return the values of scenes `start` to `stop` by key, each of length stop - start."""
        indices = np.unravel_index(np.arange(start, stop), self.shape)
        return {v.key: _picked(v, index) for v, index in zip(self.varied, indices, strict=True)}


def make_points(varied: Sequence[Varied], controllers: Sequence[str] = ()) -> Points:
    """Return the points of a sweep.

    Args:
        varied: Keys with their values.
        controllers: Passivity algorithms to run every point under; empty: the scene's own.

    Raises:
        InputError: Nothing varies, a key varies twice, or there are too many scenes.
    """
    keys = [one.key for one in varied]
    twice = sorted({key for key in keys if keys.count(key) > 1})
    if twice:
        raise InputError(f"--vary: {twice[0]} is given twice; give all its values at once")
    if controllers:
        varied = [listed(CONTROLLER, controllers), *varied]
    if not varied:
        raise InputError("nothing varies; give --vary KEY=LOW:HIGH:log:N or KEY=A,B,C, or --controllers A,B")
    points = Points(tuple(varied))
    if len(points) > _MOST_SCENES:
        raise InputError(f"got {len(points)} scenes, expected at most {_MOST_SCENES}; take fewer values")
    return points


def scene_seeds(base: int, indices: NDArray[np.intp]) -> Array:
    """Return the random seeds of the scenes at the given indices of the whole sweep: whole numbers, shape (n,).

    It is the finaliser of SplitMix64 (Steele, Lea, Flood, OOPSLA 2014) of base and index, the same on every machine.
    """
    mixed = np.array([base * 1024 + 0xC0], dtype=np.uint64)
    for value in (np.uint64(0), indices.astype(np.uint64)):
        mixed = (mixed ^ value) + np.uint64(_SEED_STEP)
        for shift, factor in _MIX:
            mixed = (mixed ^ (mixed >> np.uint64(shift))) * np.uint64(factor)
        mixed ^= mixed >> np.uint64(31)
    return (mixed % np.uint64(1_000_000_001)).astype(float)


def _picked(varied: Varied, index: NDArray[np.intp]) -> Column:
    if varied.is_number:
        return np.array(varied.values, dtype=np.float64)[index]
    return [varied.values[i] for i in index.tolist()]
