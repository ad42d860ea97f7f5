"""`guarded` with a hand declared as spring, damper and mass, against such hands, on a drive written for this alone.

    hand     F = K (x - q) + b (x' - v) - m v'        x' piecewise linear, abs(x') <= w
    drive    M v' = c (r - v) + F - friction

The motion within a hold is linear and exact; the energy through the sensor is integrated by Simpson's rule.
"""

from dataclasses import dataclass, replace
from math import pi
from random import Random
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from canhaptic.control.admittance import build_display_group
from canhaptic.control.admittance.group_environment import GroupMass
from canhaptic.control.admittance.port import AdmittanceProperties
from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters
from canhaptic.control.balance import Certificate
from canhaptic.errors import ForceContradictedError

Array = NDArray[np.float64]

_PARTS: Final = 10  # of a hold
_ROUNDING: Final = 1e-9  # [J]
_DECLARED: Final = Certificate.DECLARED_HAND.value
_MOVES: Final = 1e-9  # [m/s]
_ROOM: Final = 1.5  # times what a run shows is declared of slew and acceleration


@dataclass(frozen=True)
class DeclaredRig:
    """A drive, its hand, and by how much each declaration is above the truth."""

    time: float = 1e-3  # T [s]
    delay: int = 1
    latency: int = 0
    sampling: str = "mean"
    moved: float = 2.0  # M [kg]
    bandwidth: float = 50.0  # of the loop [Hz]
    stiffness: float = 1000.0  # K [N/m]
    speed: float = 0.3  # w [m/s]
    mass: float = 0.0  # m [kg]
    damping: float = 0.0  # b [N*s/m]
    virtual_mass: float = 0.2  # [kg]
    virtual_damping: float = 0.0  # [N*s/m]
    allowance: float = 1e-3  # [J]
    spread: float = 0.1
    above: float = 1.05  # times drive mass and gain declared
    share: float = 1.0  # of the hand declared; below 1 a false declaration
    seed: int = 0
    axes: int = 1  # all alike, with a hand each and one account
    slew: float = 1e3  # [N/s]
    acceleration: float = 10.0  # [m/s^2]

    @property
    def gain(self) -> float:
        """Gain of the velocity loop [N*s/m]."""
        return 2.0 * pi * self.bandwidth * self.moved


@dataclass
class DeclaredOutcome:
    """What one run came to."""

    least: float = 0.0  # energy through the sensor [J]
    by_hand: int = 0  # holds whose command rests on the declared hand
    moving: int = 0
    travel: float = 0.0  # [m]
    slew: float = 0.0  # [N/s]
    acceleration: float = 0.0  # [m/s^2]
    uncertified: int = 0
    is_stopped: bool = False  # what is declared contradicts what is seen

    @property
    def is_below(self) -> bool:
        """Whether the hand got more than it gave."""
        return self.least < -_ROUNDING


def random_rig(seed: int) -> DeclaredRig:
    """Returns the rig of a seed, all declarations true but slew and acceleration, which a run shows."""
    random = Random(seed)
    return DeclaredRig(
        time=random.choice([1e-3, 2e-3, 4e-3]), delay=random.choice([0, 1, 1, 2]), latency=random.choice([0, 0, 1]),
        sampling=random.choice(["mean", "mean", "point"]), moved=random.uniform(0.5, 3.0),
        bandwidth=random.choice([50.0, 100.0, 200.0]), stiffness=random.choice([200.0, 1000.0, 5000.0]),
        speed=random.choice([0.1, 0.3, 1.0]), mass=random.choice([0.0, 0.0, 0.05, 0.3]),
        damping=random.choice([0.0, 0.0, 1.0, 5.0]), virtual_mass=random.choice([0.03, 0.1, 0.3, 1.0]),
        virtual_damping=random.choice([0.0, 2.0]), allowance=random.choice([0.0, 1e-3]),
        spread=random.choice([0.0, 0.1, 0.2]), above=1.0, seed=seed,
    )  # fmt: skip


class _Hold:
    """Half a part of a hold, as one matrix: states q, v, x, x', impulse; inputs r, x''."""

    def __init__(self, rig: DeclaredRig, step: float) -> None:
        self.step = step
        k, b, m, c = rig.stiffness, rig.damping, rig.mass, rig.gain
        spring = np.array([-k, -b, k, b, 0.0, 0.0, 0.0])  # the force but for the mass
        rise = spring.copy()
        rise[1] -= c
        rise[5] += c
        rise /= rig.moved + m
        self.force = spring - m * rise
        flow = np.zeros((7, 7))
        flow[0, 1] = flow[2, 3] = flow[3, 6] = 1.0
        flow[1], flow[4], self.rise = rise, self.force, rise
        self.matrix = np.asarray(expm(flow * step))
        self.change = self.force @ flow


