"""Reference plant of a scene: ordinary differential equations with modes, for any solver.

State: position, velocity, [twist, load_velocity], [motor_torque], [temperature], [depths, bristle], work of the motor,
work of the user. Every effect that acts on the motion is included; effects of the encoder are not.

`Model` collects elements. Each is one source of force: it adds to `forces` (one for each body, motor first) and to
`rates`, and has its own transitions between modes. Signs, units and sources are those of the effect of the same name
in `canhaptic.sim.plant.effects`.

`difference` compares two motions.
"""

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import Any, Final, NamedTuple, Protocol

import numpy as np

from canhaptic.errors import ParameterError
from canhaptic.sim.plant.direct_rig import Motion
from canhaptic.sim.plant.effects import Effect
from canhaptic.sim.plant.plant import PlantParameters
from canhaptic.sim.plant.propagator import Array
from canhaptic.sim.plant.user import OwnHand, RecordedMotion, UserParameters

Floats = list[float]


class State(Protocol):
    """State vector, as a list or as scipy's array."""

    def __getitem__(self, index: int, /) -> float: ...


_Value = Callable[[float, State, Any], float]

POSITION, VELOCITY = 0, 1
_NEGLIGIBLE: Final = 1e-12  # of a guard's scale: less than that below zero is rounding


class Transition(NamedTuple):
    """Transition out of a mode, at the moment when `value` falls through zero."""

    element: int
    mode: str
    value: _Value
    rounding: float  # in the unit of the value
    reset: Callable[[Floats], None] | None = None


class BodyPlace(NamedTuple):
    """Position of a body as a linear combination of states."""

    velocity: int
    terms: tuple[tuple[int, float], ...]

    def position(self, state: State) -> float:
        """Return the position of the body [m or rad]."""
        return sum(factor * float(state[index]) for index, factor in self.terms)


class Element(Protocol):
    """One source of force."""

    @property
    def modes(self) -> tuple[str, ...]:
        """Modes of the element; the first is the one at the start."""

    def apply(self, time: float, state: State, mode: str, forces: Floats, rates: Floats) -> None:
        """Add the element's forces, and the rates of its own states."""

    def ways(self, index: int, mode: str) -> Sequence[Transition]:
        """Return the transitions out of a mode; `index` is the index of this element."""


_Apply = Callable[[float, State, str, Floats, Floats], None]


class Smooth(NamedTuple):
    """An element with a single mode, such as viscous friction."""

    apply: _Apply
    modes: tuple[str, ...] = ("only",)

    def ways(self, index: int, mode: str) -> Sequence[Transition]:
        """No transitions."""
        return ()


def drag(damping: float) -> Smooth:
    """Viscous friction on the motor: -damping v."""

    def apply(time: float, state: State, mode: str, forces: Floats, rates: Floats) -> None:
        forces[0] -= damping * state[VELOCITY]

    return Smooth(apply)


def detents(amplitude: float, pitch: float, phase: float) -> Smooth:
    """Cogging: -amplitude sin(2 pi q / pitch + phase)."""
    wave_number = 2.0 * math.pi / pitch

    def apply(time: float, state: State, mode: str, forces: Floats, rates: Floats) -> None:
        forces[0] -= amplitude * math.sin(wave_number * state[POSITION] + phase)

    return Smooth(apply)


def shaft_between(stiffness: float, damping: float, twist: int, load: int) -> Smooth:
    """Spring and damper between motor and load; `twist` and `load`: indices of the twist and the load's velocity."""

    def apply(time: float, state: State, mode: str, forces: Floats, rates: Floats) -> None:
        force = stiffness * state[twist] + damping * (state[VELOCITY] - state[load])
        forces[0] -= force
        forces[1] += force

    return Smooth(apply)


_Numbers = Sequence[tuple[float, ...]]


def hand_on(place: BodyPlace, grasps: _Numbers, push: float, rest: float, sines: _Numbers, rows: _Numbers) -> Smooth:
    """Hand on the last body: K (x_u - q) + D (v_u - v) + push; the last state is its work.

    Args:
        place: Position of the held body.
        grasps: (start time, stiffness, damping) of each grasp, ascending.
        push: Constant force.
        rest: Rest position of the spring.
        sines: (amplitude, angular frequency, phase) of each sinusoid of the voluntary motion.
        rows: (time, position) of a recorded voluntary motion, linearly interpolated; empty: none.
    """

    def apply(time: float, state: State, mode: str, forces: Floats, rates: Floats) -> None:
        _, stiffness, damping = next(g for g in reversed(grasps) if g[0] <= time or g is grasps[0])
        at, speed = rest, 0.0
        for amplitude, omega, phase in sines:
            angle = omega * time + phase
            at += amplitude * math.sin(angle)
            speed += amplitude * omega * math.cos(angle)
        if rows:
            after = bisect_right(rows, time, key=itemgetter(0))
            (begin, here), (end, there) = rows[after - 1], (*rows, (math.inf, 0.0))[after]
            pace = (there - here) / (end - begin)
            at, speed = at + here + pace * (time - begin), speed + pace
        velocity = state[place.velocity]
        force = stiffness * (at - place.position(state)) + damping * (speed - velocity) + push
        forces[-1] += force
        rates[-1] += force * velocity

    return Smooth(apply)


