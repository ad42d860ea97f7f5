"""Processor times of a study of accuracy: of the thread that runs, so that other work on the machine counts little.

`interleaved` measures candidates in turn, as the least of its repeats with their spread. A fixed workload is timed with
them, so that the ratios of a table hold on another machine. `exchange_time` measures a cycle of the control thread
without the algorithm: frames, checks and accounts. The rig runs in one thread with its simulated drives, whose time is
measured and subtracted.
"""

import itertools
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

import numpy as np

from canhaptic.control.balance import AT_REST, EnergyBalance
from canhaptic.control.ports import axis_ports
from canhaptic.cycle import Cycle, run
from canhaptic.drive.can.bus_cycle import can_buses
from canhaptic.drive.can.door import open_bus, private_channel
from canhaptic.drive.can.link import Link
from canhaptic.drive.clock import ProcessorClock, VirtualClock
from canhaptic.drive.rig import Rig
from canhaptic.scene.build import build
from canhaptic.scene.buses import can_bus, kind_of
from canhaptic.scene.far_side import build_far_end
from canhaptic.scene.models import Scene
from canhaptic.scene.parts import build_servo_drive
from canhaptic.signals import SimulatedPeer

_CYCLES: Final = 600
_TURNS: Final = 3
_BLOCK: Final = 50
"""Cycles between two readings of the clock; only the fastest block counts, so that interruptions do not."""
_NS_PER_US: Final = 1e3


def exchange_time(scene: Scene, most: int) -> float | None:
    """Return the time of a cycle in the control thread without its algorithms [us].

    None if the scene has real drives, effects on its bus, several buses or a line of EtherCAT.

    Args:
        scene: Scene whose frames are exchanged.
        most: Largest number of cycles.
    """
    if not scene.simulated or scene.bus_effects is not None or len(scene.buses) != 1 or kind_of(scene.bus) != "can":
        return None
    bus = can_bus(scene.bus)
    with ExitStack() as stack:
        channel = private_channel()
        ends = [open_bus(bus, channel) for _ in range(2)]
        for end in ends:
            stack.callback(end.shutdown)
        far_side = _TimedFarSide(build_far_end(scene, None, ends[0])[0])
        link = Link(ends[1], VirtualClock([far_side]))
        drives = [build_servo_drive(axis, link, scene.bus) for axis in scene.axes]
        rig = Rig(can_buses(link, drives, bus), drives, scene.bus)
        cycle = Cycle(rig, axis_ports(_Idle() for _ in scene.axes))
        return _fastest_block(cycle, min(most, _CYCLES), lambda: far_side.clock.now() - far_side.spent)


