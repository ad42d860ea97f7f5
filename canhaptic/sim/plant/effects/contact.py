"""A one-sided contact of springy, damped faces, used by the hard stop and by each flank of backlash.

Two modes. Touching: force = stiffness * depth + damping * d(depth)/dt on both sides, and only while it pushes. Apart:
no force; the dented face creeps back, d(depth)/dt = -stiffness / damping * depth (at once without damping), and contact
comes again where the faces meet. So it never pulls and never creates energy, which a spring-damper that is merely
switched off does (Hunt and Crossley, ASME J. Applied Mechanics 42, 1975, discuss the fault; their cure is not affine).
Exact. Energy: stiffness depth^2 / 2 stored; damping dissipated, in both modes.
"""

from collections.abc import Sequence

import numpy as np

from canhaptic.sim.plant.assembly import Guard, Part, PlantModel, Rows
from canhaptic.sim.plant.propagator import Array


class Contact(Part):
    """Contact where a distance, a sum of positions, exceeds a limit.

    Args:
        name: Name of the part and of its work.
        sides: (body, factor): distance = sum of factor * position of body; the force acts on each body against it.
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
