"""The common step of `a_priori_dissipation` and `internal_dissipation`, which render a stored state.

They differ in how a hold changes the state, `touch` and `exchange`. The rest of the step is here: how a hold is opened,
and which command follows from the state.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Generic

from canhaptic.control.balance import AT_REST, Certificate, EnergyBalance
from canhaptic.control.environments.environment import Environment
from canhaptic.control.environments.plain import plain
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.hold_account import (
    Axis,
    AxisMemory,
    Hold,
    HoldAccount,
    HoldSettings,
    begin,
    close_hold,
    hold_memory,
    hold_settings,
    open_hold,
    surplus_after,
)
from canhaptic.control.passivity.storage import UNTOUCHED, Storage, begin_storage, follow, is_deadlocked, leave
from canhaptic.control.recovery import Alpha, damping_cap, modulated_damping
from canhaptic.control.velocity import DamperVelocity
from canhaptic.kernels import GivenT, Kernel, Run
from canhaptic.kernels.binding import filled


class StoredModelParameters(DamperVelocity):
    """Velocity of the damper, and recovery of the surplus."""

    alpha: Alpha = 0.0
    """Modulated damping per joule of surplus (eq. 19), always with its unit; 0: the surplus is not removed."""


@dataclass(frozen=True, slots=True)
class StoredModelSettings(Generic[GivenT]):
    """Constants of a run."""

    given: GivenT  # parameters of the algorithm; a kernel reads their numbers alone
    cap: float  # of the damping [N*s/m or N*m*s/rad]
    damping: float  # of the model [N*s/m or N*m*s/rad]
    is_linear: bool  # whether the storage is k x^2 / 2
    stiffness: float  # k, where it is [N/m or N*m/rad]
    stores: bool  # whether it stores anything
    hold: HoldSettings


@dataclass(slots=True)
class StoredModelState:
    """State kept from SYNC to SYNC; an algorithm adds its own fields."""

    axis: Axis = field(default_factory=Axis)
    storage: Storage = field(default_factory=Storage)


def stored_model_settings(
    environment: Environment, parameters: StoredModelParameters, loop: LoopProperties
) -> StoredModelSettings[Any]:
    """Constants of a run.

    Raises:
        ParameterError: A windowed velocity without an encoder count.
    """
    cap = damping_cap(loop.delay, loop.moving_mass, loop.sample_time)
    stiffness = environment.linear_stiffness
    return StoredModelSettings(
        given=plain(parameters),
        cap=cap,
        damping=min(environment.damping, cap),
        is_linear=stiffness is not None,
        stiffness=stiffness or 0.0,
        stores=stiffness != 0.0,
        hold=hold_settings(parameters, loop, Certificate.NONE),
    )


def dissipation(settings: StoredModelSettings[Any], hold: Hold) -> float:
    """Return T d v^2 of a hold with the velocity inside the torque that was applied in it [J] (eqs. 6, 18)."""
    return hold.elapsed * (hold.damper * hold.damper) / settings.damping if settings.damping != 0.0 else 0.0


def touch(
    environment: Environment, settings: StoredModelSettings[Any], state: Any, hold: Hold, entered: bool
) -> HoldAccount:
    """Placeholder of an algorithm: its account of a hold that ended in contact."""
    raise NotImplementedError


def exchange(environment: Environment, settings: StoredModelSettings[Any], storage: Storage, hold: Hold) -> HoldAccount:
    """Placeholder of an algorithm: its account of a hold with stored energy, or of one that left the contact."""
    raise NotImplementedError


def step(
    environment: Environment,
    run: Run[StoredModelSettings[Any], StoredModelState, AxisMemory],
    position: float,
    torque_applied: float,
) -> EnergyBalance:
    """Account for the hold that ended; see `Controller.step`."""
    settings, state, memory = run.settings, run.state, run.memory
    axis, storage = state.axis, state.storage
    if not axis.started:
        begin(axis, memory, position)
        begin_storage(environment, storage, position)
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


def stored_model_kernel(
    state: Callable[[], StoredModelState],
    touch_as: Callable[..., HoldAccount],
    exchange_as: Callable[..., HoldAccount],
) -> Kernel:
    """Return the kernel of an algorithm with these functions in the place of `touch` and `exchange`."""
    return Kernel(stored_model_settings, state, hold_memory, filled(step, touch=touch_as, exchange=exchange_as))


def close(
    environment: Environment,
    settings: StoredModelSettings[Any],
    axis: Axis,
    memory: AxisMemory,
    storage: Storage,
    hold: Hold,
    account: HoldAccount,
) -> EnergyBalance:
    """Send spring, damper and the modulated damper of eq. 19, and return the balance of the hold.

    Args:
        environment: The environment rendered.
        settings: Constants of the run.
        axis: Its surplus and commands change.
        memory: Buffers of the axis.
        storage: Storage after the hold.
        hold: The hold as it was opened.
        account: Account of the hold by the algorithm.
    """
    state, h_s = storage.state, storage.h_s
    if not storage.zone:
        return close_hold(settings.hold, axis, memory, hold, account, (0.0, 0.0, 0.0), 0.0, state, h_s)
    measured = settings.hold.tolerance > 0.0 and not (settings.stores and is_deadlocked(storage))
    rendered, modulated = settings.damping, 0.0
    damper = rendered * (hold.velocity if measured else storage.velocity)
    if settings.given.alpha > 0.0:
        surplus = surplus_after(axis, hold, account)[0]
        extra = modulated_damping(
            settings.given.alpha, surplus, rendered, settings.cap, hold.displacement, hold.elapsed
        )
        modulated = extra * hold.displacement / hold.elapsed
        rendered += extra
    efforts = environment.effort(state), damper, modulated
    return close_hold(settings.hold, axis, memory, hold, account, efforts, rendered, state, h_s)
