"""The program's side of a link: what it asks this rig to render, and its account of energy.

A program has no hand on it, so that it may owe: its tank E = H - S + R may fall below 0, and it asks the rig for what
it owes and for no more. What it sends is what it has: S <= H + R + budget when S grows, and S never falls.
"""

from math import isfinite
from typing import Final, NamedTuple

from canhaptic.errors import InputError
from canhaptic.far.packet import ABOVE, BELOW, READY, STOPPING, TO_POINT, Packet, whole
from canhaptic.far.parameters import FarParameters
from canhaptic.far.port import PICO
from canhaptic.far.session import Session
from canhaptic.units import shown

_SIDES: Final = {"-": BELOW, "+": ABOVE}
"""Direction in which a wall pushes the hand -> side of it on which the hand is."""


class Hand(NamedTuple):
    """What a rig last said of an axis."""

    position: float  # [m or rad]
    velocity: float  # [m/s or rad/s]
    torque: float  # that acts on the hand [N or N*m]


class WorldAxis:
    """One axis of a rig, as a program sees it; `hand` is its newest state.

    Args:
        far: Section `far` of the rig's scene.
        session: Packets of the link.
        budget: Energy that the program may give beyond what it has received or taken in [J].
        source: Name of the scene, for errors.
    """

    def __init__(self, far: FarParameters, session: Session, budget: float, source: str) -> None:
        self.name, self._far, self._session, self._source = far.axis, far, session, source
        self._budget = budget / PICO
        self._model = 0, 0.0, 0.0, 0.0, 0.0  # flags, place, speed, stiffness, damping
        self._taken_in = 0.0  # by the program through this axis, -H [pJ]
        self._sent = self._received = self._wanted = 0
        self._newest = -1
        self.hand = Hand(0.0, 0.0, 0.0)

    @property
    def sent(self) -> float:
        """Energy sent to the rig [J]."""
        return self._sent * PICO

    @property
    def received(self) -> float:
        """Energy received from the rig [J]."""
        return self._received * PICO

    def wall(self, at: float, stiffness: float, pushes: str, speed: float = 0.0, damping: float = 0.0) -> None:
        """Ask for a wall; the rig renders it until something else is asked.

        Args:
            at: Its place [m or rad].
            stiffness: Its stiffness, at most that of the scene [N/m or N*m/rad].
            pushes: Direction in which it pushes the hand: "-" or "+".
            speed: Its own speed [m/s or rad/s]; the rig moves it on for 50 ms.
            damping: Its damping, at most that of the scene [N*s/m or N*m*s/rad].

        Raises:
            InputError: A value is out of range.
        """
        if pushes not in _SIDES:
            text = f"got {shown(pushes)}, expected '-' for a wall that pushes the hand down, or '+'"
            raise InputError(f"World: {self._far.axis}: wall: pushes: {text}")
        self._ask("wall", _SIDES[pushes], at, speed, stiffness, damping)

    def spring(self, at: float, stiffness: float, speed: float = 0.0, damping: float = 0.0) -> None:
        """Ask for a spring to a point; the arguments are as for `wall`."""
        self._ask("spring", TO_POINT, at, speed, stiffness, damping)

    def free(self) -> None:
        """Ask for nothing: the hand is free."""
        self._model = 0, *self._model[1:]
        self.tell()

    def absorbed(self, energy: float) -> None:
        """Book energy that the coupling put into the program since the last call [J]; negative: that it took out.

        Without it the program gives nothing to the hand.

        Raises:
            InputError: It is no finite number.
        """
        self._taken_in += (
            number_in(f"World: {self._far.axis}: absorbed", "energy", energy, "a finite number [J]") / PICO
        )
        self.tell()

    def _ask(self, what: str, flags: int, at: float, speed: float, stiffness: float, damping: float) -> None:
        place, most = f"World: {self._far.axis}: {what}", self._far.coupling
        for key, value in (("at", at), ("speed", speed)):
            number_in(place, key, value, "a finite number, at most 1e6 to either side", largest=1e6, least=-1e6)
        for key, value, limit in (("stiffness", stiffness, most.stiffness), ("damping", damping, most.damping)):
            text = f"0 to {limit:g} (far.coupling.{key} of {self._source}; raise it there, or ask for less)"
            number_in(place, key, value, text, least=0.0, largest=limit)
        self._model = flags, float(at), float(speed), float(stiffness), float(damping)
        self.tell()

    def take(self, packet: Packet) -> None:
        """Take what the rig says."""
        self._received, self._wanted = max(self._received, packet.sent), max(self._wanted, packet.wanted)
        if packet.seq > self._newest:
            self._newest = packet.seq
            self.hand = Hand(packet.position, packet.velocity, packet.wall)

    def tell(self, *, stopping: bool = False) -> None:
        """Send what is wanted of what is there, and say what is asked for."""
        energy = self._received - self._taken_in  # H + R
        if not stopping:
            self._sent += max(0, min(self._wanted - self._sent, whole(energy + self._budget) - self._sent))
        owed = max(0.0, self._sent - energy)
        flags, at, speed, stiffness, damping = self._model
        flags |= READY | STOPPING * stopping
        totals = self._sent, self._received, whole(self._received + owed)
        self._session.say(Packet(flags, 0, 0, *totals, at, speed, 0, stiffness, damping), may_begin=not stopping)


def number_in(
    place: str, key: str, value: object, expected: str, *, least: float = -1e9, largest: float = 1e9
) -> float:
    """Return a number in a range.

    Raises:
        InputError: It is none.
    """
    try:
        number = float(value)  # type: ignore[arg-type] # anything that a user gives
    except (TypeError, ValueError):
        number = float("nan")
    if not isfinite(number) or not least <= number <= largest:
        raise InputError(f"{place}: {key}: got {shown(value)}, expected {expected}")
    return number
