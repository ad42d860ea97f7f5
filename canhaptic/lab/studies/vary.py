"""Varied keys of a sweep (`parse_vary`), and its scenes by global index (`Points`).

    KEY=LOW:HIGH:N            N values, evenly spaced          KEY=LOW:HIGH:log:N     evenly spaced in the logarithm
    KEY=A,B,C                 exactly these, of any type       KEY=LOW:HIGH[:log]     a range, for a Latin hypercube

For example `environment.stiffness=1e2:1e6:log:40`, `bus.rate=40,1 kHz`, `bus.rpdo=event,synchronous`. Numbers are in SI
or have a unit, as in a scene, which checks the dimension.

The scenes are a grid of all values or a Latin hypercube. The hypercube is computed with integers and one division (a
keyed hash, sorted), so that it is the same on every machine, with any version of NumPy and any number of workers.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
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
        values: All values; for a range without a number of values, its two ends.
        unit: Unit as the user typed it; "" for SI.
        spacing: Spacing of a range; "list" for values given one by one.
        is_open: Whether it is a range whose values a Latin hypercube chooses.
    """

    key: str
    values: tuple[Value, ...]
    unit: str
    spacing: Literal["list", "lin", "log"]
    is_open: bool = False

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

    def at(self, shares: Array) -> "Column":
        """Return the values at fractions of the range, 0 <= share < 1, shape (n,), for a Latin hypercube.

        Each value of a list gets an equal part of 0 to 1.
        """
        if self.spacing == "list":
            return _picked(self, (shares * len(self.values)).astype(int))
        low, high = (float(value) for value in (self.values[0], self.values[-1]))
        return np.array([_within(low, high, share, self.spacing) for share in shares.tolist()])

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
        count = "" if self.is_open else f":{len(self.values)}"
        return f"{self.key}={short(self.values[0])}:{short(self.values[-1])}:{self.spacing}{count}"


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
        raise _refused(f"{key}=...", f"got {text}", "expected a number, a text such as '1:10:5', or a list of them")
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
    unit, [count] = high[1] or low[1], words or ["2"]
    if not count.isascii() or not count.isdigit():
        raise _refused(text, f"got {count!r} for the number of values", _SHAPES)
    scale = parse_unit(unit)[0] if unit else 1.0
    values = _spaced(text, low[0] * scale, high[0] * scale, int(count), spacing)
    return Varied(key, values, unit, spacing, is_open=not words)


def _spaced(text: str, low: float, high: float, count: int, spacing: str) -> tuple[float, ...]:
    if not 2 <= count <= _MOST_VALUES:
        raise _refused(text, f"got {count} values", f"expected 2 to {_MOST_VALUES}")
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise _refused(text, f"got {low:g} to {high:g}", "expected finite ends, the lower one first")
    if spacing == "log" and not low > 0.0:
        raise _refused(text, f"got {low:g} as the lower end", "a logarithmic range begins above 0; use lin, or list 0")
    return (low, *(_within(low, high, i / (count - 1), spacing) for i in range(1, count - 1)), high)


def _within(low: float, high: float, share: float, spacing: str) -> float:
    return low * math.pow(high / low, share) if spacing == "log" else low + (high - low) * share


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

_Hashes = NDArray[np.uint64]
_SEED_STEP: Final = 0x9E3779B97F4A7C15
_MIX: Final = ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB))
_MANTISSA: Final = 53


