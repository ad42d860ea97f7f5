"""How many cycles a second does one axis reach flat out, against the `canopen` package used by hand and bare frames?

All command the same simulated drive, in the same process:

    canhaptic     the whole stack: SYNC, TPDO, controller, ledger, limiter, link policy, RPDO, energy log, bus log
    canopen       `canopen.Network` with its Notifier, the control law in a TPDO callback, `rpdo.transmit()`
    bare frames   python-can `send` and `recv` with one `struct` per frame, no checks at all

Times of canopen and bare frames hold a spring-damper law only: no account of energy, no limits, no log. Both run on
python-can's stock virtual bus, as a user of these packages has it; canhaptic brings a leaner one for drives inside
its process. Bare frames on that one are shown too: what is left there is the price of the stack itself.
"""

import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import can

from canhaptic.drive.clock import Clock
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from canhaptic.sim.bus.virtual_bus import LeanVirtualBus
from tools.bench.demo import CONFIG, COUNT, PERIOD, drive_of, require_rendered
from tools.bench.peers import (
    ENABLE,
    RPDO,
    RPDO_IMAGE,
    SYNC,
    TPDO,
    TPDO_IMAGE,
    BroughtUp,
    CanopenLoop,
    OpenBus,
    law,
    stock_bus,
)
from tools.bench.report import Row, in_turn, publish

CYCLES = 5_000
REPEATS = 7
TARGET = 15_000.0
TARGET_RATIOS = {"canopen": 2.5, "bare frames": 0.5}
OUR_BUS = "bare frames on our bus"


def advance(clock: Clock) -> None:
    """Moves virtual time on by one sample time."""
    clock.wait_until(clock.now() + PERIOD)


def bare_loop(peer: BroughtUp) -> None:
    """python-can and struct, nothing else."""
    sync = can.Message(arbitration_id=SYNC, is_extended_id=False)
    rpdo = can.Message(arbitration_id=RPDO, is_extended_id=False)
    unpack, pack = TPDO_IMAGE.unpack, RPDO_IMAGE.pack
    bus, process, clock = peer.bus, peer.far_side.process, peer.clock
    last = 0.0
    for _ in range(CYCLES):
        advance(clock)
        bus.send(sync)
        process(clock.now())
        while True:
            message = bus.recv(0)
            if message is not None and message.arbitration_id == TPDO:
                break
        _, counts, _ = unpack(message.data)
        position = counts * COUNT
        rpdo.data = bytearray(pack(ENABLE, law(position, last)))
        rpdo.dlc = RPDO_IMAGE.size
        bus.send(rpdo)
        last = position
        process(clock.now())


def canopen_loop(peer: BroughtUp, loop: CanopenLoop) -> None:
    """SYNC by hand in lock-step; the answer comes from the callback in the Notifier's thread."""
    loop.begin()
    process, clock, answered = peer.far_side.process, peer.clock, loop.answered
    for _ in range(CYCLES):
        advance(clock)
        answered.clear()
        loop.network.sync.transmit()
        process(clock.now())
        if not answered.wait(1.0):
            raise TimeoutError("no TPDO callback within 1 s")
        process(clock.now())


def timed(loop: Callable[[], None]) -> float:
    """Returns cycles per second of one run."""
    start = perf_counter()
    loop()
    return CYCLES / (perf_counter() - start)


def product() -> float:
    """Returns cycles per second of the whole stack, with both logs, as `canhaptic run --pace free` runs it."""
    with tempfile.TemporaryDirectory() as folder:
        experiment = build(load_scene(CONFIG), "free", Path(folder) / "energy.h5", Path(folder) / "bus.log")
        experiment.rig.start()
        step = experiment.cycle.step

        def loop() -> None:
            for _ in range(CYCLES):
                step()

        rate = timed(loop)
        require_rendered(drive_of(experiment))
        experiment.rig.stop()
        experiment.close()
    return rate


def by_hand() -> float:
    """Returns cycles per second of the `canopen` package."""
    with BroughtUp("free") as peer:
        loop = CanopenLoop(peer.bus)
        rate = timed(lambda: canopen_loop(peer, loop))
        peer.check()
        loop.close()
    return rate


def bare(open_bus: OpenBus) -> float:
    """Returns cycles per second of python-can and struct."""
    with BroughtUp("free", open_bus) as peer:
        rate = timed(lambda: bare_loop(peer))
        peer.check()
    return rate


def main() -> None:
    """Measures all, interleaved, and publishes the table."""
    loops: dict[str, Callable[[], float]] = {
        "canhaptic": product,
        "canopen": by_hand,
        "bare frames": lambda: bare(stock_bus),
        OUR_BUS: lambda: bare(LeanVirtualBus),
    }
    rates = in_turn(loops, REPEATS)
    best = {name: max(values) for name, values in rates.items()}
    ours = best.pop("canhaptic")
    rows = [
        Row("one axis, full stack, best of 7", ours, "cycles/s", target=f">= {TARGET:g}", met=ours >= TARGET),
        Row("one axis, full stack, worst of 7", min(rates["canhaptic"]), "cycles/s"),
    ]
    for peer, rate in best.items():
        least = TARGET_RATIOS.get(peer)
        target, met = ("", None) if least is None else (f">= {least:g} times", ours >= least * rate)
        rows.append(Row(f"full stack / {peer}", ours, "cycles/s", peer, rate, ours / rate, target, met))
    publish("cycle", rows, ["canhaptic", "python-can", "canopen", "numpy", "h5py"])


if __name__ == "__main__":
    main()
