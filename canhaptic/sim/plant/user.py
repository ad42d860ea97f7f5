"""The human at the handle: an impedance (stiffness, damping) between a voluntary motion and the handle.

Hand force on the handle: K (x_u - q) + D (v_u - v) + push, with x_u the voluntary motion. A sinusoid enters the plant
as two states of a harmonic oscillator, so that hand and plant together stay exactly linear. Hogan, "Impedance control",
ASME J. Dynamic Systems 107, 1985, for the model; grips measured on hands: 100..1000 N/m, 1..10 N*s/m.
"""

import math
from typing import Annotated, Final, Literal

from pydantic import model_validator

from canhaptic.sim.plant.assembly import Part, PlantModel, Rows
from canhaptic.units import Parameters, quantity

_HAND: Final = "hand"
"""Name of the hand's part and of its work."""


class SinusoidMotion(Parameters):
    """Voluntary motion x_u(t) = offset + amplitude * sin(2 pi frequency t + phase), t from the start of the plant."""

    type: Literal["sinusoid"] = "sinusoid"
    amplitude: Annotated[float, quantity("m", "rad", ge=0.0, le=1e3)]
    """Half of the way from end to end."""
    frequency: Annotated[float, quantity("Hz", gt=0.0, le=1e3)]
    """Cycles per second."""
    phase: Annotated[float, quantity("rad", ge=-10.0, le=10.0)] = 0.0
    """At the start of the plant."""
    offset: Annotated[float, quantity("m", "rad", ge=-1e3, le=1e3)] = 0.0
    """Middle of the motion."""

    def position(self, time: float) -> float:
        """Return x_u [m or rad] at `time` [s]."""
        return self.offset + self.amplitude * math.sin(2.0 * math.pi * self.frequency * time + self.phase)


class UserParameters(Parameters):
    """The hand; every part is absent unless given."""

    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e8)] = 0.0
    """Stiffness of the hand's grip, between voluntary motion and handle."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e6)] = 0.0
    """Damping of the hand's grip."""
    push: Annotated[float, quantity("N", "N*m", ge=-1e6, le=1e6)] = 0.0
    """Constant force of the hand, towards +q."""
    rest: Annotated[float, quantity("m", "rad", ge=-1e3, le=1e3)] = 0.0
    """Where the hand's spring is at rest; the motion comes on top of it."""
    motion: SinusoidMotion | None = None
    """Voluntary motion, which the handle follows through the grip; None: the hand stays at `rest`."""

    @model_validator(mode="after")
    def _motion_reaches_the_handle(self) -> "UserParameters":
        if self.motion and self.stiffness == 0.0 and self.damping == 0.0:
            raise ValueError("motion without a hand: stiffness and damping are 0, expected one > 0")
        return self

    def add_to(self, scene: PlantModel) -> None:
        """Add the hand, when there is one, at the last body of the scene."""
        if self.stiffness or self.damping or self.push:
            Hand(self).add_to(scene)


class Hand(Part):
    """The force of the hand on the handle, with one mode per grasp."""

    def __init__(self, user: UserParameters) -> None:
        self.name, self.modes = _HAND, ("grasp_0",)
        self._user = user
        self._grasps = [(user.stiffness, user.damping)]
        self._targets: list[tuple[str, float, float]] = []  # (name, amplitude, angular frequency)

    @property
    def _rest(self) -> float:
        return self._user.rest + (self._user.motion.offset if self._user.motion else 0.0)

    def add_to(self, scene: PlantModel) -> None:
        """Add the part, its work, and the oscillator of the voluntary motion."""
        user = self._user
        scene.works[_HAND] = "user"
        scene.parts.append(self)
        if user.stiffness or user.damping:
            scene.hand = self
        scene.deflection["one"] = -self._rest
        scene.deflection.update({name: factor for name, factor in scene.bodies[-1].position if name != "position"})
        if user.motion:
            omega = 2.0 * math.pi * user.motion.frequency
            self.follow(scene, "motion", user.motion.amplitude, omega, user.motion.phase)

    def follow(self, scene: PlantModel, name: str, amplitude: float, omega: float, phase: float) -> None:
        """Add a sinusoid to the voluntary motion of the hand, as two states of an oscillator."""
        scene.add_state(f"{name}_sine", math.sin(phase))
        scene.add_state(f"{name}_cosine", math.cos(phase))
        scene.deflection[f"{name}_sine"] = -amplitude
        self._targets.append((name, amplitude, omega))

    def add_grasp(self, stiffness: float, damping: float) -> str:
        """Return the mode of a further grasp."""
        self.modes += (f"grasp_{len(self._grasps)}",)  # in the order of time
        self._grasps.append((stiffness, damping))
        return self.modes[-1]

    def grasp(self, mode: str) -> tuple[float, float]:
        """Return stiffness and damping of a grasp."""
        return self._grasps[self.modes.index(mode)]

    def assemble(self, rows: Rows, mode: str) -> None:
        """Add the force on the handle, its work, and the oscillators."""
        stiffness, damping = self.grasp(mode)
        handle = len(rows.forces) - 1
        velocity = rows.velocity(handle)
        force = rows.row(one=stiffness * self._rest + self._user.push)
        force -= stiffness * rows.position(handle) + damping * velocity
        for name, amplitude, omega in self._targets:
            sine, cosine = f"{name}_sine", f"{name}_cosine"
            rows.set_rate(sine, rows.row(**{cosine: omega}))
            rows.set_rate(cosine, rows.row(**{sine: -omega}))
            force += rows.row(**{sine: stiffness * amplitude, cosine: damping * amplitude * omega})
        rows.forces[handle] += force
        rows.add_power(_HAND, force, velocity)
