from dataclasses import dataclass, field
from math import copysign, isnan
from typing import ClassVar, Final

from canhaptic.control.balance import AT_REST, Branch, EnergyBalance
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.stored_model import Balance, solve_balance, solve_balance_nonlinear
from canhaptic.kernels import new
from canhaptic.units import Parameters
from tests.control.old_forms.hold_account import Axis, AxisMemory, Hold, HoldAccount, begin, hold_memory, open_hold
from tests.control.old_forms.kernel import Kernel
from tests.control.old_forms.stepped import SteppedController
from tests.control.old_forms.storage import (
    UNTOUCHED,
    Storage,
    approximate,
    begin_storage,
    entered_by,
    follow,
    is_deadlocked,
    leave,
    move,
    pushed_inward,
    start,
)
from tests.control.old_forms.stored_model import (
    StoredModelParameters,
    StoredModelSettings,
    close,
    dissipation,
    stored_model_settings,
)

_ROUNDING: Final = 2.5e-16
_EXACT, _STICKY = (Branch.EXACT.value, Branch.STICKY.value)


class InternalDissipationParameters(StoredModelParameters):
    pass


@dataclass(slots=True)
class _InternalDissipationState:
    axis: Axis = field(default_factory=Axis)
    storage: Storage = field(default_factory=Storage)
    blind: int = 0


def step(
    environment: Environment,
    settings: StoredModelSettings,
    state: _InternalDissipationState,
    memory: AxisMemory,
    position: float,
    torque_applied: float,
) -> EnergyBalance:
    axis, storage = (state.axis, state.storage)
    if not axis.started:
        begin(axis, memory, position)
        begin_storage(environment, storage, position)
        state.blind = 0
        return AT_REST
    hold = open_hold(settings.hold, axis, memory, position, torque_applied)
    changed = follow(environment, storage, position, hold.displacement, hold.elapsed)
    if storage.zone:
        account = touch(environment, settings, state, hold, changed)
    elif changed or hold.h_i != 0.0:
        account = leave(storage, exchange(environment, settings, storage, hold))
    else:
        account = UNTOUCHED
    return close(environment, settings, axis, memory, storage, hold, account)


def touch(
    environment: Environment, settings: StoredModelSettings, state: _InternalDissipationState, hold: Hold, entered: bool
) -> HoldAccount:
    storage, displacement = (state.storage, hold.displacement)
    fresh = entered or is_deadlocked(storage)
    if fresh or state.blind:
        if entered or pushed_inward(environment, storage, displacement):
            state.blind = settings.hold.delay if fresh else state.blind - 1
            change = entered_by(environment, storage, displacement)
            return start(environment, storage, change, hold.elapsed, hold.h_i - hold.h_pas)
        state.blind = 0
    return exchange(environment, settings, storage, hold)


def exchange(environment: Environment, settings: StoredModelSettings, storage: Storage, hold: Hold) -> HoldAccount:
    damper, h_m = (hold.damper, hold.h_i - hold.h_pas)
    change = solve(environment, settings, storage, hold.displacement, damper, h_m)
    if damper * change < 0.0:
        damper = 0.0
        change = solve(environment, settings, storage, hold.displacement, 0.0, h_m)
    if isnan(change):
        return approximate(environment, storage, hold.elapsed, dissipation(settings, hold), h_m)
    furthest = 2.0 * abs(hold.displacement)
    limited = h_m > 0.0 and (abs(change) > furthest or not settings.is_linear)
    if limited and abs(change) > furthest:
        change = copysign(furthest, change)
    branch = _STICKY if h_m > 0.0 and change * storage.state < 0.0 else _EXACT
    h_r, leak = move(environment, storage, change, hold.elapsed, damper * change, h_m, limited)
    return new(HoldAccount, (branch, h_r, 0.0, 0.0, leak))


def solve(
    environment: Environment,
    settings: StoredModelSettings,
    storage: Storage,
    displacement: float,
    damper: float,
    h_m: float,
) -> float:
    if settings.is_linear:
        stiffness = settings.stiffness
        return solve_balance(stiffness, stiffness * storage.state + damper, h_m, displacement)
    old = Balance(storage.state, storage.h_s, damper)
    return solve_balance_nonlinear(environment, old, h_m, 2.0 * displacement, _ROUNDING * storage.h_s)


class InternalDissipation(SteppedController):
    parameters_type: ClassVar[type[Parameters]] = InternalDissipationParameters
    kernel: ClassVar[Kernel] = Kernel(stored_model_settings, _InternalDissipationState, hold_memory, step)
