"""The environment at a state whose energy is paid for: for `a_priori_dissipation` and `internal_dissipation`.

They differ in how a hold changes the state. How a hold is opened, and which command follows from the state, is here.
"""

from dataclasses import dataclass

from canhaptic.control.balance import Certificate, EnergyBalance
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.hold_account import (
    Axis,
    AxisMemory,
    Hold,
    HoldAccount,
    HoldSettings,
    close_hold,
    hold_settings,
    surplus_after,
)
from canhaptic.control.passivity.storage import Storage, is_deadlocked
from canhaptic.control.recovery import Alpha, damping_cap, modulated_damping
from canhaptic.control.velocity import DamperVelocity


class StoredModelParameters(DamperVelocity):
    """Velocity of the damper, and recovery of the surplus."""

    alpha: Alpha = 0.0
    """Modulated damping per joule of surplus (eq. 19), always with its unit; 0: the surplus is not removed."""


@dataclass(frozen=True, slots=True)
class StoredModelSettings:
    """Constants of a run."""

    cap: float  # of the damping [N*s/m or N*m*s/rad]
    damping: float  # of the model [N*s/m or N*m*s/rad]
    alpha: float  # [s/m^2 or s/rad^2]
    windowed: bool  # whether the damper uses the velocity of the window
    is_linear: bool  # whether the storage is k x^2 / 2
    stiffness: float  # k, where it is [N/m or N*m/rad]
    stores: bool  # whether it stores anything
    hold: HoldSettings


def stored_model_settings(
    environment: Environment, parameters: StoredModelParameters, loop: LoopProperties
) -> StoredModelSettings:
    """Returns what is fixed for a run.

    Raises:
        ParameterError: A windowed velocity without an encoder count.
    """
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
    """Returns T d v^2 of a hold with the velocity inside the torque that was applied in it [J] (eqs. 6, 18)."""
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
    """Sends spring, damper and the modulated damper of eq. 19, and returns the balance of the hold.

    Args:
        environment: That is rendered.
        settings: Of the run.
        axis: Its surplus and commands change.
        memory: Of the axis.
        storage: After the hold.
        hold: As it was opened.
        account: What the algorithm did with it.
    """
    state, h_s = storage.state, storage.h_s
    if not storage.zone:
        return close_hold(settings.hold, axis, memory, hold, account, (0.0, 0.0, 0.0), 0.0, state, h_s)
    measured = settings.windowed and not (settings.stores and is_deadlocked(storage))
    rendered, modulated = settings.damping, 0.0
    damper = rendered * (hold.velocity if measured else storage.velocity)
    if settings.alpha > 0.0:
        surplus = surplus_after(axis, hold, account)[0]
        extra = modulated_damping(settings.alpha, surplus, rendered, settings.cap, hold.displacement, hold.elapsed)
        modulated = extra * hold.displacement / hold.elapsed
        rendered += extra
    efforts = environment.effort(state), damper, modulated
    return close_hold(settings.hold, axis, memory, hold, account, efforts, rendered, state, h_s)
