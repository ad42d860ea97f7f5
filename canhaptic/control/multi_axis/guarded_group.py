"""`guarded` for a group: the network keeps the state of its model, the energy account limits the torques together.

On one axis with a spring and a damper it equals `passivity.guarded` to rounding. On several axes the account is scalar;
efforts are compared in the norm in which every axis has its own damping cap, |f|^2 = sum(f_i^2 / cap_i), and are scaled
together, so that a limited force keeps its direction.
"""

from typing import ClassVar

from canhaptic.control.balance import AT_REST, Branch, EnergyBalance
from canhaptic.control.mechanisms.kinematics import Kinematics
from canhaptic.control.multi_axis.group_account import (
    Accounting,
    QueuedTorques,
    doubt_of_mover,
    end_group_gap,
    end_group_hold,
)
from canhaptic.control.multi_axis.group_certificates import taken_by_mover
from canhaptic.control.multi_axis.group_controller import NetworkEnvironment
from canhaptic.control.multi_axis.group_kernel import GroupHold, GroupKernel, SteppedGroup, end_holds, norm
from canhaptic.control.multi_axis.group_motion import GroupModel, begin_motion, follow, write_carried
from canhaptic.control.multi_axis.group_rendering import (
    GuardedGroupMemory,
    GuardedGroupSettings,
    GuardedGroupState,
    GuardedRun,
    free_energy,
    memory_of,
    render,
    settings_of,
)
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.guarded_settings import GuardedParameters, observe, observe_mean
from canhaptic.control.passivity.stepped import settle
from canhaptic.kernels import Buffer, Run, new
from canhaptic.units import Parameters

_FREE, _START, _EXACT = Branch.FREE.value, Branch.START.value, Branch.EXACT.value
_DEPLETED, _EXIT = Branch.DEPLETED.value, Branch.EXIT.value


def step(
    world: GroupModel,
    settings: GuardedGroupSettings,
    state: GuardedGroupState,
    memory: GuardedGroupMemory,
    missed: int,
    positions: Buffer,
    torques_applied: Buffer,
) -> GroupHold:
    """Account for the hold that ended; see `GroupKernel`."""
    group, motion, ended, commands = state.group, state.group.motion, memory.group.ended, memory.group.commands
    run = Run(settings, state, memory)  # not by `new`: compiled, no function returns a record
    if not group.started:
        begin(world, run, positions)
        return new(GroupHold, (AT_REST, 0.0, 0.0, 0.0, 0, 0))
    group.oldest = end_holds(commands, ended, settings.loop.largest, group.oldest, missed, positions, torques_applied)
    follow(world, settings.loop.motion, motion, memory.group.motion, positions, ended.displacement, missed + 1)
    observe_all(settings, memory, missed)
    supplied, uncertainty, further = end(world, run, missed)
    h_i = h_pas = lost = 0.0
    for i in range(len(ended.interactions)):
        h_i += ended.interactions[i]
        if missed == 0:  # of several holds the dampers' share of the motion is not known
            h_pas += commands.modulated[group.oldest][i] * ended.displacement[i]
            lost += commands.dampers[group.oldest][i] * ended.displacement[i]
    h_i = h_i + supplied - uncertainty
    under_way = new(QueuedTorques, (commands.torques, group.oldest - settings.loop.delay, settings.loop.delay))
    at = Accounting(settings.account, state.account, memory.account, under_way)
    h_r, deficit, leak, paid = book(run, at, h_i, h_pas, lost + motion.internal)
    rendered, certificate = render(world, run, at)
    account, branch = state.account, branch_of(state, h_i, leak, deficit)
    state.was_engaged = motion.engaged
    balance = new(EnergyBalance, (
        norm(commands.torques[group.oldest - 1]), h_i, h_pas, h_i - h_pas, h_r, account.h_s, account.h_dis, 0.0,
        deficit, leak, paid, branch, rendered, certificate, memory.group.motion.network.state[0],
    ))  # fmt: skip
    return new(GroupHold, (balance, supplied, uncertainty, further, motion.limit, group.oldest - 1))


def begin(world: GroupModel, run: GuardedRun, positions: Buffer) -> None:
    """Take the first positions, of a group at rest."""
    settings, state, memory = run
    group, motion, loop = state.group, memory.group.motion, settings.loop.motion
    group.started = True
    for i in range(len(positions)):
        memory.group.ended.position[i] = positions[i]
    begin_motion(world, loop, group.motion, motion, positions)
    if loop.moves:
        for hold in range(settings.account.apart.holds):
            write_carried(world, loop, group.motion, motion, hold, memory.account.mover_motion[hold])


