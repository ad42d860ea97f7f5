"""The human at the handle: an impedance (stiffness, damping) between a voluntary motion and the handle.

Hand force on the handle: K (x_u - q) + D (v_u - v) + push, with x_u the voluntary motion. A sinusoid enters the plant
as two states of a harmonic oscillator, so that hand and plant together stay exactly linear. Hogan, "Impedance control",
ASME J. Dynamic Systems 107, 1985, for the model; grips measured on hands: 100..1000 N/m, 1..10 N*s/m.

A recorded motion is a table of positions with linear interpolation: between two rows the hand moves at constant speed,
which keeps the plant exactly linear. The position is a state whose speed is set at every row; a row that falls on a
sample time costs nothing.
"""

import csv
import math
import re
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Literal, Self

from pydantic import Discriminator, Tag, ValidationInfo, field_serializer, model_validator

from canhaptic.errors import ParameterError
from canhaptic.files import read_regular
from canhaptic.own_results import FORCE, GIVEN, GIVEN_MARK, watch
from canhaptic.sim.plant.assembly import Account, NonlinearForce, Part, PlantModel, Rows
from canhaptic.units import Parameters, PrintablePath, PrintableText, Unit, quantity

_HAND: Final = "hand"
"""Name of the hand's part and of its work."""
PLACE: Final = "hand_place"
"""Name of the state with the position of a recorded or pointer hand [m or rad]."""
SPEED: Final = "hand_speed"
"""Name of the state with the velocity of a recorded hand [m/s or rad/s]."""


_MOST_BYTES: Final = 50_000_000
_FARTHEST: Final = 1e3  # [m or rad], as for every place of a hand
_SECONDS: Final = Unit("s", "s")
_MANY, _SLOW = 16, 0.5
"""Rows of a table that a program recorded, and the step [s] that no recorder of a hand has."""
_PLACES: Final = Unit("m", "rad")


class SinusoidMotion(Parameters):
    """Voluntary motion x_u(t) = offset + amplitude * sin(2 pi frequency t + phase), t from the start of the plant."""

    type: Literal["sinusoid"] = "sinusoid"
    amplitude: Annotated[float, quantity("m", "rad", ge=0.0, le=1e3)]
    """Amplitude of the motion."""
    frequency: Annotated[float, quantity("Hz", gt=0.0, le=1e3)]
    """Frequency of the motion."""
    phase: Annotated[float, quantity("rad", ge=-10.0, le=10.0)] = 0.0
    """Phase at the start of the plant."""
    offset: Annotated[float, quantity("m", "rad", ge=-1e3, le=1e3)] = 0.0
    """Middle of the motion."""

    def position(self, time: float) -> float:
        """Return x_u [m or rad] at `time` [s]."""
        return self.offset + self.amplitude * math.sin(2.0 * math.pi * self.frequency * time + self.phase)


_TIMES: Final = ("time", "t", "timestamp")
"""Headings of the time."""
_TRUE: Final = "true."
"""Start of a column of the simulated plant, next to the measured one."""


