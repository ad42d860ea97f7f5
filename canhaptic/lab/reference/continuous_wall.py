"""The continuous environment rendered to the same user and plant: the reference for every sampled algorithm.

No sampling, no encoder, no torque limit. Environments that are piecewise affine become a part of the exact machine of
`canhaptic.sim` (crossings bracketed to a tick); the others are integrated by DOP853 (`textbook_environment`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from canhaptic.control.environments.coulomb_surface import CoulombSurface
from canhaptic.control.environments.damper_wall import DamperWall
from canhaptic.control.environments.environment import Environment
from canhaptic.control.environments.free_space import FreeSpace
from canhaptic.control.environments.hardening_wall import HardeningWall
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.environments.two_sided_wall import TwoSidedWall
from canhaptic.control.environments.viscoelastic_medium import ViscoelasticMedium
from canhaptic.control.environments.viscous_medium import ViscousMedium
from canhaptic.lab.reference.textbook_environment import surfaces
from canhaptic.sim.plant.assembly import MOTOR, Guard, LinearPart, Part, PlainPart, PlantModel, Rows
from canhaptic.sim.plant.effects import Effect
from canhaptic.sim.plant.propagator import Array


def continuous_effect(environment: Environment) -> Effect | None:
    """Return the environment as an exact effect of a plant; None when it is not piecewise affine.

    Raises:
        InputError: There are no equations for an environment of this class; a subclass may differ in anything.
    """
    surfaces(environment)
    if isinstance(environment, HardeningWall) and environment.linear_stiffness is not None:
        environment = SpringDamperWall(**environment.model_dump(exclude={"hardening"}))
    if isinstance(environment, SpringDamperWall | DamperWall):
        below, stiffness = environment.side == "below", environment.linear_stiffness
        return _effect([_Wall("wall", environment.position, below, stiffness, environment.damping)])
    if isinstance(environment, TwoSidedWall):
        k, d = environment.stiffness, environment.damping
        lower, upper = environment.lower, environment.upper
        return _effect([_Wall("lower_wall", lower, True, k, d), _Wall("upper_wall", upper, False, k, d)])
    if isinstance(environment, ViscousMedium):
        return _effect([_medium(environment.damping)])
    if isinstance(environment, ViscoelasticMedium):
        return _effect([_maxwell(environment)], "strain")
    if isinstance(environment, CoulombSurface):
        return _effect([_PrandtlElement(environment)], "strain")
    return _effect([]) if isinstance(environment, FreeSpace) else None


@dataclass(frozen=True, slots=True)
class _ContinuousEffect:
    """Parts that are added to a plant like those of an effect named in a scene."""

    order: ClassVar[int | None] = None
    rank: ClassVar[int] = 1
    type: ClassVar[str] = "continuous_environment"

    parts: tuple[Part, ...]
    state: str | None

    def add_to(self, scene: PlantModel) -> None:
        """Add the parts, the state they share, and the work they dissipate."""
        if self.state is not None:
            scene.add_state(self.state)
        for part in self.parts:
            scene.works[part.name] = "dissipated"
            scene.parts.append(part)


def _effect(parts: Sequence[Part], state: str | None = None) -> Effect:
    return _ContinuousEffect(tuple(parts), state)


class _Wall(PlainPart):
    """Spring and damper beyond a surface, exactly as in eq. 12: the damper resists until the surface is passed.

    Args:
        name: Name of the part and of its work.
        surface: Position of the surface [m or rad].
        below: Whether it is solid below the surface.
        stiffness: Stiffness of the spring [N/m or N*m/rad].
        damping: Damping of the damper [N*s/m or N*m*s/rad].
    """

    modes: tuple[str, ...] = ("outside", "inside")
    has_guards = True

    def __init__(self, name: str, surface: float, below: bool, stiffness: float, damping: float) -> None:
        self.name = name
        self._surface, self._sign = surface, -1.0 if below else 1.0
        self._stiffness, self._damping = stiffness, damping

    def assemble(self, rows: Rows, mode: str) -> None:
        """Add force, stored energy and losses of contact."""
        if mode == "inside":
            depth, velocity = self._depth(rows), rows.velocity(MOTOR)
            rows.forces[MOTOR] -= self._stiffness * depth + self._damping * velocity
            rows.add_storage(self._stiffness, depth)
            rows.add_power(self.name, self._damping * velocity, velocity)

    def guards(self, rows: Rows, mode: str) -> Sequence[Guard]:
        """Guard: crossing of the surface."""
        beyond = self._sign * self._depth(rows)
        return (Guard(-beyond, "inside") if mode == "outside" else Guard(beyond, "outside"),)

    def _depth(self, rows: Rows) -> Array:
        return rows.position(MOTOR) - rows.row(one=self._surface)


class _PrandtlElement(PlainPart):
    """Prandtl's element: a spring between axis and ground that slides at its limit."""

    modes: tuple[str, ...] = ("elastic", "forward", "backward")
    has_guards = True

    def __init__(self, surface: CoulombSurface) -> None:
        self.name = "bristle"
        self._surface = surface

    def assemble(self, rows: Rows, mode: str) -> None:
        """Add force, strain and losses; a sliding bristle keeps its strain."""
        surface, velocity, strain = self._surface, rows.velocity(MOTOR), rows.row(strain=1.0)
        effort = surface.stiffness * strain
        rows.forces[MOTOR] -= effort + surface.damping * velocity
        rows.add_storage(surface.stiffness, strain)
        rows.add_power(self.name, surface.damping * velocity, velocity)
        if mode == "elastic":
            rows.set_rate("strain", velocity)
        else:
            rows.add_power(self.name, effort, velocity)

    def guards(self, rows: Rows, mode: str) -> Sequence[Guard]:
        """Guards: yielding when elastic, the reversal when sliding."""
        if mode == "elastic":
            limit = rows.row(one=self._surface.friction / self._surface.stiffness)
            strain, place = rows.row(strain=1.0), rows.index["strain"]
            return (
                Guard(limit - strain, "forward", ((place, limit),)),
                Guard(limit + strain, "backward", ((place, -limit),)),
            )
        velocity = rows.velocity(MOTOR)
        return (Guard(velocity if mode == "forward" else -velocity, "elastic"),)


def _medium(damping: float) -> Part:
    def write(rows: Rows) -> None:
        velocity = rows.velocity(MOTOR)
        rows.forces[MOTOR] -= damping * velocity
        rows.add_power("medium", damping * velocity, velocity)

    return LinearPart("medium", write)


def _maxwell(medium: ViscoelasticMedium) -> Part:
    def write(rows: Rows) -> None:
        velocity, strain = rows.velocity(MOTOR), rows.row(strain=1.0)
        slip = strain / medium.relaxation_time
        rows.forces[MOTOR] -= medium.stiffness * strain + medium.damping * velocity
        rows.set_rate("strain", velocity - slip)
        rows.add_storage(medium.stiffness, strain)
        rows.add_power("medium", medium.damping * velocity, velocity)
        rows.add_power("medium", medium.stiffness * strain, slip)

    return LinearPart("medium", write)