def observe_all(settings: GuardedGroupSettings, memory: GuardedGroupMemory, missed: int) -> None:
    """Give each axis's predictor the hold that ended, or the mean displacement of several."""
    ended = memory.group.ended
    for i in range(len(ended.displacement)):
        if missed == 0:
            observe(settings.prediction[i], memory.predicted[i], ended.displacement[i], ended.applied[i])
        else:
            observe_mean(memory.predicted[i], ended.displacement[i] / (missed + 1))


def end(world: GroupModel, run: GuardedRun, missed: int) -> tuple[float, float, float]:
    """Take the holds that ended into the account; return the energy that a mover supplied, and its uncertainty [J].

    The uncertainty is the largest shortfall, which is not booked, and the largest excess.

    The mover's motion is that of the motors at the pose at which it was first computed: another pose of the same hold
    could book less than was certified.
    """
    settings, state, memory = run
    ended, account, limits = memory.group.ended, memory.account, settings.account.apart
    supplied = doubt = moved = 0.0
    if settings.loop.motion.moves:
        for hold in range(missed + 1):
            write_passed(world, run, hold, missed + 1)
            supplied += taken_by_mover(ended.applied, account.passing)
            if hold < missed:
                moved += doubt_of_mover(account, ended, hold)
        for hold in range(limits.holds):
            later, into = hold + missed + 1, account.mover_motion[hold]
            if later < limits.holds:
                for i in range(len(into)):
                    into[i] = account.mover_motion[later][i]
            else:
                write_carried(world, settings.loop.motion, state.group.motion, memory.group.motion, hold, into)
    if missed == 0:
        doubt = end_group_hold(settings.account, state.account, account, ended)
        return 0.0 - supplied, doubt, doubt
    doubt, further = end_group_gap(settings.account, state.account, account, ended, missed)
    doubt += moved
    return 0.0 - supplied, doubt if doubt > 0.0 else 0.0, further + 2.0 * moved


def write_passed(world: GroupModel, run: GuardedRun, hold: int, holds: int) -> None:
    """Write the mover's motion in one of the holds that ended, in motor coordinates [rad or m]."""
    settings, state, memory = run
    motion, account = memory.group.motion, memory.account
    if hold < settings.account.apart.holds:
        for i in range(len(account.passing)):
            account.passing[i] = account.mover_motion[hold][i]
    else:
        write_carried(world, settings.loop.motion, state.group.motion, motion, hold - holds, account.passing)


def book(run: GuardedRun, at: Accounting, h_i: float, h_pas: float, lost: float) -> tuple[float, float, float, float]:
    """Book one hold into stored energy and surplus; return (h_r, deficit, leak, paid) [J].

    Args:
        run: Run of the group; its state is changed.
        at: Its account.
        h_i: Interaction energy of the hold, supplied energy included [J].
        h_pas: Energy taken by the modulated damper [J].
        lost: Energy that the network's dissipators took [J]; negative values count as 0.
    """
    account, ceiling = at.account, run.state.group.motion.energy
    h_s, surplus = account.h_s + h_i - h_pas, account.h_dis - h_pas
    slack = 0.0
    if lost > 0.0 or h_s > ceiling:
        free = free_energy(at, h_s - surplus + run.settings.credit)
        slack = min(free, h_s)
    account.h_s, account.h_dis, h_r, deficit, leak, paid = settle(h_s, surplus, lost, ceiling, slack)
    account.unrecovered += h_r + leak - paid
    return h_r, deficit, leak, paid


def branch_of(state: GuardedGroupState, h_i: float, leak: float, deficit: float) -> int:
    """Rule that booked the hold."""
    if deficit > 0.0:
        return _DEPLETED
    if state.group.motion.engaged:
        return _EXACT if state.was_engaged else _START
    return _EXIT if state.was_engaged or h_i != 0.0 or leak != 0.0 else _FREE


class GuardedGroup(SteppedGroup):
    """A network rendered as far as the certificates allow."""

    parameters_type: ClassVar[type[Parameters]] = GuardedParameters
    kernel: ClassVar[GroupKernel] = GroupKernel(settings_of, GuardedGroupState, memory_of, step)

    def __init__(
        self,
        environment: NetworkEnvironment,
        kinematics: Kinematics,
        parameters: GuardedParameters,
        loops: tuple[LoopProperties, ...],
    ) -> None:
        super().__init__(environment, kinematics, parameters, loops)
        self.max_consecutive_losses = parameters.max_consecutive_losses
        self.energy_allowance = parameters.energy_allowance