class RecordedMotion(Parameters):
    """Voluntary motion x_u(t) from a table, with t from the start of the plant and from the first row.

    It is interpolated linearly between the rows and constant after the last row.
    """

    type: Literal["recorded"] = "recorded"
    file: PrintablePath
    """CSV table in the folder of the scene, or in the current one: a heading with `time` (or `t`, `timestamp`) and
    `position`, each in SI or with its unit as in `time [ms]`, and at least two rows, as `inspect --csv` writes it. Two
    columns of numbers need no heading. A semicolon or tab may separate columns; then, if no number has a point, a comma
    is the decimal point. After the last row the hand stays. The table is where the hand wants to be, with its grip
    between it and the handle: a record of the handle does not repeat the run it was recorded in."""
    column: PrintableText = "position"
    """Heading of the position column, or its end: `position` also finds `handle.position`, the measured one, rather
    than `true.handle.position`. With a unit, as in `x [mm]`, for a heading without one."""
    time_column: PrintableText = ""
    """Heading of the time column, with a unit as in `t [ms]` for a heading without one; by default `time`, `t` or
    `timestamp`, in seconds. Frames are counted as in `frame [8.333 ms]`. A long table whose steps would be half a
    second or more is refused without a unit."""

    _rows: tuple[tuple[float, float], ...] = ()
    _digest: str = ""

    @model_validator(mode="after")
    def _read(self, info: ValidationInfo) -> Self:
        if str(self.file).startswith(GIVEN_MARK):
            return self._take(str(self.file))
        folder = Path(getattr(info.context, "folder", "")).absolute()
        path = folder / self.file
        path = path if path.exists() else Path.cwd() / self.file
        try:
            content = read_regular(path, _MOST_BYTES)
        except OSError as error:
            text = f"file: {self.file}: cannot be read ({error.strerror}): tried {folder} and {Path.cwd()}"
            raise ValueError(f"{text}; put the table into the current folder, or give its whole path") from error
        try:
            text, motion = content.decode("utf-8-sig"), getattr(info.context, "motion", None)
            self._rows = _rows_of(text, self.column, self.time_column, motion)
        except ValueError as error:
            raise ValueError(f"file: {self.file}: {error}") from error
        object.__setattr__(self, "file", path.resolve())  # found again from anywhere
        self._digest = sha256(content).hexdigest()
        return self

    def _take(self, name: str) -> Self:
        """Take the rows that a Python program gave."""
        if name not in GIVEN:
            text = "file: the motion is an array of a Python program, which another process does not have"
            raise ValueError(
                f"{text}; write it by numpy.savetxt('motion.csv', array, delimiter=',') and name that file"
            )
        self._rows, self._digest = GIVEN[name], name.rpartition(":")[2]
        return self

    @field_serializer("file")
    def _as_content(self, file: Path) -> str:
        """Return name and checksum of the file, so that the configuration is the same on every computer."""
        return f"{file.name.partition(':')[0]}, SHA-256 {self._digest}"

    @property
    def rows(self) -> tuple[tuple[float, float], ...]:
        """Rows of the table: time from the first row [s], and position [m or rad]."""
        return self._rows

    @property
    def end(self) -> float:
        """Time of the last row [s], after which the hand stays."""
        return self._rows[-1][0]

    @property
    def fastest(self) -> tuple[float, float, float]:
        """Largest speed between two rows [m/s or rad/s], the step there [m or rad], and its time [s]."""
        steps = [(after[1] - before[1], after[0] - before[0], before[0]) for before, after in pairwise(self._rows)]
        step, duration, time = max(steps, key=lambda one: abs(one[0]) / one[1])
        return abs(step) / duration, abs(step), time

    @property
    def offset(self) -> float:
        """Middle between the extreme positions [m or rad]."""
        places = [place for _, place in self._rows]
        return 0.5 * (min(places) + max(places))

    @property
    def amplitude(self) -> float:
        """Half the distance between the extreme positions [m or rad]."""
        return max(abs(place - self.offset) for _, place in self._rows)

    @property
    def frequency(self) -> float:
        """Reciprocal of the duration of the table [Hz]."""
        return 1.0 / self.end

    def position(self, time: float) -> float:
        """Return x_u [m or rad] at `time` [s]."""
        after = bisect_right(self._rows, time, key=lambda row: row[0])
        if after == len(self._rows):
            return self._rows[-1][1]
        (start, place), (stop, following) = self._rows[after - 1], self._rows[after]
        return place + (following - place) * (time - start) / (stop - start)


def _rows_of(text: str, column: str, time_column: str, motion: Any) -> tuple[tuple[float, float], ...]:
    """Return the rows of a table: time from the first row [s], and position [m or rad].

    Raises:
        ValueError: A column is missing, a row is not numeric, out of range or not later than the row before, or the
            times are none of a hand in seconds and have no unit.
    """
    given = [line for line in text.splitlines() if line.strip()]
    separator = next((letter for letter in "\t;" if given and letter in given[0]), ",")
    point = "," if separator != "," and not any("." in line for line in given[1:]) else "."
    lines = csv.reader(text.splitlines(), delimiter=separator)
    heads = next(lines, [])
    first = 2
    if len(heads) == 2 and all(_is_number(head.replace(point, ".")) for head in heads):
        lines, heads, first = csv.reader(text.splitlines(), delimiter=separator), ["time", column.partition("[")[0]], 1
        time_column = time_column and f"time {time_column[len(time_column.partition('[')[0]) :]}"
    name = time_column or _time_name(heads)
    (at, seconds), (of, places) = _column(heads, name, _SECONDS, None), _column(heads, column, _PLACES, motion)

    def numbers() -> Iterator[tuple[str, float, float]]:
        for number, cells in enumerate(lines, first):
            try:
                if cells:
                    time, place = (float(cells[column].replace(point, ".")) for column in (at, of))
                    yield f"line {number}", time * seconds, place * places
            except (ValueError, IndexError) as error:
                raise ValueError(f"line {number}: got {separator.join(cells)[:60]!r}, expected numbers") from error

    rows = checked_rows(numbers())
    step = rows[-1][0] / (len(rows) - 1)
    if len(rows) >= _MANY and step >= _SLOW and not re.search(r"[\[(]", f"{heads[at]}{time_column}"):
        seen = (
            f"column {heads[at].strip()!r}: got steps of {step:.3g} without a unit, which are too long for a hand in s"
        )
        raise ValueError(f"{seen}; write the unit into the heading, or as time_column: {heads[at].strip()} [ms]")
    return rows


