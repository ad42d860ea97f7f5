"""A slow hand that enters a wall and stops there: its depth at rest, and the drag before.

The hand is a spring whose outer end moves at a constant speed through free space and then into the wall, and stops. The
handle begins with that speed, so that it does not swing on the spring.
"""

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from canhaptic.control.certificates.scalar_bounds import DisplacementResponse, renderable_by_hand_force
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.lab.figures.guided import Leg, guided_case
from canhaptic.lab.figures.guided_hand import GuidedHand
from canhaptic.lab.figures.held import Bench
from canhaptic.lab.loop.axis_loop import LoopRun, Recorder, render

_HALVINGS: Final = 60


@dataclass(frozen=True, slots=True)
class SlowHand:
    """A spring with a moving end, towards a wall at the origin."""

    speed: float  # [m/s or rad/s]
    stiffness: float = 300.0  # [N/m or N*m/rad]
    damping: float = 0.0  # [N*s/m or N*m*s/rad]
    free: float = 0.05  # way in free space [m or rad]
    into: float = 0.03  # way into the wall [m or rad]
    settling: float = 3.0  # after the stop [s]
    rest: float = 1.0  # of that, over which depth is taken [s]


class Entered(NamedTuple):
    """Result of a slow hand."""

    depth: float  # mean, at rest [m or rad]
    drag: float  # largest |torque| before the surface [N or N*m]
    least: float  # least true sum of h_i [J]
    run: LoopRun


def enter(bench: Bench, wall: SpringDamperWall, hand: SlowHand) -> Entered:
    """Result of a slow hand at a wall that is solid below the origin."""
    period, way = bench.case.sample_time_ns * 1e-9, hand.free + hand.into
    moving = max(1, round(way / hand.speed / period)) * period  # it stops with a SYNC
    speed = way / moving
    plant = bench.plant.model_copy(update={"initial_position": hand.free, "initial_velocity": -speed})
    course = (Leg(0.0, speed=-speed), Leg(moving))
    guided = GuidedHand(stiffness=hand.stiffness, damping=hand.damping, place=hand.free)
    case = guided_case(replace(bench.case, environment=wall), plant, guided, course, bench.effects, bench.seed)
    run = render(case, round((moving + hand.settling) / period), Recorder(furthest=1.0))
    if run.ended:
        return Entered(float("nan"), float("nan"), run.least_interaction, run)
    inside = np.flatnonzero(run.true_position < 0.0)
    before = run.torque[: int(inside[0])] if len(inside) else run.torque
    depth = -float(run.true_position[-max(2, round(hand.rest / period)) :].mean())
    return Entered(depth, float(np.abs(before).max(initial=0.0)), run.least_interaction, run)


def certified_rest(response: DisplacementResponse, delay: int, hand: SlowHand) -> tuple[float, float]:
    """Depth [m or rad] and stiffness at which the hand rests on the force held by the hand-force certificate.

    The certificate holds the stiffness c F / (F + F_h) at a force F. With the force K (s - x) of a spring K that ends
    at s, the depth x has c x = F + F_h. Where it lies beyond s, the spring is too weak to be held: the depth is s, and
    the stiffness is 0.

    Args:
        response: Displacement response of the axis.
        delay: Delay in whole holds.
        hand: The hand.
    """

    def lacking(depth: float) -> float:
        force = hand.stiffness * (hand.into - depth)
        return force - renderable_by_hand_force(response, delay, force) * depth

    shallow, deep = 0.0, hand.into * (1.0 - 1e-9)
    if lacking(deep) > 0.0:
        return hand.into, 0.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (shallow + deep)
        shallow, deep = (middle, deep) if lacking(middle) > 0.0 else (shallow, middle)
    return deep, hand.stiffness * (hand.into - deep) / deep
