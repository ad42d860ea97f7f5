"""Run a scene over the whole CAN path (frames, drives, limiter) in lock-step, with the record of a loop without a bus.

`accounts_over_can` runs one scene under several algorithms and returns the account of every run.
"""

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

from canhaptic.control.balance import EnergyBalance
from canhaptic.control.ledger import LedgerSummary
from canhaptic.cycle import Cycle, running
from canhaptic.errors import CanHapticError, InputError, ParameterError, RigError
from canhaptic.lab.loop.axis_loop import LoopRun, Recorder, under
from canhaptic.scene.build import build, experiment_account
from canhaptic.scene.models import Scene
from canhaptic.scene.parts import build_ports
from canhaptic.signals import Sample, Truth

_Take = Callable[[int, Sample, EnergyBalance, Truth], None]
"""Called for each cycle of each axis with (index of the axis, the drive's report, booked balance, true values)."""


def walk_over_can(scene: Scene, cycles: int, take: _Take) -> list[LedgerSummary]:
    """Run a scene's controllers on its simulated drives; return the account of each axis.

    Args:
        scene: Scene without groups.
        cycles: Number of SYNCs.
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

        def pass_on(_sync: int, samples: Any, balances: Any, _timing: object, truths: Any, *_known: object) -> None:
            for axis, row in enumerate(zip(samples, balances, truths, strict=True)):
                take(axis, *row)

        log: Any = SimpleNamespace(append=pass_on, event=lambda *_fault: None)  # which ends the run
        cycle = Cycle(experiment.rig, build_ports(scene), log, lambda: [d.truth() for d in drives])
        with running(cycle):
            for _ in range(cycles):
                cycle.step()
            cycle.drop_log()  # a study ends before the holds of the stop
            return [ledger.summary() for ledger in cycle.ledgers]


def render_over_can(scene: Scene, cycles: int, counter: Callable[[], None]) -> list[LoopRun]:
    """Return one run per axis; where a drive or the limiter ends the run, `ended` and `reason` say so.

    Args:
        scene: Scene with the algorithm to run.
        cycles: Number of SYNCs.
        counter: Called once per cycle and axis.

    Raises:
        InputError: The drives are not simulated in this process.
    """
    recorders, reason = [Recorder(tick=counter) for _ in scene.axes], ""

    def take(axis: int, sample: Sample, balance: EnergyBalance, truth: Truth) -> None:
        received = 0.0 - truth.energy.motor
        recorders[axis].take(received, (sample.position,), (truth.position,), (sample.torque_applied,), balance)

    try:
        walk_over_can(scene, cycles, take)
    except RigError as error:
        reason = str(error)
    return [recorder.run("stopped" if reason else "", reason) for recorder in recorders]


Progress = Callable[[int], None]


def accounts_over_can(
    scene: Scene, names: Sequence[str], cycles: int, progress: Progress | None
) -> dict[str, dict[str, Any]]:
    """Run a scene under each algorithm; return name -> account with `status` and `remark`.

    An algorithm that refuses the scene has only `status` and `remark`.

    Args:
        scene: Scene with all drives simulated in this process.
        names: Names of the algorithms.
        cycles: Number of SYNCs of each run.
        progress: Called with the number of cycles done so far, of all runs together.

    Raises:
        InputError: The drives are not simulated in this process.
    """
    if not scene.simulated:
        raise InputError(f"{scene.source}: compare needs bus.interface: virtual and a `simulation`; add them")
    found: dict[str, dict[str, Any]] = {}
    for number, name in enumerate(names):
        try:
            experiment = build(under(scene, name).permitted(), "free")
        except ParameterError as error:
            found[name] = {"status": "refused", "remark": str(error)}
            continue
        report = progress or (lambda _cycles: None)
        with experiment:
            try:
                with running(experiment.cycle):
                    for done in range(cycles):
                        experiment.cycle.step()
                        report(number * cycles + done + 1)
                    found[name] = {**experiment_account(experiment, "completed", 0.0), "remark": ""}
            except CanHapticError as error:
                found[name] = {**experiment_account(experiment, "stopped", 0.0), "remark": str(error)}
    return found


def heading_of(scene: Scene, cycles: int, path: str = "can") -> dict[str, Any]:
    """Return the heading of a comparison as plain values; `path` is "can" or, without a bus, "direct"."""
    return {
        "scene": scene.source,
        "config_hash": scene.config_hash(),
        "path": path,
        "rate": 1.0 / scene.bus.sample_time,
        "delay": scene.bus.delay,
        "cycles": cycles,
        "duration": cycles * scene.bus.sample_time,
    }
