"""A plant and a controller in one loop without a bus: for sweeps, the accuracy study, and as a check of the CAN path.

With the same quantisation (encoder counts, torque quantum) it gives the same floats as the path over the bus:

    delay 0  the torque computed from q(k) acts from SYNC k (event RPDO in lock-step)
    delay 1  it acts from SYNC k+1 (synchronous RPDO)

`observed` returns the motion of a plant under given torques. `estimated_error` estimates its error without a reference
(`canhaptic accuracy` has one): the plant runs again with halved steps (sample time and substeps alike) and with coarser
event bits. The declared order, and for events the bracket that halves with every bit, turn the differences into an
error. If the steps do not converge, the estimate says so.
"""

from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from canhaptic.errors import ParameterError
from canhaptic.signals import PlantEnergy
from canhaptic.sim.plant import AccuracyParameters
from canhaptic.sim.plant.plant import Plant
from canhaptic.sim.plant.propagator import Array


class Motion(NamedTuple):
    """Motion at the ends of holds; shapes (n_holds,)."""

    position: Array  # [m or rad]
    velocity: Array  # [m/s or rad/s]
    motor: Array  # work of the motor since the start [J]
    user: Array  # work of the user since the start [J]


def observed(plant: Plant, torques: Sequence[float], hold_ns: int | None = None) -> Motion:
    """Return the motion of a plant under the torques, from its start.

    Args:
        plant: Plant before `begin`.
        torques: Torque of each hold [N or N*m].
        hold_ns: Length of a hold [ns]; None: the sample time of the plant.
    """
    plant.begin(0)
    period, table = hold_ns or plant.sample_time_ns, np.empty((len(torques), 4))
    for k, torque in enumerate(torques):
        plant.advance_to((k + 1) * period, torque)
        energy = plant.energy()
        table[k] = plant.position, plant.velocity, energy.motor, energy.user
    return Motion(*table.T)


class DirectRecord(NamedTuple):
    """Result of one run; row k belongs to SYNC k."""

    position: Array  # as the controller saw it, shape (n,) [m or rad]
    true_position: Array  # shape (n,) [m or rad]
    torque_command: Array  # as computed at SYNC k and limited, shape (n,) [N or N*m]
    torque_applied: Array  # held from SYNC k-1 to SYNC k, shape (n,) [N or N*m]
    energy: PlantEnergy  # at the last SYNC [J]


@dataclass(frozen=True)
class DirectRig:
    """Plant and controller in one loop of floats.

    Args:
        plant: Plant before `begin`; its epoch becomes SYNC 0.
        controller_step: Function of the position and the torque applied in the hold that ended; its result has the
            `torque` [N or N*m] of the hold that begins, or of the one after it with a delay of 1.
        sample_time_ns: Time between two SYNCs [ns].
        delay: Whole holds between the computation of a torque and the hold in which it acts, 0 or 1.
        counts_per_unit: Encoder counts per m or rad; None for an ideal encoder.
        torque_quantum: Step of the command [N or N*m], on CANopen one per mille of the rated torque; None: ideal.
        torque_limit: Largest torque commanded [N or N*m]; None for none.

    Raises:
        ParameterError: `delay` is neither 0 nor 1, or a scale, quantum or limit is not positive.
    """

    plant: Plant
    controller_step: Callable[[float, float], Any]
    sample_time_ns: int
    delay: int = 0
    counts_per_unit: float | None = None
    torque_quantum: float | None = None
    torque_limit: float | None = None

    def __post_init__(self) -> None:
        if self.delay not in (0, 1):
            raise ParameterError(f"delay: got {self.delay}, expected 0 (event RPDO) or 1 (synchronous RPDO)")
        for name in ("counts_per_unit", "torque_quantum", "torque_limit"):
            if (value := getattr(self, name)) is not None and not value > 0.0:
                raise ParameterError(f"{name}: got {value}, expected > 0, or None for an ideal one")

    def run(self, cycles: int) -> DirectRecord:
        """Run SYNC 0 .. cycles-1 from the plant's initial state and return the record."""
        flat = array("d")
        plant, counts, quantum, limit = self.plant, self.counts_per_unit, self.torque_quantum, self.torque_limit
        plant.begin(0)
        held = waiting = 0.0
        for k in range(cycles):
            if k:
                plant.advance_to(k * self.sample_time_ns, held)
            position = plant.encoder_position
            if counts is not None:
                position = round(position * counts) * (1.0 / counts)
            command = self.controller_step(position, held).torque
            if limit is not None and abs(command) > limit:  # false of NaN, which stays to be seen
                command = limit if command > 0.0 else -limit
            flat.extend((position, plant.position, command, held))
            quantised = command if quantum is None else round(command / quantum) * quantum
            held, waiting = (waiting, quantised) if self.delay else (quantised, 0.0)
        rows = np.array(flat).reshape(cycles, 4).T.copy()
        return DirectRecord(rows[0], rows[1], rows[2], rows[3], plant.energy())


