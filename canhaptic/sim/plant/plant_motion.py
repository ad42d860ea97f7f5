"""Motion of a plant under given torques: its state and works at the end of every hold."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from canhaptic.sim.plant.plant import Plant
from canhaptic.sim.plant.propagator import Array


class Motion(NamedTuple):
    """Shapes (n_holds,)."""

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
