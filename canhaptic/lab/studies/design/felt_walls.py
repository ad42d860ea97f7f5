"""What the hand of a scene will feel of walls on its rig: the stiffness held, drag, and the speed of a contact.

held    the largest wall within the tolerance at rest, for a push that rises slowly to a part of the torque limit
drag    the largest torque in front of a wall, against a hand that comes at an ordinary speed
start   the least speed of a hand on a spring that is held by the wall, instead of going through as if there were
        none; what a hand comes to rest against is at least half of what the ideal wall would press with
drags   that again for drags that may be declared, after the way over which drag and certain friction of the device earn
        the energy of a start
"""

from dataclasses import replace
from typing import Any, Final

from canhaptic.control.certificates.scalar_bounds import displacement_response, renderable_by_hand_force
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity.guarded_settings import GuardedParameters, hand_response, kept_for_contacts
from canhaptic.lab.figures.held import Bench, Leaning, largest_held, settling_time
from canhaptic.lab.figures.slow_hand import SlowHand, enter
from canhaptic.lab.loop.algorithms import able_under
from canhaptic.lab.loop.scenes import loop_case, plant_parts
from canhaptic.scene.hints import DRAG, LEAN
from canhaptic.scene.models import AxisScene, Scene

_PUSHES: Final = (0.5 * LEAN, LEAN, 2.0 * LEAN)
"""Pushes, as parts of the torque limit."""
_DEEPEST: Final = 0.1
"""Depth [m or rad] of the softest wall that is tried."""
_STIFFEST: Final = 4.0
"""Over m / T^2: beyond it no wall is held by any certificate."""
_ORDINARY: Final = {"m": 0.15, "rad": 1.5}
"""Speed of a hand [m/s or rad/s]."""
_SPEEDS: Final = (0.1, 10.0)
"""Slowest and fastest contact tried, over the ordinary speed."""
_HALVINGS: Final = 5
_HELD: Final = 0.5
_LONGEST: Final = 5.0  # leaning [s]
_FURTHER: Final = 1.25
"""Way in front of a wall, over the one in which the energy of a start is earned."""
_FURTHEST: Final = {"m": 0.5, "rad": 5.0}
"""Longest way tried [m or rad]."""


def felt_of(scene: Scene, algorithm: str, hand: dict[str, float], tolerance: float, stiffness: float) -> dict[str, Any]:
    """Return what is felt on the rig of a scene, as plain values.

    Args:
        scene: Scene of one simulated axis, with a wall.
        algorithm: Name of the algorithm that renders.
        hand: Stiffness and damping of its grip [N/m, N*s/m or N*m/rad, N*m*s/rad].
        tolerance: How far a stiffness may be from what is asked, as a part of it.
        stiffness: Stiffness of the wall that is entered slowly [N/m or N*m/rad].
    """
    able = able_under(scene.axes[0], algorithm, scene)
    axis, limit = able.axis, able.axis.parameters.torque_limit
    plant, _, effects, seed = plant_parts(axis)
    bench = Bench(loop_case(axis, scene), plant, effects, seed)
    period, speed = scene.bus.sample_time, _ORDINARY[axis.parameters.unit]
    duration = min(_LONGEST, 1.0 + settling_time(plant.mass, plant.damping + hand["damping"]))
    walls = []
    for push in (part * limit for part in _PUSHES):
        leaning = Leaning(
            push, duration=duration, tolerance=tolerance, damping=hand["damping"], per_decade=5, fine=0.02
        )
        found = largest_held(bench, leaning, push / _DEEPEST, _STIFFEST * plant.mass / period**2)
        walls.append({"push": push, "held": found.stiffness, "certified": _certified(axis, push)})
        walls[-1] |= {"softer": found.softer, "softer_not_held": found.failing}
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
    """Return what drags earn: nothing where a contact of any speed is felt without, or hand or mass are not known."""
    parameters, loop = bench.case.parameters, axis.loop
    if not isinstance(parameters, GuardedParameters):
        return []
    asks = parameters.model_copy(update={"earned_energy": None, "drag": 0.0})
    energy = kept_for_contacts(wall, asks, loop, hand_response(asks, loop))
    if energy == 0.0:
        return []
    rows: list[dict[str, float | None]] = []
    for drag in sorted({0.0, parameters.drag, DRAG}):
        earning = drag + (loop.device_friction or 0.0)
        way = energy / earning if earning > 0.0 else None
        start = None
        if way is not None and _FURTHER * way <= _FURTHEST[axis.parameters.unit]:
            tried = replace(bench, case=replace(bench.case, parameters=asks.model_copy(update={"drag": drag})))
            start = _start_speed(tried, wall, replace(comes, free=max(comes.free, _FURTHER * way)))
        rows.append({"drag": drag, "energy": energy, "way": way, "start_speed": start})
    return rows


def _certified(axis: AxisScene, push: float) -> float | None:
    """Return the stiffness that the hand-force certificate holds at a push; None where it is not declared."""
    force, loop = getattr(axis.passivity.parameters, "hand_force", None), axis.loop
    if force is None or loop.moving_mass is None:
        return None
    pull, most = force + (loop.device_friction_bound or 0.0), loop.device_damping_bound or 0.0
    least = loop.device_damping or 0.0
    response = displacement_response(loop.sample_time, loop.moving_mass, pull, least, most, timing=loop.timing)
    return renderable_by_hand_force(response, loop.delay, push)


def _start_speed(bench: Bench, wall: SpringDamperWall, comes: SlowHand) -> float | None:
    """Return the least speed tried [m/s or rad/s] that is held, as every faster one tried; None where none is."""

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
