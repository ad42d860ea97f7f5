"""One algorithm on one simulated axis, without a bus: a record of every hold with the plant's true values."""

from array import array
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from canhaptic.control.balance import Branch, EnergyBalance, residual
from canhaptic.control.environments.environment import Environment
from canhaptic.control.ledger import Ledger, LedgerSummary
from canhaptic.control.passivity import build_controller
from canhaptic.control.passivity.controller import Controller, LoopProperties
from canhaptic.control.running_sum import RunningSum, add
from canhaptic.errors import ControlError
from canhaptic.scene.models import AxisSimulation
from canhaptic.sim.plant.direct_rig import DirectRig
from canhaptic.sim.plant.plant import Plant
from canhaptic.units import Parameters

Array = NDArray[np.float64]

FURTHEST: Final = 1e3
"""Distance that counts as divergence unless something is known of the motion [m or rad]."""
_TRAVELS: Final = 10.0
"""The same in travels of an axis whose motion is known."""
_LEAST_TRAVEL: Final = 5e-3  # [m or rad]
_APART: Final = (Branch.FREE.value, Branch.EXIT.value)
_COLUMNS: Final = ("position", "true_position", "torque", "interaction", "believed", "dissipated", "damping")


class Case(Protocol):
    """An environment with its algorithm and plant, on an axis or a group."""

    @property
    def sample_time_ns(self) -> int:
        """T [ns]."""

    def controller(self) -> Any:
        """Return the algorithm, at rest."""


@dataclass(frozen=True, slots=True)
class LoopCase:
    """One algorithm, one environment, one plant, and the loop between them.

    `loop` is what the algorithm assumes, the rest is true.
    """

    environment: Environment
    algorithm: str
    parameters: Parameters | None
    loop: LoopProperties
    make_plant: Callable[[], Plant]
    sample_time_ns: int
    delay: int  # whole holds, 0 or 1
    counts_per_unit: float | None = None  # None: ideal encoder
    torque_quantum: float | None = None  # None: ideal torque [N or N*m]
    torque_limit: float | None = None  # of the drive [N or N*m]
    device_damping: float = 0.0  # that the device has for certain [N*s/m or N*m*s/rad]
    own: type[Any] | None = None  # algorithm of the user's own, in place of `algorithm`
    device_friction: float = 0.0  # Coulomb friction in motion that the device has for certain [N or N*m]
    simulation: AxisSimulation | None = None  # what `make_plant` makes; None where a compiled loop cannot move it

    def controller(self) -> Controller:
        """Return the algorithm, at rest."""
        if self.own is not None:
            controller: Controller = self.own(self.environment, self.parameters, self.loop)
            return controller
        return build_controller(self.environment, self.algorithm, self.parameters, self.loop)


class LoopRun(NamedTuple):
    """Result of one run; row k belongs to SYNC k. Shapes (n,); energies are sums since the start [J]."""

    position: Array  # as the controller saw it [m or rad]
    true_position: Array  # [m or rad]
    torque: Array  # applied in the hold that ended at SYNC k [N or N*m]
    interaction: Array  # TRUE sum of h_i, from the plant
    believed: Array  # sum of h_i as booked
    dissipated: Array  # sum of h_r as booked
    damping: Array  # rendered, NaN out of contact [N*s/m or N*m*s/rad]
    summary: LedgerSummary
    residual: float  # largest residual of the identity over the largest term of its hold (A1)
    ended: str  # "" when it ran to its end, else "diverged" or "stopped"
    reason: str = ""  # why it was stopped, in words
    engine: str = "python"  # what computed it: python or numba

    @property
    def least_interaction(self) -> float:
        """Least true sum of h_i after any hold, eq. 3 [J]."""
        return float(self.interaction.min(initial=0.0))

    @property
    def least_margin(self) -> float:
        """Least true sum of h_i less booked sum of h_r after any hold, eq. 4 [J]."""
        return float((self.interaction - self.dissipated).min(initial=0.0))

    @property
    def believed_error(self) -> float:
        """Largest |accounted - true| sum of h_i after any hold [J]."""
        return float(np.abs(self.believed - self.interaction).max(initial=0.0))

    @property
    def variation(self) -> float:
        """Total variation of the torque, the first step from zero included [N or N*m]."""
        return float(np.abs(np.diff(self.torque, prepend=0.0)).sum())


