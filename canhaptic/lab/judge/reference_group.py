"""Equations of motion of several motors - separate axes, an X-Y stage, a five-bar - and of an admittance display.

The five-bar has the same links as the simulated one, but other equations: `M(q) v' = torque + ... - C(q, v)`, for
accelerations and any solver. The simulated one takes discrete-gradient steps in momenta.
"""

import math
from collections.abc import Sequence
from functools import partial
from itertools import accumulate
from typing import Any

import numpy as np

from canhaptic.errors import InputError
from canhaptic.lab.judge import reference_model
from canhaptic.lab.judge.reference_model import MOTOR_WORK, POSITION, VELOCITY, Floats, Model, Modes, Transition
from canhaptic.sim.plant.direct_rig import Motion
from canhaptic.sim.plant.mechanism import MechanismParameters
from canhaptic.sim.plant.mechanism import five_bar_linkage as five_bar
from canhaptic.sim.plant.mechanism.five_bar_linkage import Inertia, LinkagePose, hand_pull, quadratic
from canhaptic.sim.plant.mechanism.task_hand import TaskHand
from canhaptic.sim.plant.mechanism.xy_stage import XYStage
from canhaptic.sim.plant.plant import PlantParameters
from canhaptic.sim.plant.user import SinusoidMotion, UserParameters
from canhaptic.sim.plant.velocity_drive import AdmittanceSimulation

State = Sequence[float]


class _Motors:
    """Motors of a group.

    Args:
        places: Indices of their positions in the state.
        speeds: Indices of their velocities.
        works: Indices of the works of the motors; the work of a user follows each.
    """

    first: Modes = ()
    switches = False

    def __init__(self, places: Sequence[int], speeds: Sequence[int], works: Sequence[int]) -> None:
        self._places, self._speeds, self._works = places, speeds, works

    def positions(self, state: State) -> Floats:
        """Return the positions of the motors [m or rad]."""
        return [float(state[place]) for place in self._places]

    def velocities(self, state: State) -> Floats:
        """Return the velocities of the motors [m/s or rad/s]."""
        return [float(state[place]) for place in self._speeds]

    def works(self, state: State) -> tuple[float, float]:
        """Return the works of all motors and of the user since the start [J]."""
        return sum(float(state[place]) for place in self._works), sum(float(state[place + 1]) for place in self._works)

    def motion(self, states: Sequence[State]) -> Motion:
        """Return a motion from the states at the ends of the holds; its motors in columns."""
        rows = ((self.positions(state), self.velocities(state), *self.works(state)) for state in states)
        return Motion(*(np.array(column) for column in zip(*rows, strict=True)))

    def ways(self, modes: Modes) -> list[Transition]:
        """Every transition out of these modes; see `SwitchedModel`."""
        return []


class AxesModel(_Motors):
    """Motors with a separate plant each; the modes are those of all plants in sequence."""

    def __init__(self, models: Sequence[Model]) -> None:
        self._models = models
        self._parts = _slices([len(model.start) for model in models])
        places = [part.start + POSITION for part in self._parts]
        speeds = [part.start + VELOCITY for part in self._parts]
        super().__init__(places, speeds, [part.stop + MOTOR_WORK for part in self._parts])
        self._modes = _slices([len(model.first) for model in models])
        self.start = [value for model in models for value in model.start]
        self.first: Modes = tuple(mode for model in models for mode in model.first)
        self.breaks = [time for model in models for time in model.breaks]
        self.switches = any(model.switches for model in models)

    def rates(self, time: float, state: State, torque: State, modes: Modes) -> Floats:
        """Return the rate of every state; see `SwitchedModel`."""
        found: Floats = []
        for model, part, own, held in zip(self._models, self._parts, self._modes, torque, strict=True):
            found += model.rates(time, state[part], held, modes[own])
        return found

    def ways(self, modes: Modes) -> list[Transition]:
        """Every transition out of these modes; see `SwitchedModel`."""
        parts = enumerate(zip(self._models, self._parts, self._modes, strict=True))
        return [
            _of_motor(way, motor, part, own.start)
            for motor, (model, part, own) in parts
            for way in model.ways(modes[own])
        ]


def _of_motor(way: Transition, motor: int, part: slice, first: int) -> Transition:
    """Return a transition of one plant as a transition of the group.

    Args:
        way: Transition of the plant.
        motor: Index of the plant's motor.
        part: Part of the state that belongs to the plant.
        first: Index of the plant's first mode among all modes.
    """

    def value(time: float, state: Any, torques: Any) -> float:
        return way.value(time, state[part], torques[motor])

    def reset(state: Floats) -> None:
        own = state[part]
        change(own)
        state[part] = own

    change = way.reset or (lambda _state: None)
    return Transition(first + way.element, way.mode, value, way.rounding, reset)


