"""The continuous environment on the textbook plant, by event-located DOP853; needs extra `study`.

Independent of the sampled loop and of the plant's own stepper. It takes every effect and environment for which there
are equations, and refuses the others.
"""

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np

from canhaptic.control.environments.coulomb_surface import CoulombSurface
from canhaptic.control.environments.damper_wall import DamperWall
from canhaptic.control.environments.detents import Detents
from canhaptic.control.environments.environment import Environment
from canhaptic.control.environments.free_space import FreeSpace
from canhaptic.control.environments.hardening_wall import HardeningWall
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.environments.two_sided_wall import TwoSidedWall
from canhaptic.control.environments.viscoelastic_medium import ViscoelasticMedium
from canhaptic.control.environments.viscous_medium import ViscousMedium
from canhaptic.errors import InputError
from canhaptic.lab.judge.event_location import states_at
from canhaptic.lab.judge.reference_elements import POSITION, VELOCITY, Floats, State, Transition
from canhaptic.lab.judge.reference_model import Model
from canhaptic.sim.plant.propagator import Array

_ROUNDING: Final = 1e-12  # [m or rad]
_BETWEEN_EVENTS: Final = 2.5e-4
"""Step at whose ends friction, stops and flanks are looked at [s]."""
_BETWEEN_SURFACES: Final = 2e-3
"""The same where nothing but the environment switches: a handle crosses a surface and returns in no less [s]."""
_SURFACES: Final[dict[type, tuple[str, ...]]] = {
    SpringDamperWall: ("position",),
    HardeningWall: ("position",),
    DamperWall: ("position",),
    TwoSidedWall: ("lower", "upper"),
    ViscousMedium: (),
    ViscoelasticMedium: (),
    CoulombSurface: (),
    Detents: (),
    FreeSpace: (),
}
"""Parameters that are positions where contact begins or ends. A subclass is another environment: it may add some."""


class ContinuousRun(NamedTuple):
    """The axis in the continuous environment, shapes (n,)."""

    position: Array  # [m or rad]
    velocity: Array  # [m/s or rad/s]
    impulse: Array  # of the environment's force since the start [N*s or N*m*s]
    interaction: Array  # energy into the environment since the start [J]


def continuous_run(
    environment: Environment, model: Model, times: Sequence[float], rtol: float, stop: Callable[[], bool] | None = None
) -> ContinuousRun:
    """Motion that the user would feel without sampling.

    Args:
        environment: Rendered without sampling.
        model: Plant, user and effects; the environment is added to it.
        times: Ascending, from 0 [s].
        rtol: Relative tolerance of the solver.
        stop: Polled now and then; true gives up.

    Raises:
        InputError: There are no equations for the environment, scipy is missing, the solver fails, or it was stopped.
    """
    longest = _BETWEEN_EVENTS if model.switches else _BETWEEN_SURFACES
    force = _EnvironmentForce(environment, model)
    model.add(force)
    table = np.array(states_at(model, times, rtol, stop, longest))
    return ContinuousRun(*(table[:, place] for place in (POSITION, VELOCITY, force.impulse, force.interaction)))


def surfaces(environment: Environment) -> list[float]:
    """Return the positions where contact begins or ends [m or rad]; where the torque may jump.

    Raises:
        InputError: There are no equations for an environment of this class.
    """
    names = _SURFACES.get(type(environment))
    if names is None and _has_own_surfaces(environment):
        return [float(place) for place in environment.surfaces()]  # type: ignore[attr-defined]
    if names is None:
        known = ", ".join(kind.__name__ for kind in _SURFACES)
        raise InputError(
            f"environment: got {type(environment).__name__}, for which there is no continuous run, expected one of: "
            f"{known}, or an OwnEnvironment with `surfaces` of its `contact`; what needs none is measured all the same"
        )
    return [float(getattr(environment, name)) for name in names]


def _has_own_surfaces(environment: Environment) -> bool:
    """Whether a user's own environment defines its switching surfaces, and is a force of position alone.

    `surfaces` must be defined in the class of `contact` and `true_state`, or below: otherwise it may not match them.
    """
    where = {
        name: place
        for place, kind in reversed(list(enumerate(type(environment).__mro__)))
        for name in ("surfaces", "contact", "true_state")
        if name in vars(kind)
    }
    return "surfaces" in where and not environment.relaxes and where["surfaces"] == min(where.values())


class _EnvironmentForce:
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

    def apply(self, time: float, state: State, mode: str, forces: Floats, rates: Floats) -> None:
        """Add the force of the environment, its power, and the rate of its strain."""
        velocity = float(state[VELOCITY])
        force = 0.0 if mode == "0" else self._force(state, mode, velocity, rates)
        forces[0] += force
        rates[self.impulse] = force
        rates[self.interaction] = -force * velocity

    def ways(self, index: int, mode: str) -> Sequence[Transition]:
        """Transitions: crossing of the surfaces, yielding, or its reversal."""
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

    def _force(self, state: State, mode: str, velocity: float, rates: Floats) -> float:
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


def _distance(surface: float, sign: float) -> Callable[[float, State, float], float]:
    """Value that falls through zero where the axis crosses the surface towards -sign."""

    def distance(_time: float, state: State, _torque: float) -> float:
        return sign * (float(state[POSITION]) - surface)

    return distance
