"""Current loop: the motor's torque follows the held torque with a first-order lag.

    d(tau)/dt = (held - tau) / time_constant

`time_constant` is L / R of the winding, or the closed current loop's. States added: motor_torque. Exact for any ratio
of sample time to time constant. Energy: motor work uses the true torque. Typical: 50 us .. 1 ms.
Source: Hanselman, "Brushless Permanent Magnet Motor Design", 2003; Leonhard, "Control of Electrical Drives", 2001.
"""

from typing import Annotated, Literal

from canhaptic.sim.plant.assembly import EffectParameters, LinearPart, PlantModel, Rows
from canhaptic.units import quantity


class CurrentLoop(EffectParameters):
    """A first-order lag between the held torque and the motor."""

    rank = 0
    type: Literal["current_loop"] = "current_loop"
    time_constant: Annotated[float, quantity("s", ge=1e-6, le=1.0)]
    """Time constant of the winding, L / R, or of the closed current loop."""

    def add_to(self, scene: PlantModel) -> None:
        """Add the torque of the motor as a state."""
        scene.claim("current loop", self.type)
        scene.add_state("motor_torque")
        scene.motor_torque = "motor_torque"
        scene.parts.append(LinearPart(self.type, self._write))

    def _write(self, rows: Rows) -> None:
        rate = 1.0 / self.time_constant
        rows.set_rate("motor_torque", rows.row(torque=rate, motor_torque=-rate))
