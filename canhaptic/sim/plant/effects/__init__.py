"""Simulated effects of the plant, one per file, and their table; an effect is imported only if a scene names it.

An effect is a frozen parameter model with `type` (its name in a scene) and `add_to(scene)`, which adds states, parts,
commands, encoders or efforts to a `canhaptic.sim.plant.assembly.PlantModel`.
"""

from typing import TYPE_CHECKING, ClassVar, Final, Protocol

if TYPE_CHECKING:
    from canhaptic.sim.plant.assembly import PlantModel

EFFECTS: Final[dict[str, str]] = {
    "backlash": "canhaptic.sim.plant.effects.backlash:Backlash",
    "cogging": "canhaptic.sim.plant.effects.cogging:Cogging",
    "coulomb_friction": "canhaptic.sim.plant.effects.coulomb_friction:CoulombFriction",
    "current_loop": "canhaptic.sim.plant.effects.current_loop:CurrentLoop",
    "encoder_noise": "canhaptic.sim.plant.effects.encoder_noise:EncoderNoise",
    "encoder_quantisation": "canhaptic.sim.plant.effects.encoder_quantisation:EncoderQuantisation",
    "grasp_change": "canhaptic.sim.plant.effects.grasp_change:GraspChange",
    "hard_stop": "canhaptic.sim.plant.effects.hard_stop:HardStop",
    "lugre_friction": "canhaptic.sim.plant.effects.lugre_friction:LuGreFriction",
    "shaft_compliance": "canhaptic.sim.plant.effects.shaft_compliance:ShaftCompliance",
    "stribeck_friction": "canhaptic.sim.plant.effects.stribeck_friction:StribeckFriction",
    "thermal_derating": "canhaptic.sim.plant.effects.thermal_derating:ThermalDerating",
    "torque_quantisation": "canhaptic.sim.plant.effects.torque_quantisation:TorqueQuantisation",
    "torque_ripple": "canhaptic.sim.plant.effects.torque_ripple:TorqueRipple",
    "torque_saturation": "canhaptic.sim.plant.effects.torque_saturation:TorqueSaturation",
    "tremor": "canhaptic.sim.plant.effects.tremor:Tremor",
    "viscous_friction": "canhaptic.sim.plant.effects.viscous_friction:ViscousFriction",
    "voltage_limit": "canhaptic.sim.plant.effects.voltage_limit:VoltageLimit",
}
"""Name in a scene -> "module:Class" of its frozen parameters."""


class Effect(Protocol):
    """Interface of every entry of `EFFECTS`."""

    @property
    def type(self) -> str:
        """Name of the effect in a scene."""

    order: ClassVar[int | None]
    """Order of the error in the substep; None when the effect is exact."""
    rank: ClassVar[int]
    """Effects are added in this order, then in the order of the scene."""

    def add_to(self, scene: "PlantModel") -> None:
        """Add the states, parts and forces of the effect to a plant.

        Raises:
            ParameterError: It needs another effect that is not there, or excludes one that is.
        """
