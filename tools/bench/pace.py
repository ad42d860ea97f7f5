"""How punctual is the cycle at 1 kHz, in one process that holds only master and simulated drive?

    canhaptic     the whole stack at real pace, without logs
    bare frames   the same pace by hand: sleep, spin, `send`, `recv` and one `struct` per frame; no checks at all
    canopen       `canopen.Network` with its Notifier and `sync.start`, the control law in a TPDO callback

Wake-up lateness is counted from the deadline of a SYNC, a cycle from the wake-up until its RPDO has been handed to the
bus. A burst is a SYNC less than half a period after the one before. Best of the interleaved repeats.
"""

import struct
from collections.abc import Callable
from itertools import pairwise
from time import monotonic_ns, sleep  # noqa: TID251 - a peer that paces itself by hand
from typing import NamedTuple

import can

from canhaptic.drive.clock import WallClock
from canhaptic.scene.build import Experiment, build
from canhaptic.scene.load import load_scene
from tools.bench.cycle import CONFIG, COUNT, NODE, CanopenLoop, law
from tools.bench.report import Row, interleave, publish

PERIOD = 1_000_000  # [ns]
CYCLES = 3_000
REPEATS = 3
MARGIN = 200_000  # [ns] of spinning, as the configuration has it
QUANTILES = {"p50": 0.5, "p99": 0.99}


