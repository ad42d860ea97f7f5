"""A commissioning session without a bus: its torques move an axis whose motion is known in closed form."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from types import SimpleNamespace
from typing import Any, Protocol

from canhaptic.commission.session import CommissioningLimits, OpenLoop, Session, Unattended
from canhaptic.drive.can.servo_drive import ServoDrive
from canhaptic.drive.profile.quirks import quirks_of
from canhaptic.errors import SdoError
from canhaptic.scene.models import AxisScene, Scene


class Axis(Protocol):
    """What moves."""

    @property
    def position(self) -> float:
        """Position at the next SYNC [m or rad]."""

    def advance(self, command: float) -> float:
        """Let a torque or velocity act for one hold; return what the drive reports of that hold."""


class FreeMass:
    """A mass with viscous friction, its position rounded to counts; it starts at rest at every step.

    Args:
        mass: [kg].
        sample_time: [s].
        count: Of the encoder [m]; 0: exact.
    """

    def __init__(self, mass: float, sample_time: float, count: float = 0.0) -> None:
        self._mass, self._time, self._count = mass, sample_time, count
        self._at = self._speed = 0.0

    @property
    def position(self) -> float:
        """As the encoder shows it [m]."""
        return round(self._at / self._count) * self._count if self._count else self._at

    def advance(self, command: float) -> float:
        """As `Axis`."""
        self._at += self._time * (self._speed + 0.5 * self._time * command / self._mass)
        self._speed += self._time * command / self._mass
        return command


class Sdo:
    """The objects of a drive by index and subindex; one that is missing is not answered."""

    def __init__(self, objects: dict[tuple[int, int], int]) -> None:
        self._objects = objects

    def read(self, index: int, subindex: int = 0) -> int:
        """As `ObjectAccess`."""
        if (index, subindex) not in self._objects:
            raise SdoError("does not exist", index, subindex)
        return self._objects[index, subindex]


class Nobody:
    """A bus on which the configured drives alone answer."""

    clock = SimpleNamespace(now=lambda: 0)

    def subscribe(self, *_: object) -> None:
        """As `Link`."""

    send = pump = unsubscribe = subscribe


_NOBODY = Nobody()


class _Drive(ServoDrive):
    """A drive on CAN, of which the steps ask these attributes."""

    def __init__(self, **attributes: Any) -> None:
        self.__dict__ |= attributes


class PlayedSession(Session):
    """Plays on axes of a test, and keeps what was asked for.

    Args:
        scene: As loaded.
        axes: What each of its axes moves.
        refused: Word of the questions that the person does not agree to.
        limits: Of the session.
        objects: Of every drive.

    Attributes:
        played: Axis, torques, cycles and travels of each call of `play`.
        hands: Whether each rig was built with the hand.
        said: Lines shown.
    """

    def __init__(
        self, scene: Scene, axes: Sequence[Axis], refused: str = "", limits: CommissioningLimits | None = None,
        objects: dict[tuple[int, int], int] | None = None,
    ) -> None:  # fmt: skip
        self.said: list[str] = []
        said = self.said

        class Person(Unattended):
            def confirm(self, question: str) -> bool:
                return super().confirm(question) and not (refused and refused in question)

        super().__init__(scene, Person(said.append), limits or CommissioningLimits(), lambda: False)
        self.moving = axes
        self.played: list[tuple[int, list[float], int, float]] = []
        self.hands: list[bool] = []
        self.quanta = [0.01 for _ in axes]
        self._sdo = Sdo(objects or {})

    @contextmanager
    def rig_of(self, *, with_hand: bool, hand: Callable[[AxisScene], object] | None = None) -> Iterator[None]:
        """Build nothing."""
        self.hands.append(with_hand)
        yield

    @property
    def rig(self) -> Any:
        """A rig without a bus."""
        return SimpleNamespace(drives=self.drives)

    @cached_property
    def drives(self) -> Sequence[Any]:
        """What the steps ask of a drive: the scale of its torque, and its objects."""
        scaling, information = SimpleNamespace(torque_quantum=0.01), SimpleNamespace(vendor_number=7, product_number=8)
        dictionary = SimpleNamespace(device_information=information)
        return [
            _Drive(
                link=_NOBODY,
                bus=self.scene.bus,
                scaling=scaling,
                quirks=quirks_of(()),
                sdo=self._sdo,
                axis=axis.parameters,
                dictionary=dictionary,
            )
            for axis in self.axes
        ]

    def note_objects(self, axis: int) -> None:
        """There are none."""

    def play(
        self, axis: int, torques: Sequence[float], cycles: int, ready: Callable[[], bool] = bool, travels: float = 1.0
    ) -> OpenLoop:
        """As that of `Session`, without a rig."""
        self.played.append((axis, list(torques), cycles, travels))
        law = OpenLoop(torques, self.guard(axis, travels)) if torques else OpenLoop()
        self.run_alone(axis, law, cycles, lambda: ready() or bool(law.tripped))
        return law

    def truth(self, axis: int) -> float | None:
        """The position of the axis."""
        return self.moving[axis].position

    def run_alone(self, axis: int, law: OpenLoop, cycles: int, ready: Callable[[], bool]) -> None:
        """Move the axis; a command acts at once, or as many SYNCs later as the scene says."""
        moving, reported, law.weight = self.moving[axis], 0.0, self.weight(axis)
        queue = [0.0] * self.scene.bus.delay
        for _ in range(cycles):
            if ready():
                return
            queue.append(law.step(moving.position, reported).torque)
            reported = moving.advance(queue.pop(0))
