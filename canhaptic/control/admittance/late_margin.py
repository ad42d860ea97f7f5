"""Lower bound of an energy margin W, where forces arrive late by whole samples.

Between two SYNCs W decreases by no more than follows from the commands: its `change`. A force that belongs to an
earlier SYNC gives a bound on W then; the changes since bring it up to date. The larger of the two bounds counts.
"""

from dataclasses import dataclass
from typing import NamedTuple

from canhaptic.kernels import Buffer, MakeBuffer


@dataclass(slots=True)
class LateMargin:
    """Bounds of the margin W."""

    known: float = 0.0  # at least [J]
    place: int = 0  # of this SYNC in the rings


class MarginMemory(NamedTuple):
    """Rings over the SYNCs whose forces have not arrived, shape (latency + 1,)."""

    changes: Buffer  # of W in the hold that ended there [J]
    before: Buffer  # W there, with all that was taken from the account before [J]


def margin_memory(latency: int, make_buffer: MakeBuffer) -> MarginMemory:
    """Return the buffers of one margin."""
    return MarginMemory(make_buffer(latency + 1), make_buffer(latency + 1))


def fall(margin: LateMargin, memory: MarginMemory, change: float, taken: float) -> None:
    """Apply the change of W in the hold that ended [J], and record the energy taken from the account so far [J]."""
    margin.known += change
    if len(memory.changes) == 1:  # no force comes late
        memory.before[0] = margin.known + taken
        return
    place = margin.place + 1
    if place == len(memory.changes):
        place = 0
    margin.place = place
    memory.changes[place] = change
    memory.before[place] = margin.known + taken


def oldest(margin: LateMargin, memory: MarginMemory) -> int:
    """Place of the SYNC to which the received force belongs."""
    then = margin.place + 1
    return then if then < len(memory.changes) else 0


def known_then(known: float, margin: LateMargin, memory: MarginMemory) -> float:
    """Present bound, less the changes since the SYNC to which the received force belongs [J]."""
    then = oldest(margin, memory)
    for place in range(len(memory.changes)):
        if place != then:
            known -= memory.changes[place]
    return known


def rise(margin: LateMargin, memory: MarginMemory, then: int, value: float, taken: float) -> None:
    """Raise the bound by W at the place `then`, as the force shows it [J]."""
    if then != margin.place:
        for place in range(len(memory.changes)):
            if place != then:
                value += memory.changes[place]
    if value > margin.known:
        margin.known = value
    if then == margin.place:
        memory.before[then] = margin.known + taken
