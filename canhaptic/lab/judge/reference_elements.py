"""Forces of the reference plant, one element each: its forces on the bodies, and its transitions between modes.

An element adds to `forces` (one per body, motor first) and to `rates`. Signs, units and sources are those of the effect
of the same name in `canhaptic.sim.plant.effects`.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple, Protocol

Floats = list[float]


class State(Protocol):
    """A state, as a list or as scipy's array."""

    def __getitem__(self, index: int, /) -> float: ...


_Value = Callable[[float, State, Any], float]

POSITION, VELOCITY = 0, 1
_NEGLIGIBLE: Final = 1e-12  # of a guard's scale: less than that below zero is rounding


class Transition(NamedTuple):
    """Leaves a mode where `value` falls through zero."""

    element: int
    mode: str
    value: _Value
    rounding: float  # in the unit of the value
    reset: Callable[[Floats], None] | None = None


class BodyPlace(NamedTuple):
    """Where a body is in the state: the sum of factor times state."""

    velocity: int
    terms: tuple[tuple[int, float], ...]

    def position(self, state: State) -> float:
        """Return the position of the body [m or rad]."""
        return sum(factor * float(state[index]) for index, factor in self.terms)


class Element(Protocol):
    """One source of force.

    Attributes:
        modes: Its modes, the first at the start.
    """

    modes: tuple[str, ...]

    def apply(self, time: float, state: State, mode: str, forces: Floats, rates: Floats) -> None:
        """Add its forces and the rates of its own states."""

    def ways(self, index: int, mode: str) -> Sequence[Transition]:
        """Transitions out of a mode; `index` is its own place among the elements."""


class _Smooth:
    """Common part of elements without modes."""

    modes: tuple[str, ...] = ("only",)

    def ways(self, index: int, mode: str) -> Sequence[Transition]:
        """No transitions."""
        return ()


class Drag(_Smooth):
    """Viscous friction on the motor: -damping v."""

    def __init__(self, damping: float) -> None:
        self._damping = damping

    def apply(self, time: float, state: State, mode: str, forces: Floats, rates: Floats) -> None:
        """Add the friction."""
        forces[0] -= self._damping * state[VELOCITY]


class ReferenceDetents(_Smooth):
    """Cogging: -amplitude sin(2 pi q / pitch + phase)."""

    def __init__(self, amplitude: float, pitch: float, phase: float) -> None:
        self._amplitude, self._wave_number, self._phase = amplitude, 2.0 * math.pi / pitch, phase

    def apply(self, time: float, state: State, mode: str, forces: Floats, rates: Floats) -> None:
        """Add the detent force."""
        forces[0] -= self._amplitude * math.sin(self._wave_number * state[POSITION] + self._phase)


class Shaft(_Smooth):
    """Spring and damper between motor and load."""

    def __init__(self, stiffness: float, damping: float, twist: int, load_velocity: int) -> None:
        self._stiffness, self._damping, self._twist, self._load = stiffness, damping, twist, load_velocity

    def apply(self, time: float, state: State, mode: str, forces: Floats, rates: Floats) -> None:
        """Add the torque of the shaft to both sides."""
        force = self._stiffness * state[self._twist] + self._damping * (state[VELOCITY] - state[self._load])
        forces[0] -= force
        forces[1] += force


class ReferenceHand(_Smooth):
    """K (x_u - q) + D (v_u - v) + push on the last body; its work goes to the last state.

    Args:
        place: Place of the held body.
        grasps: (from time, stiffness, damping), ascending.
        push: Constant force.
        rest: Rest position of the spring.
        sines: (amplitude, angular frequency, phase) of the voluntary motion.
    """

    def __init__(
        self,
        place: BodyPlace,
        grasps: Sequence[tuple[float, float, float]],
        push: float,
        rest: float,
        sines: Sequence[tuple[float, float, float]],
    ) -> None:
        self._place, self._grasps = place, tuple(grasps)
        self._push, self._rest, self._sines = push, rest, tuple(sines)

    @property
    def changes(self) -> list[float]:
        """Times at which the grasp changes [s]."""
        return [time for time, _, _ in self._grasps[1:]]

    def apply(self, time: float, state: State, mode: str, forces: Floats, rates: Floats) -> None:
        """Add the force of the hand and its power."""
        _, stiffness, damping = next(g for g in reversed(self._grasps) if g[0] <= time or g is self._grasps[0])
        place, speed = self._rest, 0.0
        for amplitude, omega, phase in self._sines:
            angle = omega * time + phase
            place += amplitude * math.sin(angle)
            speed += amplitude * omega * math.cos(angle)
        velocity = state[self._place.velocity]
        force = stiffness * (place - self._place.position(state)) + damping * (speed - velocity) + self._push
        forces[-1] += force
        rates[-1] += force * velocity


class ReferenceOwnHand(_Smooth):
    """A force of the user's own on the motor, by time, position and velocity; its work goes to the last state."""

    def __init__(self, force: Callable[[float, float, float], float]) -> None:
        self._force = force

    def apply(self, time: float, state: State, mode: str, forces: Floats, rates: Floats) -> None:
        """Add the force and its power."""
        velocity = float(state[VELOCITY])
        force = self._force(time, float(state[POSITION]), velocity)
        forces[0] += force
        rates[-1] += force * velocity


