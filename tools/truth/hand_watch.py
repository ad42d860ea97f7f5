"""How hard a simulated hand really pulled and pushed: whether a declared hand force was true.

Read from the states of the simulated plant at every SYNC. What else can move the body at the encoder besides motor and
bearings counts as hand: dry friction beyond its declared bound and cogging by their largest values, a shaft by its own
torque.
"""

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Final

from canhaptic.scene.build import Experiment
from canhaptic.scene.models import MechanismScene
from canhaptic.sim.plant.plant import Plant
from canhaptic.sim.plant.user import PLACE, UserParameters

_MEMORY: Final = 4
"""SYNCs in which a hand force counts for a torque: from the hold before the first torque under way to its own. Lost
commands that are declared come on top: a torque that was not replaced still acts."""
_BETWEEN_SYNCS: Final = 1.1
"""A force read at SYNCs may be so much larger between them."""
_Force = Callable[[], float]


class HandWatch:
    """Largest force of everything but motor and bearings, along the torque that acts.

    Args:
        experiment: Not run yet.
        outward: Sign of the direction out of the wall, of each axis; 0 where it is that of the torque.

    Attributes:
        pull: Largest force out of the wall while a torque points there; per axis [N or N*m]. Where torques come late:
            while any torque acts, because what moves the axis meanwhile is bounded by pull and push at once (L1 of
            `docs/theory/late_torques.md`). Where an environment of one axis turns: along the torque of its effort where
            the handle is, while any torque acts.
        push: Largest force into the wall while a torque points there, or where torques come late any torque acts; per
            axis [N or N*m]. Where an environment turns: against that torque, and either way without an effort.
        speed: Largest mean speed of a hold; per axis [m/s or rad/s].
    """

    def __init__(self, experiment: Experiment, outward: Sequence[int]) -> None:
        self._rig = experiment.rig
        self._forces = _readers(experiment)
        self._outward = tuple(outward)
        self._turning: list[Any] = [
            None if side or axis.group else axis.environment.parameters
            for side, axis in zip(outward, experiment.scene.axes, strict=True)
        ]
        self._is_late = [
            bool(side) and bool(axis.loop.torque_window or axis.loop.current_lag)
            for side, axis in zip(outward, experiment.scene.axes, strict=True)
        ]
        laws = [port.passivity.parameters for port in experiment.scene.ports]
        memory = _MEMORY + max(getattr(law, "max_consecutive_losses", 0) for law in laws)
        self._seen, self._torques, self._words = ([deque[float](maxlen=memory) for _ in self._forces] for _ in range(3))
        self.pull = [0.0] * len(self._forces)
        self.push = [0.0] * len(self._forces)
        self.speed = [0.0] * len(self._forces)
        motors: list[Any] = [drive.servo.motor for drive in experiment.far_side.drives] if experiment.far_side else []
        self._motors, self._period = motors, experiment.rig.bus.sample_time
        self._positions = [motor.position for motor in motors]

    def __call__(self, _cycles: int) -> None:
        """Reads the forces of the SYNC that was just answered; given to `run` as its progress."""
        sent = self._rig.records[-1].torques_per_mille
        for axis, motor in enumerate(self._motors):
            before, self._positions[axis] = self._positions[axis], motor.position
            self.speed[axis] = max(self.speed[axis], _BETWEEN_SYNCS * abs(motor.position - before) / self._period)
        for axis, read in enumerate(self._forces):
            self._seen[axis].append(read())
            self._torques[axis].append(self._rig.drives[axis].scaling.torque(sent[axis]))
            if self._turning[axis] is not None:
                self._take_words(axis)
                continue
            for sign in (1, -1):
                acting = (torque if self._is_late[axis] else torque * sign > 0.0 for torque in self._torques[axis])
                if any(acting):
                    self._take(axis, sign, max(force * sign for force in self._seen[axis]))

    def _take_words(self, axis: int) -> None:
        """Takes the force of the hand by the words that hold where the handle is."""
        environment, position, force = self._turning[axis], self._motors[axis].position, self._seen[axis][-1]
        effort = 0.0
        if environment.contact(position):
            effort = environment.effort(environment.true_state(position, 0.0, 0.0))
        along = -force * math.copysign(1.0, effort) if effort else -abs(force)
        self._words[axis].append(along)
        if any(self._torques[axis]):
            self.pull[axis] = max(self.pull[axis], _BETWEEN_SYNCS * max(self._words[axis]))
            self.push[axis] = max(self.push[axis], -_BETWEEN_SYNCS * min(self._words[axis]))

    def _take(self, axis: int, sign: int, force: float) -> None:
        outward = self._outward[axis]
        kept = self.push if outward and sign != outward else self.pull
        kept[axis] = max(kept[axis], force * _BETWEEN_SYNCS)


