"""Parts of a plant whose modes are states of contact: dry friction with stiction, and a one-sided contact.

Dry friction sticks or slides. Sticking is a separate mode instead of a steep slope, which would creep (Karnopp, ASME J.
Dynamic Systems 107, 1985).

A one-sided contact has springy, damped faces; the hard stop and each flank of backlash are such contacts. Touching:
force = stiffness * depth + damping * d(depth)/dt on both sides, and only while it pushes. Apart: no force; the dented
face recovers, d(depth)/dt = -stiffness / damping * depth (at once without damping), and contact begins where the faces
meet. So the contact never pulls and never creates energy; a spring-damper that is merely switched off does both (Hunt
and Crossley, ASME J. Applied Mechanics 42, 1975, whose remedy is not affine). Exact. Energy: stiffness depth^2 / 2
stored; damping dissipated, in both modes.
"""

from collections.abc import Sequence
from typing import Annotated, Self

import numpy as np
from pydantic import model_validator

from canhaptic.sim.plant.assembly import MOTOR, Guard, Part, PlantModel, Rows
from canhaptic.sim.plant.propagator import Array
from canhaptic.units import Parameters, quantity


class DryFriction(Parameters):
    """Dry friction with stiction: a sliding level and a breakaway level."""

    kinetic: Annotated[float, quantity("N", "N*m", gt=0.0, le=1e6)]
    """Sliding friction; if it depends on the velocity, its value at high velocity."""
    static: Annotated[float, quantity("N", "N*m", gt=0.0, le=1e6)]
    """Breakaway force; at least `kinetic`."""

    @model_validator(mode="after")
    def _static_is_not_below_kinetic(self) -> Self:
        if self.static < self.kinetic:
            raise ValueError(f"static {self.static} is below kinetic {self.kinetic}, expected static >= kinetic")
        return self

    def add_stick_slip(self, scene: PlantModel, name: str, body: int = MOTOR) -> None:
        """Add the part with its three modes, and its work."""
        scene.works[name] = "dissipated"
        scene.parts.append(StickSlip(name, self, scene.states[scene.bodies[body].velocity], body))


class StickSlip(Part):
    """Dry friction on a body as a part with a sliding and a breakaway level.

    Args:
        name: Name of the part and of its work.
        friction: Levels of the friction.
        velocity: Initial velocity, which selects the first mode.
        body: Index of the body.
    """

    has_guards = True

    def __init__(self, name: str, friction: DryFriction, velocity: float, body: int) -> None:
        self.name = name
        self._body = body
        self._kinetic, self._static = friction.kinetic, friction.static
        first = "stuck" if velocity == 0.0 else "forward" if velocity > 0.0 else "backward"
        self.modes = (first, *(mode for mode in ("stuck", "forward", "backward") if mode != first))

    def assemble(self, rows: Rows, mode: str) -> None:
        """Add the sliding friction if this mode slides."""
        if mode != "stuck":
            friction = rows.row(one=self._kinetic if mode == "forward" else -self._kinetic)
            rows.forces[self._body] -= friction
            rows.add_power(self.name, friction, rows.velocity(self._body))

    def constrain(self, rows: Rows, mode: str) -> None:
        """Hold the body while it is stuck: no acceleration; its velocity was reset to zero."""
        if mode == "stuck":
            rows.set_rate(rows.scene.bodies[self._body].velocity, np.zeros(rows.size))

    def guards(self, rows: Rows, mode: str) -> Sequence[Guard]:
        """Guards: breakaway when stuck, sticking when the velocity reverses."""
        velocity = rows.velocity(self._body)
        if mode == "stuck":
            force, static = rows.forces[self._body], rows.row(one=self._static)
            return Guard(static - force, "forward"), Guard(static + force, "backward")
        stop = ((rows.index[rows.scene.bodies[self._body].velocity], np.zeros(rows.size)),)
        return (Guard(velocity if mode == "forward" else -velocity, "stuck", stop),)


class Contact(Part):
    """A contact that closes where a distance, a weighted sum of positions, exceeds a limit.

    Args:
        name: Name of the part and of its work.
        sides: (body, factor): distance = sum of factor * position of body; the force on each body reduces it.
        limit: Distance at which the faces touch [m or rad].
        stiffness: Stiffness of the faces [N/m or N*m/rad].
        damping: Damping of the faces [N*s/m or N*m*s/rad].
    """

    modes: tuple[str, ...] = ("apart", "touching")
    has_guards = True

    def __init__(
        self, name: str, sides: Sequence[tuple[int, float]], limit: float, stiffness: float, damping: float
    ) -> None:
        self.name = name
        self.depth = f"{name}_depth"
        self._sides, self._limit = tuple(sides), limit
        self._stiffness, self._damping = stiffness, damping

    def add_to(self, scene: PlantModel) -> None:
        """Add the contact, its depth as a state, and its work to the plant."""
        scene.add_state(self.depth)
        scene.works[self.name] = "dissipated"
        scene.parts.append(self)

    def assemble(self, rows: Rows, mode: str) -> None:
        """Add the force when touching, and the recovery of the face when apart."""
        depth = rows.row(**{self.depth: 1.0})
        rows.add_storage(self._stiffness, depth)
        if mode == "touching":
            rate, force = self._approach(rows), self._force(rows)
            rows.set_rate(self.depth, rate)
            for body, factor in self._sides:
                rows.forces[body] -= factor * force
            rows.add_power(self.name, self._damping * rate, rate)
        elif self._damping > 0.0:
            rows.set_rate(self.depth, -self._stiffness / self._damping * depth)
            rows.add_power(self.name, self._stiffness**2 / self._damping * depth, depth)

    def guards(self, rows: Rows, mode: str) -> Sequence[Guard]:
        """Guards: separation at zero force, contact at zero gap."""
        index = rows.index[self.depth]
        beyond = sum((factor * rows.position(body) for body, factor in self._sides), -rows.row(one=self._limit))
        if mode == "touching":
            depth = beyond if self._damping > 0.0 else np.zeros(rows.size)  # where it is, but for gathered rounding
            return (Guard(self._force(rows), "apart", ((index, depth),)),)
        return (Guard(rows.row(**{self.depth: 1.0}) - beyond, "touching", ((index, beyond),)),)

    def _approach(self, rows: Rows) -> Array:
        return sum((factor * rows.velocity(body) for body, factor in self._sides), np.zeros(rows.size))

    def _force(self, rows: Rows) -> Array:
        return self._stiffness * rows.row(**{self.depth: 1.0}) + self._damping * self._approach(rows)
