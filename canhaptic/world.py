"""A slow world: the user's own program - a physics engine, a game loop - behind a wall that a rig renders at its rate.

    with canhaptic.World("loopback", scene="rig.yaml") as world:
        for hand in world:
            x = hand["handle"].position
            ...
            world["handle"].wall(at=0.03, stiffness=2000.0, pushes="-")

The rig runs elsewhere (`canhaptic run rig.yaml`), and nothing that the program does or fails to do can stop or delay
its cycle. With `World("virtual", ...)` the simulated rig of the scene runs inside the iteration, in virtual time.
"""

import random
import secrets
from collections.abc import Iterator, Mapping
from functools import partial
from math import inf
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Final, Self

from canhaptic.cycle import running
from canhaptic.drive.clock import WallClock
from canhaptic.errors import InputError, LinkError
from canhaptic.far.packet import HELLO, Packet
from canhaptic.far.parameters import LOOPBACK, FarParameters, address
from canhaptic.far.session import Session
from canhaptic.far.side import terms_of
from canhaptic.far.udp import UdpLink
from canhaptic.far.world_side import Hand, WorldAxis, number_in
from canhaptic.registry import nearest
from canhaptic.scene.build import build, experiment_account
from canhaptic.scene.models import Scene
from canhaptic.sim.network import NetworkParameters, SimulatedNetwork
from canhaptic.simulation import load_any
from canhaptic.units import shown

if TYPE_CHECKING:
    from canhaptic.result import RunResult

_PATIENCE: Final = 10.0
"""Time for which a world waits for its rig [s]."""
_WAIT: Final = 0.01
"""Longest wait for a packet [s]."""
_OLD: Final = 100_000_000
"""Time without a look after which what waits in the socket may be old [ns]: a full one keeps the first packets."""
_MOST: Final = 512  # looks into the socket in one turn
_VIRTUAL: Final = "virtual"
_GREETING: Final = Packet(HELLO, 0, 0, 0, 0, 0, 0.0, 0.0, 0)


class World:
    """A program behind a rig: iterate over it, one turn for each of its steps; the iteration ends with the session.

    Each turn yields the newest state of the rig by the name of its axis: `position`, `velocity` and `torque`. The names
    of the axes give what the program asks for: `wall`, `spring`, `free`, `absorbed`.

    Args:
        rig: `loopback`: a rig on this computer, or the addresses that the scene declares; `HOST:PORT`: where a rig
            listens; `virtual`: the simulated rig of the scene, in this process and in virtual time.
        scene: Scene of the rig, with a section `far` that names a `world`: a file, a mapping or a loaded scene.
        changes: Values that replace those of the scene, by path, as for `simulate`.
        budget: Energy that the program may give beyond what it has received or taken in [J].
        period: Virtual time of a turn [s].
        energy_log: Energy log of the virtual rig to write.

    Attributes:
        result: Account of the virtual rig after the iteration; None before, and for any other rig.

    Raises:
        InputError: The scene names no world, or a virtual rig has no simulated drives.

    Example:
        >>> with canhaptic.World("virtual", scene="configs/far_world.yaml") as world:
        ...     for hand in world:
        ...         world["handle"].wall(at=0.02, stiffness=1000.0, pushes="-")
    """

    def __init__(
        self,
        rig: str,
        *,
        scene: str | PathLike[str] | Mapping[str, object] | Scene,
        changes: Mapping[str, object] | None = None,
        budget: float = 0.0,
        period: float = 1.0 / 60.0,
        energy_log: str | PathLike[str] | None = None,
    ) -> None:
        self.result: RunResult | None = None
        self._scene = loaded = load_any(scene, changes or {}, False)
        if loaded.far is None or loaded.far.world is None:
            text = f"{loaded.source}: far: expected a section `far` with `world: loopback`"
            raise InputError(f"World: {text}, which names this program as the far side of an axis")
        far, turn = loaded.far, "1e-4 to 10 s of virtual time for a turn"
        budget = number_in("World", "budget", budget, "a number of at least 0 J", least=0.0)
        period = number_in("World", "period", period, turn, least=1e-4, largest=10.0)
        silence, key = terms_of(far, loaded.bus.sample_time)
        self._place: _Virtual | _Elsewhere
        self._place = _Virtual(loaded, period, energy_log) if rig == _VIRTUAL else _Elsewhere(loaded, far, rig)
        self._session = Session(key, silence, inf, self._place.fresh, self._place.transport.send)
        self._axis = WorldAxis(far, self._session, budget, str(loaded.source))
        self._is_begun = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __iter__(self) -> Iterator[dict[str, Hand]]:
        return self

    def __getitem__(self, name: str) -> WorldAxis:
        """Return the axis of the rig that this world is coupled to.

        Raises:
            KeyError: It is another one.
        """
        known = self._name
        if name != known:
            raise KeyError(
                f"World: got axis {shown(name)}, expected {known!r}, which far.axis names{nearest(name, [known])}"
            )
        return self._axis

    @property
    def _name(self) -> str:
        return self._axis.name

    def __next__(self) -> dict[str, Hand]:
        """Tell the rig what was decided, and return its newest state; the first turn waits for the rig.

        Raises:
            LinkError: No rig has answered for 10 s.
        """
        session = self._session
        if self._is_begun:
            self._axis.tell()
            self._turn()
        waited = 0
        while not self._is_begun and not self._place.is_over:
            session.say(_GREETING)
            waited += self._turn()
            self._is_begun = session.is_alive
            if waited * self._scene.bus.sample_time > _PATIENCE and not self._is_begun:
                text = f"no rig has answered at {self._place.name} for {_PATIENCE:g} s"
                raise LinkError(f"World: {text}; start it by `canhaptic run {self._scene.source} --pace real`")
        if self._place.is_over or not session.is_alive:
            self.close()
            raise StopIteration
        return {self._name: self._axis.hand}

    def _turn(self) -> int:
        """Let the rig run on, take what it has said; return how many sample times passed."""
        self._place.turn()
        for data in self._place.transport.arrived():
            packet = self._session.take(data, may_begin=not self._is_begun)
            if packet is not None:
                self._axis.take(packet)
        passed = self._place.periods()
        self._session.pass_time(passed)  # last: what a stall of this program has kept waiting has been heard
        return passed

    def pause(self, seconds: float) -> None:
        """Stand still for a time [s], virtual where the rig is."""
        self._place.pause(seconds)

    def close(self) -> None:
        """Tell the rig that this program stops, which takes its torque; a second call does nothing."""
        if self._session.is_alive:
            self._axis.tell(stopping=True)
            self._session.end()
        self.result = self._place.close() or self.result


