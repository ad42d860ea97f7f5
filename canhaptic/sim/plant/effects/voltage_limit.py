"""Voltage limit: the drive cannot drive the current faster, or against a higher back-EMF, than its supply allows.

    voltage = resistance i + inductance di/dt + back_emf v,   |voltage| <= supply,   torque = back_emf i

Within the supply the current follows as in `current_loop`; at the supply it follows the winding's own equation. In SI
the torque per ampere equals the back-EMF per unit of speed. Above the speed supply / back_emf the motor always brakes.
Needs `current_loop`. States added: none (3 modes). Exact. Energy: motor work uses the true torque.
Typical: 24..48 V, 0.05..5 ohm, 0.05..5 mH. Source: Leonhard, "Control of Electrical Drives", 2001, ch. 5 and 7.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Literal

from canhaptic.errors import ParameterError
from canhaptic.sim.plant.assembly import MOTOR, EffectParameters, Guard, Part, PlantModel, Rows
from canhaptic.sim.plant.propagator import Array
from canhaptic.units import quantity


class VoltageLimit(EffectParameters):
    """A supply that limits the voltage of the winding."""

    type: Literal["voltage_limit"] = "voltage_limit"
    supply: Annotated[float, quantity("V", gt=0.0, le=1e6)]
    """Largest voltage of the drive at the winding."""
    back_emf: Annotated[float, quantity("V*s/m", "V*s/rad", gt=0.0, le=1e6)]
    """Back-EMF per unit of speed; the torque per ampere is the same number."""
    resistance: Annotated[float, quantity("ohm", gt=0.0, le=1e6)]
    """Resistance of the winding."""
    inductance: Annotated[float, quantity("H", gt=0.0, le=1e3)]
    """Inductance of the winding."""

    def add_to(self, scene: PlantModel) -> None:
        """Add the modes with the voltage at the supply limit.

        Raises:
            ParameterError: There is no current loop.
        """
        if "current loop" not in scene.slots:
            raise ParameterError("voltage_limit: got no current_loop, expected one; add it: it sets the current's lag")
        scene.claim("voltage limit", self.type)
        scene.parts.append(_Winding(self))

    def slowest_lag(self, time_constant: float, torque: float, speed: float) -> float:
        """Return the largest time constant [s] of the torque; infinite if the torque may not follow at all.

        With the voltage that remains, w = supply - resistance i - back_emf v, the torque changes at the rate back_emf w
        / inductance; a step of the torque is at most 2 `torque`.

        Args:
            time_constant: Time constant of the current loop [s].
            torque: Largest requested torque [N or N*m].
            speed: Largest speed [m/s or rad/s].
        """
        rest = self.supply - self.resistance * torque / self.back_emf - self.back_emf * speed
        steep = 2.0 * torque * self.inductance
        return max(time_constant, steep / (self.back_emf * rest)) if rest > 0.0 else math.inf


class _Winding(Part):
    """The winding: within the supply, at it, or at its negative."""

    name = "voltage_limit"
    modes: tuple[str, ...] = ("within", "upper", "lower")
    has_guards = True

    def __init__(self, limit: VoltageLimit) -> None:
        self._limit = limit

    def assemble(self, rows: Rows, mode: str) -> None:
        """Keep the rate of the current loop; at the supply limit, replace it by that of the winding."""
        p, current = self._limit, rows.row(motor_torque=1.0)
        back = p.back_emf * rows.velocity(MOTOR)
        self._wanted: Array = rows.rates[rows.index["motor_torque"]].copy()
        self._voltage = (p.resistance * current + p.inductance * self._wanted) / p.back_emf + back
        if mode != "within":
            supply = rows.row(one=p.supply if mode == "upper" else -p.supply)
            rows.set_rate("motor_torque", (p.back_emf * (supply - back) - p.resistance * current) / p.inductance)

    def guards(self, rows: Rows, mode: str) -> Sequence[Guard]:
        """Guards: the requested voltage exceeds the supply, or returns below it."""
        supply, voltage = rows.row(one=self._limit.supply), self._voltage
        if mode == "within":
            return Guard(supply - voltage, "upper"), Guard(supply + voltage, "lower")
        return (Guard((voltage if mode == "upper" else -voltage) - supply, "within"),)