class DivergedError(ControlError):
    """The axis went farther than the user could have moved it."""


class Recorder:
    """Records every SYNC; used by the loop without a bus and by the one over it.

    Args:
        furthest: Distance from `centre` that counts as divergence [m or rad].
        centre: Centre of the permitted range [m or rad].
    """

    def __init__(self, furthest: float = FURTHEST, centre: float = 0.0) -> None:
        self._columns = [array("d") for _ in _COLUMNS]
        self._ledger = Ledger()
        self._lowest, self._highest = centre - furthest, centre + furthest
        self._believed, self._dissipated = RunningSum(), RunningSum()
        self._h_s = self._residual = 0.0

    @classmethod
    def around(cls, motion: Array) -> "Recorder":
        """Recorder for which ten times the range of a known motion [m or rad], shape (n,), is divergence."""
        lowest, highest = float(motion.min()), float(motion.max())
        return cls(_TRAVELS * max(highest - lowest, _LEAST_TRAVEL), 0.5 * (lowest + highest))

    def take(self, position: float, true_position: float, torque: float, balance: EnergyBalance, motor: float) -> None:
        """Take one SYNC.

        Args:
            position: Position as the controller read it [m or rad].
            true_position: True position [m or rad].
            torque: Torque applied in the hold that ended [N or N*m].
            balance: Balance booked by the controller.
            motor: True work of the motor on the moving mass since the start [J].

        Raises:
            DivergedError: The position is not finite, or farther away than any user moved it.
        """
        self._ledger.add(balance, len(self._columns[0]))
        believed, dissipated = add(self._believed, balance.h_i), add(self._dissipated, balance.h_r)
        largest = max(self._h_s, balance.h_s, abs(balance.h_i), balance.h_r, balance.gen, balance.deficit, balance.leak)
        if largest > 0.0:
            self._residual = max(self._residual, abs(residual(balance, self._h_s)) / largest)
        self._h_s = balance.h_s
        damping = float("nan") if balance.branch in _APART else balance.damping_rendered
        row = (position, true_position, torque, 0.0 - motor, believed, dissipated, damping)
        for column, value in zip(self._columns, row, strict=True):
            column.append(value)
        if not self._lowest < true_position < self._highest:
            raise DivergedError(f"the axis is at {true_position:g}, expected {self._lowest:g} to {self._highest:g}")

    def run(self, ended: str = "", reason: str = "") -> LoopRun:
        """Everything recorded so far.

        Args:
            ended: "" at the run's end, else "diverged" or "stopped".
            reason: Reason of the stop, in words.
        """
        position, true, torque, interaction, believed, dissipated, damping = (np.array(c) for c in self._columns)
        summary = self._ledger.summary()
        return LoopRun(
            position, true, torque, interaction, believed, dissipated, damping, summary, self._residual, ended, reason
        )


def render(
    case: LoopCase,
    cycles: int,
    recorder: Recorder | None = None,
    progress: Callable[[], None] | None = None,
) -> LoopRun:
    """Run a case from the plant's initial state; a run that diverges or fails ends early and is marked so.

    Args:
        case: Case to run.
        cycles: SYNCs.
        recorder: Defines divergence; 1 km by default.
        progress: Called once per cycle; must be cheap.

    Raises:
        ParameterError: The algorithm needs a value that its loop does not give.
    """
    controller, plant, taken = case.controller(), case.make_plant(), recorder or Recorder()

    def step(position: float, held: float) -> EnergyBalance:
        balance = controller.step(position, held)
        taken.take(position, plant.position, held, balance, plant.energy().motor)
        if progress is not None:
            progress()
        return balance

    rig = DirectRig(
        plant, step, case.sample_time_ns, case.delay, case.counts_per_unit, case.torque_quantum, case.torque_limit
    )
    try:
        rig.run(cycles)
    except DivergedError:
        return taken.run("diverged")
    except ControlError as error:
        return taken.run("stopped", str(error))
    return taken.run()
