from dataclasses import dataclass

from canhaptic.control.balance import Certificate, EnergyBalance
from canhaptic.control.damping import Alpha, DamperVelocity, damping_cap, modulated_damping
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from tests.control.old_forms.hold_account import (
    Axis,
    AxisMemory,
    Hold,
    HoldAccount,
    HoldSettings,
    close_hold,
    hold_settings,
    surplus_after,
)
from tests.control.old_forms.storage import Storage, is_deadlocked


class StoredModelParameters(DamperVelocity):
    alpha: Alpha = 0.0


@dataclass(frozen=True, slots=True)
class StoredModelSettings:
    cap: float
    damping: float
    alpha: float
    windowed: bool
    is_linear: bool
    stiffness: float
    stores: bool
    hold: HoldSettings


def stored_model_settings(
    environment: Environment, parameters: StoredModelParameters, loop: LoopProperties
) -> StoredModelSettings:
    cap = damping_cap(loop.delay, loop.moving_mass, loop.sample_time)
    stiffness = environment.linear_stiffness
    return StoredModelSettings(
        cap=cap,
        damping=min(environment.damping, cap),
        alpha=parameters.alpha,
        windowed=parameters.velocity == "windowed",
        is_linear=stiffness is not None,
        stiffness=stiffness or 0.0,
        stores=stiffness != 0.0,
        hold=hold_settings(parameters, loop, Certificate.NONE),
    )


def dissipation(settings: StoredModelSettings, hold: Hold) -> float:
    return hold.elapsed * (hold.damper * hold.damper) / settings.damping if settings.damping != 0.0 else 0.0


def close(
    environment: Environment,
    settings: StoredModelSettings,
    axis: Axis,
    memory: AxisMemory,
    storage: Storage,
    hold: Hold,
    account: HoldAccount,
) -> EnergyBalance:
    state, h_s = (storage.state, storage.h_s)
    if not storage.zone:
        return close_hold(settings.hold, axis, memory, hold, account, (0.0, 0.0, 0.0), 0.0, state, h_s)
    measured = settings.windowed and (not (settings.stores and is_deadlocked(storage)))
    rendered, modulated = (settings.damping, 0.0)
    damper = rendered * (hold.velocity if measured else storage.velocity)
    if settings.alpha > 0.0:
        surplus = surplus_after(axis, hold, account)[0]
        extra = modulated_damping(settings.alpha, surplus, rendered, settings.cap, hold.displacement, hold.elapsed)
        modulated = extra * hold.displacement / hold.elapsed
        rendered += extra
    efforts = (environment.effort(state), damper, modulated)
    return close_hold(settings.hold, axis, memory, hold, account, efforts, rendered, state, h_s)
