"""The reference plant of a scene: elements collected, states named, and one right-hand side for any solver.

State: position, velocity, [twist, load_velocity], [motor_torque], [temperature], [depths, bristle], work of the motor,
work of the user. Every effect that acts on the motion is there; those of the encoder are not.
"""

import math
from collections.abc import Sequence
from typing import Any, Final

from canhaptic.errors import ParameterError
from canhaptic.lab.judge.reference_elements import (
    POSITION,
    VELOCITY,
    BodyPlace,
    Drag,
    Element,
    Floats,
    LuGre,
    ReferenceContact,
    ReferenceDetents,
    ReferenceHand,
    ReferenceOwnHand,
    ReferenceStickSlip,
    Shaft,
    State,
    Transition,
)
from canhaptic.sim.plant.effects import Effect
from canhaptic.sim.plant.own_hand import OwnHand
from canhaptic.sim.plant.plant import PlantParameters
from canhaptic.sim.plant.user import UserParameters

MOTOR_WORK, USER_WORK = -2, -1
"""Places of the works in the state [J]."""
Modes = tuple[str, ...]
_DRY: Final = ("coulomb_friction", "stribeck_friction")
_COMMANDS: Final = ("torque_saturation", "torque_quantisation", "thermal_derating")
_ONCE: Final = ("current_loop", "shaft_compliance", "backlash", "lugre_friction", "thermal_derating", *_DRY)
_OFTEN: Final = ("torque_ripple", "viscous_friction", "cogging", "hard_stop", "grasp_change", "tremor", *_COMMANDS[:2])
_OF_THE_ENCODER: Final = ("encoder_noise", "encoder_quantisation")
"""Effects on measured values, on which the motion does not depend."""


class Model:
    """One scene as ordinary differential equations with modes.

    Args:
        parameters: Mass and bearings.
        user: The hand; None without a hand.
        effects: Effects as for `Plant`.

    Raises:
        ParameterError: An effect or the hand has no equations here, or an effect is given twice and has them once.

    Attributes:
        names: Names of the states.
        start: State at time 0.
        first: Mode of each element at time 0.
        breaks: Times at which the equations change by the clock [s].
        kinematics: States that are integrals of velocities: place -> (place of the velocity, factor).
        evaluations: Number of evaluations of the forces.
        switches: Whether anything may leave its mode.
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
        """Add a further element that acts on the motor, such as an environment.

        Its forces come before those of dry friction, which balances the remaining force.
        """
        dry = 1 if self._friction is not None else 0
        self._elements.insert(len(self._elements) - dry, element)
        self._close()

    def add_state(self, name: str, initial: float = 0.0) -> int:
        """Add a state before the works and return its place."""
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
                self._elements.append(Shaft(shaft.stiffness, shaft.damping, twist, load))
        self._elements.append(Drag(parameters.damping))
        self._elements += [Drag(drag.damping) for drag in self._effects.get("viscous_friction", [])]
        for cogging in self._effects.get("cogging", []):
            self._elements.append(ReferenceDetents(cogging.amplitude, cogging.pitch, cogging.phase))

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
        depth = self.add_state(f"{name}_depth")
        self._elements.append(ReferenceContact(sides, limit, stiffness, damping, depth))

    def _add_hand(self, user: UserParameters | None) -> None:
        if isinstance(user, OwnHand):
            self._elements.append(ReferenceOwnHand(user.force))
        elif user is not None and type(user) is not UserParameters:
            raise ParameterError(f"user: {type(user).__name__} has no equations here; make it a subclass of OwnHand")
        if user is None or not (user.stiffness or user.damping or user.push):
            return
        grasps = [(0.0, user.stiffness, user.damping)]
        changes = sorted(self._effects.get("grasp_change", []), key=lambda change: change.time)
        grasps += [(change.time, change.stiffness, change.damping) for change in changes]
        sines = []
        if user.motion:
            sines.append((user.motion.amplitude, 2.0 * math.pi * user.motion.frequency, user.motion.phase))
        for tremor in self._effects.get("tremor", []):
            sines.append((tremor.amplitude, 2.0 * math.pi * tremor.frequency, tremor.phase))
        rest = user.rest + (user.motion.offset if user.motion else 0.0)
        hand = ReferenceHand(self._places[-1], grasps, user.push, rest, sines)
        self.breaks = hand.changes
        self._elements.append(hand)

    def _add_friction(self) -> None:
        self._friction: ReferenceStickSlip | None = None
        lugre = self._one("lugre_friction")
        if lugre:
            self._elements.append(LuGre(lugre, self.add_state("bristle_deflection")))
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
        """Force of the first `count` elements on each body; writes the rates that they know."""
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
        """Torque that the drive applies for a command; writes the rate of the winding's temperature."""
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

    def _other_forces(self, time: float, state: State, torque: float) -> float:
        """All forces on the motor but dry friction, in the modes of the last call of `ways`."""
        rates = [0.0] * len(self.names)
        return self._forces(time, state, torque, self._asked, rates, len(self._elements) - 1)[0]

    def ways(self, modes: Modes) -> list[Transition]:
        """Every transition out of these modes; valid until the next call."""
        self._asked = modes
        return [way for i, element in enumerate(self._elements) for way in element.ways(i, modes[i])]

    @property
    def dynamic_size(self) -> int:
        """States without the works, on which nothing depends."""
        return len(self.names) - 2


def _require_known(effect: str, number: int) -> None:
    """Refuse an effect without equations: a judge that ignores an effect would blame the plant for it.

    Raises:
        ParameterError: The effect has no equations here, or as the `number`-th of its type.
    """
    if effect in _OF_THE_ENCODER or effect in _OFTEN or (effect in _ONCE and number == 1):
        return
    known = ", ".join(sorted({*_ONCE, *_OFTEN, *_OF_THE_ENCODER}))
    got = f"{effect} for the {number}. time" if effect in _ONCE else repr(effect)
    raise ParameterError(
        f"effects: got {got}, for which the textbook plant has no equations; it has them for: {known}", effect
    )
