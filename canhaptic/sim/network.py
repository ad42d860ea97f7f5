"""A simulated network between two rigs: delay, jitter, losses in bursts, doubles, outages, and clocks that differ."""

import heapq
import random
from collections.abc import Iterator
from typing import Annotated, Self

from pydantic import model_validator

from canhaptic.units import Parameters, quantity


class NetworkParameters(Parameters):
    """The network between this rig and the far side, as simulated; both directions are alike."""

    delay: Annotated[float, quantity("s", ge=0.0, le=10.0)] = 0.0
    """Time of a packet on its way, one way."""
    jitter: Annotated[float, quantity("s", ge=0.0, le=10.0)] = 0.0
    """Mean of a further time, exponentially distributed; packets may overtake each other."""
    loss: Annotated[float, quantity("1", ge=0.0, lt=1.0)] = 0.0
    """Share of the packets that are lost."""
    burst: Annotated[float, quantity("1", ge=1.0, le=1e6)] = 1.0
    """Mean number of packets lost one after the other."""
    double: Annotated[float, quantity("1", ge=0.0, le=1.0)] = 0.0
    """Share of the packets that arrive twice."""
    outage: tuple[Annotated[float, quantity("s", ge=0.0)], Annotated[float, quantity("s", ge=0.0)]] | None = None
    """Times between which no packet gets through, from the first SYNC on."""
    clock: Annotated[float, quantity("1", ge=-0.01, le=0.01)] = 0.0
    """By how much the clock of the far side is fast."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.outage is not None and self.outage[0] > self.outage[1]:
            raise ValueError(f"outage: got {self.outage}, expected [begin, end]; exchange them")
        return self


class SimulatedNetwork:
    """Carries packets between two rigs in one virtual time.

    Args:
        parameters: The network.
        seed: Seed of everything random in it.

    Attributes:
        ends: What each rig sends to and receives from.
    """

    def __init__(self, parameters: NetworkParameters, seed: int) -> None:
        self._given, self._random = parameters, random.Random(seed)
        self.ends = NetworkEnd(self, 0), NetworkEnd(self, 1)
        self._boxes: tuple[list[tuple[float, int, bytes]], ...] = [], []
        self._is_bad, self._number, self.now = [False, False], 0, 0.0

    def post(self, to: int, data: bytes) -> None:
        """Put a packet on its way to one end now, or lose it."""
        given, draw = self._given, self._random.random
        out = given.outage is not None and given.outage[0] <= self.now < given.outage[1]
        if given.loss > 0.0:
            leave = 1.0 / given.burst
            enter = leave * given.loss / (1.0 - given.loss)
            self._is_bad[to] = draw() > leave if self._is_bad[to] else draw() < enter
        if out or self._is_bad[to]:
            return
        for _ in range(2 if draw() < given.double else 1):
            late = self._random.expovariate(1.0 / given.jitter) if given.jitter else 0.0
            self._number += 1
            heapq.heappush(self._boxes[to], (self.now + given.delay + late, self._number, data))

    def arrived(self, at: int) -> Iterator[bytes]:
        """Yield the packets that have arrived at one end until now."""
        box = self._boxes[at]
        while box and box[0][0] <= self.now:
            yield heapq.heappop(box)[2]


class NetworkEnd:
    """One end of a simulated network."""

    def __init__(self, network: SimulatedNetwork, place: int) -> None:
        self._network, self._place = network, place

    def send(self, data: bytes) -> None:
        """Send a packet to the other end."""
        self._network.post(1 - self._place, data)

    def arrived(self) -> Iterator[bytes]:
        """Yield the packets that have arrived."""
        return self._network.arrived(self._place)

    def close(self) -> None:
        """No-op."""
