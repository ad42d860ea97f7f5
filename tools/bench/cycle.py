"""How many cycles a second does one axis reach flat out, beside the `canopen` package used by hand and bare frames?

All three command the same simulated drive, in the same process, through the same python-can virtual bus:

    canhaptic     the whole stack: SYNC, TPDO, controller, ledger, limiter, link policy, RPDO, energy log, bus log
    canopen       `canopen.Network` with its Notifier, the control law in a TPDO callback, `rpdo.transmit()`
    bare frames   python-can `send` and `recv` with one `struct` per frame, no checks at all

Times of canopen and bare frames hold a spring-damper law only: no account of energy, no limits, no log.
"""

import struct
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import can
import canopen

from canhaptic.dictionary import read_dictionary
from canhaptic.scene.build import Experiment, build
from canhaptic.scene.load import load_scene
from canhaptic.sim.state_machine import DriveState
from tools.bench.report import Row, publish

CONFIG = Path(__file__).resolve().parents[2] / "configs" / "demo.yaml"
CYCLES = 5_000
REPEATS = 7
TARGET = 15_000.0
TARGET_RATIOS = {"canopen": 2.5, "bare frames": 0.5}
NODE = 1
COUNT = 1e-6  # [m]
RATED = 10.0  # [N]
STIFFNESS, DAMPING, WALL, SAMPLE_TIME = 100.0, 10.0, -0.05, 1e-3


def law(position: float, last: float) -> int:
    """Returns the torque [per mille] of the plain sampled wall of the demo."""
    if position >= WALL:
        return 0
    force = -STIFFNESS * (position - WALL) - DAMPING * (position - last) / SAMPLE_TIME
    return max(-2000, min(2000, round(force / RATED * 1000.0)))


class Flat:
    """One brought-up rig, and a way to run its drive flat out; made anew for every repeat."""

    def __init__(self, folder: Path | None) -> None:
        # The peers send no heartbeat of their own, so the drive must not wait for one.
        overrides = () if folder else ("axes.0.watchdog=false",)
        logs = (None, None) if folder is None else (folder / "energy.h5", folder / "bus.log")
        self.experiment: Experiment = build(load_scene(CONFIG, overrides), "free", *logs)
        self.experiment.rig.start()
        far_side = self.experiment.far_side
        assert far_side is not None
        self.far_side = far_side
        self.clock = self.experiment.clock
        self.link = self.experiment.rig.links[0]
        self.bus: can.BusABC = self.link._bus  # noqa: SLF001 - the peers take over the connection that the rig brought up

    def check(self) -> None:
        """Makes sure that the loop did its job: the drive still enabled, and the wall took energy from the user."""
        [drive] = self.far_side.drives
        if drive.state is not DriveState.OPERATION_ENABLED or not drive.truth().energy.motor < -0.01:
            raise SystemExit(f"the loop did not render the wall: {drive.state.name}, {drive.truth()}")

    def advance(self) -> None:
        """Moves virtual time on by one sample time."""
        self.clock.wait_until(self.clock.now() + 1_000_000)


def canhaptic_loop(flat: Flat) -> None:
    """The product, as `canhaptic run --pace free` runs it."""
    step = flat.experiment.cycle.step
    for _ in range(CYCLES):
        step()


def bare_loop(flat: Flat) -> None:
    """python-can and struct, nothing else."""
    sync = can.Message(arbitration_id=0x080, is_extended_id=False)
    rpdo = can.Message(arbitration_id=0x200 + NODE, is_extended_id=False)
    unpack, pack = struct.Struct("<Hih").unpack, struct.Struct("<Hh").pack
    bus, process, clock = flat.bus, flat.far_side.process, flat.clock
    last = 0.0
    for _ in range(CYCLES):
        flat.advance()
        bus.send(sync)
        process(clock.now())
        while True:
            message = bus.recv(0)
            if message is not None and message.arbitration_id == 0x180 + NODE:
                break
        _, counts, _ = unpack(message.data)
        position = counts * COUNT
        rpdo.data = bytearray(pack(0x0F, law(position, last)))
        rpdo.dlc = 4
        bus.send(rpdo)
        last = position
        process(clock.now())


