"""The environment sampled as it is: state and velocity straight from the position, no protection.

`unprotected` is this and nothing else; `passivity_observer` and `energy_bounding` act on its torque. What sampling
creates is booked as `gen`, what it loses as `leak`, so that the account closes like every other.
"""

from dataclasses import dataclass
from typing import NamedTuple

from canhaptic.control.balance import Branch
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.hold_account import Axis, AxisMemory, Hold, begin
from canhaptic.kernels import new

_FREE, _START, _EXACT, _EXIT = Branch.FREE.value, Branch.START.value, Branch.EXACT.value, Branch.EXIT.value


@dataclass(slots=True)
class SampledModel:
    """The true state of an environment, and the state that is rendered."""

    zone: int = 0  # of contact
    true: float = 0.0  # [m or rad]
    state: float = 0.0  # rendered [m or rad]
    h_s: float = 0.0  # energy stored at `state` [J]


class Asked(NamedTuple):
    """What the sampled environment did in one hold, and asks for in the next."""

    branch: int
    h_r: float  # [J]
    touches: bool  # whether the next command carries a torque
    spring: float  # effort of the storage for the next hold [N or N*m]
    damper: float  # effort of the damper for the next hold [N or N*m]
    damping: float  # of that damper, 0 out of contact [N*s/m or N*m*s/rad]


def begin_model(environment: Environment, axis: Axis, model: SampledModel, memory: AxisMemory, position: float) -> None:
    """Takes the first position [m or rad]; a state that is displaced there stores energy that never came in."""
    begin(axis, memory, position)
    model.zone = environment.contact(position)
    model.true = environment.true_state(position, 0.0, 0.0) if model.zone else 0.0
    model.state = model.h_s = 0.0


def follow(environment: Environment, model: SampledModel, position: float, hold: Hold) -> Asked:
    """Follows one hold and returns what it dissipated and the efforts for the next; `settle` must follow.

    Args:
        environment: The environment sampled.
        model: Its true state moves.
        position: At the end of the hold [m or rad].
        hold: As it was opened.
    """
    before, displacement, damper = model.true, hold.displacement, hold.damper
    zone, zone_before = environment.contact(position), model.zone
    model.zone = zone
    if zone == 0:
        h_r = 0.0
        if zone_before:
            h_r = max(0.0, damper * (environment.admissible(before + displacement, before) - before))
        model.true = 0.0
        branch = _EXIT if zone_before or hold.h_i != 0.0 or model.h_s != 0.0 else _FREE
        return new(Asked, (branch, h_r, False, 0.0, 0.0, 0.0))
    entered = zone != zone_before
    state = environment.true_state(position, displacement, 0.0 if entered else before)
    before = environment.admissible(state - displacement if entered else before, state)
    h_r = max(0.0, damper * (state - before))
    if environment.relaxes:
        strained = environment.stored_energy(state)
        state = environment.relaxed(state, hold.elapsed)
        h_r += strained - environment.stored_energy(state)
    model.true = state
    damping = environment.damping
    spring, damper = environment.effort(state), damping * hold.velocity
    return new(Asked, (_START if entered else _EXACT, h_r, True, spring, damper, damping))


def settle(environment: Environment, model: SampledModel, share: float, h_m: float, h_r: float) -> tuple[float, float]:
    """Stores the state that is rendered and closes the account; returns (gen, leak) [J].

    Args:
        environment: The environment sampled.
        model: Its rendered state moves.
        share: Part of the model's effort that is rendered in the next hold, 0..1.
        h_m: Energy the model received in this hold [J].
        h_r: Energy dissipated in it [J].
    """
    model.state = state = model.true if share == 1.0 else share * model.true
    before = model.h_s
    model.h_s = h_s = environment.stored_energy(state)
    rest = before + h_m - h_r - h_s
    return max(0.0, -rest), max(0.0, rest)
