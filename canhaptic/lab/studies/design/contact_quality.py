"""Trials of a wall by a guided hand: the stiffness held under a push, and the depth and drag of a slow approach.

The hand follows a course: legs of constant speed and of a push that changes at a constant rate. Its position, speed,
push and rate of the push are states that change linearly, so that the plant stays as exact as with any other hand and
any effects; `Plant.set_states` changes them at a SYNC.

`largest_held` finds by bisection the largest stiffness that a loop holds at rest under a slowly rising push:

    push     from 0 to its full force while it rises, from in front of the wall; then constant
    held     over the last part of the run: mean torque over mean depth is within the tolerance of the stiffness, depth
             swings by no more than the tolerance, and no more energy came out than the allowance

Initial oscillations must have died away by the damping of device and hand when a wall is judged: `settling_time`.

`enter` lets a slow hand enter a wall and stop there, for its depth at rest and the drag in front of the wall. This hand
is a spring whose outer end moves at a constant speed through free space and into the wall, and stops. The handle begins
with that speed, so that it does not swing on the spring.

`felt_of` computes what the hand of a scene feels at walls on its rig:

held    the largest wall within the tolerance at rest, for a push that rises slowly to a fraction of the torque limit
drag    the largest torque in front of a wall, against a hand that approaches at an ordinary speed
start   the least speed at which the wall holds a hand on a spring, with at least half the force of the ideal wall at
        rest, instead of letting it pass
drags   the same for possible declared drags, after the distance over which drag and declared friction of the device
        earn the energy of a start
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from canhaptic.audit.why.ripple import to_and_fro
from canhaptic.control.certificates.scalar_bounds import displacement_response, renderable_by_hand_force
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity.guarded import GuardedParameters, hand_response, kept_for_contacts
from canhaptic.lab.batch.scalar import render
from canhaptic.lab.loop.axis_loop import LoopCase, LoopRun, Reach, loop_case, under
from canhaptic.lab.studies import Row
from canhaptic.scene.far_side import effect_of
from canhaptic.scene.hints import DRAG, LEAN
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.sim.plant.assembly import PlantModel, Rows
from canhaptic.sim.plant.effects import Effect
from canhaptic.sim.plant.plant import Plant, PlantParameters
from canhaptic.sim.plant.user import SPEED, Hand, PointerHand

PUSH: Final = "hand_push"
"""Name of the state with the push of the hand, in addition to its grip [N or N*m]."""
PUSH_RATE: Final = "hand_push_rate"
"""Name of the state with the rate of the push [N/s or N*m/s]."""


class GuidedHand(PointerHand):
    """A hand whose position and push are set from outside."""

    def add_to(self, scene: PlantModel) -> None:
        """Add the hand and its states."""
        _GuidedPart(self).add_to(scene)
        Hand.add_place(scene, self.place, 0.0)
        scene.add_state(PUSH)
        scene.add_state(PUSH_RATE)


class _GuidedPart(Hand):
    def assemble(self, rows: Rows, mode: str) -> None:
        """Add the force on the handle, its work, and the rate of the push."""
        super().assemble(rows, mode)
        rows.set_rate(PUSH, rows.row(**{PUSH_RATE: 1.0}))
        handle = len(rows.forces) - 1
        force = rows.row(**{PUSH: 1.0})
        rows.forces[handle] += force
        rows.add_power(self.name, force, rows.velocity(handle))


_NS: Final = 1e9


class Leg(NamedTuple):
    """A part of the course of a hand; it begins with the SYNC nearest to its time."""

    begins: float  # [s]
    speed: float = 0.0  # of the place [m/s or rad/s]
    push_rate: float = 0.0  # [N/s or N*m/s]


class GuidedPlant(Plant):
    """A plant with a guided hand, whose rates change at the beginning of each leg.

    Args:
        parameters: Mass, bearings and start.
        hand: The guided hand.
        effects: Effects of the plant.
        sample_time_ns: Sample time [ns].
        course: Course of the hand, in the order of time; before the first leg the hand rests.
        seed: Seed of every random effect.
    """

    def __init__(
        self, parameters: PlantParameters, hand: GuidedHand, effects: Sequence[Effect], sample_time_ns: int,
        course: Iterable[Leg], seed: int = 0,
    ) -> None:  # fmt: skip
        super().__init__(parameters, hand, effects, sample_time_ns, seed)
        self._legs = {round(leg.begins * _NS / sample_time_ns) * sample_time_ns: leg for leg in course}

    def begin(self, now: int) -> None:
        """Start the clock, and the first leg if it begins at once."""
        super().begin(now)
        self._turn(now)

    def advance_to(self, now: int, torque: float) -> None:
        """Move to `now` [ns] under a torque; see `Plant`."""
        super().advance_to(now, torque)
        self._turn(now)

    def _turn(self, now: int) -> None:
        leg = self._legs.get(now)
        if leg is not None:
            self.set_states({SPEED: leg.speed, PUSH_RATE: leg.push_rate})


_FURTHEST: Final = 4.0
"""Displacement that counts as divergence, as a multiple of the requested depth."""
_LEAST_FURTHEST: Final = 0.2  # [m or rad]
_TIMES: Final = 5.0
"""Length of a run's free swing, in time constants."""


