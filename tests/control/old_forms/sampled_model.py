from dataclasses import dataclass
from typing import NamedTuple

from canhaptic.control.balance import Branch
from canhaptic.control.environments.environment import Environment
from canhaptic.kernels import new
from tests.control.old_forms.hold_account import Axis, AxisMemory, Hold, begin

_FREE, _START, _EXACT, _EXIT = (Branch.FREE.value, Branch.START.value, Branch.EXACT.value, Branch.EXIT.value)


@dataclass(slots=True)
class SampledModel:
    zone: int = 0
    true: float = 0.0
    state: float = 0.0
    h_s: float = 0.0


class ModelStep(NamedTuple):
    branch: int
    h_r: float
    contact: bool
    spring: float
    damper: float


def begin_model(environment: Environment, axis: Axis, model: SampledModel, memory: AxisMemory, position: float) -> None:
    begin(axis, memory, position)
    model.zone = environment.contact(position)
    model.true = environment.true_state(position, 0.0, 0.0) if model.zone else 0.0
    model.state = model.h_s = 0.0


def follow(environment: Environment, model: SampledModel, position: float, hold: Hold) -> ModelStep:
    before, displacement, damper = (model.true, hold.displacement, hold.damper)
    zone, zone_before = (environment.contact(position), model.zone)
    model.zone = zone
    if zone == 0:
        h_r = 0.0
        if zone_before:
            h_r = max(0.0, damper * (environment.admissible(before + displacement, before) - before))
        model.true = 0.0
        branch = _EXIT if zone_before or hold.h_i != 0.0 or model.h_s != 0.0 else _FREE
        return new(ModelStep, (branch, h_r, False, 0.0, 0.0))
    entered = zone != zone_before
    state = environment.true_state(position, displacement, 0.0 if entered else before)
    before = environment.admissible(state - displacement if entered else before, state)
    h_r = max(0.0, damper * (state - before))
    if environment.relaxes:
        strained = environment.stored_energy(state)
        state = environment.relaxed(state, hold.elapsed)
        h_r += strained - environment.stored_energy(state)
    model.true = state
    spring, damper = (environment.effort(state), environment.damping * hold.velocity)
    return new(ModelStep, (_START if entered else _EXACT, h_r, True, spring, damper))


def settle(environment: Environment, model: SampledModel, share: float, h_m: float, h_r: float) -> tuple[float, float]:
    model.state = state = model.true if share == 1.0 else share * model.true
    before = model.h_s
    model.h_s = h_s = environment.stored_energy(state)
    rest = before + h_m - h_r - h_s
    return (max(0.0, -rest), max(0.0, rest))
