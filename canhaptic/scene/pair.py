"""Two simulated rigs and the network between them in one virtual time (`canhaptic run A.yaml --with B.yaml`)."""

import random
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple, TypedDict

from canhaptic.cycle import running
from canhaptic.drive.clock import WallClock
from canhaptic.errors import CanHapticError, InputError
from canhaptic.far.parameters import LOOPBACK
from canhaptic.result import RunResult
from canhaptic.scene.build import Experiment, build, experiment_account
from canhaptic.scene.models import Scene
from canhaptic.sim.network import NetworkParameters, SimulatedNetwork

_APART: Final = 0.37
"""Part of a sample time by which the second rig's SYNCs lie between the first rig's."""


class PairResult(TypedDict):
    """What two coupled rigs did together; energies in [J]."""

    least_true: float  # least sum of the energies that came in at both motors, by the plants, at every SYNC of either
    least_true_at_handle: float  # the same with what both devices dissipated
    sent: tuple[float, float]  # by each rig to the other
    received: tuple[float, float]


class Outcome(NamedTuple):
    """Account of each rig, what they did together, and the error that ended the run."""

    results: tuple[RunResult, RunResult]
    pair: PairResult
    error: CanHapticError | None


class Pair:
    """Two rigs that see each other through a simulated network; close it after its run.

    Args:
        scenes: Both scenes, each with `far` and `peer: loopback`; the first one's network counts.
        logs: Energy log of each, or None.

    Raises:
        InputError: A scene has no `far`, another peer, or no simulated drives.
    """

    def __init__(self, scenes: tuple[Scene, Scene], logs: Sequence[str | Path | None] = (None, None)) -> None:
        for scene in scenes:
            if scene.far is None or scene.far.peer != LOOPBACK or not scene.simulated:
                text = f"{scene.source}: far: expected a simulated rig with a section `far` whose peer is {LOOPBACK}"
                raise InputError(f"{text}; without --with a rig meets its peer over UDP")
        seed = scenes[0].simulation.seed if scenes[0].simulation is not None else 0
        given = scenes[0].far_network or NetworkParameters()
        self.network = SimulatedNetwork(given, seed)
        self.rigs: list[Experiment] = []
        try:
            for scene, end, log in zip(scenes, self.network.ends, logs, strict=True):
                numbers = partial(random.Random(seed * 2 + len(self.rigs)).randint, 1, 1 << 62)
                self.rigs.append(build(scene, "free", log, to_far=(end, numbers)))
        except BaseException:
            self.close("failed")
            raise
        self._periods = [scene.bus.sample_time for scene in scenes]
        self._periods[1] *= 1.0 - given.clock
        self.least = self.least_at_handle = 0.0

    def _due(self, place: int) -> float:
        return self._periods[place] * (self.rigs[place].cycle.cycles + _APART * place)

    def step(self) -> None:
        """Run the next SYNC of either rig, and compare the energies of both plants."""
        place = 0 if self._due(0) <= self._due(1) else 1
        self.network.now = self._due(place)
        self.rigs[place].cycle.step()
        self.compare()

    def compare(self) -> None:
        """Note the sums of both plants' energies."""
        motors = heat = 0.0
        for rig in self.rigs:
            cycle = rig.cycle
            if cycle.judge is not None and rig.far is not None:
                axis = rig.far.axis
                motors += cycle.judge.interaction[axis] - cycle.ledgers[axis].supplied
                heat += cycle.judge.dissipated[axis]
        self.least, self.least_at_handle = min(self.least, motors), min(self.least_at_handle, motors + heat)

    def run_through(
        self, duration: float, stop_requested: Callable[[], bool], progress: Callable[[int], None] | None = None
    ) -> Outcome:
        """Run both rigs until the first has completed a duration [s], or one fails; close, and return the accounts."""
        clock, first = WallClock(), self.rigs[0].cycle
        begin, error, cycles = clock.now(), None, max(1, round(duration / self._periods[0]))
        try:
            with running(first), running(self.rigs[1].cycle):
                while first.cycles < cycles and not stop_requested():
                    self.step()
                    if progress is not None:
                        progress(first.cycles)
        except CanHapticError as raised:
            error = raised
        self.compare()
        status = f"failed: {error}" if error else "stopped" if stop_requested() else "completed"
        elapsed = (clock.now() - begin) * 1e-9
        one, other = (experiment_account(rig, status, elapsed) for rig in self.rigs)
        links = [rig.far.summary() for rig in self.rigs if rig.far is not None]
        pair: PairResult = {
            "least_true": self.least,
            "least_true_at_handle": self.least_at_handle,
            "sent": (links[0].sent, links[1].sent),
            "received": (links[0].received, links[1].received),
        }
        try:
            self.close(status)
        except CanHapticError as raised:
            error = error or raised
        return Outcome((one, other), pair, error)

    def close(self, status: str = "completed") -> None:
        """Close logs and buses of both rigs; a second call does nothing."""
        for rig in self.rigs:
            rig.close(status)