@dataclass(frozen=True, slots=True)
class Leaning:
    """A slowly rising push against a wall at the origin."""

    push: float = 5.0  # [N or N*m]
    rise: float = 0.3  # [s]
    clearance: float = 5e-4  # [m or rad] in front of the wall
    duration: float = 5.0  # [s]
    rest: float = 0.5  # at the end, over which it is judged [s]
    tolerance: float = 0.05
    allowance: float = 1e-6  # of energy given out [J]
    damping: float = 0.0  # of the hand [N*s/m or N*m*s/rad]
    per_decade: int = 12  # walls tried before the largest is bracketed
    fine: float = 0.005  # part to which the largest stiffness is found


def settling_time(mass: float, damping: float) -> float:
    """Time in which an oscillation of the device on an ideal spring decays to 1 % [s]."""
    return _TIMES * 2.0 * mass / damping


class Held(NamedTuple):
    """Outcome of a trial of one wall."""

    share: float  # mean torque over the requested one at the mean depth
    ripple: float  # way to and fro over the mean depth
    least: float  # least true sum of h_i [J]
    passed: bool


@dataclass(frozen=True, slots=True)
class Bench:
    """The device and its loop, on which walls are tried."""

    case: LoopCase  # its environment and plant are replaced
    plant: PlantParameters
    effects: Sequence[Effect] = ()
    seed: int = 0

    def run(
        self, wall: SpringDamperWall, hand: GuidedHand, course: Sequence[Leg], seconds: float, reach: Reach,
        position: float, velocity: float = 0.0,
    ) -> LoopRun:  # fmt: skip
        """Return a run of the loop at a wall, with a guided hand on the handle.

        Args:
            wall: The wall.
            hand: The hand.
            course: Course of the hand.
            seconds: Length of the run [s].
            reach: Range of positions that do not count as divergence [m or rad].
            position: Initial position of the handle [m or rad].
            velocity: Initial velocity of the handle [m/s or rad/s].
        """
        plant = self.plant.model_copy(update={"initial_position": position, "initial_velocity": velocity})
        period = self.case.sample_time_ns
        case = replace(
            self.case, environment=wall, simulation=None,
            make_plant=lambda: GuidedPlant(plant, hand, self.effects, period, course, self.seed),
        )  # fmt: skip
        return render(case, round(seconds / (period * 1e-9)), reach)


def held(bench: Bench, stiffness: float, leaning: Leaning, damping: float = 0.0) -> Held:
    """Return the outcome of a push on one wall.

    Args:
        bench: Device and loop.
        stiffness: Stiffness of the wall [N/m or N*m/rad].
        leaning: Push on the wall.
        damping: Damping of the wall [N*s/m or N*m*s/rad].
    """
    course = (Leg(0.0, push_rate=-leaning.push / leaning.rise), Leg(leaning.rise))
    wall, hand = SpringDamperWall(stiffness=stiffness, damping=damping), GuidedHand(damping=leaning.damping)
    deepest = max(_FURTHEST * leaning.push / stiffness, _LEAST_FURTHEST)
    run = bench.run(wall, hand, course, leaning.duration, Reach(-deepest, deepest), leaning.clearance)
    if run.ended:
        return Held(float("nan"), float("nan"), run.least_interaction, passed=False)
    last = slice(-max(2, round(leaning.rest / (bench.case.sample_time_ns * 1e-9))), None)
    depth, torque = -run.true_position[last], run.torque[last]
    mean = float(depth.mean())
    share = float(torque.mean()) / (stiffness * mean) if mean > 0.0 else 0.0
    ripple = to_and_fro(depth) if mean > 0.0 else float("inf")
    within = abs(share - 1.0) <= leaning.tolerance and ripple <= leaning.tolerance
    return Held(share, ripple, run.least_interaction, within and run.least_interaction >= -leaning.allowance)