def checked_rows(rows: Iterable[tuple[str, float, float]]) -> tuple[tuple[float, float], ...]:
    """Return the rows of a motion: time from the first row [s], and position [m or rad].

    Args:
        rows: Name of each row for errors, its time [s] and its position [m or rad].

    Raises:
        ValueError: A row is out of range or not later than the row before, or there are fewer than two.
    """
    found: list[tuple[float, float]] = []
    for where, time, place in rows:
        if not math.isfinite(time) or not abs(place) <= _FARTHEST:
            raise ValueError(f"{where}: got {place:g} at {time:g} s, expected at most {_FARTHEST:g} m or rad")
        if found and time <= found[-1][0]:
            raise ValueError(f"{where}: got time {time:g} s, expected one after {found[-1][0]:g} s")
        found.append((time, place))
    if len(found) < 2:
        raise ValueError(f"got {len(found)} rows of numbers, expected at least 2")
    return tuple((time - found[0][0], place) for time, place in found)


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _time_name(heads: list[str]) -> str:
    """Return the name of the column of the time."""
    titles = {head.replace("(", "[").partition("[")[0].strip().lower() for head in heads}
    return next((name for name in _TIMES if name in titles), _TIMES[0])


def _column(heads: list[str], name: str, unit: Unit, motion: Any) -> tuple[int, float]:
    """Return the number of a column, and the factor from its unit to SI."""
    name, _, own_unit = (part.strip(" ]") for part in name.partition("["))
    parts = [head.replace("(", "[").rstrip(" ])").partition("[") for head in heads]
    titles = [title.strip().lower() for title, _, _ in parts]
    wanted = name.lower()
    found = [titles.index(wanted)] if wanted in titles else [
        place for place, title in enumerate(titles) if title.endswith(f".{wanted}")
    ]  # fmt: skip
    found = [place for place in found if not titles[place].startswith(_TRUE)] or found
    if len(found) != 1:
        why = f"{', '.join(titles[place] for place in found)}: name one by `column`" if found else f"no column {name!r}"
        remedy = "" if found else f"; name another by `{'time_column' if unit is _SECONDS else 'column'}`"
        raise ValueError(f"{why}; the heading has: {', '.join(heads)[:200] or 'nothing'}{remedy}")
    written = (own_unit or parts[found[0]][2]).strip()
    factor = unit.read(written if written[:1].isdigit() else f"1 {written}", motion) if written else 1.0
    return found[0], float(str(factor))


def _type_of(motion: object) -> object:
    return motion.get("type", "sinusoid") if isinstance(motion, Mapping) else getattr(motion, "type", None)


