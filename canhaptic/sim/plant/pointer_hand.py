"""A hand whose position is set from outside while the plant runs: by the pointer of `canhaptic touch`.

The position is a state that no force moves, so that the plant stays as exact as with any other hand.
`Plant.move_hand` sets it between two holds; until it is set again the hand stays where it is.
"""

from typing import Annotated

from canhaptic.sim.plant.assembly import PlantModel, Rows
from canhaptic.sim.plant.user import PLACE, Hand, UserParameters
from canhaptic.units import quantity


class PointerHand(UserParameters):
    """A grip on the handle at a position that is set from outside."""

    place: Annotated[float, quantity("m", "rad", ge=-1e3, le=1e3)] = 0.0
    """Where the hand is at the start."""

    def add_to(self, scene: PlantModel) -> None:
        """Add the hand and its position."""
        _PlacedHand(self).add_to(scene)
        scene.add_state(PLACE, self.place)
        scene.deflection[PLACE] = -1.0


class _PlacedHand(Hand):
    def assemble(self, rows: Rows, mode: str) -> None:
        """Add the force on the handle and its work."""
        stiffness, _ = self.grasp(mode)
        pull = rows.row(**{PLACE: stiffness})
        super().assemble(rows, mode)
        handle = len(rows.forces) - 1
        rows.forces[handle] += pull
        rows.add_power(self.name, pull, rows.velocity(handle))