class _TwoMotors(_Motors):
    """Two motors and a handle in the plane; state: two positions, two velocities, work of the motors and the user."""

    def __init__(self, hand: TaskHand | None, positions: Sequence[float]) -> None:
        super().__init__((0, 1), (2, 3), (4,))
        self._hand = five_bar.force_of_hand(hand)
        self.start, self.breaks = [*positions, 0.0, 0.0, 0.0, 0.0], list[float]()
        self.evaluations = 0


class StageModel(_TwoMotors):
    """An X-Y stage; its modes come from the dry friction of its guides."""

    def __init__(self, stage: XYStage, hand: TaskHand | None) -> None:
        super().__init__(hand, stage.initial_position)
        self._masses, self._damping = (stage.mass_x, stage.mass_y), (stage.damping_x, stage.damping_y)
        self._guides = [
            reference_model.ReferenceStickSlip(
                dry.kinetic, dry.static, 0.0, 1.0, 0.0, partial(self._other_force, guide), (guide, 2 + guide)
            )
            for guide, dry in enumerate((stage.friction_x, stage.friction_y))
            if dry is not None
        ]
        self.first = tuple(guide.modes[0] for guide in self._guides)
        self.switches = bool(self._guides)

    def inertia(self, positions: State) -> list[Floats]:
        """Return the inertia at each motor [kg or kg*m^2]."""
        return [[self._masses[0], 0.0], [0.0, self._masses[1]]]

    def rates(self, time: float, state: State, torque: State, modes: Modes) -> Floats:
        """Return the rate of every state; see `SwitchedModel`."""
        self.evaluations += 1
        speed, (forces, hand) = state[2:4], self._forces(time, state, torque)
        for guide, mode in zip(self._guides, modes, strict=True):
            guide.apply(time, state, mode, forces, [])
        accelerations = [force / mass for force, mass in zip(forces, self._masses, strict=True)]
        return [*speed, *accelerations, _dot(torque, speed), _dot(hand, speed)]

    def ways(self, modes: Modes) -> list[Transition]:
        """Every transition out of these modes; see `SwitchedModel`."""
        return [way for i, guide in enumerate(self._guides) for way in guide.ways(i, modes[i])]

    def _forces(self, time: float, state: State, torques: State) -> tuple[Floats, tuple[float, float]]:
        """Return the forces on the masses without dry friction, and the hand's part of these forces [N]."""
        place, speed = state[:2], state[2:4]
        hand = hand_pull(self._hand, time, (place[0], place[1]), (speed[0], speed[1]))
        pairs = zip(torques, hand, self._damping, speed, strict=True)
        return [torque + force - b * v for torque, force, b, v in pairs], hand

    def _other_force(self, guide: int, time: float, state: State, torques: State) -> float:
        return self._forces(time, state, torques)[0][guide]


class FiveBarModel(_TwoMotors):
    """Equations of motion of a five-bar and its hand."""

    def __init__(self, links: five_bar.FiveBarLinkage, hand: TaskHand | None) -> None:
        super().__init__(hand, links.initial_angles)
        self._linkage, self._damping, self._stop = links.linkage(), links.damping, links.elbow_stop

    def inertia(self, positions: State) -> list[Floats]:
        """Return the inertia at each motor in a pose [kg*m^2]."""
        found = five_bar.inertia_in(self._linkage, self._pose(float(positions[0]), float(positions[1])))
        return [[found.a, found.b], [found.b, found.c]]

    def rates(self, time: float, state: State, torque: State, modes: Modes) -> Floats:
        """Return the rate of every state; see `SwitchedModel`."""
        self.evaluations += 1
        left, right, v_left, v_right = (float(value) for value in state[:4])
        pose = self._pose(left, right)
        (xl, xr), (yl, yr) = pose.jacobian
        force = hand_pull(self._hand, time, pose.handle, (xl * v_left + xr * v_right, yl * v_left + yr * v_right))
        hand = xl * force[0] + yl * force[1], xr * force[0] + yr * force[1]
        by_left, by_right = (five_bar.inertia_rate(self._linkage, pose, by) for by in (0, 1))
        turning = Inertia(*(a * v_left + b * v_right for a, b in zip(by_left, by_right, strict=True)))  # dM / dt
        centrifugal = (0.5 * quadratic(by_left, v_left, v_right), 0.5 * quadratic(by_right, v_left, v_right))
        pull = self._stop_pull(pose.span)
        spans = five_bar.span_rates(pose)
        total = [
            torque[i] + hand[i] - self._damping * v - pull * spans[i] + centrifugal[i] - turned
            for i, v, turned in (
                (0, v_left, turning.a * v_left + turning.b * v_right),
                (1, v_right, turning.b * v_left + turning.c * v_right),
            )
        ]
        accelerations = five_bar.solved(five_bar.inertia_in(self._linkage, pose), *total)
        return [
            v_left, v_right, *accelerations, torque[0] * v_left + torque[1] * v_right,
            hand[0] * v_left + hand[1] * v_right,
        ]  # fmt: skip

    def _pose(self, left: float, right: float) -> LinkagePose:
        """Return the pose at two motor angles [rad].

        Raises:
            ParameterError: The pose is singular.
        """
        pose = five_bar.pose_at(self._linkage, left, right)
        if not pose.is_regular:
            raise five_bar.singular(self._linkage, left, right, pose.span)
        return pose

    def _stop_pull(self, span: float) -> float:
        """Return the force of the elbow stop, positive if it draws the elbows together [N]."""
        if self._stop is None:
            return 0.0
        return self._stop.stiffness * (max(0.0, span - self._stop.most) - max(0.0, self._stop.least - span))


