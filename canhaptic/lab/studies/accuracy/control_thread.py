"""What one cycle costs the control thread apart from the algorithm: frames, checks and accounts, without the far side.

The rig of the scene runs in lock-step with its simulated drives in one thread; the time that these take is measured
on the way and taken off.
"""

import math
from contextlib import ExitStack
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from canhaptic.control.balance import AT_REST, EnergyBalance
from canhaptic.cycle import Cycle, run
from canhaptic.drive.can.link import Link
from canhaptic.drive.clock import VirtualClock, WallClock
from canhaptic.drive.rig import Rig
from canhaptic.scene.build import build, build_drive_group
from canhaptic.scene.bus import open_bus, private_channel
from canhaptic.scene.models import Scene
from canhaptic.scene.parts import build_servo_drive
from canhaptic.signals import SimulatedPeer

_CYCLES: Final = 600
_TURNS: Final = 3
_BLOCK: Final = 50
"""Cycles between two readings: the least block counts, so that interruptions do not."""
_NS_PER_US: Final = 1e3


def exchange_time(scene: Scene) -> float | None:
    """Return the time of a cycle in the control thread without its algorithms [us].

    None where the scene has real drives, effects on its bus or several buses.
    """
    if not scene.simulated or scene.bus_effects is not None or len(scene.buses) != 1:
        return None
    with ExitStack() as stack:
        channel = private_channel()
        ends = [open_bus(scene.bus, channel) for _ in range(2)]
        for end in ends:
            stack.callback(end.shutdown)
        far_side = _TimedFarSide(build_drive_group(scene, ends[0]))
        link = Link(ends[1], VirtualClock([far_side]))
        rig = Rig(link, [build_servo_drive(axis, link, scene.bus) for axis in scene.axes], scene.bus)
        readings: list[int] = []

        def read(cycles: int) -> None:
            if cycles % _BLOCK == 0:
                readings.append(far_side.clock.now() - far_side.spent)

        run(Cycle(rig, [_Idle() for _ in scene.axes]), _CYCLES, progress=read)
    return min(after - before for before, after in pairwise(readings)) / _BLOCK / _NS_PER_US


def log_time(scene: Scene) -> float | None:
    """Return what writing the energy log costs the control thread in a cycle [us]; None where nothing can be run.

    The least block of a run with the log, less the least of one without; both in lock-step, taken in turn.
    """
    if not scene.simulated or scene.bus_effects is not None:
        return None
    clock, least = WallClock(), [math.inf, math.inf]
    with TemporaryDirectory() as folder:
        for turn in range(2 * _TURNS):
            log = Path(folder) / f"{turn}.h5" if turn % 2 else None
            with build(replace(scene, auto_accuracy=None), energy_log=log) as experiment:
                readings: list[int] = []

                def read(cycles: int, readings: list[int] = readings) -> None:
                    if cycles % _BLOCK == 0:
                        readings.append(clock.now())

                run(experiment.cycle, _CYCLES // 2, progress=read)
            each = min(after - before for before, after in pairwise(readings))
            least[turn % 2] = min(least[turn % 2], each / _BLOCK / _NS_PER_US)
    return max(0.0, least[1] - least[0])


class _TimedFarSide:
    """A far side and the time it took [ns]."""

    def __init__(self, far_side: SimulatedPeer) -> None:
        self.clock, self.spent = WallClock(), 0
        self._far_side = far_side

    def process(self, now: int) -> None:
        """Handle what is due."""
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
        """Keep nothing."""

    def hold(self) -> EnergyBalance:
        """Return rest."""
        return AT_REST

    def step(self, position: float, torque_applied: float) -> EnergyBalance:
        """Return rest."""
        return AT_REST