class LuGre(_Smooth):
    """Bristles that bend and slip; the deflection is a state."""

    def __init__(self, friction: Any, deflection: int) -> None:
        self._friction, self._deflection = friction, deflection

    def apply(self, time: float, state: State, mode: str, forces: Floats, rates: Floats) -> None:
        """Add the friction and the rate of the deflection."""
        p, velocity, bend = self._friction, state[VELOCITY], state[self._deflection]
        ratio = velocity / p.stribeck_velocity
        level = p.kinetic + (p.static - p.kinetic) * math.exp(-ratio * ratio)
        rate = velocity - p.bristle_stiffness * abs(velocity) / level * bend
        rates[self._deflection] = rate
        forces[0] -= p.bristle_stiffness * bend + p.bristle_damping * rate + p.viscous * velocity


class ReferenceContact:
    """A one-sided damped contact whose dented face recovers; `depth` is a state.

    Args:
        sides: (body, its place, factor); distance = sum of factor times position.
        limit: Distance at which the faces meet.
        stiffness: Stiffness of the faces.
        damping: Damping of the faces.
        depth: Place of the state.
    """

    modes: tuple[str, ...] = ("apart", "touching")

    def __init__(
        self, sides: Sequence[tuple[int, BodyPlace, float]], limit: float, stiffness: float, damping: float, depth: int
    ) -> None:
        self._sides, self._limit = tuple(sides), limit
        self._stiffness, self._damping, self._depth = stiffness, damping, depth

    def apply(self, time: float, state: State, mode: str, forces: Floats, rates: Floats) -> None:
        """Add the force while it touches, and the rate of the depth."""
        if mode == "touching":
            rates[self._depth] = self._approach(state)
            force = self._force(state)
            for body, _, factor in self._sides:
                forces[body] -= factor * force
        elif self._damping > 0.0:
            rates[self._depth] = -self._stiffness / self._damping * state[self._depth]

    def ways(self, index: int, mode: str) -> Sequence[Transition]:
        """Transitions: separation at zero force, contact at zero gap."""

        def meet(state: Floats) -> None:
            state[self._depth] = self._beyond(state)

        def straighten(state: Floats) -> None:
            state[self._depth] = 0.0

        if mode == "touching":
            reset = None if self._damping > 0.0 else straighten
            return (Transition(index, "apart", lambda t, y, u: self._force(y), _NEGLIGIBLE * self._stiffness, reset),)
        return (Transition(index, "touching", lambda t, y, u: y[self._depth] - self._beyond(y), _NEGLIGIBLE, meet),)

    def _beyond(self, state: State) -> float:
        return sum(factor * place.position(state) for _, place, factor in self._sides) - self._limit

    def _approach(self, state: State) -> float:
        return sum(factor * float(state[place.velocity]) for _, place, factor in self._sides)

    def _force(self, state: State) -> float:
        return self._stiffness * float(state[self._depth]) + self._damping * self._approach(state)


class ReferenceStickSlip:
    """Dry friction on a body: held up to `static`, then `kinetic`; with Stribeck an excess that falls off.

    Args:
        kinetic: Level while sliding.
        static: Level at breakaway.
        excess: Excess of the Stribeck characteristic at rest; 0 without it.
        stribeck_velocity: Velocity over which it falls.
        velocity: Velocity at the start.
        others: (time, state, torque) -> sum of the other forces on the body.
        body: Index of the body, and of its velocity in the state; the motor by default.
    """

    def __init__(
        self, kinetic: float, static: float, excess: float, stribeck_velocity: float, velocity: float, others: _Value,
        body: tuple[int, int] = (0, VELOCITY),
    ) -> None:  # fmt: skip
        self._kinetic, self._static, self._excess = kinetic, static, excess
        self._stribeck_velocity, self._others = stribeck_velocity, others
        self._body, self._velocity = body
        first = "stuck" if velocity == 0.0 else "forward" if velocity > 0.0 else "backward"
        self.modes = (first, *(mode for mode in ("stuck", "forward", "backward") if mode != first))

    def apply(self, time: float, state: State, mode: str, forces: Floats, rates: Floats) -> None:
        """Add the friction while sliding; stuck, it takes up every other force."""
        if mode == "stuck":
            forces[self._body] = 0.0
            return
        ratio = state[self._velocity] / self._stribeck_velocity if self._excess else 0.0
        size = self._kinetic + self._excess * math.exp(-ratio * ratio)
        forces[self._body] -= size if mode == "forward" else -size

    def ways(self, index: int, mode: str) -> Sequence[Transition]:
        """Transitions: breakaway when stuck, rest when sliding."""
        static, others, rounding = self._static, self._others, _NEGLIGIBLE * self._static

        def stop(state: Floats) -> None:
            state[self._velocity] = 0.0

        if mode == "stuck":
            return (
                Transition(index, "forward", lambda t, y, u: static - others(t, y, u), rounding),
                Transition(index, "backward", lambda t, y, u: static + others(t, y, u), rounding),
            )
        sign = 1.0 if mode == "forward" else -1.0
        return (Transition(index, "stuck", lambda t, y, u: sign * float(y[self._velocity]), _NEGLIGIBLE, stop),)