PlantOf: TypeAlias = Callable[[AccuracyParameters, int], Plant]
"""(accuracy, sample time [ns]) -> plant before `begin`."""
_BITS_COARSER: Final = 6
_FLOOR: Final = 1e-9
"""Fraction of the travel below which differences show no order."""
_COARSE: Final = 0.03
"""Fraction of the travel: at larger differences of halved steps the order is not reliable."""
_DETENTS: Final = 6.0
"""Detents passed in a substep from which half and a third of the substep may both pass whole numbers of detents."""
_SUSPECT: Final = 1e3
"""Multiple of the event bracket: a larger difference of halved steps has another cause."""


class ErrorEstimate(NamedTuple):
    """Estimated largest error of the position at any SYNC."""

    size: float  # [m or rad]
    travel: float  # of the position over the same periods [m or rad]
    doubt: str = ""  # why the estimate is not reliable; empty if it is


def estimated_error(
    plant_of: PlantOf, accuracy: AccuracyParameters, order: int, torques: Sequence[float], sample_time_ns: int
) -> ErrorEstimate | None:
    """Return the estimated largest error of the position at any SYNC; None if the plant is exact to rounding.

    Args:
        plant_of: Makes the plant at another accuracy and sample time.
        accuracy: Accuracy to estimate.
        order: Least order in the substep that a part of the plant declares.
        torques: Torque of each hold [N or N*m].
        sample_time_ns: Length of a hold [ns].
    """
    plant = plant_of(accuracy, sample_time_ns)
    switches = any(part.has_guards for part in plant.scene.parts)
    if plant.is_exact and not switches:
        return None
    runs = _Runs(plant_of, torques, sample_time_ns)
    travel = max(float(np.ptp(runs.of(accuracy))), 1e-12)
    step = runs.between(accuracy, 1, 2)
    bracket = _bracket_error(runs, accuracy) if switches else 0.0
    if plant.is_exact:
        doubt = _moved(step, travel) if step > _SUSPECT * max(bracket, _FLOOR * travel) else ""
        return ErrorEstimate(max(bracket, 2.0 * step), travel, doubt)
    passed, pitches = 0.0, [float(of.pitch) for of in plant.effects if hasattr(of, "pitch")]
    if pitches:  # over whole detents halves show nothing: thirds do, up to six of them
        step = max(step, runs.between(accuracy, 1, 3))
        passed = float(np.abs(np.diff(runs.of(accuracy))).max(initial=0.0)) / accuracy.substeps / min(pitches)
    error = step * 2.0**order / (2.0**order - 1.0) + bracket
    slow = step > _FLOOR * travel and runs.between(accuracy, 2, 4) > step * 2.0 ** (-0.5 * order)
    doubt = f"{_moved(step, travel)}; raise accuracy.substeps" if slow or step > _COARSE * travel else ""
    if passed >= _DETENTS:
        doubt = f"a substep passes {passed:.2g} detents, in which no error shows; raise accuracy.substeps"
    return ErrorEstimate(error, travel, doubt)


def _moved(step: float, travel: float) -> str:
    return f"halving the steps moves the position by {100.0 * step / travel:.2g} % of its travel"


class _Runs:
    """Positions at the SYNCs for one torque history, with several accuracies and step lengths."""

    def __init__(self, plant_of: PlantOf, torques: Sequence[float], sample_time_ns: int) -> None:
        self._plant_of, self._torques, self._period = plant_of, torques, sample_time_ns
        self._found: dict[tuple[AccuracyParameters, int], Array] = {}

    def of(self, accuracy: AccuracyParameters, finer: int = 1) -> Array:
        """Return the positions of a plant whose sample time and substeps are `finer` times shorter."""
        key = (accuracy, finer)
        if key not in self._found:
            plant = self._plant_of(accuracy, max(1, self._period // finer))
            self._found[key] = observed(plant, self._torques, self._period).position
        return self._found[key]

    def between(self, accuracy: AccuracyParameters, one: int, other: int) -> float:
        """Return the largest difference between two step lengths [m or rad]."""
        return float(np.abs(self.of(accuracy, one) - self.of(accuracy, other)).max())


def _bracket_error(runs: _Runs, accuracy: AccuracyParameters) -> float:
    """Return the position error due to the bracket of events, which halves with every bit [m or rad]."""
    less = max(1, accuracy.event_bits - _BITS_COARSER)
    more = accuracy.event_bits + _BITS_COARSER if accuracy.event_bits == less else less
    factor = 2.0 ** abs(accuracy.event_bits - more)
    other = runs.of(accuracy.model_copy(update={"event_bits": more}))
    apart = float(np.abs(other - runs.of(accuracy)).max())
    return apart / (factor - 1.0) if more < accuracy.event_bits else apart * factor / (factor - 1.0)
