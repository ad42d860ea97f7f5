"""The runs behind the paper's figures, each through the whole CAN path in lock-step, and their figures.

What is drawn and counted is what an energy log of the run would hold: positions and torques as the frames brought
them, energies as the controller booked them, and with them the energies of the simulated plant.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from canhaptic import load_scene
from canhaptic.control.balance import Branch, EnergyBalance
from canhaptic.control.ledger import LedgerSummary
from canhaptic.lab.batch.scalar import continuous_reference
from canhaptic.lab.loop.axis_loop import environment_of
from canhaptic.lab.loop.over_can import walk_over_can
from canhaptic.lab.reference import ContinuousReference
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import Scene
from canhaptic.signals import Sample, Truth

Array = NDArray[np.float64]

ROOT: Final = Path(__file__).resolve().parents[1]
LATE: Final = ("bus.rpdo=synchronous",)
_TOUCHED: Final = 1e-3  # [N]


@dataclass(frozen=True, slots=True)
class Record:
    """One run; row k belongs to SYNC k. Shapes (n,)."""

    time: Array  # [s]
    position: Array  # [m]
    torque: Array  # applied in the hold that ended at SYNC k [N]
    command: Array  # asked for at SYNC k, before any limit [N]
    h_i: Array  # [J]
    h_r: Array  # [J]
    true: Array  # sum of h_i by the plant's own energy [J]
    branch: NDArray[np.int64]
    wall: float  # [m]
    summary: LedgerSummary
    reference: ContinuousReference  # the continuous wall of the same hand

    @property
    def sticky(self) -> NDArray[np.bool_]:
        """Holds booked as sticky whose torque held the hand back, shape (n,)."""
        held_back: NDArray[np.bool_] = np.logical_and(self.branch == Branch.STICKY.value, self.torque < -_TOUCHED)
        return held_back


def record(config: str, overrides: Sequence[str] = ()) -> Record:
    """Returns one run of a scene of `configs/` with one simulated axis.

    Args:
        config: Name of the file.
        overrides: As `--set` takes them.
    """
    scene = load_scene(ROOT / "configs" / config, overrides)
    cycles, rows = round((scene.run.duration or 1.0) / scene.bus.sample_time), list[tuple[float, ...]]()

    def take(_axis: int, sample: Sample, balance: EnergyBalance, truth: Truth) -> None:
        seen, booked = (sample.position, sample.torque_applied), (balance.torque, balance.h_i, balance.h_r)
        rows.append((*seen, *booked, -truth.energy.motor, balance.branch))

    [summary] = walk_over_can(scene, cycles, take)
    position, torque, command, h_i, h_r, true, branch = np.array(rows, dtype=float).T
    return Record(
        time=np.arange(cycles, dtype=float) * scene.bus.sample_time,
        position=position,
        torque=torque,
        command=command,
        h_i=h_i,
        h_r=h_r,
        true=true,
        branch=branch.astype(int),
        wall=_surface(scene),
        summary=summary,
        reference=_continuous(config, scene.bus.sample_time_ns, cycles),
    )


def _surface(scene: Scene) -> float:
    return float(getattr(environment_of(scene.axes[0]), "position", 0.0))


@cache
def _continuous(config: str, sample_time_ns: int, cycles: int) -> ContinuousReference:
    """Returns the run of the continuous wall, which knows neither algorithm nor delay."""
    [axis] = load_scene(ROOT / "configs" / config).axes
    return continuous_reference(environment_of(axis), simulation_of(axis), sample_time_ns, cycles)


def figures_of(taken: Record) -> dict[str, Any]:
    """Returns the figures of a run by name; SI units, energies [J]."""
    summary, sticky = taken.summary, taken.sticky
    variation = float(np.abs(np.diff(taken.torque, prepend=0.0)).sum())
    error = taken.position - taken.reference.position
    return {
        "force_variation_over_continuous": variation / taken.reference.variation,
        "position_rms_error": float(np.sqrt(np.mean(error * error))),
        "deepest": float(taken.wall - taken.position.min()),
        "deepest_continuous": float(taken.wall - taken.reference.position.min()),
        "largest_force": float(taken.torque.max()),
        "least_force": float(taken.torque.min()),
        "sticky_holds": int(sticky.sum()),
        "sticky_least_force": float(taken.torque[sticky].min(initial=0.0)),
        "interaction": float(taken.h_i.sum()),
        "dissipated": summary.dissipated,
        "least_margin": summary.margin_value,
        "least_interaction_of_the_plant": float(taken.true.min(initial=0.0)),
        "believed_error": float(np.abs(np.cumsum(taken.h_i) - taken.true).max()),
        "generated": summary.generated,
        "recovered": summary.recovered,
        "deficit": summary.deficit,
        "surplus_end": summary.surplus_end,
        "damping_rendered_most": summary.damping_most,
        "booked_at_the_exit": float(np.abs(taken.h_i[taken.branch == Branch.EXIT.value]).sum()),
    }