def _far_speed(rig: DeclaredRig, random: Random, hold: int, command: float, plan: tuple[int, float]) -> float:
    """Returns the speed that the far side is to reach at the end of a hold [m/s]."""
    kind, period = plan
    time, w = hold * rig.time, rig.speed
    phase = time % period / period
    if kind == 0:
        return w * float(np.sin(2.0 * pi * phase))
    if kind == 1:  # to and fro at full speed
        return w if phase < 0.5 else -w
    if kind == 2:  # gives, then draws away from the motion
        return w if phase < 0.5 else -w * float(np.sign(command))
    if kind == 3:  # always against the motion, after a push
        return w if time < period else -w * float(np.sign(command))
    return w * random.uniform(-1.0, 1.0)


def run(rig: DeclaredRig, seconds: float = 0.6) -> DeclaredOutcome:
    """Returns what the hands, one on each axis, did to the guard; the declarations as they are."""
    random, found, controller = Random(rig.seed), DeclaredOutcome(), _controller(rig)
    half, axes = _Hold(rig, 0.5 * rig.time / _PARTS), range(rig.axes)
    first = random.randrange(5), random.choice([0.05, 0.1, 0.3])
    states, energy, impulses = [np.zeros(7) for _ in axes], 0.0, [0.0] * rig.axes
    queue, late = [[0.0] * rig.axes] * (rig.delay + 1), [[0.0] * rig.axes] * rig.latency
    quickest = random.choice([5.0, 50.0]) * rig.time  # change of the far side's speed in a hold [m/s]
    others = [random.choice([first, (random.randrange(5), 0.1)]) for _ in axes[1:]]
    plans, commands = [first, *others], [0.0] * rig.axes
    controller.step([0.0] * rig.axes, [0.0] * rig.axes)
    for hold in range(round(seconds / rig.time)):
        gained = np.zeros(_PARTS)
        for state, acting, command, plan in zip(states, queue.pop(0), commands, plans, strict=True):
            state[5] = acting
            wanted = _far_speed(rig, random, hold, command, plan) - state[3]
            state[6] = min(quickest, max(-quickest, wanted)) / rig.time
            gained += _follow(half, state, found)
        found.least, energy = min(found.least, energy + float(gained.min())), energy + float(gained[-1])
        is_point = rig.sampling == "point"
        late.append([
            float(half.force @ state) if is_point else (state[4] - impulse) / rig.time
            for state, impulse in zip(states, impulses, strict=True)
        ])  # fmt: skip
        impulses = [state.item(4) for state in states]
        try:
            balance = controller.step([state.item(0) for state in states], [-force for force in late.pop(0)])
        except ForceContradictedError:
            found.is_stopped = True
            break
        commands = list(balance.torques)
        queue.append(commands)
        moves, certificate = bool(max(map(abs, commands)) > _MOVES), balance.account.certificate
        found.moving += moves
        found.by_hand += certificate == _DECLARED and moves
        found.uncertified += certificate == Certificate.NONE.value
    return found


def _follow(half: _Hold, state: Array, found: DeclaredOutcome) -> Array:
    """Moves the state on by a hold; returns the energy through the sensor since its begin, after each part [J]."""
    gained = np.zeros(_PARTS)
    for place in range(_PARTS):
        powers = []
        for part in range(3):
            if part:
                state[:] = half.matrix @ state
            powers.append(float(half.force @ state) * state.item(1))
            found.slew = max(found.slew, abs(float(half.change @ state)))
            found.acceleration = max(found.acceleration, abs(float(half.rise @ state)))
        gained[place] = half.step / 3.0 * (powers[0] + 4.0 * powers[1] + powers[2])
    found.travel = max(found.travel, abs(state.item(0)))
    return np.cumsum(gained)


def _controller(rig: DeclaredRig) -> Any:
    properties = AdmittanceProperties(
        sample_time=rig.time, delay=rig.delay, sampling="point" if rig.sampling == "point" else "mean",
        latency=rig.latency, force_slew=rig.slew, handle_acceleration=rig.acceleration, speed_limit=2.0,
        acceleration_limit=500.0,
    )  # fmt: skip
    parameters = GuardedAdmittanceParameters(
        drive_mass=rig.moved * rig.above, loop_gain=rig.gain * rig.above, spread=rig.spread,
        energy_allowance=rig.allowance, hand_stiffness=rig.stiffness * rig.share, hand_speed=rig.speed * rig.share,
        hand_mass=rig.mass * rig.share, hand_damping=rig.damping * rig.share, drive_friction=0.0,
    )  # fmt: skip
    environment = GroupMass(mass=rig.virtual_mass, damping=rig.virtual_damping)
    return build_display_group(environment, "guarded", parameters, [properties] * rig.axes)


def with_true_bounds(rig: DeclaredRig, seconds: float = 0.6) -> tuple[DeclaredRig, DeclaredOutcome] | None:
    """Returns a rig whose slew and acceleration are as declared, with its run; None where none was found."""
    for _ in range(5):
        found = run(rig, seconds)
        if not found.is_stopped and found.slew <= rig.slew and found.acceleration <= rig.acceleration:
            return rig, found
        rig = replace(
            rig, slew=max(rig.slew, _ROOM * found.slew), acceleration=max(rig.acceleration, _ROOM * found.acceleration)
        )
    return None