class Run(NamedTuple):
    """Of one run, in [ns]."""

    lateness: list[int]  # empty where there is no deadline to be late for
    cycle: list[int]
    syncs: list[int]  # when each was handed to the bus

    def bursts(self) -> int:
        """Returns how many SYNCs came less than half a period after the one before."""
        return sum(later - earlier < PERIOD // 2 for earlier, later in pairwise(self.syncs))


def at_real_pace(*, watchdog: bool) -> Experiment:
    """Returns a rig that has been started; a peer sends no heartbeat, so the drive must not wait for one."""
    overrides = ["bus.heartbeat_timeout=5", *(() if watchdog else ("axes.0.watchdog=false",))]
    experiment = build(load_scene(CONFIG, overrides), "real")
    experiment.rig.start()
    return experiment


def canhaptic_run() -> Run:
    """The product, as `canhaptic run --pace real` runs it."""
    run = Run([], [], [])
    with at_real_pace(watchdog=True) as experiment:
        cycle, rig = experiment.cycle, experiment.rig
        cycle.step()
        for _ in range(CYCLES):
            cycle.step()
            timing = rig.timing
            run.lateness.append(timing.wakeup_lateness)
            run.cycle.append(timing.sync_to_last_tpdo + timing.compute + timing.send)
            run.syncs.append(rig._exchange.synced)  # noqa: SLF001 - the instant that nobody else reports
        rig.stop()
    return run


def bare_run() -> Run:
    """python-can, struct and a clock, nothing else."""
    run = Run([], [], [])
    with at_real_pace(watchdog=False) as experiment:
        assert experiment.far_side is not None
        bus: can.BusABC = experiment.rig.links[0]._bus  # noqa: SLF001 - the peers take over the connection
        _bare_cycles(run, bus, experiment.far_side.process)
    return run


def _bare_cycles(run: Run, bus: can.BusABC, process: Callable[[int], None]) -> None:
    sync = can.Message(arbitration_id=0x080, is_extended_id=False)
    rpdo = can.Message(arbitration_id=0x200 + NODE, is_extended_id=False)
    unpack, pack = struct.Struct("<Hih").unpack, struct.Struct("<Hh").pack
    last, deadline = 0.0, monotonic_ns() + PERIOD
    for _ in range(CYCLES):
        idle = deadline - monotonic_ns() - MARGIN
        if idle > 0:
            sleep(idle * 1e-9)
        while (now := monotonic_ns()) < deadline:
            pass
        run.lateness.append(now - deadline)
        run.syncs.append(now)
        bus.send(sync)
        process(monotonic_ns())
        while (message := bus.recv(0)) is None or message.arbitration_id != 0x180 + NODE:
            pass
        _, counts, _ = unpack(message.data)
        position = counts * COUNT
        rpdo.data = bytearray(pack(0x0F, law(position, last)))
        rpdo.dlc = 4
        bus.send(rpdo)
        last = position
        run.cycle.append(monotonic_ns() - now)
        process(monotonic_ns())
        deadline += -(-(monotonic_ns() - deadline) // PERIOD) * PERIOD


class _TimedBus:
    """Notes when SYNC and RPDO pass on their way to the bus."""

    def __init__(self, bus: can.BusABC, run: Run) -> None:
        self._send = bus.send
        self._run = run

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Sends a frame."""
        now = monotonic_ns()
        if msg.arbitration_id == 0x080:
            self._run.syncs.append(now)
        self._send(msg, timeout)
        if msg.arbitration_id == 0x200 + NODE and self._run.syncs:
            self._run.cycle.append(monotonic_ns() - self._run.syncs[-1])


class _Taken:
    """What `CanopenLoop` needs of a rig whose connection it takes over."""

    def __init__(self, experiment: Experiment) -> None:
        self.experiment = experiment
        self.bus: can.BusABC = experiment.rig.links[0]._bus  # noqa: SLF001 - the peers take over the connection


def canopen_run() -> Run:
    """The `canopen` package as its documentation shows it; the drive lives in this thread, the callback in another."""
    run = Run([], [], [])
    with at_real_pace(watchdog=False) as experiment:
        taken = _Taken(experiment)
        taken.bus.send = _TimedBus(taken.bus, run).send  # type: ignore[method-assign]
        loop = CanopenLoop(taken)  # type: ignore[arg-type]
        network = loop.network
        network.notifier = can.Notifier(taken.bus, network.listeners, network.NOTIFIER_CYCLE)
        network.sync.start(PERIOD * 1e-9)
        assert experiment.far_side is not None
        clock = WallClock([experiment.far_side])
        end = clock.now() + CYCLES * PERIOD
        while clock.now() < end:
            experiment.far_side.process(clock.now())
            sleep(20e-6)
        network.sync.stop()  # type: ignore[no-untyped-call]
        loop.close()
    return run


def rows_of(best: dict[str, Run]) -> list[Row]:
    """Returns the table: ours beside each peer."""
    ours, bare, natural = (best[name] for name in ("canhaptic", "bare frames", "canopen"))
    rows = []
    for quantile, fraction in QUANTILES.items():
        value = _quantile(ours.cycle, fraction)
        for name, peer in (("bare frames", bare), ("canopen", natural)):
            other = _quantile(peer.cycle, fraction)
            has_target = name == "bare frames"
            rows.append(
                Row(
                    f"cycle at 1 kHz, {quantile}",
                    value,
                    "us",
                    name,
                    other,
                    value / other,
                    target="<= 2 times" if has_target else "",
                    met=value <= 2.0 * other if has_target else None,
                )
            )
    late, peer_late = _quantile(ours.lateness, 0.5), _quantile(bare.lateness, 0.5)
    rows.append(
        Row("wake-up lateness, p50", late, "us", "bare frames", peer_late, late / peer_late, "<= 5 us", late <= 5.0)
    )
    late = _quantile(ours.lateness, 0.99)
    rows.append(Row("wake-up lateness, p99", late, "us", "bare frames", _quantile(bare.lateness, 0.99)))
    rows.append(Row("SYNC bursts", ours.bursts(), "", "canopen", natural.bursts(), target="0", met=ours.bursts() == 0))
    return rows


def _quantile(values: list[int], fraction: float) -> float:
    """Returns a quantile [us]."""
    return sorted(values)[min(len(values) - 1, int(fraction * len(values)))] * 1e-3


def main() -> None:
    """Measures the three, interleaved, and publishes the table."""
    runs: dict[str, list[Run]] = {"canhaptic": [], "bare frames": [], "canopen": []}
    interleave(
        {
            "canhaptic": lambda: runs["canhaptic"].append(canhaptic_run()),
            "bare frames": lambda: runs["bare frames"].append(bare_run()),
            "canopen": lambda: runs["canopen"].append(canopen_run()),
        },
        REPEATS,
    )
    best = {name: min(of_name, key=lambda run: _quantile(run.cycle, 0.99)) for name, of_name in runs.items()}
    publish("pace", rows_of(best), ["canhaptic", "python-can", "canopen"])


if __name__ == "__main__":
    main()
