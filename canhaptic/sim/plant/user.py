"""The human at the handle: an impedance (stiffness, damping) between a voluntary motion and the handle.

Hand force on the handle: K (x_u - q) + D (v_u - v) + push, with x_u the voluntary motion. A sinusoid enters the plant
as two states of a harmonic oscillator, so that hand and plant together stay exactly linear. Hogan, "Impedance control",
ASME J. Dynamic Systems 107, 1985, for the model; grips measured on hands: 100..1000 N/m, 1..10 N*s/m.

A recorded motion is a table of places, joined by straight lines: between two rows the hand moves at constant speed,
which keeps the plant exactly linear. The place is a state and its speed is set at every row; a row on a sample time
costs nothing.
"""

import csv
import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import Discriminator, Tag, ValidationInfo, field_serializer, model_validator

from canhaptic.input_file import read_regular
from canhaptic.sim.plant.assembly import Part, PlantModel, Rows
from canhaptic.units import Parameters, PrintablePath, PrintableText, Unit, quantity

_HAND: Final = "hand"
"""Name of the hand's part and of its work."""
PLACE: Final = "hand_place"
"""State that is the place of a hand that is recorded, or set from outside [m or rad]."""
SPEED: Final = "hand_speed"
"""State that is the speed of a recorded hand [m/s or rad/s]."""


_MOST_BYTES: Final = 50_000_000
_FARTHEST: Final = 1e3  # [m or rad], as for every place of a hand
_SECONDS: Final = Unit("s", "s")
_PLACES: Final = Unit("m", "rad")


class SinusoidMotion(Parameters):
    """Voluntary motion x_u(t) = offset + amplitude * sin(2 pi frequency t + phase), t from the start of the plant."""

    type: Literal["sinusoid"] = "sinusoid"
    amplitude: Annotated[float, quantity("m", "rad", ge=0.0, le=1e3)]
    """Half of the way from end to end."""
    frequency: Annotated[float, quantity("Hz", gt=0.0, le=1e3)]
    """Cycles per second."""
    phase: Annotated[float, quantity("rad", ge=-10.0, le=10.0)] = 0.0
    """At the start of the plant."""
    offset: Annotated[float, quantity("m", "rad", ge=-1e3, le=1e3)] = 0.0
    """Middle of the motion."""

    def position(self, time: float) -> float:
        """Return x_u [m or rad] at `time` [s]."""
        return self.offset + self.amplitude * math.sin(2.0 * math.pi * self.frequency * time + self.phase)


class RecordedMotion(Parameters):
    """Voluntary motion x_u(t) of a recording, t from the start of the plant and from the first row of the table.

    Straight lines join its rows. Behind the last row the hand stays where it is.
    """

    type: Literal["recorded"] = "recorded"
    file: PrintablePath
    """Table (CSV) in the folder of the scene: a heading with `time` and `position`, each in SI or with its unit as in
    `time [ms]`, and at least two rows. A table of `inspect --csv` is one. Behind its last row the hand stays."""
    column: PrintableText = "position"
    """Heading of the position, or its end: `handle.position`."""

    _rows: tuple[tuple[float, float], ...] = ()
    _digest: str = ""

    @model_validator(mode="after")
    def _read(self, info: ValidationInfo) -> Self:
        path = Path(getattr(info.context, "folder", "")) / self.file
        try:
            content = read_regular(path, _MOST_BYTES)
        except OSError as error:
            raise ValueError(
                f"file: {self.file}: cannot be read ({error.strerror}); put it into the folder of the scene"
            ) from error
        try:
            self._rows = _rows_of(content.decode("utf-8-sig"), self.column, getattr(info.context, "motion", None))
        except ValueError as error:
            raise ValueError(f"file: {self.file}: {error}") from error
        object.__setattr__(self, "file", path.resolve())  # found again from anywhere
        self._digest = sha256(content).hexdigest()
        return self

    @field_serializer("file")
    def _as_content(self, file: Path) -> str:
        """Return name and content, so that the configuration is the same on every computer."""
        return f"{file.name}, SHA-256 {self._digest}"

    @property
    def rows(self) -> tuple[tuple[float, float], ...]:
        """Times [s] from 0 on, and places [m or rad]."""
        return self._rows

    @property
    def end(self) -> float:
        """Time of the last row [s]; the hand stays from there on."""
        return self._rows[-1][0]

    @property
    def offset(self) -> float:
        """Middle of the motion [m or rad]."""
        places = [place for _, place in self._rows]
        return 0.5 * (min(places) + max(places))

    @property
    def amplitude(self) -> float:
        """Half of the way from end to end [m or rad]."""
        return max(abs(place - self.offset) for _, place in self._rows)

    @property
    def frequency(self) -> float:
        """One over the length of the recording [Hz]."""
        return 1.0 / self.end

    def position(self, time: float) -> float:
        """Return x_u [m or rad] at `time` [s]."""
        after = bisect_right(self._rows, time, key=lambda row: row[0])
        if after == len(self._rows):
            return self._rows[-1][1]
        (start, place), (stop, following) = self._rows[after - 1], self._rows[after]
        return place + (following - place) * (time - start) / (stop - start)