def _readers(experiment: Experiment) -> list[_Force]:
    drives, mechanisms = experiment.far_side.drives if experiment.far_side else (), experiment.scene.mechanisms
    readers = []
    for drive, axis in zip(drives, experiment.scene.axes, strict=True):
        motor: Any = drive.servo.motor
        if isinstance(motor, Plant):
            readers.append(_of_plant(motor, axis.loop.device_friction_bound or 0.0))
        else:
            of = next(of for of in mechanisms if axis.parameters.name in of.axes)
            if of.mechanism.name == "xy_stage":
                readers.append(_of_stage(motor.shared.mechanism, of, motor.axis))
            else:
                readers.append(_of_linkage(motor, of, experiment))
    return readers


def _of_plant(plant: Plant, declared_friction: float) -> _Force:
    friction = sum(_dry_friction(effect) for effect in plant.effects)
    margin = max(0.0, friction - declared_friction)
    margin += sum(getattr(effect, "amplitude", 0.0) for effect in plant.effects if effect.type == "cogging")
    shafts = [effect for effect in plant.effects if effect.type == "shaft_compliance"]
    force = _of_shaft(plant, shafts[0]) if shafts else _of_hand(plant, plant.user)
    return lambda: math.copysign(abs(force()) + margin, force())


def _dry_friction(effect: Any) -> float:
    """Returns what dry friction may push with; viscous friction cannot."""
    is_dry = effect.type in ("coulomb_friction", "stribeck_friction", "lugre_friction")
    return float(max(effect.static, effect.kinetic)) if is_dry else 0.0


def _of_hand(plant: Plant, user: UserParameters | None) -> _Force:
    if user is None:
        return lambda: 0.0
    places = {name: place for place, name in enumerate(plant.scene.names)}
    grasps, swings = [(user.stiffness, user.damping)], []
    for effect in plant.effects:
        of: Any = effect
        if effect.type == "grasp_change":
            grasps.append((of.stiffness, of.damping))
        elif effect.type == "tremor":
            swings.append((of.amplitude, 2.0 * math.pi * of.frequency, places["tremor_sine"]))
    if user.sinusoid is not None:
        swings.append((user.sinusoid.amplitude, 2.0 * math.pi * user.sinusoid.frequency, places["motion_sine"]))
    rest = user.rest + (user.sinusoid.offset if user.sinusoid else 0.0)
    recorded = places.get(PLACE)

    def force() -> float:
        state = plant.state
        stretch, rate = rest - plant.position, -plant.velocity
        for amplitude, omega, sine in swings:
            stretch += amplitude * state.item(sine)
            rate += amplitude * omega * state.item(sine + 1)
        if recorded is not None:
            stretch += state.item(recorded)
            rate += state.item(recorded + 1)
        return user.push + max((stiffness * stretch + damping * rate for stiffness, damping in grasps), key=abs)

    return force


def _of_shaft(plant: Plant, shaft: Any) -> _Force:
    places = {name: place for place, name in enumerate(plant.scene.names)}
    twist, load = places["twist"], places["load_velocity"]

    def force() -> float:
        state = plant.state
        return -float(shaft.stiffness * state.item(twist) + shaft.damping * (plant.velocity - state.item(load)))

    return force


def _of_stage(stage: Any, of: MechanismScene, axis: int) -> _Force:
    hand = of.hand
    if hand is None:
        return lambda: 0.0
    places = {name: place for place, name in enumerate(stage.state_names)}
    stiffness, damping = hand.stiffness_matrix, hand.damping_matrix
    k = (stiffness.xx, stiffness.xy) if axis == 0 else (stiffness.xy, stiffness.yy)
    d = (damping.xx, damping.xy) if axis == 0 else (damping.xy, damping.yy)

    def force() -> float:
        state, total = stage.state, hand.push[axis]
        for body, (name, motion) in enumerate(zip("xy", hand.motions, strict=True)):
            stretch = hand.rest[body] - state.item(places[f"{name}_position"])
            rate = -state.item(places[f"{name}_velocity"])
            if motion is not None:
                sine, omega = places[f"{name}_motion_sine"], 2.0 * math.pi * motion.frequency
                stretch += motion.offset + motion.amplitude * state.item(sine)
                rate += motion.amplitude * omega * state.item(sine + 1)
            total += k[body] * stretch + d[body] * rate
        return float(total)

    return force


def _of_linkage(motor: Any, of: MechanismScene, experiment: Experiment) -> _Force:
    """Returns what is left of M dv/dt where motor and bearing are taken off: hand, stop, and what the pose changes."""
    mechanism, axis, period = motor.shared.mechanism, motor.axis, experiment.rig.bus.sample_time
    damping: float = of.mechanism.parameters.damping  # type: ignore[attr-defined]
    before = [mechanism.velocities, motor.torque()]

    def force() -> float:
        inertia, velocities = mechanism._place.inertia, mechanism.velocities  # noqa: SLF001 - of the plant itself
        rates = [(now - then) / period for now, then in zip(velocities, before[0], strict=True)]
        row = (inertia.a, inertia.b) if axis == 0 else (inertia.b, inertia.c)
        torque, before[1], before[0] = before[1], motor.torque(), velocities
        return float(row[0] * rates[0] + row[1] * rates[1] - torque + damping * velocities[axis])

    return force
