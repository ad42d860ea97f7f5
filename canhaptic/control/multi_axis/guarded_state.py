"""Parameters, state and buffers of `guarded` of a group."""

from dataclasses import dataclass, field
from typing import NamedTuple

from canhaptic.control.multi_axis.account_memory import AccountMemory, account_memory
from canhaptic.control.multi_axis.group_account import AccountSettings, GroupAccount
from canhaptic.control.multi_axis.group_certificates import AxisLimits, axes_of
from canhaptic.control.multi_axis.group_kernel import Group, GroupLoop, GroupMemory, group_loop, group_memory
from canhaptic.control.multi_axis.group_motion import RequestedEfforts, World
from canhaptic.control.multi_axis.per_axis_memory import per_axis_limits
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.guarded_settings import GuardedParameters, calm_stiffness_of
from canhaptic.control.passivity.prediction import (
    PREDICTION_HOLDS,
    PredictedMotion,
    PredictionSettings,
    prediction_settings,
)
from canhaptic.errors import ParameterError
from canhaptic.kernels import Buffer, list_of_zeros


class GuardedGroupSettings(NamedTuple):
    """Constants of a run."""

    loop: GroupLoop
    account: AccountSettings
    credit: float  # energy that may be given out before any came in [J]
    alpha: float  # [s/m^2 or s/rad^2]
    lead: float  # prediction [holds]
    prediction: list[PredictionSettings]  # of each axis
    calm: Buffer  # stiffness of the largest spring that the rate renders, (axes,) [N/m or N*m/rad]
    damped: Buffer  # the same by the damping of the devices, (axes,); 0 where it is not declared [N/m or N*m/rad]
    path: float  # of the hand in the holds that a torque takes; 0 without a hand speed [m or rad]
    quanta: Buffer  # of the torque commands, (axes,); 0: ideal [N*m or N]
    quantised: bool


@dataclass(slots=True)
class GuardedGroupState:
    """State kept from SYNC to SYNC."""

    was_engaged: bool = False
    group: Group = field(default_factory=Group)
    account: GroupAccount = field(default_factory=GroupAccount)


class GuardedGroupMemory(NamedTuple):
    """Buffers of a group."""

    group: GroupMemory
    account: AccountMemory
    predicted: list[PredictedMotion]  # of each axis
    column: Buffer  # torques under way of one axis, (delay + 1,) [N*m or N]
    way: Buffer  # of the motors until the next torques act, (axes,) [rad or m]
    steady: Buffer  # the same by the last motion alone
    step: Buffer  # motion in a hold then
    wish: RequestedEfforts
    damper: Buffer  # efforts to be sent, (axes,) [N*m or N]
    modulated: Buffer
    torques: Buffer  # requested
    sent: Buffer
    asked: Buffer  # as far as no limiter cuts them
    scaled: Buffer


def settings_of(world: World, parameters: GuardedParameters, loops: tuple[LoopProperties, ...]) -> GuardedGroupSettings:
    """Constants of a run.

    Raises:
        ParameterError: No declared property certifies any torque, or a group cannot honour a key.
    """
    _refuse_keys_of_one_axis(parameters)
    sample_time, delay = loops[0].sample_time, loops[0].delay
    late = max([loop.timing.late for loop in loops]) / sample_time
    axes = axes_of(loops, parameters.hand_force, parameters.hand_speed)
    _require_certificates(axes, loops)
    loop = group_loop(world, loops)
    limits = per_axis_limits(axes, delay, parameters.max_consecutive_losses)
    quanta = [loop.torque_quantum for loop in loops]
    return GuardedGroupSettings(
        loop,
        AccountSettings(axes, limits, loop.motion.moves),
        credit=parameters.energy_allowance,
        alpha=parameters.alpha,
        lead=PREDICTION_HOLDS + delay + late,
        prediction=[
            prediction_settings(
                loop.moving_mass,
                loop.device_damping or 0.0,
                sample_time,
                delay,
                PREDICTION_HOLDS + late,
                loop.encoder_count,
            )
            for loop in loops
        ],
        calm=[calm_stiffness_of(loop) for loop in loops],
        damped=[2.0 * b / (1 + delay) for b in axes.damping],
        path=axes.path * (1 + delay),
        quanta=quanta,
        quantised=any(quanta),
    )


def _refuse_keys_of_one_axis(parameters: GuardedParameters) -> None:
    """Refuse what the certificates of a single axis alone can use.

    Raises:
        ParameterError: Such a key is declared; it names it.
    """
    push, pull = parameters.hand_push or 0.0, parameters.hand_force or 0.0
    if push > pull:
        raise ParameterError(
            f"guarded group: got hand_push {push:g}, expected none above hand_force ({pull:g}); a group knows no way "
            f"out of its contacts, and hand_force counts along every torque: declare hand_force {push:g}, or leave out "
            "hand_push"
        )
    for key in ("earned_energy", "drag"):
        if value := getattr(parameters, key):
            raise ParameterError(
                f"guarded group: got {key} {value:g}, expected 0; a group keeps no energy for later contacts: leave it "
                "out, and declare energy_allowance where a contact has to start faster"
            )


def _require_certificates(axes: AxisLimits, loops: tuple[LoopProperties, ...]) -> None:
    if not (axes.by_hand or axes.by_damping or axes.path):
        raise ParameterError(
            "guarded group: got neither moving_mass of every axis with hand_force, nor device_damping of every "
            "axis, nor hand_speed, expected one of them; without any no torque can be certified"
        )
    if axes.by_hand and any(loop.device_damping_bound is None for loop in loops):
        raise ParameterError(
            "guarded group: got hand_force without device_damping_bound of every axis, expected the largest damping "
            "that each device can have; measure it (canhaptic commission), or declare hand_force: null and another "
            "certificate"
        )


def memory_of(world: World, settings: GuardedGroupSettings) -> GuardedGroupMemory:
    """Return the buffers of a group at rest."""
    axes, one, limits = len(settings.quanta), list_of_zeros, settings.account.apart
    return GuardedGroupMemory(
        group_memory(world, settings.loop, 0), account_memory(limits), [PredictedMotion() for _ in settings.quanta],
        one(settings.loop.delay + 1), one(axes), one(axes), one(axes),
        RequestedEfforts(one(axes), one(axes), one(axes), one(axes)),
        one(axes), one(axes), one(axes), one(axes), one(axes), one(axes),
    )  # fmt: skip
