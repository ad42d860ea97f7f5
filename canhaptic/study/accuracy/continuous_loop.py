"""The reference of the loop side: the continuous environment on the textbook plant, by event-located DOP853.

Independent of the sampled loop and of the plant's own stepper alike.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from canhaptic.control.environments.coulomb_surface import CoulombSurface
from canhaptic.control.environments.environment import Environment
from canhaptic.control.environments.viscoelastic_medium import ViscoelasticMedium
from canhaptic.scene.accuracy_choice import simulation_of, textbook_model
from canhaptic.scene.models import AxisScene
from canhaptic.sim.plant.propagator import Array
from canhaptic.sim.textbook.event_location import located_states
from canhaptic.sim.textbook.reference_elements import POSITION, VELOCITY, Floats, Transition
from canhaptic.sim.textbook.reference_model import Model
from canhaptic.study.reference.continuous_ode import surfaces
from canhaptic.study.scenes import environment_of

_TOLERANCE: Final = 1e-11
_ROUNDING: Final = 1e-12  # [m or rad]


class ContinuousLoop(NamedTuple):
    """The continuous axis at every `step_ns`, shapes (steps + 1,)."""

    step_ns: int
    position: Array  # [m or rad]
    impulse: Array  # of the environment's force since the start [N*s or N*m*s]
    interaction: Array  # energy into the environment since the start [J]


def continuous_loop(
    axis: AxisScene, step_ns: int, steps: int, stop: Callable[[], bool] | None = None
) -> ContinuousLoop:
    """Returns what the user would feel without sampling.

    Args:
        axis: Its environment, plant, user and effects.
        step_ns: Time between two readings [ns].
        steps: Readings after the first.
        stop: Asked now and then whether to give up.

    Raises:
        InputError: scipy is missing, the solver fails, or it was stopped.
    """
    model = textbook_model(simulation_of(axis))
    force = EnvironmentForce(environment_of(axis), model)
    model.add(force)
    states = located_states(model, [0.0] * steps, step_ns, "DOP853", _TOLERANCE, 1e-14, stop)
    table = np.array([model.start, *states])
    return ContinuousLoop(step_ns, table[:, POSITION], table[:, force.impulse], table[:, force.interaction])


class EnvironmentForce:
    """The environment as an element of the textbook plant; books its impulse and the energy it takes."""

    def __init__(self, environment: Environment, model: Model) -> None:
        self._environment = environment
        self.impulse, self.interaction = model.add_state("impulse"), model.add_state("interaction")
        self._strain = model.add_state("strain") if environment.relaxes else -1
        self._surfaces = surfaces(environment)
        start = model.start[POSITION]
        if isinstance(environment, CoulombSurface):
            self.modes: tuple[str, ...] = ("elastic", "forward", "backward")
        elif self._surfaces:
            zone = str(environment.contact(start))
            self.modes = (zone, *(z for z in ("0", "1", "2") if z != zone))
        else:
            self.modes = ("only",)

    def apply(self, time: float, state: Any, mode: str, forces: Floats, rates: Floats) -> None:
        """Adds the force of the environment, its power, and the rate of its strain."""
        velocity = float(state[VELOCITY])
        force = 0.0 if mode == "0" else self._force(state, mode, velocity, rates)
        forces[0] += force
        rates[self.impulse] = force
        rates[self.interaction] = -force * velocity

    def ways(self, index: int, mode: str) -> Sequence[Transition]:
        """Returns crossing of the surfaces, yielding, or the reversal of what yields."""
        if isinstance(self._environment, CoulombSurface):
            return self._yielding(index, mode, self._environment.friction / self._environment.stiffness)
        if mode == "only":
            return ()
        found = []
        for surface in self._surfaces:
            for zone in {self._zone(surface, -1.0), self._zone(surface, 1.0)} - {mode}:
                if mode in (self._zone(surface, -1.0), self._zone(surface, 1.0)):
                    sign = -1.0 if zone == self._zone(surface, 1.0) else 1.0
                    found.append(Transition(index, zone, _distance(surface, sign), _ROUNDING))
        return found

    def _zone(self, surface: float, side: float) -> str:
        return str(self._environment.contact(math.nextafter(surface, side * math.inf)))

    def _force(self, state: Any, mode: str, velocity: float, rates: Floats) -> float:
        environment, damper = self._environment, -self._environment.damping * velocity
        if isinstance(environment, CoulombSurface):
            strain = float(state[self._strain])
            rates[self._strain] = velocity if mode == "elastic" else 0.0
            return damper - environment.effort(strain)
        if isinstance(environment, ViscoelasticMedium):
            strain = float(state[self._strain])
            rates[self._strain] = velocity - strain / environment.relaxation_time
            return damper - environment.effort(strain)
        place = float(state[POSITION])
        for surface in self._surfaces if mode != "only" else ():  # rounding may have it on the wrong side
            if mode == self._zone(surface, 1.0) != self._zone(surface, -1.0):
                place = max(place, math.nextafter(surface, math.inf))
            elif mode == self._zone(surface, -1.0) != self._zone(surface, 1.0):
                place = min(place, math.nextafter(surface, -math.inf))
        return damper - environment.effort(environment.true_state(place, 0.0, 0.0))

    def _yielding(self, index: int, mode: str, limit: float) -> Sequence[Transition]:
        strain = self._strain

        def at(value: float) -> Callable[[Floats], None]:
            def reset(state: Floats) -> None:
                state[strain] = value

            return reset

        if mode == "elastic":
            return (
                Transition(index, "forward", lambda t, y, u: limit - float(y[strain]), _ROUNDING, at(limit)),
                Transition(index, "backward", lambda t, y, u: limit + float(y[strain]), _ROUNDING, at(-limit)),
            )
        sign = 1.0 if mode == "forward" else -1.0
        return (Transition(index, "elastic", lambda t, y, u: sign * float(y[VELOCITY]), _ROUNDING),)


def _distance(surface: float, sign: float) -> Callable[[float, Any, float], float]:
    """Returns what falls through zero where the axis crosses the surface towards -sign."""

    def distance(_time: float, state: Any, _torque: float) -> float:
        return sign * (float(state[POSITION]) - surface)

    return distance