class LargestHeld(NamedTuple):
    """Result of `largest_held`."""

    stiffness: float  # 0: none [N/m or N*m/rad]
    softer: int  # walls that were tried and are softer
    failing: int  # those of them that are not held


def largest_held(bench: Bench, leaning: Leaning, softest: float, stiffest: float) -> LargestHeld:
    """Return the stiffest wall that withstands the push, and the number of softer walls that do not.

    Args:
        bench: Device and loop.
        leaning: Push on the walls.
        softest: Stiffness tried first [N/m or N*m/rad].
        stiffest: Largest stiffness tried; if it is below `softest`, no wall is tried.
    """
    if stiffest < softest:
        return LargestHeld(0.0, 0, 0)
    walls = np.geomspace(softest, stiffest, 2 + int(leaning.per_decade * np.log10(stiffest / softest))).tolist()
    passed = [held(bench, stiffness, leaning).passed for stiffness in walls]
    if True not in passed:
        return LargestHeld(0.0, 0, 0)
    last = len(passed) - 1 - passed[::-1].index(True)
    low, high = walls[last], walls[min(last + 1, len(walls) - 1)]
    while high > (1.0 + leaning.fine) * low:
        middle = (low * high) ** 0.5
        low, high = (middle, high) if held(bench, middle, leaning).passed else (low, middle)
    return LargestHeld(float(low), last, passed[:last].count(False))


@dataclass(frozen=True, slots=True)
class SlowHand:
    """A hand that is a spring, whose outer end moves towards a wall at the origin."""

    speed: float  # [m/s or rad/s]
    stiffness: float = 300.0  # [N/m or N*m/rad]
    damping: float = 0.0  # [N*s/m or N*m*s/rad]
    free: float = 0.05  # way in free space [m or rad]
    into: float = 0.03  # way into the wall [m or rad]
    settling: float = 3.0  # after the stop [s]
    rest: float = 1.0  # of that, over which depth is taken [s]


class Entered(NamedTuple):
    """A slow hand's entry into a wall: the depth it reaches, the drag before it, and the energy."""

    depth: float  # mean, at rest [m or rad]
    drag: float  # largest |torque| before the surface [N or N*m]
    least: float  # least true sum of h_i [J]
    run: LoopRun


def enter(bench: Bench, wall: SpringDamperWall, hand: SlowHand) -> Entered:
    """Return the depth and drag of a slow hand at a wall that is solid below the origin."""
    period, way = bench.case.sample_time_ns * 1e-9, hand.free + hand.into
    moving = max(1, round(way / hand.speed / period)) * period  # it stops with a SYNC
    speed, course = way / moving, (Leg(0.0, speed=-way / moving), Leg(moving))
    guided = GuidedHand(stiffness=hand.stiffness, damping=hand.damping, place=hand.free)
    run = bench.run(wall, guided, course, moving + hand.settling, Reach(-1.0, 1.0), hand.free, -speed)
    if run.ended:
        return Entered(float("nan"), float("nan"), run.least_interaction, run)
    inside = np.flatnonzero(run.true_position < 0.0)
    before = run.torque[: int(inside[0])] if len(inside) else run.torque
    depth = -float(run.true_position[-max(2, round(hand.rest / period)) :].mean())
    return Entered(depth, float(np.abs(before).max(initial=0.0)), run.least_interaction, run)


_PUSHES: Final = (0.5 * LEAN, LEAN, 2.0 * LEAN)
"""Pushes, as fractions of the torque limit."""
_DEEPEST: Final = 0.1
"""Depth [m or rad] of the softest wall that is tried."""
_STIFFEST: Final = 4.0
"""Stiffness as a multiple of m / T^2, above which no certificate covers a wall."""
_ORDINARY: Final = {"m": 0.15, "rad": 1.5}
"""Ordinary speed of a hand [m/s or rad/s]."""
_SPEEDS: Final = (0.1, 10.0)
"""Slowest and fastest contact tried, as multiples of the ordinary speed."""
_HALVINGS: Final = 5
_HELD: Final = 0.5
_LONGEST: Final = 5.0  # leaning [s]
_FURTHER: Final = 1.25
"""Ratio of the free distance in front of a wall to the distance in which drag earns the energy that contact needs."""
_LONGEST_WAY: Final = {"m": 0.5, "rad": 5.0}
"""Longest distance tried in front of a wall [m or rad]."""


