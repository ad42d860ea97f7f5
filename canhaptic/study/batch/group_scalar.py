"""One group of a scene in a loop without a bus, with the names of the batch.

What a figure of one axis means for a group: energies are those of all its motors and of a mover; torques are Euclidean
norms, `torque_peak` is the largest of any motor. Travel, stiffness and what is compared with a continuous run are NaN:
a group has no position.
"""

from collections.abc import Sequence
from dataclasses import asdict
from math import nan, sqrt
from typing import Final

import numpy as np

from canhaptic.control.balance import Branch
from canhaptic.control.multi_axis.group_controller import GroupBalance
from canhaptic.errors import ControlError
from canhaptic.scene.models import Scene
from canhaptic.study.batch.closed_loop import LoopSettings
from canhaptic.study.batch.group_loop import GroupHold, loop_of, run_group_loop
from canhaptic.study.batch.meter import Meter, count_branch, take_energy
from canhaptic.study.figures import CONTINUOUS, METRICS, metrics_of, sums_of
from canhaptic.study.loop import FURTHEST, DivergedError

_OUT_OF_CONTACT: Final = (Branch.FREE.value, Branch.EXIT.value)
_OF_A_POSITION: Final = ("travel", "stiffness_rendered.value", "stiffness_rendered.share", *CONTINUOUS)


def run_group(scene: Scene, cycles: int, metrics: Sequence[str] | None = None) -> dict[str, float]:
    """Returns the figures of the one group of a scene; see `run_scalar`.

    Raises:
        InputError: The motors of the group are not simulated, or move with others.
        ParameterError: The group cannot be built.
    """
    names = list(METRICS if metrics is None else metrics)
    found = {name: np.array([value]) for name, value in asdict(_metered(scene, cycles)).items()}
    own = [name for name in names if name not in _OF_A_POSITION]
    figures = metrics_of(own, {name: found[name] for name in sums_of(own)})
    return {name: float(figures[name][0]) if name in figures else nan for name in names}


def _metered(scene: Scene, cycles: int) -> Meter:
    """Returns the meter of the loop after its cycles, or when it diverged."""
    (group,), meter = scene.groups, Meter()
    axes = [scene.axis(name) for name in group.axes]
    loop = loop_of(axes[0], scene.bus.delay)
    damping = [(axis.loop.device_damping or 0.0) / scene.bus.sample_time for axis in axes]
    before: list[Sequence[float]] = []

    def take(hold: GroupHold) -> None:
        last = before.pop() if before else hold.true
        meter.lost += sum(b * (to - at) ** 2 for b, at, to in zip(damping, last, hold.true, strict=True))
        before.append(hold.true)
        _take(meter, loop, hold.held, hold.interaction, hold.balance)
        if not all(-FURTHEST < at < FURTHEST for at in hold.true):
            raise DivergedError(f"the group is at {tuple(hold.true)}")

    try:
        run_group_loop(scene, cycles, take)
    except ControlError:
        meter.diverged = 1.0
    return meter


def _take(meter: Meter, loop: LoopSettings, held: tuple[float, ...], interaction: float, balance: GroupBalance) -> None:
    """Takes one SYNC; see `meter.take`."""
    account, norm = balance.account, sqrt(sum(torque * torque for torque in held))
    meter.cycles += 1.0
    take_energy(loop.meter, meter, 0.0, interaction, account)
    meter.torque_peak = max(meter.torque_peak, *map(abs, held))
    meter.variation += abs(norm - meter.torque)
    meter.torque = norm
    meter.certificate = max(meter.certificate, float(account.certificate))
    count_branch(meter, account.branch)
    if account.branch not in _OUT_OF_CONTACT:
        meter.contacts += 1.0
        meter.damping += account.damping_rendered
        meter.damping_least = min(meter.damping_least, account.damping_rendered)
        meter.damping_most = max(meter.damping_most, account.damping_rendered)