def _rows_of(text: str, column: str, motion: Any) -> tuple[tuple[float, float], ...]:
    """Return times from 0 on [s] and places [m or rad].

    Raises:
        ValueError: A column is missing, or a row is no number, out of range or not later than the one before.
    """
    lines = csv.reader(text.splitlines())
    heads = next(lines, [])
    (at, seconds), (of, places) = _column(heads, "time", _SECONDS, None), _column(heads, column, _PLACES, motion)
    rows: list[tuple[float, float]] = []
    for number, cells in enumerate(lines, 2):
        if not cells:
            continue
        try:
            time, place = float(cells[at]) * seconds, float(cells[of]) * places
        except (ValueError, IndexError) as error:
            raise ValueError(f"line {number}: got {','.join(cells)[:60]!r}, expected numbers") from error
        if not math.isfinite(time) or not abs(place) <= _FARTHEST:
            raise ValueError(f"line {number}: got {place:g} at {time:g} s, expected at most {_FARTHEST:g} m or rad")
        if rows and time <= rows[-1][0]:
            raise ValueError(f"line {number}: got time {time:g} s, expected one after {rows[-1][0]:g} s")
        rows.append((time, place))
    if len(rows) < 2:
        raise ValueError(f"got {len(rows)} rows below the heading, expected at least 2")
    return tuple((time - rows[0][0], place) for time, place in rows)


def _column(heads: list[str], name: str, unit: Unit, motion: Any) -> tuple[int, float]:
    """Return the number of a column, and the factor from its unit to SI."""
    parts = [head.replace("(", "[").rstrip(" ])").partition("[") for head in heads]
    titles = [title.strip().lower() for title, _, _ in parts]
    wanted = name.lower()
    found = [titles.index(wanted)] if wanted in titles else [
        place for place, title in enumerate(titles) if title.endswith(f".{wanted}")
    ]  # fmt: skip
    if len(found) != 1:
        why = f"{', '.join(titles[place] for place in found)}: name one by `column`" if found else f"no column {name!r}"
        raise ValueError(f"{why}; the heading has: {', '.join(heads)[:200] or 'nothing'}")
    _, _, written = parts[found[0]]
    factor = unit.read(f"1 {written}", motion) if written.strip() else 1.0
    return found[0], float(str(factor))


def _type_of(motion: object) -> object:
    return motion.get("type", "sinusoid") if isinstance(motion, Mapping) else getattr(motion, "type", None)


class UserParameters(Parameters):
    """The hand; every part is absent unless given."""

    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e8)] = 0.0
    """Stiffness of the hand's grip, between voluntary motion and handle."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)] = 0.0
    """Damping of the hand's grip."""
    push: Annotated[float, quantity("N", "N*m", ge=-1e6, le=1e6)] = 0.0
    """Constant force of the hand, towards +q."""
    rest: Annotated[float, quantity("m", "rad", ge=-1e3, le=1e3)] = 0.0
    """Where the hand's spring is at rest; the motion comes on top of it."""
    motion: (
        Annotated[
            Annotated[SinusoidMotion, Tag("sinusoid")] | Annotated[RecordedMotion, Tag("recorded")],
            Discriminator(_type_of),
        ]
        | None
    ) = None
    """Voluntary motion, which the handle follows through the grip; None: the hand stays at `rest`."""

    @model_validator(mode="after")
    def _motion_reaches_the_handle(self) -> "UserParameters":
        if self.motion and self.stiffness == 0.0 and self.damping == 0.0:
            raise ValueError("motion without a hand: stiffness and damping are 0, expected one > 0")
        return self

    @property
    def has_equations(self) -> bool:
        """Whether it is a grip that moves in a sinusoid or not at all: neither own code nor a recording."""
        return type(self) is UserParameters and self.sinusoid is self.motion

    @property
    def sinusoid(self) -> SinusoidMotion | None:
        """The voluntary motion where it is a sinusoid."""
        return self.motion if isinstance(self.motion, SinusoidMotion) else None

    def add_to(self, scene: PlantModel) -> None:
        """Add the hand, when there is one, at the last body of the scene."""
        if self.stiffness or self.damping or self.push:
            Hand(self).add_to(scene)


