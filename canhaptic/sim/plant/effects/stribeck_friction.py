"""Stribeck friction: dry friction that falls from `static` to `kinetic` as the body begins to slide.

F = -[kinetic + (static - kinetic) exp(-(v / stribeck_velocity)^2)] sign(v); stuck up to `static`. The constant part
and stiction are modes of the exact core; the falling part is an effort of the mean velocity of a substep.
States added: none (travel and effort of the splitting). Order 2, sticking and breakaway included.
Energy: friction times path is dissipated. Typical stribeck velocity: 1..50 mm/s.
Source: Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994.
"""

from typing import Annotated, ClassVar, Literal

from canhaptic.sim.plant.assembly import MOTOR, Account, PlantModel
from canhaptic.sim.plant.dry_friction import DryFriction, StickSlip
from canhaptic.sim.plant.effort_forces import FALLING, Effort, falling_friction
from canhaptic.units import quantity


class StribeckFriction(DryFriction):
    """Dry friction with a falling characteristic; the cause of stick-slip."""

    order: ClassVar[int | None] = 2
    rank: ClassVar[int] = 1

    type: Literal["stribeck_friction"] = "stribeck_friction"
    stribeck_velocity: Annotated[float, quantity("m/s", "rad/s", gt=0.0, le=1e3)]
    """Velocity at which the friction has fallen by 63 % of the way from `static` to `kinetic`."""

    def add_to(self, scene: PlantModel) -> None:
        """Adds the modes of dry friction and the effort of the falling part."""
        scene.claim("friction model", self.type)
        scene.works[self.type] = "dissipated"
        velocity = scene.states[scene.bodies[MOTOR].velocity]
        scene.parts.append(StickSlip(self.type, self, velocity))
        scene.efforts.append(_FallingFriction(self))


class _FallingFriction:
    """The part of the friction that is gone once the body slides fast."""

    state_names: tuple[str, ...] = ()
    account: Account | None = "dissipated"

    def __init__(self, friction: StribeckFriction) -> None:
        self.effort = Effort(
            FALLING,
            kinetic=friction.kinetic,
            static=friction.static,
            stribeck_velocity=friction.stribeck_velocity,
        )

    def reset(self) -> None:
        """Keeps nothing."""

    def force(self, position: float, travel: float, duration: float, torque: float) -> float:
        """Returns the friction [N or N*m] at the mean velocity."""
        return falling_friction(self.effort, travel, duration)

    def commit(self, position: float, travel: float, duration: float, torque: float) -> None:
        """Keeps nothing."""

    def stored(self, position: float) -> float:
        """Returns 0."""
        return 0.0