class UserParameters(Parameters):
    """Parameters of the hand; every part is absent by default."""

    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e8)] = 0.0
    """Stiffness of the hand's grip, between voluntary motion and handle."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)] = 0.0
    """Damping of the hand's grip."""
    push: Annotated[float, quantity("N", "N*m", ge=-1e6, le=1e6)] = 0.0
    """Constant force of the hand, towards +q."""
    rest: Annotated[float, quantity("m", "rad", ge=-1e3, le=1e3)] = 0.0
    """Rest position of the hand's spring; the motion is added to it."""
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
        """Whether the hand is a grip at rest or in sinusoidal motion: neither user-defined nor recorded."""
        return type(self) is UserParameters and self.sinusoid is self.motion

    @property
    def sinusoid(self) -> SinusoidMotion | None:
        """The voluntary motion if it is a sinusoid, else None."""
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
        """Add the position of a recorded hand as a state, and its speed, which is set at every row."""
        speeds = [(after - place) / (stop - start) for (start, place), (stop, after) in pairwise(rows)]
        self.add_place(scene, rows[0][1], speeds[0])
        following = zip(rows[1:], [*speeds[1:], 0.0], strict=True)
        scene.settings += [(time, {PLACE: place, SPEED: speed}) for (time, place), speed in following]

    @staticmethod
    def add_place(scene: PlantModel, place: float, speed: float | None = None) -> None:
        """Add the position of the hand as a state that no force changes; with `speed` it moves at that speed."""
        scene.add_state(PLACE, place)
        if speed is not None:
            scene.add_state(SPEED, speed)
        scene.deflection[PLACE] = -1.0

    def add_grasp(self, stiffness: float, damping: float) -> str:
        """Add a grasp and return its mode."""
        self.modes += (f"grasp_{len(self._grasps)}",)  # in the order of time
        self._grasps.append((stiffness, damping))
        return self.modes[-1]

    def grasp(self, mode: str) -> tuple[float, float]:
        """Return stiffness and damping of a grasp."""
        return self._grasps[self.modes.index(mode)]

    def assemble(self, rows: Rows, mode: str) -> None:
        """Add the hand to the equations of the plant: its force on the handle, that force's work, its oscillators."""
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
    """A hand whose position `Plant.move_hand` sets while the plant runs.

    The position is a state, so that the plant stays as exact as with any other hand.
    """

    place: Annotated[float, quantity("m", "rad", ge=-1e3, le=1e3)] = 0.0
    """Initial position of the hand."""

    def add_to(self, scene: PlantModel) -> None:
        """Add the hand and its position."""
        Hand(self).add_to(scene)
        Hand.add_place(scene, self.place)


class OwnHand(UserParameters):
    """Base of a user-defined hand: write the force that it adds to the grip.

        class Startled(OwnHand):
            def force(self, time: float, position: float, velocity: float) -> float:
                return -5.0 if 1.0 < time < 1.2 else 0.0

    Stiffness, damping, push and motion of the grip are as for every hand. The force is evaluated at the middle of each
    substep, held over it and solved together with the motion (`splitting.py`): second order in the substep for a
    smooth force.
    """

    order: ClassVar[int | None] = 2  # of the error in the substep, by the splitting

    def force(self, time: float, position: float, velocity: float) -> float:
        """Return the force on the handle, towards +q [N or N*m].

        Args:
            time: Time since the start of the plant [s].
            position: Position of the handle [m or rad].
            velocity: Velocity of the handle [m/s or rad/s].
        """
        raise NotImplementedError(f"{type(self).__name__}: write force(time, position, velocity)")

    def add_to(self, scene: PlantModel) -> None:
        """Add the grip and the force.

        Raises:
            ParameterError: A `shaft_compliance` separates the handle from the motor's body.
        """
        if len(scene.bodies) > 1:
            raise ParameterError("user: a user-defined hand holds the motor's body; remove shaft_compliance", "user")
        super().add_to(scene)
        scene.efforts.append(_OwnForce(self, "user"))


class ForceEffect(Parameters):
    """Base of an effect that is a force on the motor by time, position and velocity; its work counts as dissipated."""

    order: ClassVar[int | None] = 2
    rank: ClassVar[int] = 1

    type: Literal["force"] = "force"

    def force(self, time: float, position: float, velocity: float) -> float:
        """Return the force, as a hand does; see `OwnHand.force`."""
        raise NotImplementedError(f"{type(self).__name__}: write force(time, position, velocity)")

    def add_to(self, scene: PlantModel) -> None:
        """Add the force."""
        scene.efforts.append(_OwnForce(self, "dissipated"))


class _OwnForce(NonlinearForce):
    """The force of a user-defined hand or effect as a part of the plant."""

    def __init__(self, owner: OwnHand | ForceEffect, account: Account) -> None:
        watch(type(owner), ("force",), FORCE)
        self._owner, self.account = owner, account
        self._time = 0.0

    def reset(self) -> None:
        """Return to time 0."""
        self._time = 0.0

    def force(self, position: float, travel: float, duration: float, torque: float) -> float:
        """Return the force at the middle of a substep [N or N*m]."""
        velocity = travel / duration if duration else 0.0
        return self._owner.force(self._time + 0.5 * duration, position + 0.5 * travel, velocity)

    def commit(self, position: float, travel: float, duration: float, torque: float) -> None:
        """Advance the time by the substep."""
        self._time += duration