class Hand(Part):
    """The force of the hand on the handle, with one mode per grasp."""

    def __init__(self, user: UserParameters) -> None:
        self.name, self.modes = _HAND, ("grasp_0",)
        self._user = user
        self._grasps = [(user.stiffness, user.damping)]
        self._targets: list[tuple[str, float, float]] = []  # (name, amplitude, angular frequency)

    @property
    def _rest(self) -> float:
        return self._user.rest + (self._user.sinusoid.offset if self._user.sinusoid else 0.0)

    def add_to(self, scene: PlantModel) -> None:
        """Add the part, its work, and the oscillator of the voluntary motion."""
        user = self._user
        scene.works[_HAND] = "user"
        scene.parts.append(self)
        if user.stiffness or user.damping:
            scene.hand = self
        scene.deflection["one"] = -self._rest
        scene.deflection.update({name: factor for name, factor in scene.bodies[-1].position if name != "position"})
        motion = user.motion
        if isinstance(motion, SinusoidMotion):
            omega = 2.0 * math.pi * motion.frequency
            self.follow(scene, "motion", motion.amplitude, omega, motion.phase)
        elif motion is not None:
            self._follow_rows(scene, motion.rows)

    def follow(self, scene: PlantModel, name: str, amplitude: float, omega: float, phase: float) -> None:
        """Add a sinusoid to the voluntary motion of the hand, as two states of an oscillator."""
        scene.add_state(f"{name}_sine", math.sin(phase))
        scene.add_state(f"{name}_cosine", math.cos(phase))
        scene.deflection[f"{name}_sine"] = -amplitude
        self._targets.append((name, amplitude, omega))

    def _follow_rows(self, scene: PlantModel, rows: Sequence[tuple[float, float]]) -> None:
        """Add the place of a recording as a state, and its speed, which is set at every row."""
        speeds = [(after - place) / (stop - start) for (start, place), (stop, after) in pairwise(rows)]
        self.add_place(scene, rows[0][1], speeds[0])
        following = zip(rows[1:], [*speeds[1:], 0.0], strict=True)
        scene.settings += [(time, {PLACE: place, SPEED: speed}) for (time, place), speed in following]

    @staticmethod
    def add_place(scene: PlantModel, place: float, speed: float | None = None) -> None:
        """Add the place of the hand as a state that no force moves; with a speed, it moves at that."""
        scene.add_state(PLACE, place)
        if speed is not None:
            scene.add_state(SPEED, speed)
        scene.deflection[PLACE] = -1.0

    def add_grasp(self, stiffness: float, damping: float) -> str:
        """Return the mode of a further grasp."""
        self.modes += (f"grasp_{len(self._grasps)}",)  # in the order of time
        self._grasps.append((stiffness, damping))
        return self.modes[-1]

    def grasp(self, mode: str) -> tuple[float, float]:
        """Return stiffness and damping of a grasp."""
        return self._grasps[self.modes.index(mode)]

    def assemble(self, rows: Rows, mode: str) -> None:
        """Add the force on the handle, its work, and the oscillators."""
        stiffness, damping = self.grasp(mode)
        handle = len(rows.forces) - 1
        velocity = rows.velocity(handle)
        force = rows.row(one=stiffness * self._rest + self._user.push)
        force -= stiffness * rows.position(handle) + damping * velocity
        for name, amplitude, omega in self._targets:
            sine, cosine = f"{name}_sine", f"{name}_cosine"
            rows.set_rate(sine, rows.row(**{cosine: omega}))
            rows.set_rate(cosine, rows.row(**{sine: -omega}))
            force += rows.row(**{sine: stiffness * amplitude, cosine: damping * amplitude * omega})
        if PLACE in rows.index:
            force += rows.row(**{PLACE: stiffness})
        if SPEED in rows.index:
            rows.set_rate(PLACE, rows.row(**{SPEED: 1.0}))
            force += rows.row(**{SPEED: damping})
        rows.forces[handle] += force
        rows.add_power(_HAND, force, velocity)


class PointerHand(UserParameters):
    """A grip on the handle at a position that is set from outside while the plant runs, by `Plant.move_hand`.

    The position is a state, so that the plant stays as exact as with any other hand.
    """

    place: Annotated[float, quantity("m", "rad", ge=-1e3, le=1e3)] = 0.0
    """Where the hand is at the start."""

    def add_to(self, scene: PlantModel) -> None:
        """Add the hand and its position."""
        Hand(self).add_to(scene)
        Hand.add_place(scene, self.place)