def own_hand(force_of: Callable[[float, float, float], float]) -> Smooth:
    """User-defined force on the motor, a function of time, position and velocity; the last state is its work."""

    def apply(time: float, state: State, mode: str, forces: Floats, rates: Floats) -> None:
        velocity = float(state[VELOCITY])
        force = force_of(time, float(state[POSITION]), velocity)
        forces[0] += force
        rates[-1] += force * velocity

    return Smooth(apply)


def lugre(p: Any, deflection: int) -> Smooth:
    """LuGre friction: bristles that bend and slip; `deflection` is their index in the state."""

    def apply(time: float, state: State, mode: str, forces: Floats, rates: Floats) -> None:
        velocity, bend = state[VELOCITY], state[deflection]
        ratio = velocity / p.stribeck_velocity
        level = p.kinetic + (p.static - p.kinetic) * math.exp(-ratio * ratio)
        rate = velocity - p.bristle_stiffness * abs(velocity) / level * bend
        rates[deflection] = rate
        forces[0] -= p.bristle_stiffness * bend + p.bristle_damping * rate + p.viscous * velocity

    return Smooth(apply)


class ReferenceContact:
    """A one-sided damped contact with a dented face that recovers; `depth` is a state.

    Args:
        sides: (body, its position, factor); distance = sum of factor times position.
        limit: Distance at which the faces meet.
        stiffness: Stiffness of the faces.
        damping: Damping of the faces.
        depth: Index of the state.
    """

    modes: tuple[str, ...] = ("apart", "touching")

    def __init__(
        self, sides: Sequence[tuple[int, BodyPlace, float]], limit: float, stiffness: float, damping: float, depth: int
    ) -> None:
        self._sides, self._limit = tuple(sides), limit
        self._stiffness, self._damping, self._depth = stiffness, damping, depth

    def apply(self, time: float, state: State, mode: str, forces: Floats, rates: Floats) -> None:
        """Add the force while in contact, and the rate of the dent's depth."""
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
    """Dry friction on a body: sticks up to `static`, then slides with `kinetic`, plus a Stribeck excess if given.

    Args:
        kinetic: Friction while sliding.
        static: Friction at breakaway.
        excess: Stribeck excess at zero speed, which decays with speed; 0: none.
        stribeck_velocity: Speed scale of that decay.
        velocity: Velocity at the start.
        others: (time, state, torque) -> sum of the other forces on the body.
        body: Index of the body, and index of its velocity in the state; the motor by default.
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
        """Add the sliding friction, or at rest a force that balances all other forces."""
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


class ReferenceWinding:
    """Motor winding with a limited supply voltage: u = R i + L di/dt + K v, torque K i, u clipped to +-U.

    Args:
        limit: Supply voltage U, back-EMF and torque constant K, resistance R and inductance L.
        place: Index of the motor torque in the state.
        wanted: (state, held torque) -> rate of the torque that the current loop requests.
    """

    modes: tuple[str, ...] = ("free", "high", "low")

    def __init__(self, limit: Any, place: int, wanted: Callable[[State, float], float]) -> None:
        self._limit, self._place, self._wanted = limit, place, wanted

    def _asked(self, state: State, torque: float) -> float:
        p, ampere, change = self._limit, state[self._place] / self._limit.back_emf, self._wanted(state, torque)
        return float(p.resistance * ampere + p.inductance * change / p.back_emf + p.back_emf * state[VELOCITY])

    def apply(self, time: float, state: State, mode: str, forces: Floats, rates: Floats) -> None:
        """Set the rate of change of the torque to what the clipped voltage permits."""
        if mode != "free":
            p = self._limit
            rest = p.supply if mode == "high" else -p.supply
            rest -= p.back_emf * state[VELOCITY] + p.resistance * state[self._place] / p.back_emf
            rates[self._place] = p.back_emf * rest / p.inductance

    def ways(self, index: int, mode: str) -> Sequence[Transition]:
        """Transitions where the requested voltage passes the supply, in either direction."""
        supply = self._limit.supply
        rounding = _NEGLIGIBLE * supply
        if mode == "free":
            return (
                Transition(index, "high", lambda t, y, u: supply - self._asked(y, u), rounding),
                Transition(index, "low", lambda t, y, u: supply + self._asked(y, u), rounding),
            )
        sign = 1.0 if mode == "high" else -1.0
        return (Transition(index, "free", lambda t, y, u: sign * self._asked(y, u) - supply, rounding),)


MOTOR_WORK, USER_WORK = -2, -1
"""Indices of the motor's and the user's work in the state [J]."""
Modes = tuple[str, ...]
_DRY: Final = ("coulomb_friction", "stribeck_friction")
_COMMANDS: Final = ("torque_saturation", "torque_quantisation", "thermal_derating")
_ONCE: Final = ("current_loop", "voltage_limit", "shaft_compliance", "backlash", "lugre_friction", _COMMANDS[2], *_DRY)
_OFTEN: Final = ("torque_ripple", "viscous_friction", "cogging", "hard_stop", "grasp_change", "tremor", *_COMMANDS[:2])
_OF_THE_ENCODER: Final = ("encoder_noise", "encoder_quantisation")
"""Effects that change measured values only, not the motion."""


class Model:
    """One plant and hand as ordinary differential equations with modes.

    Args:
        parameters: Mass and bearings.
        user: The hand; None without a hand.
        effects: Effects as for `Plant`.

    Raises:
        ParameterError: An effect or the hand has no equations here, or an effect occurs more often than they allow.

    Attributes:
        names: Names of the states.
        start: State at time 0.
        first: Mode of each element at time 0.
        breaks: Times at which the equations change [s].
        kinematics: States that integrate a velocity: index -> (index of the velocity, factor).
        evaluations: Number of evaluations of the forces.
        switches: Whether any element can leave its mode.
    """

    def __init__(self, parameters: PlantParameters, user: UserParameters | None, effects: Sequence[Effect]) -> None:
        self._effects: dict[str, list[Any]] = {}
        for effect in effects:
            self._effects.setdefault(effect.type, []).append(effect)
            _require_known(effect.type, len(self._effects[effect.type]))
        self._commands: list[Any] = sorted((e for e in effects if e.type in _COMMANDS), key=lambda e: e.rank)
        self.names = ["position", "velocity"]
        self.start = [parameters.initial_position, parameters.initial_velocity]
        self._masses = [parameters.mass]
        self._places = [BodyPlace(VELOCITY, ((POSITION, 1.0),))]
        self.kinematics: dict[int, tuple[tuple[int, float], ...]] = {POSITION: ((VELOCITY, 1.0),)}
        self._elements: list[Element] = []
        self.breaks: list[float] = []
        self.evaluations = 0
        self._add_drive()
        self._add_smooth(parameters)
        self._add_contacts()
        self._add_hand(user)
        self._add_friction()
        self.names += ["motor_work", "user_work"]
        self.start += [0.0, 0.0]
        self._close()

    def add(self, element: Element) -> None:
        """Add an element that acts on the motor, such as an environment.

        Its forces are added before dry friction, which balances the sum of all other forces at rest.
        """
        dry = 1 if self._friction is not None else 0
        self._elements.insert(len(self._elements) - dry, element)
        self._close()

    def add_state(self, name: str, initial: float = 0.0) -> int:
        """Add a state before the work of motor and user, and return its index."""
        at = len(self.names) - (2 if "user_work" in self.names else 0)
        self.names.insert(at, name)
        self.start.insert(at, initial)
        return at

    def _close(self) -> None:
        self.first: Modes = tuple(element.modes[0] for element in self._elements)
        self.switches = any(len(element.modes) > 1 for element in self._elements)

    def _one(self, name: str) -> Any:
        return self._effects.get(name, [None])[0]

    def _add_drive(self) -> None:
        loop, derating = self._one("current_loop"), self._one("thermal_derating")
        self._lag = loop and loop.time_constant
        self._current = self.add_state("motor_torque") if loop else -1
        self._winding = self.add_state("temperature", derating.ambient) if derating else -1
        limit = self._one("voltage_limit")
        if limit:
            self._elements.append(ReferenceWinding(limit, self._current, self._wanted))
        self._ripples = [
            (r.amplitude, 2.0 * math.pi / r.pitch, r.phase) for r in self._effects.get("torque_ripple", [])
        ]

    def _add_smooth(self, parameters: PlantParameters) -> None:
        shaft = self._one("shaft_compliance")
        if shaft:
            twist, load = self.add_state("twist"), self.add_state("load_velocity", self.start[VELOCITY])
            self._masses.append(shaft.load_mass)
            self._places.append(BodyPlace(load, ((POSITION, 1.0), (twist, -1.0))))
            self.kinematics[twist] = ((VELOCITY, 1.0), (load, -1.0))
            if not self._one("backlash"):
                self._elements.append(shaft_between(shaft.stiffness, shaft.damping, twist, load))
        self._elements.append(drag(parameters.damping))
        self._elements += [drag(viscous.damping) for viscous in self._effects.get("viscous_friction", [])]
        for cogging in self._effects.get("cogging", []):
            self._elements.append(detents(cogging.amplitude, cogging.pitch, cogging.phase))

    def _add_contacts(self) -> None:
        for stop in self._effects.get("hard_stop", []):
            factor, last = (1.0 if stop.side == "upper" else -1.0), len(self._places) - 1
            side = (last, self._places[last], factor)
            self._add_contact([side], factor * stop.position, stop.stiffness, stop.damping, f"{stop.side}_stop")
        gap, shaft = self._one("backlash"), self._one("shaft_compliance")
        if gap:
            for name, sign in (("forward_flank", 1.0), ("backward_flank", -1.0)):
                sides = [(0, self._places[0], sign), (1, self._places[1], -sign)]
                self._add_contact(sides, 0.5 * gap.gap, shaft.stiffness, shaft.damping, name)

    def _add_contact(self, sides: Any, limit: float, stiffness: float, damping: float, name: str) -> None:
        self._elements.append(ReferenceContact(sides, limit, stiffness, damping, self.add_state(f"{name}_depth")))

    def _add_hand(self, user: UserParameters | None) -> None:
        if isinstance(user, OwnHand):
            self._elements.append(own_hand(user.force))
        elif user is not None and type(user) is not UserParameters:
            raise ParameterError("user: got own code, expected a sinusoid, a recording or an OwnHand: no equations")
        if user is None or not (user.stiffness or user.damping or user.push):
            return
        grasps = [(0.0, user.stiffness, user.damping)]
        changes = sorted(self._effects.get("grasp_change", []), key=lambda change: change.time)
        grasps += [(change.time, change.stiffness, change.damping) for change in changes]
        sines = []
        if user.sinusoid:
            sines.append((user.sinusoid.amplitude, 2.0 * math.pi * user.sinusoid.frequency, user.sinusoid.phase))
        for tremor in self._effects.get("tremor", []):
            sines.append((tremor.amplitude, 2.0 * math.pi * tremor.frequency, tremor.phase))
        rest = user.rest + (user.sinusoid.offset if user.sinusoid else 0.0)
        rows = user.motion.rows if isinstance(user.motion, RecordedMotion) else ()
        self.breaks = [time for time, *_ in (*grasps[1:], *rows[1:])]
        self._elements.append(hand_on(self._places[-1], grasps, user.push, rest, sines, rows))

    def _add_friction(self) -> None:
        self._friction: ReferenceStickSlip | None = None
        if bristles := self._one("lugre_friction"):
            self._elements.append(lugre(bristles, self.add_state("bristle_deflection")))
        dry = next((self._one(name) for name in _DRY if self._one(name)), None)
        if dry:
            width = getattr(dry, "stribeck_velocity", 1.0)
            excess = dry.static - dry.kinetic if dry.type == "stribeck_friction" else 0.0
            velocity = self.start[VELOCITY]
            self._friction = ReferenceStickSlip(dry.kinetic, dry.static, excess, width, velocity, self._other_forces)
            self._elements.append(self._friction)

    def rates(self, time: float, state: State, torque: float, modes: Modes) -> Floats:
        """Return the rate of every state."""
        rates = [0.0] * len(self.names)
        forces = self._forces(time, state, torque, modes, rates, len(self._elements))
        for place, force, mass in zip(self._places, forces, self._masses, strict=True):
            rates[place.velocity] = force / mass
        for index, terms in self.kinematics.items():
            rates[index] = sum(factor * float(state[velocity]) for velocity, factor in terms)
        return rates

    def _forces(self, time: float, state: State, torque: float, modes: Modes, rates: Floats, count: int) -> Floats:
        """Return the force of the first `count` elements on each body, and write the rates of their states."""
        self.evaluations += 1
        forces = [0.0] * len(self._masses)
        held = self._held(state, torque, rates) if self._commands else torque
        motor = held
        if self._current >= 0:
            motor = state[self._current]
            rates[self._current] = (held - motor) / self._lag
        if self._ripples:
            motor *= 1.0 + sum(a * math.sin(w * state[POSITION] + phase) for a, w, phase in self._ripples)
        forces[0] = motor
        rates[MOTOR_WORK] = motor * state[VELOCITY]
        for element, mode in zip(self._elements[:count], modes, strict=False):
            element.apply(time, state, mode, forces, rates)
        return forces

    def _held(self, state: State, torque: float, rates: Floats) -> float:
        """Return the torque that the drive applies for a command, and write the rate of the winding's temperature."""
        for command in self._commands:
            if command.type == "torque_saturation":
                torque = max(-command.limit, min(command.limit, torque))
            elif command.type == "torque_quantisation":
                torque = command.quantum * round(torque / command.quantum)
            else:
                warmth = float(state[self._winding])
                share = (command.hot - warmth) / (command.hot - command.warm)
                allowed = command.torque_limit * max(0.0, min(1.0, share))
                torque = max(-allowed, min(allowed, torque))
                heat = command.thermal_resistance * command.copper_loss * torque**2
                rates[self._winding] = (heat - (warmth - command.ambient)) / command.time_constant
        return torque

    def _wanted(self, state: State, torque: float) -> float:
        """Return the rate of the motor torque that the current loop requests."""
        held = self._held(state, torque, [0.0] * len(self.names)) if self._commands else torque
        return float((held - state[self._current]) / self._lag)

    def _other_forces(self, time: float, state: State, torque: float) -> float:
        """Return all forces on the motor except dry friction, in the modes of the last call of `ways`."""
        return self._forces(time, state, torque, self._asked, [0.0] * len(self.names), len(self._elements) - 1)[0]

    def ways(self, modes: Modes) -> list[Transition]:
        """Every transition out of these modes; valid until the next call."""
        self._asked = modes
        return [way for i, element in enumerate(self._elements) for way in element.ways(i, modes[i])]

    def motion(self, states: Sequence[State]) -> Motion:
        """Return a motion from the states at the ends of the holds."""
        table = np.array(states, dtype=float).reshape(len(states), -1)
        return Motion(*(table[:, place] for place in (POSITION, VELOCITY, MOTOR_WORK, USER_WORK)))

    @property
    def dynamic_size(self) -> int:
        """Return the number of states without the work of motor and user, on which no rate depends."""
        return len(self.names) - 2


