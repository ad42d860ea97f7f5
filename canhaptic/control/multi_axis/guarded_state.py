"""Parameters, state and buffers of `guarded` of a group."""

from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

from canhaptic.control.multi_axis.account_memory import AccountMemory, account_memory
from canhaptic.control.multi_axis.group_account import AccountSettings, GroupAccount
from canhaptic.control.multi_axis.group_certificates import AxisLimits, axes_of
from canhaptic.control.multi_axis.group_kernel import Group, GroupLoop, GroupMemory, group_loop, group_memory
from canhaptic.control.multi_axis.group_motion import RequestedEfforts, World
from canhaptic.control.multi_axis.per_axis_memory import per_axis_limits
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.guarded_settings import calm_stiffness_of
from canhaptic.control.passivity.prediction import PredictedMotion, PredictionSettings, prediction_settings
from canhaptic.control.recovery import Alpha
from canhaptic.errors import ParameterError
from canhaptic.kernels import Buffer, list_of_zeros
from canhaptic.units import Parameters, quantity


class GuardedGroupParameters(Parameters):
    """Assumptions behind the certificates. Mass and damping of the devices are properties of each axis's loop."""

    hand_force: Annotated[float, quantity("N", "N*m", ge=0.0)] | None = 0.0
    """Largest force with which the hand pulls each motor axis, Coriolis forces included (`bound`); None: not used."""
    hand_speed: Annotated[float, quantity("m/s", "rad/s", gt=0.0)] | None = None
    """Largest speed of every motor axis. None: the certificate is not used."""
    energy_allowance: Annotated[float, quantity("J", ge=0.0)] = 0.0
    """Energy that may be given out before any came in: the promise becomes sum(h_i) >= -energy_allowance."""
    alpha: Alpha = 0.0
    """Modulated damping per joule of surplus (eq. 19), always with its unit; 0: the surplus is not removed."""
    prediction_holds: Annotated[float, quantity("count", ge=0.0, le=1.0)] = 0.5
    """Prediction beyond the delay, in holds: 0.5 aims at the middle of the hold, and what is more calms a spring."""
    max_consecutive_losses: Annotated[int, quantity("count", ge=0, le=16)] = 0
    """Consecutive cycles in which any axis may be without a new torque; each costs stiffness. 0: all axes always apply
    together what was sent."""


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
    torques: Buffer  # asked for
    sent: Buffer
    asked: Buffer  # as far as no limiter cuts them
    scaled: Buffer


def settings_of(
    world: World, parameters: GuardedGroupParameters, loops: tuple[LoopProperties, ...]
) -> GuardedGroupSettings:
    """Returns what is fixed for a run.

    Raises:
        ParameterError: No declared property certifies any torque.
    """
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
        lead=parameters.prediction_holds + delay + late,
        prediction=[
            prediction_settings(
                loop.moving_mass,
                loop.device_damping or 0.0,
                sample_time,
                delay,
                parameters.prediction_holds + late,
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
    """Returns the buffers of a group at rest."""
    axes, one, limits = len(settings.quanta), list_of_zeros, settings.account.apart
    return GuardedGroupMemory(
        group_memory(world, settings.loop, 0), account_memory(limits), [PredictedMotion() for _ in settings.quanta],
        one(settings.loop.delay + 1), one(axes), one(axes), one(axes),
        RequestedEfforts(one(axes), one(axes), one(axes), one(axes)),
        one(axes), one(axes), one(axes), one(axes), one(axes), one(axes),
    )  # fmt: skip
