"""One linear plant and one controller in one loop, from SYNC to SYNC: a kernel, and what it shares with other loops.

The order and the rounding are those of `direct_rig.DirectRig` and `canhaptic.study.loop.render`; the plant moves by
the exact flow of one hold, its rows summed term by term.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf, isfinite
from typing import Any

from canhaptic.control.environments.environment import Environment
from canhaptic.kernels import Buffer
from canhaptic.study.batch.meter import Meter, MeterSettings, compare, take
from canhaptic.study.batch.reference_kernel import (
    ReferenceMemory,
    ReferenceSettings,
    ReferenceState,
    begin_reference,
    follow_hold,
)


@dataclass(frozen=True, slots=True)
class LoopSettings:
    """What lies between plant and controller."""

    delay: int = 0  # whole holds between computing a torque and its hold, 0 or 1
    counts_per_unit: float = 0.0  # of the encoder; 0: ideal
    torque_quantum: float = 0.0  # step of the command; 0: ideal [N or N*m]
    torque_limit: float = inf  # of the drive [N or N*m]
    furthest: float = inf  # distance from the origin that counts as divergence [m or rad]
    meter: MeterSettings = field(default_factory=MeterSettings)


def measured(loop: LoopSettings, position: float) -> float:
    """Returns a position as the encoder reports it [m or rad]."""
    if loop.counts_per_unit == 0.0:
        return position
    return round(position * loop.counts_per_unit) * (1.0 / loop.counts_per_unit)


def commanded(loop: LoopSettings, torque: float) -> float:
    """Returns a torque as the drive applies it [N or N*m]."""
    if abs(torque) > loop.torque_limit:
        torque = loop.torque_limit if torque > 0.0 else -loop.torque_limit
    return torque if loop.torque_quantum == 0.0 else round(torque / loop.torque_quantum) * loop.torque_quantum


def step(
    environment: Environment, settings: Any, state: Any, memory: Any, position: float, torque_applied: float
) -> Any:
    """Stands for the kernel of an algorithm, which whoever runs `run_loop` gives in its place."""
    raise NotImplementedError


def run_loop(
    environment: Environment,
    settings: Any,
    loop: LoopSettings,
    state: Any,
    memory: Any,
    meter: Meter,
    flow: Sequence[Sequence[float]],
    plant: Buffer,
    moved: Buffer,
    continuous: ReferenceSettings,
    reference: ReferenceState,
    reference_memory: ReferenceMemory,
    cycles: int,
) -> None:
    """Runs a loop until its last SYNC or until it diverges, which a number that is not finite does too.

    Args:
        environment: That is rendered.
        settings: Of the algorithm.
        loop: Between plant and controller.
        state: Of the algorithm, at rest.
        memory: Of the algorithm, zeros.
        meter: Gathers the figures.
        flow: Of the plant over one hold, shape (states, states + 2).
        plant: [states..., torque, 1] at the start; the first state is the position [m or rad].
        moved: Room for the states, shape (states,).
        continuous: Environment that the loop is compared with, if there is one.
        reference: Its run, before it begins.
        reference_memory: Of that, at the start.
        cycles: SYNCs.
    """
    held = waiting = interaction = before = 0.0
    for cycle in range(cycles):
        if cycle:
            move(flow, plant, moved, held)
        true_position = plant[0]
        if continuous.exists:
            mean = 0.0
            if cycle:
                mean = follow_hold(continuous, reference, reference_memory)
            else:
                begin_reference(continuous, reference, reference_memory)
            compare(meter, true_position, held, reference_memory.state[0], mean)
        interaction -= held * (true_position - before)
        before = true_position
        position = measured(loop, true_position) if isfinite(true_position) else true_position
        if not isfinite(position - state.axis.position + held):
            meter.diverged = 1.0
            break
        balance = step(environment, settings, state, memory, position, held)
        if not isfinite(balance.torque):
            meter.diverged = 1.0
            break
        take(environment, loop.meter, meter, position, true_position, held, interaction, balance)
        if not -loop.furthest < true_position < loop.furthest:
            meter.diverged = 1.0
            break
        command = commanded(loop, balance.torque)
        if loop.delay:
            held, waiting = waiting, command
        else:
            held = command


def states_in(moved: Buffer) -> int:
    """Returns the number of states; compiled it is a constant, so that loops over them are unrolled."""
    return len(moved)


def move(flow: Sequence[Sequence[float]], plant: Buffer, moved: Buffer, torque: float) -> None:
    """Moves a plant by one hold of constant torque [N or N*m]."""
    states = states_in(moved)
    plant[states] = torque
    for row in range(states):
        factors, total = flow[row], 0.0
        for column in range(states + 2):
            total += factors[column] * plant[column]
        moved[row] = total
    for row in range(states):
        plant[row] = moved[row]