class CanopenLoop:
    """The `canopen` package as its documentation shows it: a callback on the TPDO, a transmit on the RPDO."""

    def __init__(self, flat: Flat) -> None:
        self.flat = flat
        eds = CONFIG.parent.parent / "eds" / "cia402_servo.eds"
        self.network = canopen.Network(flat.bus)
        self.network.NOTIFIER_CYCLE = 0.05
        node = canopen.RemoteNode(NODE, read_dictionary(eds, NODE))
        self.network.add_node(node)
        self.tpdo, self.rpdo = node.tpdo[1], node.rpdo[1]
        self._map(self.tpdo, [0x6041, 0x6064, 0x6074], 0x180 + NODE)
        self._map(self.rpdo, [0x6040, 0x6071], 0x200 + NODE)
        self.tpdo.add_callback(self._on_tpdo)
        self.answered = threading.Event()
        self.last = 0.0

    @staticmethod
    def _map(pdo: canopen.pdo.PdoMap, objects: list[int], cob_id: int) -> None:
        pdo.clear()
        for index in objects:
            pdo.add_variable(index)
        pdo.cob_id, pdo.enabled = cob_id, True
        pdo.subscribe()

    def _on_tpdo(self, pdo: canopen.pdo.PdoMap) -> None:
        position = float(pdo.map[1].raw) * COUNT
        self.rpdo.map[0].raw = 0x0F
        self.rpdo.map[1].raw = law(position, self.last)
        self.rpdo.transmit()
        self.last = position
        self.answered.set()

    def __call__(self) -> None:
        """Runs the loop and stops the Notifier."""
        self.network.notifier = can.Notifier(self.flat.bus, self.network.listeners, self.network.NOTIFIER_CYCLE)
        process, clock, answered = self.flat.far_side.process, self.flat.clock, self.answered
        for _ in range(CYCLES):
            self.flat.advance()
            answered.clear()
            self.network.sync.transmit()
            process(clock.now())
            if not answered.wait(1.0):
                raise TimeoutError("no TPDO callback within 1 s")
            process(clock.now())

    def close(self) -> None:
        """Stops the Notifier; not part of the time."""
        assert self.network.notifier is not None
        self.network.notifier.stop(1.0)


def timed(loop: Callable[[], None]) -> float:
    """Returns cycles per second of one run."""
    start = perf_counter()
    loop()
    return CYCLES / (perf_counter() - start)


def product() -> float:
    """Returns cycles per second of the whole stack, with both logs."""
    with tempfile.TemporaryDirectory() as folder:
        flat = Flat(Path(folder))
        rate = timed(lambda: canhaptic_loop(flat))
        flat.check()
        flat.experiment.rig.stop()
        flat.experiment.close()
    return rate


def by_hand() -> float:
    """Returns cycles per second of the `canopen` package."""
    flat = Flat(None)
    loop = CanopenLoop(flat)
    rate = timed(loop)
    flat.check()
    loop.close()
    flat.experiment.close()
    return rate


def bare() -> float:
    """Returns cycles per second of python-can and struct."""
    flat = Flat(None)
    rate = timed(lambda: bare_loop(flat))
    flat.check()
    flat.experiment.close()
    return rate


def main() -> None:
    """Measures the three, interleaved, and publishes the table."""
    rates: dict[str, list[float]] = {"canhaptic": [], "canopen": [], "bare frames": []}
    for _ in range(REPEATS):
        for name, loop in zip(rates, (product, by_hand, bare), strict=True):
            rates[name].append(loop())
    best = {name: max(values) for name, values in rates.items()}
    ours = best["canhaptic"]
    rows = [
        Row("one axis, full stack, best of 7", ours, "cycles/s", target=f">= {TARGET:g}", met=ours >= TARGET),
        Row("one axis, full stack, worst of 7", min(rates["canhaptic"]), "cycles/s"),
    ]
    for peer, least in TARGET_RATIOS.items():
        ratio = ours / best[peer]
        target = f">= {least:g} times"
        rows.append(Row(f"full stack / {peer}", ours, "cycles/s", peer, best[peer], ratio, target, ratio >= least))
    publish("cycle", rows, ["canhaptic", "python-can", "canopen", "numpy", "h5py"])


if __name__ == "__main__":
    main()
