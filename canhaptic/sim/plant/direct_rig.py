"""A plant and a controller in one loop without a bus: for sweeps, the accuracy study, and as a check of the CAN path.

With the same quantisation (encoder counts, torque quantum) it gives the same floats as the path over the bus:

    delay 0  the torque computed from q(k) acts from SYNC k (event RPDO in lock-step)
    delay 1  it acts from SYNC k+1 (synchronous RPDO)

`observed` returns the motion of a plant under given torques.
"""

from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from canhaptic.errors import ParameterError
from canhaptic.signals import PlantEnergy
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
