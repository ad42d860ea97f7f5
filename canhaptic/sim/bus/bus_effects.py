"""Effects of a simulated bus on its frames, as a scene names them under `simulation.bus`. Absent: the bus is ideal."""

from collections.abc import Sequence
from typing import Annotated, Final, Literal

from pydantic import model_validator

from canhaptic.units import Parameters, quantity

Direction = Literal["to_drive", "to_master"]
_Probability = Annotated[float, quantity("1", ge=0.0, le=1.0)]
_CobId = Annotated[int, quantity("1", ge=0, le=0x7FF)]

_NANO: Final = 1e9
_EFFECTS: Final = (
    *("drop", "duplicate", "reorder", "truncate", "corrupt", "refuse", "delay", "jitter", "foreign_rate", "wire_time"),
    *("freeze", "stall", "bus_off"),
)


class Window(Parameters):
    """A time window, once or periodic."""

    begin: Annotated[float, quantity("s", ge=0.0, le=1e6)] = 0.0
    """Counted from the first SYNC; from the first frame when `bring_up` is set."""
    duration: Annotated[float, quantity("s", gt=0.0, le=1e6)]
    """From its beginning to its end."""
    every: Annotated[float, quantity("s", gt=0.0, le=1e6)] | None = None
    """Period from one beginning to the next; None: it happens once."""

    @model_validator(mode="after")
    def _check(self) -> "Window":
        if self.every is not None and self.every <= self.duration:
            raise ValueError(f"every is {self.every:g} s, expected more than duration ({self.duration:g} s)")
        return self


class BusEffects(Parameters):
    """Faults of frames between master and drives. Probabilities are per frame and direction.

    `direction`, `ids` and `during` select the frames for the effects on single frames: drop, duplicate, reorder,
    truncate, corrupt, refuse, delay, jitter. The others act on the bus as a whole; frames of other devices keep to
    `during` too.
    """

    drop: _Probability = 0.0
    """Share of frames that are lost."""
    drop_burst: Annotated[float, quantity("count", ge=1.0, le=1e4)] | None = None
    """Mean number of frames lost in a row (Gilbert's two states); None: each frame is lost on its own."""
    duplicate: _Probability = 0.0
    """Share of frames that arrive twice."""
    reorder: _Probability = 0.0
    """Share of frames that are held back for `reorder_delay` while those behind them pass."""
    reorder_delay: Annotated[float, quantity("s", gt=0.0, le=10.0)] = 1e-3
    """For which a reordered frame is held back."""
    truncate: _Probability = 0.0
    """Share of frames that lose bytes at their end."""
    corrupt: _Probability = 0.0
    """Share of frames that arrive with one bit of their data turned, as behind a gateway with a fault."""
    refuse: _Probability = 0.0
    """Share of the master's frames that its interface refuses to send (ENOBUFS)."""
    delay: Annotated[float, quantity("s", ge=0.0, le=10.0)] = 0.0
    """Delay of every frame."""
    jitter: Annotated[float, quantity("s", ge=0.0, le=10.0)] = 0.0
    """And later again by anything between zero and this; no frame overtakes another of its direction."""
    direction: Literal["both", "to_drive", "to_master"] = "both"
    """Direction of the frames that are affected."""
    ids: tuple[_CobId, ...] | None = None
    """COB-IDs that suffer; None: all."""
    during: tuple[Window, ...] = ()
    """When they suffer; empty: always."""
    foreign_rate: Annotated[float, quantity("Hz", ge=0.0, le=1e5)] = 0.0
    """Frames of other devices per second, at random times (Poisson), seen by master and drives."""
    foreign_ids: tuple[_CobId, ...] = (0x7F0,)
    """COB-IDs that these frames take in turn; those of an axis make them impostors."""
    wire_time: bool = False
    """Whether each frame takes its worst-case time at `bus.bitrate`, one at a time, lowest COB-ID first."""
    freeze: tuple[Window, ...] = ()
    """When the bus carries no frame; waiting frames come at the end, in one burst."""
    stall: tuple[Window, ...] = ()
    """When the master's host is stalled; needs the master in the same process."""
    bus_off: tuple[Window, ...] = ()
    """When nothing can be sent and what arrives is lost."""
    bring_up: bool = False
    """Whether frames before the first SYNC suffer too."""
    buses: tuple[str, ...] | None = None
    """Names of the buses that suffer, each from faults of its own; None: all."""

    @model_validator(mode="after")
    def _check(self) -> "BusEffects":
        if not any(getattr(self, name) for name in _EFFECTS):
            raise ValueError(f"names no effect, expected one of: {', '.join(_EFFECTS)}; leave it out for an ideal bus")
        for name, what in (("ids", "COB-ID"), ("foreign_ids", "COB-ID"), ("buses", "name")):
            if getattr(self, name) == ():
                raise ValueError(f"{name} is empty, expected at least one {what}; leave it out for the usual ones")
        most = 1.0 if self.drop_burst is None else self.drop_burst / (1.0 + self.drop_burst)
        if self.drop > most:
            raise ValueError(
                f"drop is {self.drop:g}, expected at most {most:g} with a drop_burst of {self.drop_burst:g} frames, "
                "since one frame at least is heard between two bursts"
            )
        return self

    @property
    def named(self) -> tuple[str, ...]:
        """Effects other than their defaults, in the order in which they are listed."""
        return tuple(name for name in _EFFECTS if getattr(self, name))

    def suffers(self, direction: Direction) -> bool:
        """Whether the effects on single frames act on a direction."""
        return self.direction in ("both", direction)


class Schedule:
    """Windows on integer nanoseconds.

    Args:
        windows: Windows of the scene.
    """

    def __init__(self, windows: Sequence[Window]) -> None:
        self._windows = tuple(
            (round(w.begin * _NANO), round(w.duration * _NANO), round((w.every or 0.0) * _NANO)) for w in windows
        )

    def end(self, time: int) -> int:
        """End of the window around `time` [ns], joined with those that follow it at once; 0 in none."""
        latest = time
        for begin, duration, every in self._windows * len(self._windows):  # any of them may follow any other
            since = latest - begin
            if since >= 0 and every:
                since %= every
            if 0 <= since < duration:
                latest += duration - since
        return latest if latest > time else 0
