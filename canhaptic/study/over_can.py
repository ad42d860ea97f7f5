"""The same figures over the whole CAN path: frames, drives, limiter and all, in lock-step."""

from collections.abc import Callable, Sequence

from canhaptic.cycle import Cycle, run
from canhaptic.errors import CanHapticError, InputError
from canhaptic.haptics.balance import EnergyBalance
from canhaptic.scene.build import build, build_controllers
from canhaptic.scene.models import Scene
from canhaptic.signals import CycleTiming, Sample, Truth
from canhaptic.study.loop import LoopRun, Recorder


class _Recorders:
    """Takes the cycles of all axes where a log would."""

    def __init__(self, axes: int, counter: Callable[[], None]) -> None:
        self.of_axes = [Recorder() for _ in range(axes)]
        self._counter = counter

    def append(
        self,
        sync_index: int,
        samples: Sequence[Sample],
        balances: Sequence[EnergyBalance],
        timing: CycleTiming,
        truths: Sequence[Truth] | None = None,
    ) -> None:
        """Takes one cycle."""
        for recorder, sample, balance, truth in zip(self.of_axes, samples, balances, truths or (), strict=True):
            recorder.take(sample.position, truth.position, sample.torque_applied, balance, truth.energy.motor)
            self._counter()

    def event(self, sync_index: int, kind: str, port: str, text: str) -> None:
        """Takes nothing: a fault ends the run."""


def render_over_can(scene: Scene, cycles: int, counter: Callable[[], None]) -> list[LoopRun]:
    """Returns one run per axis; a run that a drive or the limiter ends says so.

    Args:
        scene: With the algorithm to run.
        cycles: SYNCs.
        counter: Called once per cycle and axis.

    Raises:
        InputError: The drives are not simulated in this process.
    """
    if not scene.simulated:
        raise InputError(f"{scene.source}: --can needs bus.interface: virtual and a `simulation`; leave --can out")
    recorders, ended = _Recorders(len(scene.axes), counter), ""
    with build(scene, "free") as experiment:
        far_side = experiment.far_side
        assert far_side is not None
        drives = far_side.drives
        cycle = Cycle(experiment.rig, build_controllers(scene), recorders, lambda: [d.truth() for d in drives])
        try:
            run(cycle, cycles)
        except CanHapticError as error:
            ended = f"stopped: {error}"
    return [recorder.run(ended) for recorder in recorders.of_axes]