def _fastest_block(cycle: Cycle, cycles: int, clock: Callable[[], int]) -> float:
    """Return the time of a cycle in the fastest block of a run [us]."""
    readings: list[int] = []
    block = max(1, min(_BLOCK, (cycles - 1) // 2))

    def read(done: int) -> None:
        if done % block == 0:
            readings.append(clock())

    run(cycle, cycles, progress=read)
    return min(after - before for before, after in itertools.pairwise(readings)) / block / _NS_PER_US


class RunPrice(NamedTuple):
    """Processor time of a whole simulated run in a cycle: drives, plants and control thread together [us].

    Attributes:
        cycle: Without an energy log.
        log: What the energy log adds to the control thread; 0 within the spread of the repeats.
    """

    cycle: float
    log: float


def run_price(scene: Scene, most: int) -> RunPrice | None:
    """Return what a cycle of a run takes; None if the scene cannot be run here.

    It is the fastest block of several runs, with the log and without; the two run alternately.

    Args:
        scene: Scene to run.
        most: Largest number of cycles.
    """
    if not scene.simulated or scene.bus_effects is not None:
        return None
    times: tuple[list[float], list[float]] = [], []
    with TemporaryDirectory() as folder:
        for turn in range(2 * _TURNS):
            log = Path(folder) / f"{turn}.h5" if turn % 2 else None
            with build(replace(scene, auto_accuracy=None), energy_log=log) as experiment:
                block = _fastest_block(experiment.cycle, min(most, _CYCLES // 2), ProcessorClock().now)
            times[turn % 2].append(block)
    without, logged = (ProcessorTime(min(of), max(of) / max(min(of), 1e-9) - 1.0, len(of)) for of in times)
    return RunPrice(without.least, max(0.0, saving(logged, without) or 0.0))


class _TimedFarSide:
    """The simulated drives, and the time that they took [ns]."""

    def __init__(self, far_side: SimulatedPeer) -> None:
        self.clock, self.spent = ProcessorClock(), 0
        self._far_side = far_side

    def process(self, now: int) -> None:
        """Handle everything that is due."""
        begin = self.clock.now()
        self._far_side.process(now)
        self.spent += self.clock.now() - begin

    def next_due(self) -> int:
        """Return the time of the next timer [ns]."""
        begin = self.clock.now()
        due = self._far_side.next_due()
        self.spent += self.clock.now() - begin
        return due


class _Idle:
    """A controller that does nothing."""

    def reset(self) -> None:
        """Reset nothing."""

    def sample_lost(self) -> EnergyBalance:
        """Return the balance at rest."""
        return AT_REST

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        """Return the balance at rest."""
        return AT_REST


_LEAST_REPEATS: Final = 3
_MOST_REPEATS: Final = 15
_PRODUCTS: Final = 20_000
WORKLOAD: Final = f"{_PRODUCTS} products of a 6 x 6 matrix with a vector, called from Python"


class ProcessorTime(NamedTuple):
    """Processor time of one candidate."""

    least: float  # [s]
    spread: float  # largest over least, less one
    repeats: int


def interleaved(
    candidates: Mapping[str, Callable[[], object]],
    budget: float,
    stop: Callable[[], bool],
    progress: Callable[[float], None],
) -> dict[str, ProcessorTime]:
    """Return the processor time of each candidate; they run in turn, A B C A B C, as often as the budget allows.

    Args:
        candidates: Candidates by name, the most important first.
        budget: Processor time of all runs [s]; when it is used up no further one begins, except the first.
        stop: Polled before each run; true aborts, and the results so far are returned.
        progress: Called with the completed fraction.
    """
    clock, spent, done = ProcessorClock(), 0, 0
    times: dict[str, list[int]] = {name: [] for name in candidates}
    for repeat in range(_MOST_REPEATS):
        for name, candidate in candidates.items():
            taken = times[name]
            of_next = min(taken, default=0)
            if stop() or (done and spent + of_next > budget * 1e9) or len(taken) < repeat:
                continue
            start = clock.now()
            candidate()
            taken.append(clock.now() - start)
            spent += taken[-1]
            done += 1
            progress(min(1.0, done / (_LEAST_REPEATS * len(candidates))))
    progress(1.0)
    return {name: _time_of(of_one) for name, of_one in times.items() if of_one}


def _time_of(times: list[int]) -> ProcessorTime:
    least = min(times)
    return ProcessorTime(least * 1e-9, max(times) / max(least, 1) - 1.0, len(times))


def saving(whole: ProcessorTime | None, part: ProcessorTime | None) -> float | None:
    """Return by how much one time is less than another, in their unit; None within the spread of their repeats."""
    if whole is None or part is None or min(whole.repeats, part.repeats) < _LEAST_REPEATS:
        return None
    saved, unsure = whole.least - part.least, whole.least * whole.spread + part.least * part.spread
    return saved if abs(saved) > unsure else None


def workload() -> None:
    """Run the fixed workload that every time is compared with."""
    matrix, state = np.eye(6) * 0.999, np.ones(6)
    product = matrix.dot
    for _ in range(_PRODUCTS):
        state = product(state)