def _require_known(effect: str, number: int) -> None:
    """Refuse an effect without equations: if it were ignored, the simulated plant would seem wrong.

    Args:
        effect: Effect of a plant.
        number: Count of this type so far, the effect included.

    Raises:
        ParameterError: The effect has no equations here, or there are too many of its type.
    """
    if effect in _OF_THE_ENCODER or effect in _OFTEN or (effect in _ONCE and number == 1):
        return
    known = ", ".join(sorted({*_ONCE, *_OFTEN, *_OF_THE_ENCODER}))
    got = f"{effect} for the {number}. time" if effect in _ONCE else repr(effect)
    raise ParameterError(
        f"effects: got {got}, for which the textbook plant has no equations; it has them for: {known}", effect
    )


class MotionError(NamedTuple):
    """Largest difference of two motions at the end of any hold."""

    position: float  # [m or rad]
    force: float  # mean net force on the motor's body over a hold [N or N*m]
    energy: float  # work of the motor, work of the user or kinetic energy, whichever differs most [J]

    @property
    def is_finite(self) -> bool:
        """Whether all values are finite."""
        return bool(np.isfinite(self.position) and np.isfinite(self.force) and np.isfinite(self.energy))


def difference(one: Motion, other: Motion, mass: float, sample_time: float) -> MotionError:
    """Difference of two motions; infinite where one of them is not finite.

    Args:
        one: First motion.
        other: Second motion, over the same holds.
        mass: Mass of the motor's body [kg or kg*m^2].
        sample_time: Sample time [s].
    """
    with np.errstate(all="ignore"):
        kicks = np.diff(one.velocity - other.velocity, prepend=0.0) * (mass / sample_time)
        works = (one.motor - other.motor, one.user - other.user, 0.5 * mass * (one.velocity**2 - other.velocity**2))
        return largest_error(one.position - other.position, kicks, np.array(works))


def largest_error(*apart: Array) -> MotionError:
    """Return the largest size of each difference, of position, force and energy; infinite where one is not finite."""
    return MotionError(*(float(np.abs(of).max(initial=0.0)) if np.isfinite(of).all() else math.inf for of in apart))