def felt_of(scene: Scene, algorithm: str, hand: dict[str, float], tolerance: float, stiffness: float) -> Row:
    """Return the figures felt on the rig of a scene, as plain values.

    Args:
        scene: Scene of one simulated axis, with a wall.
        algorithm: Name of the algorithm that renders.
        hand: Stiffness and damping of the grip [N/m, N*s/m or N*m/rad, N*m*s/rad].
        tolerance: Largest relative difference of a stiffness from the requested one.
        stiffness: Stiffness of the wall that is entered slowly [N/m or N*m/rad].
    """
    [axis] = under(scene, algorithm).permitted().axes
    limit, simulation = axis.parameters.torque_limit, simulation_of(axis)
    plant, effects = simulation.plant, [effect_of(effect) for effect in simulation.effects]
    bench = Bench(loop_case(axis, scene), plant, effects, simulation.seed)
    period, speed = scene.bus.sample_time, _ORDINARY[axis.parameters.unit]
    duration = min(_LONGEST, 1.0 + settling_time(plant.mass, plant.damping + hand["damping"]))
    leaning = Leaning(duration=duration, tolerance=tolerance, damping=hand["damping"], per_decade=5, fine=0.02)
    walls = []
    for push in (part * limit for part in _PUSHES):
        found = largest_held(bench, replace(leaning, push=push), push / _DEEPEST, _STIFFEST * plant.mass / period**2)
        walls.append(
            {"push": push, "held": found.stiffness, "certified": _certified(axis, push), "softer": found.softer,
             "softer_not_held": found.failing}
        )  # fmt: skip
    comes = SlowHand(
        speed, hand["stiffness"], hand["damping"], 0.1 * speed, LEAN * limit / hand["stiffness"], settling=1.0, rest=0.3
    )
    wall = SpringDamperWall(stiffness=stiffness)
    return {
        "walls": walls,
        "drag": enter(bench, wall, comes).drag,
        "speed": speed,
        "start_speed": _start_speed(bench, wall, comes),
        "slowest": _SPEEDS[0] * speed,
        "drags": _drags(bench, axis, wall, comes),
    }


def _drags(bench: Bench, axis: AxisScene, wall: SpringDamperWall, comes: SlowHand) -> list[dict[str, float | None]]:
    """Return rows on the energy earned by drag; none if every contact is felt without, or hand or mass are unknown."""
    parameters, loop = bench.case.parameters, axis.loop
    if not isinstance(parameters, GuardedParameters):
        return []
    asks = parameters.model_copy(update={"earned_energy": None, "drag": 0.0})
    energy = kept_for_contacts(wall, asks, loop, hand_response(asks, loop))
    rows: list[dict[str, float | None]] = []
    for drag in sorted({0.0, parameters.drag, DRAG}) if energy else ():
        earning = drag + (loop.device_friction or 0.0)
        way, start = energy / earning if earning > 0.0 else None, None
        if way is not None and _FURTHER * way <= _LONGEST_WAY[axis.parameters.unit]:
            tried = replace(bench, case=replace(bench.case, parameters=asks.model_copy(update={"drag": drag})))
            start = _start_speed(tried, wall, replace(comes, free=max(comes.free, _FURTHER * way)))
        rows.append({"drag": drag, "energy": energy, "way": way, "start_speed": start})
    return rows


def _certified(axis: AxisScene, push: float) -> float | None:
    """Return the stiffness that the hand-force certificate covers at a push; None if no hand force is declared."""
    force, loop = getattr(axis.passivity.parameters, "hand_force", None), axis.loop
    if force is None or loop.moving_mass is None:
        return None
    pull, most = force + (loop.device_friction_bound or 0.0), loop.device_damping_bound or 0.0
    least = loop.device_damping or 0.0
    response = displacement_response(loop.sample_time, loop.moving_mass, pull, least, most, timing=loop.timing)
    return renderable_by_hand_force(response, loop.delay, push)


def _start_speed(bench: Bench, wall: SpringDamperWall, comes: SlowHand) -> float | None:
    """Return the speed of approach [m/s or rad/s] from which the wall holds the hand; None if it never does."""

    def is_held(speed: float) -> bool:
        hand = replace(comes, speed=speed)
        ideal = comes.into * comes.stiffness / (comes.stiffness + wall.stiffness)
        lacking = comes.into - enter(bench, wall, hand).depth
        return lacking >= _HELD * (comes.into - ideal)

    slow, fast = (part * comes.speed for part in _SPEEDS)
    if is_held(slow):
        return slow
    if not is_held(fast):
        return None
    for _ in range(_HALVINGS):
        middle = (slow * fast) ** 0.5
        slow, fast = (slow, middle) if is_held(middle) else (middle, fast)
    return fast
