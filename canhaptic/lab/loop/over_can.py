"""The same figures over the whole CAN path: frames, drives, limiter and all, in lock-step."""

from collections.abc import Callable, Sequence

from canhaptic.control.balance import EnergyBalance
from canhaptic.control.ledger import LedgerSummary
from canhaptic.cycle import Cycle, run
from canhaptic.errors import InputError, RigError
from canhaptic.lab.loop.axis_loop import LoopRun, Recorder
from canhaptic.scene.build import build
from canhaptic.scene.models import Scene
from canhaptic.scene.parts import build_axis_controllers
from canhaptic.signals import CycleTiming, Sample, Truth

_Take = Callable[[int, Sample, EnergyBalance, Truth], None]
"""Takes one cycle of one axis: its place, the drive's report, the booked balance, and the true values."""


class _Tap:
    """Passes every cycle on in the place of a log."""

    def __init__(self, take: _Take) -> None:
        self._take = take

    def append(
        self,
        sync_index: int,
        samples: Sequence[Sample],
        balances: Sequence[EnergyBalance],
        timing: CycleTiming,
        truths: Sequence[Truth] | None = None,
        *_known: object,
    ) -> None:
        """Take one cycle."""
        for axis, row in enumerate(zip(samples, balances, truths or (), strict=True)):
            self._take(axis, *row)

    def event(self, sync_index: int, kind: str, port: str, text: str) -> None:
        """No-op: a fault ends the run."""


def walk_over_can(scene: Scene, cycles: int, take: _Take) -> list[LedgerSummary]:
    """Run the controllers of a scene on its simulated drives, pass every cycle on, and return the accounts.

    Args:
        scene: No axis of it is in a group.
        cycles: SYNCs.
        take: Called once per cycle and axis.

    Raises:
        InputError: The drives are not simulated in this process.
        RigError: A drive, the link or the limiter ended the run.
    """
    refused = f"{scene.source}: --can needs bus.interface: virtual and a `simulation`; leave --can out"
    if not scene.simulated:
        raise InputError(refused)
    with build(scene, "free") as experiment:
        if experiment.far_side is None:
            raise InputError(refused)
        drives = experiment.far_side.drives
        cycle = Cycle(experiment.rig, build_axis_controllers(scene), _Tap(take), lambda: [d.truth() for d in drives])
        run(cycle, cycles)
    return [ledger.summary() for ledger in cycle.ledgers]


def render_over_can(scene: Scene, cycles: int, counter: Callable[[], None]) -> list[LoopRun]:
    """One run per axis; a run that a drive or the limiter ends is marked so.

    Args:
        scene: Scene with the algorithm to run.
        cycles: SYNCs.
        counter: Called once per cycle and axis.

    Raises:
        InputError: The drives are not simulated in this process.
    """
    recorders, reason = [Recorder() for _ in scene.axes], ""

    def take(axis: int, sample: Sample, balance: EnergyBalance, truth: Truth) -> None:
        motor = truth.energy.motor
        recorders[axis].take(sample.position, truth.position, sample.torque_applied, balance, motor)
        counter()

    try:
        walk_over_can(scene, cycles, take)
    except RigError as error:
        reason = str(error)
    return [recorder.run("stopped" if reason else "", reason) for recorder in recorders]
