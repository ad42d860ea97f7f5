"""Thermal derating: the winding warms with torque squared; from `warm` to `hot` the largest torque falls to 0.

    time_constant dT/dt = thermal_resistance * copper_loss * torque^2 - (T - ambient)

States added: winding_temperature. Exact under a held torque; the limit is taken at the start of each hold (order 1 in
the sample time), and with a current loop the heating follows the held torque. Energy: copper loss is electrical,
no part of the mechanical balance. Typical: 0.5..5 K/W, 10..1000 s. Source: IEC 60034-11; Leonhard,
"Control of Electrical Drives", 2001, ch. 4.
"""

import math
from typing import Annotated, Literal

from pydantic import model_validator

from canhaptic.sim.plant.assembly import EffectParameters, PlantModel, TorqueCommand
from canhaptic.units import quantity


class ThermalDerating(EffectParameters):
    """A winding with thermal protection."""

    order = 1
    type: Literal["thermal_derating"] = "thermal_derating"
    torque_limit: Annotated[float, quantity("N", "N*m", gt=0.0, le=1e6)]
    """Largest torque of the cold winding."""
    copper_loss: Annotated[float, quantity("W/N^2", "W/N^2/m^2", gt=0.0, le=1e9)]
    """Heat per torque squared [W/N^2 or W/(N*m)^2]."""
    thermal_resistance: Annotated[float, quantity("K/W", gt=0.0, le=1e6)]
    """Thermal resistance from the winding to its surroundings."""
    time_constant: Annotated[float, quantity("s", gt=0.0, le=1e6)]
    """Time constant of the winding's warming and cooling."""
    ambient: Annotated[float, quantity("K", ge=0.0, le=1e4)] = 293.15
    """Ambient temperature, at which the winding starts."""
    warm: Annotated[float, quantity("K", ge=0.0, le=1e4)] = 373.15
    """Temperature from which the limit falls."""
    hot: Annotated[float, quantity("K", ge=0.0, le=1e4)] = 403.15
    """Temperature at which the limit is 0; more than `warm`."""

    @model_validator(mode="after")
    def _hot_is_above_warm(self) -> "ThermalDerating":
        if self.hot <= self.warm:
            raise ValueError(f"hot {self.hot} K is not above warm {self.warm} K, expected hot > warm")
        return self

    def add_to(self, scene: PlantModel) -> None:
        """Add the temperature-dependent limit of the torque."""
        scene.claim("thermal derating", self.type)
        scene.commands.append(_Winding(self))


class _Winding(TorqueCommand):
    """The winding's temperature and the torque that it allows."""

    state_names: tuple[str, ...] = ("winding_temperature",)

    def __init__(self, derating: ThermalDerating) -> None:
        self._derating = derating
        self.reset()

    def reset(self) -> None:
        """Cool down to ambient."""
        self.temperature = self._derating.ambient

    def apply(self, torque: float, duration: float) -> float:
        """Torque within the present limit of the winding [N or N*m]; heats the winding for the hold."""
        p = self._derating
        allowed = p.torque_limit * min(max((p.hot - self.temperature) / (p.hot - p.warm), 0.0), 1.0)
        torque = min(max(torque, -allowed), allowed)
        final = p.ambient + p.thermal_resistance * p.copper_loss * torque * torque
        self.temperature += (final - self.temperature) * -math.expm1(-duration / p.time_constant)
        return torque
