"""One side of a link in the cycle: packets in, one step of the port, packets out.

Order in a SYNC: book the hold and receive, compute the torque, deduct what is sent, and only then send it.
"""

import secrets
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Final, NamedTuple, Protocol

from canhaptic.control.ledger import EnergyLossMeter
from canhaptic.errors import InputError
from canhaptic.far.packet import ABOVE, BELOW, READY, STOPPING, TO_POINT, Packet, whole
from canhaptic.far.parameters import FarParameters
from canhaptic.far.port import IDLE, LINKED, LOST, PICO, FarPort, certain
from canhaptic.far.session import Session
from canhaptic.far.udp import UdpLink
from canhaptic.far.world_model import SPRING
from canhaptic.files import read_regular
from canhaptic.signals import FarRow, Sample

_KEY: Final = 32  # bytes
_HARD: Final = 0.1
"""Part of the torque limit above which a torque that moves nothing has found a wall."""
_STILL: Final = 0.02
"""Speed below which it moves nothing [m/s or rad/s]."""
_BEYOND: Final = 5e-3
"""How far the axis may get beyond a wall before it is forgotten [m or rad]."""


class Transport(Protocol):
    """What carries packets to the other side and back, without waiting."""

    def send(self, data: bytes) -> None:
        """Send a packet, or lose it."""

    def arrived(self) -> Iterable[bytes]:
        """Return the packets that have arrived."""

    def close(self) -> None:
        """Stop carrying."""


class Nowhere:
    """A transport without another side, for a scene that is only checked."""

    def send(self, data: bytes) -> None:
        """Lose a packet."""

    def arrived(self) -> Iterable[bytes]:
        """Return none."""
        return ()

    def close(self) -> None:
        """No-op."""


def over_udp(far: FarParameters) -> UdpLink:
    """Return the socket of a section `far`.

    Raises:
        InputError: Its own address cannot be used.
    """
    return UdpLink(*far.places)


class LinkSummary(NamedTuple):
    """What a link has done, for the account of a run; energies in [J]."""

    sessions: int
    linked: bool
    round_trip: float  # newest [s]; negative: not known
    lost: float  # share of the packets of the newest session
    refused: int  # packets
    received: float  # totals of all sessions
    sent: float
    given_up: float
    under_way: float  # sent, and not known to have arrived
    in_tank: float
    cut: int  # cycles in which more arrived than the declared limits let in
    limited: int  # cycles in which the torque was cut while energy that was asked of the other side was lacking