@dataclass(frozen=True, slots=True)
class Points:
    """The points of a sweep: the varied values of every scene, by its global index.

    Attributes:
        varied: Keys with their values; in a grid the last key changes fastest.
        samples: Points of a Latin hypercube; 0 for the grid of all values.
        seed: Seed of the hypercube.
    """

    varied: tuple[Varied, ...]
    samples: int = 0
    seed: int = 0

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the scenes: number of values of each key of a grid, or ([algorithms,] samples) of a hypercube."""
        if not self.samples:
            return tuple(len(varied.values) for varied in self.varied)
        return (*(len(varied.values) for varied in self.varied if varied.key == CONTROLLER), self.samples)

    def __len__(self) -> int:
        return math.prod(self.shape)

    def numbers(self, key: str) -> NDArray[np.intp]:
        """Return, for every scene, the index of its value among the values of a key of the grid, shape (n,)."""
        place = 0 if self.samples else [varied.key for varied in self.varied].index(key)
        return np.unravel_index(np.arange(len(self)), self.shape)[place]

    def columns(self, start: int, stop: int) -> dict[str, "Column"]:
        """Return the values of scenes `start` to `stop` by key, each of length stop - start."""
        indices = np.unravel_index(np.arange(start, stop), self.shape)
        if not self.samples:
            return {v.key: _picked(v, index) for v, index in zip(self.varied, indices, strict=True)}
        found: dict[str, Column] = {}
        for order, varied in enumerate(self.varied):
            shares = _shares(self.samples, self.seed, order)[indices[-1]]
            found[varied.key] = _picked(varied, indices[0]) if varied.key == CONTROLLER else varied.at(shares)
        return found


def make_points(varied: Sequence[Varied], controllers: Sequence[str] = (), samples: int = 0, seed: int = 0) -> Points:
    """Return the points of a sweep, a grid or a Latin hypercube.

    Args:
        varied: Keys with their values.
        controllers: Passivity algorithms to run every point under; empty: the scene's own.
        samples: Points of a Latin hypercube; 0 for a grid.
        seed: Seed of the hypercube.

    Raises:
        InputError: Nothing varies, a key varies twice, a range of a grid has no number of values, or there are too many
            scenes.
    """
    keys = [one.key for one in varied]
    twice = sorted({key for key in keys if keys.count(key) > 1})
    if twice:
        raise InputError(f"--vary: {twice[0]} is given twice; give all its values at once")
    if controllers:
        varied = [listed(CONTROLLER, controllers), *varied]
    if not varied:
        raise InputError("nothing varies; give --vary KEY=LOW:HIGH:log:N or KEY=A,B,C, or --controllers A,B")
    for one in varied:
        if one.is_open and not samples:
            raise InputError(f"--vary {one}: has no number of values; add :N, or sample it with --sample lhs:N")
    points = Points(tuple(varied), samples, seed)
    if len(points) > _MOST_SCENES:
        raise InputError(
            f"got {len(points)} scenes, expected at most {_MOST_SCENES}; take fewer values, or --sample lhs:N"
        )
    return points


def scene_seeds(base: int, indices: NDArray[np.intp]) -> Array:
    """Return the random seeds of the scenes at the given indices of the whole sweep: whole numbers, shape (n,)."""
    return (_hashed(base, 0xC0, indices.astype(np.uint64)) % np.uint64(1_000_000_001)).astype(float)


def _picked(varied: Varied, index: NDArray[np.intp]) -> Column:
    if varied.is_number:
        return np.array(varied.values, dtype=np.float64)[index]
    return [varied.values[i] for i in index.tolist()]


@lru_cache(maxsize=16)
def _shares(samples: int, seed: int, order: int) -> Array:
    """Return one point in each of `samples` equal strata of 0 to 1, shuffled, shape (samples,)."""
    numbers = np.arange(samples, dtype=np.uint64)
    strata = np.argsort(_hashed(seed, 2 * order, numbers), kind="stable")
    within = (_hashed(seed, 2 * order + 1, numbers) >> np.uint64(64 - _MANTISSA)) * 2.0**-_MANTISSA
    shares: Array = np.minimum((strata + within) / samples, np.nextafter(1.0, 0.0))
    return shares


def _hashed(seed: int, stream: int, numbers: _Hashes) -> _Hashes:
    """Return the finaliser of SplitMix64 (Steele, Lea, Flood, OOPSLA 2014) of seed, stream and each number."""
    mixed = np.array([seed * 1024 + stream], dtype=np.uint64)
    for value in (None, numbers):
        mixed = (mixed if value is None else mixed ^ value) + np.uint64(_SEED_STEP)
        for shift, factor in _MIX:
            mixed = (mixed ^ (mixed >> np.uint64(shift))) * np.uint64(factor)
        mixed ^= mixed >> np.uint64(31)
    return mixed
