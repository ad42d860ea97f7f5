"""Dry friction with stiction: its two levels, and the part that holds a body still or slides on it.

Sticking is a mode of its own instead of a steep slope, which creeps (Karnopp, ASME J. Dynamic Systems 107, 1985).
"""

from collections.abc import Sequence
from typing import Annotated, Self

import numpy as np
from pydantic import model_validator

from canhaptic.sim.plant.assembly import MOTOR, Guard, Part, PlantModel, Rows
from canhaptic.units import Parameters, quantity


class DryFriction(Parameters):
    """Dry friction with stiction: a sliding level and a breakaway level."""

    kinetic: Annotated[float, quantity("N", "N*m", gt=0.0, le=1e6)]
    """Friction while it slides; of a fast slide, where it depends on the velocity."""
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
        velocity: Velocity at the start, for the first mode.
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
        """Add the friction of a sliding mode."""
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