class FarSide:
    """The link of one axis: what arrived goes into its port before a step, and what the port says goes out after it.

    Args:
        far: Section `far` of the scene.
        port: Controller of the axis.
        axis: Its place in the rig.
        transport: Carries the packets.
        fresh: Returns a random number of 63 bits, not 0.
    """

    def __init__(
        self, far: FarParameters, port: FarPort, axis: int, transport: Transport, fresh: Callable[[], int] | None = None
    ) -> None:
        self.far, self.port, self.axis, self._transport = far, port, axis, transport
        self._time, self._is_world = port.settings.sample_time, far.world is not None
        silence, secret = terms_of(far, self._time)
        self.session = Session(secret, silence, far.from_far.energy / PICO, fresh or _random, transport.send)
        self._position = self._velocity = self._arrived = self._wall = 0.0
        self._side = 0
        self._sums = [0.0, 0.0]  # of the sessions before: received, sent [pJ]
        self._before = [0.0, 0.0]
        self._given: tuple[float, float, float, float, float, float, float, int, int, int, int] = (
            *(0.0,) * 7, 0, 0, -1, -1
        )  # fmt: skip
        self.cut = self.limited = self._sessions = 0
        self.is_stopping = False

    def turn(self, samples: Sequence[Sample], periods: int) -> None:
        """Take the packets that have arrived, before the step of the port.

        Args:
            samples: Samples of the rig.
            periods: Sample times since the SYNC before.
        """
        session, state = self.session, self.port.state
        session.pass_time(periods)
        newest, may_begin = session.seen, state.phase == IDLE and not self.is_stopping
        for data in self._transport.arrived():
            packet = session.take(data, may_begin=may_begin)
            if session.sessions != self._sessions:  # nothing of another session counts in this one
                self._sessions, newest = session.sessions, -1
                state.received = state.wanted = self._arrived = 0.0
                state.far_ready = state.stopping = False
            if packet is None:
                continue
            state.received = max(state.received, float(packet.sent))
            state.wanted = max(state.wanted, float(packet.wanted))
            self._arrived = max(self._arrived, float(packet.received))
            state.stopping = state.stopping or bool(packet.flags & STOPPING)
            if packet.seq > newest:
                newest = packet.seq
                state.far_position, state.far_velocity, state.far_wall = packet.position, packet.velocity, packet.wall
                state.far_side = 1.0 * bool(packet.flags & BELOW) - 1.0 * bool(packet.flags & ABOVE)
                if self._is_world:
                    self._take_model(packet)
                state.far_ready = state.far_ready or bool(packet.flags & READY)
            if not session.is_alive:  # the other side stops: what follows is for another session
                break
        state.linked = session.is_alive and (state.phase == LINKED or may_begin)
        state.linked = state.linked or (state.phase == LOST and session.is_greeted)  # what is held is let go for it
        self._given = (*self.port.given(), session.number, session.seen, session.next_sequence)
        sample = samples[self.axis]
        if sample.fresh:
            self._velocity = (sample.position - self._position) / (periods * self._time)
            self._position = sample.position
            if self._is_world:
                self._wall = sample.torque_applied
            else:
                self._search(sample.torque_applied)

    def _take_model(self, packet: Packet) -> None:
        """Take the stiffness that a program asks for, at most what the scene declares."""
        state, most = self.port.state, self.far.coupling
        state.world.stiffness = min(max(0.0, packet.wall), most.stiffness)
        state.world.damping = min(max(0.0, packet.damping), most.damping)
        if packet.flags & TO_POINT:
            state.far_side = SPRING

    def _search(self, torque: float) -> None:
        """Find a wall where a torque does not move the axis; forget it where the axis is beyond it."""
        wall, hard = self._wall, _HARD * self.port.settings.torque_limit
        if self._side and self._side * (self._position - wall) > _BEYOND:
            self._side = 0
        if not self._side and abs(torque) > hard and abs(self._velocity) < _STILL:
            self._side, self._wall = (1 if torque > 0.0 else -1), self._position

    def row(self) -> FarRow:
        """Return the row of the log for this SYNC, after the step of the port."""
        return FarRow(*self._given, self.port.state.booked, self.port.state.sent)

    def stop(self) -> None:
        """Send no more energy: the rig stops, and tells the other side."""
        self.is_stopping = self.port.state.stopping = True

    def send(self) -> None:
        """Tell the other side what the port has decided, after the torque was sent."""
        state, port = self.port.state, self.port
        self.cut += state.cut > 0.0
        self.limited += port.is_limited
        now = [state.booked, state.sent]
        for place in (0, 1):  # the totals of a session that was forgotten
            if now[place] < self._before[place]:
                self._sums[place] += self._before[place]
        self._before = now
        flags = (
            READY * port.is_ready | STOPPING * self.is_stopping | BELOW * (self._side > 0) | ABOVE * (self._side < 0)
        )
        totals = whole(state.sent), whole(state.booked), whole(state.request)
        may_begin = state.phase == IDLE and not self.is_stopping
        told = flags, 0, 0, *totals, self._position, self._velocity, 0, self._wall, 0.0
        self.session.say(told, may_begin=may_begin)

    def summary(self) -> LinkSummary:
        """Return what the link has done so far."""
        session, state = self.session, self.port.state
        received, sent = (PICO * (of + now) for of, now in zip(self._sums, self._before, strict=True))
        share = session.lost / (session.lost + session.heard) if session.heard else 0.0
        trip = session.round_trip * self._time if session.round_trip >= 0 else -1.0
        return LinkSummary(
            session.sessions, session.is_alive, trip, share, session.refused, received, sent, state.given_up,
            PICO * max(0.0, state.sent - self._arrived), certain(state), self.cut,
            self.limited,
        )  # fmt: skip

    def close(self) -> None:
        """Close the transport."""
        self._transport.close()


class CoupledLossMeter(EnergyLossMeter):
    """Energy received through a port with a far side, by its own record of the totals in the packets.

    What came from there is the largest total of an authentic packet, within `from_far`, and what went there the largest
    that was handed to the network: both are read from the bytes, and neither from the port.
    """

    side: FarSide

    @property
    def supplied(self) -> float:
        """Energy received from the far side less what was sent to it [J]."""
        return PICO * self.side.session.supplied

    def take(self, samples: Sequence[Sample], deadline: int) -> bool:
        """Add the energy of a hold; see `EnergyLossMeter.take`."""
        super().take(samples, deadline)
        return self.energy + self.supplied < self.floor


def _random() -> int:
    return secrets.randbits(62) + 1


def terms_of(far: FarParameters, sample_time: float) -> tuple[int, bytes]:
    """Return the sample times of silence after which a session of a link ends, and its key; raise as `read_key`."""
    return max(1, round(far.silence / sample_time)), read_key(far.key) if far.key else b""


def read_key(path: Path) -> bytes:
    """Return the key of a file that only its owner can read.

    Raises:
        InputError: There is none, it is of another length, or others can read it.
    """
    remedy = f"make one by `canhaptic new --far-key {path}` and copy it to both"
    try:
        key, mode = read_regular(path, _KEY + 1), path.stat().st_mode
    except OSError as error:
        raise InputError(f"{path}: the key cannot be read ({error.strerror}); {remedy}") from error
    if len(key) != _KEY:
        raise InputError(f"{path}: got {len(key)} bytes, expected a key of {_KEY}; {remedy}")
    if mode & 0o077:
        raise InputError(f"{path}: others can read this key; make it yours alone (chmod 600 {path})")
    return key
