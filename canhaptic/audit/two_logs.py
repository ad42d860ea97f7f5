"""Two logs of one link, joined by their packets and without a clock: the energy of both rigs over every consistent cut.

SYNC i of A lies after the SYNC of B whose packet it has seen last, and before the first SYNC of B that has seen packet
i or a later one. Each SYNC of B between them makes a consistent cut with i: nothing had arrived that was not yet sent.
On every such cut the energies that came in at both motors add up to at least 0 (`docs/theory/far.md`, F3).
"""

from typing import Final, NamedTuple, TypedDict

import numpy as np

from canhaptic.control.verdict import ROUNDING
from canhaptic.errors import InputError
from canhaptic.logs.energy_reader import EnergyLog, Quantities
from canhaptic.logs.hdf5 import Array

_PICO: Final = 1e-12


class JoinedLogs(TypedDict):
    """What two logs of one link say together; energies in [J]."""

    session: int
    least: float  # least sum of what came in at both motors, over all consistent cuts
    resolution: float  # of that sum
    widest: int  # most SYNCs of the other log between which one can lie
    under_way: float  # at the end: sent and not received, both ways
    given_up: float
    agrees: bool  # whether every total received is one that the other log sent
    holds: bool  # whether that is so, and the least sum is 0 within its resolution


class Course(NamedTuple):
    """What two logs of one link say at each SYNC of the first one in their common session; energies in [J].

    Of the other rig a column has the SYNC whose packet the first one had seen last.
    """

    time: Array  # of the SYNC [s]
    energies: tuple[Array, Array]  # came in at the motor of each rig since the start
    least: Array  # least sum of both over the cuts that are consistent with this SYNC; NaN without one
    under_way: Array  # sent and not received, both ways
    given_up: Array  # by both


class _Side(NamedTuple):
    """Columns of one log in the common session, and what came in before it."""

    time: Array  # [s]
    energy: Array  # came in at the motor since the start [J]
    sequence: Array  # of the packet of each SYNC
    seen: Array  # largest number of a packet of the other side
    booked: Array  # R [pJ]
    sent: Array  # S [pJ]
    given_up: Array  # since the start [J]
    resolution: float


def joined(first: EnergyLog, second: EnergyLog) -> JoinedLogs:
    """Return what two logs of one link say together, of the longest session that both have.

    Raises:
        InputError: A log has no far side, or they have no session in common.
    """
    session, a, b = _sides(first, second)
    sums, widest = _sums(a, b)
    least = min(0.0, float(np.nanmin(sums, initial=0.0)))
    agrees = _came_from(a, b) and _came_from(b, a)
    under_way = (a.sent[-1] - b.booked[-1]) + (b.sent[-1] - a.booked[-1])
    resolution = a.resolution + b.resolution
    return {
        "session": session,
        "least": least,
        "resolution": resolution,
        "widest": widest,
        "under_way": float(max(0.0, under_way)) * _PICO,
        "given_up": float(a.given_up[-1] + b.given_up[-1]),
        "agrees": agrees,
        "holds": agrees and least + resolution >= -ROUNDING,
    }


def course(first: EnergyLog, second: EnergyLog) -> Course:
    """Return what two logs of one link say over the SYNCs of the first one; errors as for `joined`."""
    _, a, b = _sides(first, second)
    seen = np.clip(np.searchsorted(b.sequence, a.seen), 0, len(b.energy) - 1)
    under_way = (a.sent - b.booked[seen]) + (b.sent[seen] - a.booked)
    both = a.energy, b.energy[seen]
    return Course(a.time, both, _sums(a, b)[0], _PICO * np.maximum(0.0, under_way), a.given_up + b.given_up[seen])


def _sides(first: EnergyLog, second: EnergyLog) -> tuple[int, _Side, _Side]:
    """Return the number of the longest session that both logs have, and the columns of each in it."""
    if first.far is None or second.far is None:
        raise InputError(f"{first.path}, {second.path}: expected two logs with a far side")
    found = first.far, second.far
    numbers = [dict(zip(*np.unique(far["session"], return_counts=True), strict=True)) for far in found]
    common = (numbers[0].keys() & numbers[1].keys()) - {0}
    if not common:
        raise InputError(f"{first.path}, {second.path}: have no session in common; inspect the two logs of one link")
    session = max(common, key=lambda number: int(numbers[0][number]))
    a, b = (_side(log, far, session) for log, far in zip((first, second), found, strict=True))
    return int(session), a, b


def _side(log: EnergyLog, far: Quantities, session: int) -> _Side:
    """Return the columns of the session; the axis of the link is the one with energy from elsewhere, or the first."""
    name = max(log.axes, key=lambda axis: float(np.abs(log.ports[axis]["supplied"]).sum()))
    port, rows = log.ports[name], far["session"] == session
    energy = np.cumsum(port["interaction"] - port["supplied"], dtype=np.longdouble) + port["device_dissipated"]
    return _Side(
        log.sample_time * np.flatnonzero(rows), np.asarray(energy[rows], dtype=float), far["sequence"][rows],
        far["seen"][rows], far["booked"][rows], far["sent"][rows], np.cumsum(port["leaked"])[rows],
        float(port["energy_resolution"][rows].max(initial=0.0)),
    )  # fmt: skip


def _sums(a: _Side, b: _Side) -> tuple[Array, int]:
    """Return the least sum over the cuts of each SYNC of A [J], and the most SYNCs of B between which one can lie."""
    low = np.searchsorted(b.sequence, a.seen)
    high = np.searchsorted(np.maximum.accumulate(b.seen), a.sequence)
    low = np.clip(low, 0, len(b.energy) - 1)
    sums, widest = np.full(len(a.energy), np.nan), 0
    for row, (begin, end) in enumerate(zip(low.tolist(), high.tolist(), strict=True)):
        if begin < end:
            sums[row], widest = a.energy[row] + b.energy[begin:end].min(), max(widest, end - begin)
    return sums, widest


def _came_from(a: _Side, b: _Side) -> bool:
    """Whether every total that A received was sent by B no later than the newest packet that A had seen."""
    heard = a.seen >= 0
    place = np.searchsorted(b.sequence, a.seen[heard], side="right") - 1
    sent = np.where(place >= 0, b.sent[np.clip(place, 0, None)], 0.0)
    return bool((a.booked[heard] <= sent).all() and (a.booked[~heard] == 0.0).all())