class _Elsewhere:
    """A rig in another process: packets over UDP, the time of this computer."""

    is_over = False

    def __init__(self, scene: Scene, far: FarParameters, rig: str) -> None:
        other, own = far.places
        if rig != LOOPBACK:
            try:
                other = address(rig, "World")
            except ValueError as error:
                raise InputError(f"{error}, or {_VIRTUAL}") from error
        self.name, self.fresh = "{}:{}".format(*other), partial(_random, secrets.SystemRandom())
        self._clock, self._period = WallClock(), scene.bus.sample_time_ns
        self.transport, self._link = self, UdpLink(own, other)
        self._told = self._looked = self._clock.now()

    def send(self, data: bytes) -> None:
        """Send a packet, or lose it."""
        self._link.send(data)

    def arrived(self) -> Iterator[bytes]:
        """Yield the packets that have arrived: all that a rig has sent since the turn before."""
        for _ in range(_MOST):
            if not (come := list(self._link.arrived())):
                return
            yield from come

    def turn(self) -> None:
        """Wait for a packet, unless a fresh one is there."""
        if self._clock.now() - self._looked > _OLD:
            for _ in self.arrived():
                pass
        self._link.wait(_WAIT)
        self._looked = self._clock.now()

    def periods(self) -> int:
        """Return how many sample times have passed since it was asked before."""
        passed = (self._clock.now() - self._told) // self._period
        self._told += passed * self._period
        return passed

    def pause(self, seconds: float) -> None:
        """Sleep [s]."""
        self._clock.wait_until(self._clock.now() + round(1e9 * seconds))

    def close(self) -> None:
        """Close the socket."""
        self._link.close()


class _Virtual:
    """A simulated rig that runs inside the iteration, and the network between."""

    def __init__(self, scene: Scene, period: float, energy_log: str | PathLike[str] | None) -> None:
        if not scene.simulated:
            raise InputError(f"World: {scene.source}: expected simulated drives for a virtual rig; add `simulation`")
        seed = 0 if scene.simulation is None else scene.simulation.seed
        network = SimulatedNetwork(scene.far_network or NetworkParameters(), seed)
        near, self.transport = network.ends
        numbers = random.Random(seed)
        self.fresh, self.name, self._network = partial(_random, numbers), "the virtual rig", network
        log = None if energy_log is None else Path(energy_log)
        self.experiment = build(scene, "free", log, to_far=(near, partial(_random, numbers)))
        self._clock, self._begin, self._time, self._told = WallClock(), WallClock().now(), 0.0, 0
        self._period, self._sample_time, self._step = period, scene.bus.sample_time, period
        duration = scene.run.duration
        self._cycles = inf if duration is None else max(1, round(duration / self._sample_time))
        self.is_over, self._is_closed, self._status = False, False, "failed"
        self._turns = self._run()

    def _run(self) -> Iterator[None]:
        cycle, network = self.experiment.cycle, self._network
        try:
            with running(cycle):
                while not self.is_over:
                    end = self._time + self._step
                    while cycle.cycles < self._cycles and (due := cycle.cycles * self._sample_time) <= end:
                        network.now = due
                        cycle.step()
                    self._time = network.now = end
                    self.is_over = cycle.cycles >= self._cycles
                    yield
            self._status = "completed"
        finally:
            self.is_over = True
            self.experiment.close(self._status)

    def turn(self) -> None:
        """Run the rig for the period of a turn."""
        next(self._turns, None)

    def pause(self, seconds: float) -> None:
        """Run the rig for another time [s]."""
        self._step = seconds
        self.turn()
        self._step = self._period

    def periods(self) -> int:
        """Return how many sample times have passed since it was asked before."""
        now = round(self._time / self._sample_time)
        passed, self._told = now - self._told, now
        return passed

    def close(self) -> "RunResult | None":
        """Stop the rig, and return its account; None at a second call."""
        if self._is_closed:
            return None
        self._is_closed = self.is_over = True
        self.turn()
        return experiment_account(self.experiment, self._status, 1e-9 * (self._clock.now() - self._begin))


def _random(numbers: random.Random) -> int:
    return numbers.getrandbits(62) + 1