class DisplayModel(_Motors):
    """An admittance display and its hand, on both sides of the force sensor; `torque` is the command r of the velocity.

        M v' = c (r - v) + f_I + F - b v,   f_I' = k (r - v),   F = k_g (x - q) + d_g (w - v)
        m x'' = -F + K (x_u - x) + D (x_u' - w) + push,          E' = F v

    q, v: mass on the motor's side; x, w: mass on the hand's side; f_I: integral part of the velocity loop; F: force at
    the sensor; E: energy through it, booked as the user's work. Effects and torque limits are omitted.

    Args:
        plant: Mass on the motor's side, and its start.
        display: Velocity loop, and grip on the hand's side.
        user: The hand; None without a hand.
    """

    def __init__(self, plant: PlantParameters, display: AdmittanceSimulation, user: UserParameters | None) -> None:
        super().__init__((0,), (1,), (4,))
        self._plant, self._display, self._user = plant, display, user or UserParameters()
        begin = (plant.initial_position, plant.initial_velocity)
        self.evaluations = 0
        self.start, self.breaks = [*begin, *begin, 0.0, 0.0], list[float]()  # q, v, x, w, f_I, E

    def rates(self, time: float, state: State, torque: float, modes: Modes) -> Floats:
        """Return the rate of every state; see `SwitchedModel`."""
        self.evaluations += 1
        q, v, x, w, integral, _ = (float(value) for value in state)
        plant, user, loop, grip = self._plant, self._user, self._display.loop, self._display.grip
        motion = user.sinusoid or SinusoidMotion(amplitude=0.0, frequency=1.0)
        omega = 2.0 * math.pi * motion.frequency
        angle = omega * time + motion.phase
        place = user.rest + motion.offset + motion.amplitude * math.sin(angle)
        speed = motion.amplitude * omega * math.cos(angle)
        force = grip.stiffness * (x - q) + grip.damping * (w - v)
        hand = user.stiffness * (place - x) + user.damping * (speed - w) + user.push
        driven = loop.gain * (torque - v) + integral - plant.damping * v
        forced = (driven + force) / plant.mass, (hand - force) / grip.mass
        return [v, forced[0], w, forced[1], loop.integral_gain * (torque - v), force * v]


ReferenceMechanism = StageModel | FiveBarModel
ReferenceGroup = AxesModel | ReferenceMechanism
"""Motors and their mechanics; the `torque` of `rates` has one entry for each motor."""


def mechanism_model(parameters: MechanismParameters, hand: TaskHand | None) -> ReferenceMechanism:
    """Return the equations of a mechanism.

    Raises:
        InputError: There are no equations for it.
    """
    if isinstance(parameters, XYStage):
        return StageModel(parameters, hand)
    if isinstance(parameters, five_bar.FiveBarLinkage):
        return FiveBarModel(parameters, hand)
    raise InputError(f"the mechanism {type(parameters).__name__} has no equations; expected XY stage or five-bar")


def _slices(sizes: Sequence[int]) -> list[slice]:
    return [slice(end - size, end) for size, end in zip(sizes, accumulate(sizes), strict=True)]


def _dot(one: Sequence[float], other: Sequence[float]) -> float:
    return math.fsum(a * float(b) for a, b in zip(one, other, strict=True))
