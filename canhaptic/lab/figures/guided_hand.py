"""A hand guided from outside: its position and its push change at rates that are set between two holds.

Place, speed, push and its rate are states that change linearly, so that the plant stays as exact as with any other
hand, with any effects; `Plant.set_states` changes them at a SYNC.
"""

from typing import Final

from canhaptic.sim.plant.assembly import PlantModel, Rows
from canhaptic.sim.plant.pointer_hand import PLACE, PointerHand
from canhaptic.sim.plant.user import Hand

SPEED: Final = "hand_speed"
"""State that is the speed of the place [m/s or rad/s]."""
PUSH: Final = "hand_push"
"""State that is the force of the hand besides its grip [N or N*m]."""
PUSH_RATE: Final = "hand_push_rate"
"""State that is the rate of that force [N/s or N*m/s]."""


class GuidedHand(PointerHand):
    """A grip on the handle and a push, both set from outside."""

    def add_to(self, scene: PlantModel) -> None:
        """Add the hand and its states."""
        _GuidedPart(self).add_to(scene)
        for name, initial in ((PLACE, self.place), (SPEED, 0.0), (PUSH, 0.0), (PUSH_RATE, 0.0)):
            scene.add_state(name, initial)
        scene.deflection[PLACE] = -1.0


class _GuidedPart(Hand):
    def assemble(self, rows: Rows, mode: str) -> None:
        """Add the force on the handle, its work, and the course of place and push."""
        stiffness, damping = self.grasp(mode)
        super().assemble(rows, mode)
        rows.set_rate(PLACE, rows.row(**{SPEED: 1.0}))
        rows.set_rate(PUSH, rows.row(**{PUSH_RATE: 1.0}))
        handle = len(rows.forces) - 1
        force = rows.row(**{PLACE: stiffness, SPEED: damping, PUSH: 1.0})
        rows.forces[handle] += force
        rows.add_power(self.name, force, rows.velocity(handle))
