from dataclasses import dataclass, field
from typing import ClassVar, Literal

from canhaptic.control.balance import AT_REST, EnergyBalance
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.kernels import MakeBuffer
from canhaptic.units import Parameters
from tests.control.old_forms.hold_account import Axis, AxisMemory, Hold, HoldAccount, begin, hold_memory, open_hold
from tests.control.old_forms.kernel import Kernel
from tests.control.old_forms.stepped import SteppedController
from tests.control.old_forms.storage import (
    UNTOUCHED,
    Storage,
    approximate,
    begin_storage,
    empty,
    entered_by,
    follow,
    is_deadlocked,
    leave,
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


class APrioriDissipationParameters(StoredModelParameters):
    rearm: Literal["printed", "displacement"] = "printed"


@dataclass(frozen=True, slots=True)
class _APrioriDissipationSettings:
    rearms_as_printed: bool
    model: StoredModelSettings


@dataclass(slots=True)
class _APrioriDissipationState:
    axis: Axis = field(default_factory=Axis)
    storage: Storage = field(default_factory=Storage)
    met: bool = False


def settings_of(
    environment: Environment, parameters: APrioriDissipationParameters, loop: LoopProperties
) -> _APrioriDissipationSettings:
    return _APrioriDissipationSettings(
        parameters.rearm == "printed", stored_model_settings(environment, parameters, loop)
    )


def memory_of(settings: _APrioriDissipationSettings, make_buffer: MakeBuffer) -> AxisMemory:
    return hold_memory(settings.model, make_buffer)


def step(
    environment: Environment,
    settings: _APrioriDissipationSettings,
    state: _APrioriDissipationState,
    memory: AxisMemory,
    position: float,
    torque_applied: float,
) -> EnergyBalance:
    axis, storage = (state.axis, state.storage)
    if not axis.started:
        begin(axis, memory, position)
        begin_storage(environment, storage, position)
        return AT_REST
    hold = open_hold(settings.model.hold, axis, memory, position, torque_applied)
    changed = follow(environment, storage, position, hold.displacement, hold.elapsed)
    if storage.zone:
        account = touch(environment, settings, state, hold, changed)
    elif changed or hold.h_i != 0.0:
        account = leave(storage, update(environment, settings, storage, hold))
    else:
        account = UNTOUCHED
    return close(environment, settings.model, axis, memory, storage, hold, account)


def touch(
    environment: Environment,
    settings: _APrioriDissipationSettings,
    state: _APrioriDissipationState,
    hold: Hold,
    entered: bool,
) -> HoldAccount:
    storage, displacement = (state.storage, hold.displacement)
    state.met = state.met or entered
    if entered or (is_deadlocked(storage) and pushed_inward(environment, storage, displacement)):
        printed = settings.rearms_as_printed and state.met and (not entered)
        state.met = True
        change = storage.true if printed else entered_by(environment, storage, displacement)
        return start(environment, storage, change, hold.elapsed, hold.h_i - hold.h_pas)
    return update(environment, settings, storage, hold)


def update(
    environment: Environment, settings: _APrioriDissipationSettings, storage: Storage, hold: Hold
) -> HoldAccount:
    lost = dissipation(settings.model, hold)
    account = approximate(environment, storage, hold.elapsed, lost, hold.h_i - hold.h_pas)
    if storage.h_s == 0.0:
        empty(storage)
    return account


class APrioriDissipation(SteppedController):
    parameters_type: ClassVar[type[Parameters]] = APrioriDissipationParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, _APrioriDissipationState, memory_of, step)
