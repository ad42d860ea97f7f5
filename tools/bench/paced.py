"""What the paced benchmarks share: three loops at 1 kHz, what is noted of each cycle, and the table.

    canhaptic     the whole stack at real pace, without logs
    bare frames   the same pace by hand: sleep, spin, `send`, `recv` and one `struct` per frame; no checks at all
    canopen       `canopen.Network` with its Notifier and `sync.start`, the control law in a TPDO callback

Wake-up lateness is counted from the deadline of a SYNC, a cycle from the wake-up until its RPDO has been handed to the
bus. A burst is a SYNC less than half a period after the one before.
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from time import monotonic_ns, sleep  # noqa: TID251 - a peer that paces itself by hand
from typing import NamedTuple, Protocol

import can

from canhaptic.scene.build import Experiment
from tools.bench.demo import COUNT, PERIOD
from tools.bench.peers import (
    ENABLE,
    RPDO,
    RPDO_IMAGE,
    SYNC,
    TPDO,
    TPDO_IMAGE,
    CanopenLoop,
    Law,
    law,
)
from tools.bench.report import Row

CYCLES = 3_000
MARGIN = 200_000  # [ns] of spinning, as the configuration has it
_PATIENCE = 500_000  # [ns] that bare frames wait for a TPDO, as the configuration has it
QUANTILES = {"p50": 0.5, "p99": 0.99}


class Run(NamedTuple):
    """Times of one run [ns]."""

    lateness: list[int]  # empty where there is no deadline to be late for
    cycle: list[int]
    syncs: list[int]  # when each was handed to the bus

    def bursts(self) -> int:
        """Returns how many SYNCs came less than half a period after the one before."""
        return sum(later - earlier < PERIOD // 2 for earlier, later in pairwise(self.syncs))

    def missed(self) -> int:
        """Returns how many SYNCs no RPDO answered."""
        return len(self.syncs) - len(self.cycle)


class Peer(Protocol):
    """A drive that was brought up, in this process or elsewhere, and a connection to it."""

    bus: can.BusABC
    patience: float  # [s] for which the loop may wait for a frame before it lets the drive live again
    pause: float  # [s] for which it may sleep

    def process(self, now: int) -> None:
        """Lets a drive in this process live up to `now` [ns]."""


def canhaptic_run(experiment: Experiment) -> Run:
    """The product, as `canhaptic run --pace real` runs it."""
    run = Run([], [], [])
    cycle, rig = experiment.cycle, experiment.rig
    rig.start()
    cycle.step()
    for _ in range(CYCLES):
        cycle.step()
        timing = rig.timing
        run.lateness.append(timing.wakeup_lateness)
        run.syncs.append(rig._exchange.woken)  # noqa: SLF001 - the instant that nothing else reports
        if cycle.rig.records[-1].samples[0].fresh:
            run.cycle.append(timing.sync_to_last_tpdo + timing.compute + timing.send)
    rig.stop()
    return run


def bare_run(peer: Peer) -> Run:
    """python-can, struct and a clock, nothing else."""
    run = Run([], [], [])
    sync = can.Message(arbitration_id=SYNC, is_extended_id=False)
    rpdo = can.Message(arbitration_id=RPDO, is_extended_id=False)
    unpack, pack = TPDO_IMAGE.unpack, RPDO_IMAGE.pack
    bus, process, patience = peer.bus, peer.process, peer.patience
    last, deadline = 0.0, monotonic_ns() + PERIOD
    for _ in range(CYCLES):
        idle = deadline - monotonic_ns() - MARGIN
        if idle > 0:
            sleep(idle * 1e-9)
        while bus.recv(0) is not None:
            pass  # a TPDO that came too late would pass for the answer to the next SYNC, and to every one after it
        while (now := monotonic_ns()) < deadline:
            pass
        run.lateness.append(now - deadline)
        run.syncs.append(now)
        bus.send(sync)
        process(monotonic_ns())
        while (message := bus.recv(patience)) is None or message.arbitration_id != TPDO:
            if monotonic_ns() - now > _PATIENCE:
                break
        else:
            _, counts, _ = unpack(message.data)
            position = counts * COUNT
            rpdo.data = bytearray(pack(ENABLE, law(position, last)))
            rpdo.dlc = RPDO_IMAGE.size
            bus.send(rpdo)
            last = position
            run.cycle.append(monotonic_ns() - now)
        process(monotonic_ns())
        deadline += -(-(monotonic_ns() - deadline) // PERIOD) * PERIOD
    return run


class _TimedBus:
    """Notes when SYNC and RPDO pass on their way to the bus."""

    def __init__(self, bus: can.BusABC, run: Run) -> None:
        self._send = bus.send
        self._run = run

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Sends a frame."""
        now = monotonic_ns()
        if msg.arbitration_id == SYNC:
            self._run.syncs.append(now)
        self._send(msg, timeout)
        if msg.arbitration_id == RPDO and self._run.syncs:
            self._run.cycle.append(monotonic_ns() - self._run.syncs[-1])


def canopen_run(peer: Peer, law: Law = law, cycles: int = CYCLES) -> Run:
    """The `canopen` package as its documentation shows it; a drive in this process lives in this thread."""
    run = Run([], [], [])
    peer.bus.send = _TimedBus(peer.bus, run).send  # type: ignore[method-assign]
    loop = CanopenLoop(peer.bus, law)
    loop.begin()
    loop.network.sync.start(PERIOD * 1e-9)
    end = monotonic_ns() + cycles * PERIOD
    while (now := monotonic_ns()) < end:
        peer.process(now)
        sleep(peer.pause)
    loop.network.sync.stop()  # type: ignore[no-untyped-call]
    loop.close()
    return run


def best_of(runs: Mapping[str, Sequence[Run]]) -> dict[str, Run]:
    """Returns of each loop the repeat with the least p99."""
    return {name: min(of_name, key=lambda run: quantile(run.cycle, 0.99)) for name, of_name in runs.items()}


def rows_of(best: Mapping[str, Run]) -> list[Row]:
    """Returns the table of ours and each peer."""
    ours, bare, natural = (best[name] for name in ("canhaptic", "bare frames", "canopen"))
    rows = []
    for name, fraction in QUANTILES.items():
        value = quantile(ours.cycle, fraction)
        for peer, of_peer in (("bare frames", bare), ("canopen", natural)):
            other = quantile(of_peer.cycle, fraction)
            target, met = ("<= 2 times", value <= 2.0 * other) if of_peer is bare else ("", None)
            rows.append(Row(f"cycle at 1 kHz, {name}", value, "us", peer, other, value / other, target, met))
    for name, fraction in QUANTILES.items():
        late, other = quantile(ours.lateness, fraction), quantile(bare.lateness, fraction)
        target, met = ("<= 5 us", late <= 5.0) if name == "p50" else ("", None)
        rows.append(Row(f"wake-up lateness, {name}", late, "us", "bare frames", other, late / other, target, met))
    counts: dict[str, Callable[[Run], int]] = {"SYNC bursts": Run.bursts, "SYNCs without an answer in time": Run.missed}
    for name, count in counts.items():
        value, target = count(ours), "0" if count is Run.bursts else ""
        for peer, of_peer in (("bare frames", bare), ("canopen", natural)):
            met = value == 0 if target else None
            rows.append(Row(name, value, "", peer, count(of_peer), target=target, met=met))
    return rows


def quantile(values: Sequence[int], fraction: float) -> float:
    """Returns a quantile [us]; infinite when there is no value."""
    return sorted(values)[min(len(values) - 1, int(fraction * len(values)))] * 1e-3 if values else float("inf")
