"""Effects on single frames, one class each; a line of a bus runs only those that its scene names.

Each draws from a random stream of its own, once per frame, so that naming one more effect does not change the others.
"""

import copy
from collections.abc import Callable
from random import Random
from typing import NamedTuple, Protocol

import can

from canhaptic.sim.bus.bus_effects import BusEffects, Direction


class Flight(NamedTuple):
    """A frame on its way."""

    message: can.Message
    due: int  # when it arrives [ns]
    keeps_order: bool  # False: the ones behind it may overtake


_Count = Callable[[str, int], None]
"""Called as count(effect, COB-ID) for each frame that an effect struck."""


class _FrameEffect(Protocol):
    """Effect on one frame: none, another due time, another content, no frame, or two."""

    def apply(self, flight: Flight) -> list[Flight]:
        """Apply delay, loss or corruption to one frame; return the resulting frames."""


def _with_data(message: can.Message, data: bytearray) -> can.Message:
    """Return a copy of a frame with other data."""
    changed = copy.copy(message)
    changed.data, changed.dlc = data, len(data)
    return changed


class _Drop:
    """Loses frames, each on its own or in runs (Gilbert, 1960: two states, lost and received)."""

    def __init__(self, effects: BusEffects, random: Random, count: _Count) -> None:
        share, burst = effects.drop, effects.drop_burst
        self._after_heard = share if burst is None else share / (burst * (1.0 - share))
        self._after_lost = share if burst is None else 1.0 - 1.0 / burst
        self._is_lost = False
        self._random, self._count = random, count

    def apply(self, flight: Flight) -> list[Flight]:
        """Return the frame, or nothing."""
        self._is_lost = self._random.random() < (self._after_lost if self._is_lost else self._after_heard)
        if not self._is_lost:
            return [flight]
        self._count("drop", flight.message.arbitration_id)
        return []


class _Truncate:
    """Cuts bytes off the end of the data."""

    def __init__(self, effects: BusEffects, random: Random, count: _Count) -> None:
        self._share, self._random, self._count = effects.truncate, random, count

    def apply(self, flight: Flight) -> list[Flight]:
        """Return the frame, perhaps shorter."""
        message = flight.message
        if self._random.random() >= self._share or not message.data:
            return [flight]
        self._count("truncate", message.arbitration_id)
        kept = self._random.randrange(len(message.data))
        return [flight._replace(message=_with_data(message, bytearray(message.data[:kept])))]


class _Corrupt:
    """Flips one bit of the data."""

    def __init__(self, effects: BusEffects, random: Random, count: _Count) -> None:
        self._share, self._random, self._count = effects.corrupt, random, count

    def apply(self, flight: Flight) -> list[Flight]:
        """Return the frame, perhaps with another content."""
        message = flight.message
        if self._random.random() >= self._share or not message.data:
            return [flight]
        self._count("corrupt", message.arbitration_id)
        bit = self._random.randrange(8 * len(message.data))
        data = bytearray(message.data)
        data[bit // 8] ^= 1 << bit % 8
        return [flight._replace(message=_with_data(message, data))]


class _Delay:
    """Delays every frame by a fixed time and a random one."""

    def __init__(self, effects: BusEffects, random: Random, count: _Count) -> None:
        self._delay, self._jitter = round(effects.delay * 1e9), round(effects.jitter * 1e9)
        self._random = random

    def apply(self, flight: Flight) -> list[Flight]:
        """Return the frame with its new due time."""
        later = self._delay + (self._random.randrange(self._jitter + 1) if self._jitter else 0)
        return [flight._replace(due=flight.due + later)]


class _Duplicate:
    """Duplicates a frame, one right behind the other."""

    def __init__(self, effects: BusEffects, random: Random, count: _Count) -> None:
        self._share, self._random, self._count = effects.duplicate, random, count

    def apply(self, flight: Flight) -> list[Flight]:
        """Return the frame once or twice."""
        if self._random.random() >= self._share:
            return [flight]
        self._count("duplicate", flight.message.arbitration_id)
        return [flight, flight._replace(message=_with_data(flight.message, bytearray(flight.message.data)))]


class _Reorder:
    """Delays a frame while others overtake it."""

    def __init__(self, effects: BusEffects, random: Random, count: _Count) -> None:
        self._share, self._hold = effects.reorder, round(effects.reorder_delay * 1e9)
        self._random, self._count = random, count

    def apply(self, flight: Flight) -> list[Flight]:
        """The frame, perhaps delayed."""
        if self._random.random() >= self._share:
            return [flight]
        self._count("reorder", flight.message.arbitration_id)
        return [Flight(flight.message, flight.due + self._hold, keeps_order=False)]


class Refuse:
    """Selects the frames that the interface refuses to take (ENOBUFS)."""

    def __init__(self, effects: BusEffects, seed: int) -> None:
        self._share, self._random = effects.refuse, stream(seed, "to_drive", "refuse")

    def happens(self) -> bool:
        """Return whether the next frame is refused."""
        return self._random.random() < self._share


_CLASSES: dict[str, Callable[[BusEffects, Random, _Count], _FrameEffect]] = {
    "drop": _Drop,
    "truncate": _Truncate,
    "corrupt": _Corrupt,
    "delay": _Delay,
    "jitter": _Delay,
    "duplicate": _Duplicate,
    "reorder": _Reorder,
}


def stream(seed: int, direction: str, effect: str) -> Random:
    """Random numbers of one effect on one direction; the same on every machine."""
    return Random(f"canhaptic bus {seed} {direction} {effect}")


def frame_effects(effects: BusEffects, direction: Direction, seed: int, count: _Count) -> list[_FrameEffect]:
    """Effects on single frames that a scene names for one direction, in the order in which they act."""
    if not effects.suffers(direction):
        return []
    chosen = {kind: name for name, kind in _CLASSES.items() if name in effects.named}
    return [kind(effects, stream(seed, direction, name), count) for kind, name in chosen.items()]
