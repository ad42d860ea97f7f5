"""The torques of a guarded group: efforts as far as the account covers them, sent as far as they are certified.

Parameters, state and buffers of `guarded` of a group.

The certificates of a group: the energy reserved for queued torques, and the certified share of the next ones.
"""

from dataclasses import dataclass, field
from math import sqrt
from typing import Final, NamedTuple, TypeAlias

from canhaptic.control.balance import Certificate
from canhaptic.control.certificates.scalar_bounds import hand_force_bound
from canhaptic.control.certificates.torque_bound import keep
from canhaptic.control.damping import modulated_damping
from canhaptic.control.multi_axis.group_account import (
    Accounting,
    AccountMemory,
    AccountSettings,
    GroupAccount,
    LateShare,
    QueuedTorques,
    account_memory,
    certain_energy,
    copy_range,
    fade,
    given_in_debt,
    older_needs,
    older_size,
    quotient,
    share_of_late,
)
from canhaptic.control.multi_axis.group_certificates import (
    AxisLimits,
    along_last,
    axes_of,
    base_of,
    damping_need,
    gain_of,
    path_need,
    response_to_late,
    taken_by_mover,
)
from canhaptic.control.multi_axis.group_kernel import (
    Group,
    GroupLoop,
    GroupMemory,
    group_loop,
    group_memory,
    next_place,
    send_nothing,
    take_applied,
)
from canhaptic.control.multi_axis.group_motion import (
    GroupModel,
    MotionAhead,
    RequestedEfforts,
    write_efforts,
    write_springs,
)
from canhaptic.control.multi_axis.per_axis_certificates import (
    inward_first,
    needed_by_hand,
    per_axis_limits,
    share_by_hand,
    take_sent,
    taken_at_most,
    write_needs,
)
from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.control.passivity.guarded_settings import (
    PREDICTION_HOLDS,
    GuardedParameters,
    PredictedMotion,
    PredictionSettings,
    calm_stiffness_of,
    predicted,
    prediction_settings,
)
from canhaptic.control.passivity.stepped import towards_zero
from canhaptic.control.port_hamiltonian.sampled_network import internal_motion
from canhaptic.errors import ParameterError
from canhaptic.kernels import Buffer, Run, list_of_zeros, new


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
    request: RequestedEfforts
    damper: Buffer  # efforts to be sent, (axes,) [N*m or N]
    modulated: Buffer
    torques: Buffer  # requested
    sent: Buffer
    asked: Buffer  # as far as no limiter cuts them
    scaled: Buffer


GuardedRun: TypeAlias = Run[GuardedGroupSettings, GuardedGroupState, GuardedGroupMemory]
"""Settings, state and memory of a group."""


def settings_of(
    world: GroupModel, parameters: GuardedParameters, loops: tuple[LoopProperties, ...]
) -> GuardedGroupSettings:
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


def memory_of(world: GroupModel, settings: GuardedGroupSettings) -> GuardedGroupMemory:
    """Return the buffers of a group at rest."""
    axes, one, limits = len(settings.quanta), list_of_zeros, settings.account.apart
    return GuardedGroupMemory(
        group_memory(world, settings.loop, 0), account_memory(limits), [PredictedMotion() for _ in settings.quanta],
        one(settings.loop.delay + 1), one(axes), one(axes), one(axes),
        RequestedEfforts(one(axes), one(axes), one(axes), one(axes)),
        one(axes), one(axes), one(axes), one(axes), one(axes), one(axes),
    )  # fmt: skip


def worst_case(at: Accounting, torques: Buffer, count: int) -> float:
    """Return the base of torques that act after some of the queued ones [J]; see `base_of`."""
    axes, memory, sent, first = at.settings.axes, at.memory, at.under_way.torques, at.under_way.first
    along = along_last(axes, torques, memory.displacement, memory.position_uncertainty)
    if not axes.timing.is_ideal:
        copy_range(axes, memory, False)
    return base_of(axes, torques, memory.displacement, along, memory.torques, sent, first, count, memory.now)


def extraction_of(at: Accounting, hold: int) -> float:
    """Return the most energy [J] that the torques of one of the queued holds may take out in it."""
    axes, memory, torques = at.settings.axes, at.memory, at.under_way.torques[at.under_way.first + hold]
    taken = worst_case(at, torques, hold) + gain_of(axes, torques)
    if not axes.timing.is_ideal:
        taken += response_to_late(axes, torques, memory.now.highest, memory.now.lowest, torques, axes.during)
    return taken + taken_by_mover(torques, memory.mover_motion[hold]) if at.settings.moves else taken


def moved_at_most(at: Accounting) -> float:
    """Energy that a mover takes [J] in the holds of queued torques, where that is positive."""
    total, under_way = 0.0, at.under_way
    if at.settings.moves:
        for hold in range(under_way.holds):
            total += max(0.0, taken_by_mover(under_way.torques[under_way.first + hold], at.memory.mover_motion[hold]))
    return total


def needed_under_way(at: Accounting) -> float:
    """Return the most energy [J] that the queued torques may give out to a hand within its force."""
    axes, memory, worst, given = at.settings.axes, at.memory, 0.0, 0.0
    for hold in range(at.under_way.holds):
        given += extraction_of(at, hold)
        worst = max(worst, given)
    if axes.timing.is_ideal:
        return worst
    return worst + share_of_late(axes, memory, at.under_way, memory.nothing, 1.0).constant


def free_energy(at: Accounting, energy: float) -> float:
    """Part of `energy` [J] that the certificates of the queued torques do not need."""
    settings, account, memory, under_way = at
    axes = settings.axes
    if settings.apart.is_apart:
        return free_if_apart(at, energy)
    free, moved = 0.0, moved_at_most(at)
    if axes.by_hand:
        free = max(free, energy - needed_under_way(at))
    needs, paths = older_needs(axes, memory)
    for hold in range(under_way.holds):
        torques = under_way.torques[under_way.first + hold]
        if axes.path > 0.0:
            paths += path_need(axes, torques)
        if axes.by_damping:
            needs += damping_need(axes, torques)
    if axes.path > 0.0:
        free = max(free, energy - moved - paths)
    if axes.by_damping:
        free = max(free, energy + account.dissipated - (moved + needs))
    return free


def shares(at: Accounting, torques: Buffer, energy: float) -> tuple[float, float, float]:
    """Share of the torques that each certificate admits: hand force, device damping, hand speed; may be > 1.

    Args:
        at: Account of the group.
        torques: W, for the next free hold [N*m or N].
        energy: Energy budget [J].
    """
    settings, account, memory, under_way = at
    axes = settings.axes
    if settings.apart.is_apart:
        return shares_if_apart(at, torques, energy)
    by_force = by_damping = by_speed = moved = 0.0
    if settings.moves:
        moved = taken_by_mover(torques, memory.mover_motion[under_way.holds])
    if axes.by_hand:
        by_force = by_hand_force(at, torques, energy, moved)
    if axes.by_damping or axes.path > 0.0:
        more, taken = max(0.0, moved), moved_at_most(at)
        needs, paths = older_needs(axes, memory)
        for hold in range(under_way.holds):
            acting = under_way.torques[under_way.first + hold]
            needs += damping_need(axes, acting) if axes.by_damping else 0.0
            paths += path_need(axes, acting)
        if axes.by_damping:
            budget = energy + account.dissipated - more - taken - needs
            by_damping = sqrt(quotient(budget, damping_need(axes, torques)))
        if axes.path > 0.0:
            budget = energy - taken - paths
            by_speed = quotient(budget, path_need(axes, torques) + more)
    return by_force, by_damping, by_speed


def by_hand_force(at: Accounting, torques: Buffer, energy: float, moved: float) -> float:
    """Return the share by hand force; at most 1 where torques come late, see `group_account`.

    `moved` is the energy of a mover on the torques [J]; the other arguments are as for `shares`.
    """
    axes, memory, under_way = at.settings.axes, at.memory, at.under_way
    for hold in range(under_way.holds):
        extraction = extraction_of(at, hold)
        acting, along = under_way.torques[under_way.first + hold], 0.0
        for i in range(len(torques)):
            along += acting[i] * torques[i]
        energy -= extraction if along >= 0.0 else max(0.0, extraction)
    base, gain = worst_case(at, torques, under_way.holds) + moved, gain_of(axes, torques)
    if axes.timing.is_ideal:
        return hand_force_bound(energy, base, gain)
    late = share_of_late(axes, memory, under_way, torques, 1.0)
    if not energy >= late.constant:
        return share_in_debt(at, torques, base, gain)
    share = share_beyond(energy, base, gain, late, 1.0)
    size = min(1.0, older_size(axes, memory, torques))
    if share < 1.0 and size > 0.0:
        late = share_of_late(axes, memory, under_way, torques, size)
        if energy >= late.constant:
            share = max(share, share_beyond(energy, base, gain, late, size))
    return share


def share_beyond(energy: float, base: float, gain: float, late: LateShare, size: float) -> float:
    """Return the share, up to `size`, of torques beyond what the older ones give out.

    `late` is for `size`, its constant at most the energy; `base` and `gain` are for all of the torques.
    """
    start, more = size * base + late.linear, max(0.0, size * size * gain + late.square)
    return size * min(1.0, hand_force_bound(energy - late.constant, start, more))


def share_in_debt(at: Accounting, torques: Buffer, base: float, gain: float) -> float:
    """Return the share of torques that absorbs energy for certain, where older ones may give out more than the budget.

    The range in `now` is that at the SYNC of the torques; the other arguments are as for `by_hand_force`.
    """
    own = given_in_debt(at.settings.axes, at.memory, at.under_way, torques)
    return min(1.0, hand_force_bound(0.0, base + own.linear, max(0.0, gain + own.square)))


def damping_need_of(axes: AxisLimits, squares: Buffer) -> float:
    """Return sum((T + theta_i) / 4 b_i times the sum of squares of an axis) [J]."""
    total = 0.0
    for i in range(len(squares)):
        total += squares[i] / axes.squares[i]
    return total


def size_of(values: Buffer) -> float:
    """Return the sum of values."""
    total = 0.0
    for value in values:
        total += value
    return total


def take_all_sent(at: Accounting) -> None:
    """Take the hold that ended and the torques that may still act, for per-axis certificates."""
    settings, _, memory, under_way = at
    copy_range(settings.axes, memory, True)
    take_sent(
        settings.axes, settings.apart, memory.apart, memory.displacement, memory.position_uncertainty, memory.torques,
        under_way.torques, under_way.first, memory.now,
    )  # fmt: skip


def free_if_apart(at: Accounting, energy: float) -> float:
    """`free_energy` for per-axis certificates."""
    settings, account, memory, _ = at
    axes, limits, apart, free = settings.axes, settings.apart, memory.apart, 0.0
    take_all_sent(at)
    older_damped, older_paths = older_needs(axes, memory)
    moved = taken_at_most(limits, apart, memory.mover_motion, apart.nothing)[0] if settings.moves else 0.0
    if axes.by_hand:
        free = max(free, energy - needed_by_hand(axes, limits, apart, memory.mover_motion))
    if axes.path > 0.0:
        write_needs(limits, apart, apart.nothing, squared=False)
        free = max(free, energy - moved - axes.path * size_of(apart.old) - older_paths)
    if axes.by_damping:
        write_needs(limits, apart, apart.nothing, squared=True)
        free = max(free, energy + account.dissipated - moved - damping_need_of(axes, apart.old) - older_damped)
    return free


def shares_if_apart(at: Accounting, torques: Buffer, energy: float) -> tuple[float, float, float]:
    """`shares` for per-axis certificates; none is above 1 by hand force."""
    settings, account, memory, _ = at
    axes, limits, apart = settings.axes, settings.apart, memory.apart
    take_all_sent(at)
    older_damped, older_paths = older_needs(axes, memory)
    by_force = by_damping = by_speed = moved = more = 0.0
    if settings.moves:
        moved, more = taken_at_most(limits, apart, memory.mover_motion, torques)
    if axes.by_hand:
        by_force = share_by_hand(axes, limits, apart, memory.mover_motion, torques, energy)
    if axes.by_damping:
        write_needs(limits, apart, torques, squared=True)
        budget = energy + account.dissipated - moved - more
        budget -= damping_need_of(axes, apart.old) + older_damped
        by_damping = sqrt(quotient(budget, damping_need_of(axes, apart.new)))
    if axes.path > 0.0:
        write_needs(limits, apart, torques, squared=False)
        budget = energy - moved - axes.path * size_of(apart.old) - older_paths
        by_speed = quotient(budget, axes.path * size_of(apart.new) + more)
    return by_force, by_damping, by_speed


_UNBOUNDED, _BY_FORCE = Certificate.EXACT.value, Certificate.HAND_FORCE.value
_BY_DAMPING, _BY_SPEED = Certificate.DEVICE_DAMPING.value, Certificate.HAND_SPEED.value

_FADE: Final = 0.8
_GRID_TRIES: Final = 3
_GRID_BACK: Final = 0.99


class Rendering(NamedTuple):
    """Damping rendered in a hold, and its certificate."""

    damping: float  # rendered along the motion [N*s/m or N*m*s/rad]
    certificate: int


def render(world: GroupModel, run: GuardedRun, at: Accounting) -> Rendering:
    """Send the torques for the next free hold."""
    settings, state, memory = run
    group, commands, request = state.group, memory.group.commands, memory.request
    place = group.oldest
    if not group.motion.engaged:
        group.oldest = send_nothing(commands, place)
        fade(state.account, _FADE)
        return new(Rendering, (0.0, _UNBOUNDED))
    speed = write_wish(world, run, at.under_way)
    energy = certain_energy(state.account, settings.credit)
    share, lead_share, damper_share, covered = shares_of_wish(run, speed, energy)
    rendered = write_dampers(run, damper_share)
    damper, modulated, torques = memory.damper, memory.modulated, memory.torques
    for i in range(len(torques)):
        torques[i] = -(share * request.spring[i] + lead_share * request.lead[i] + damper[i] + modulated[i])
    most = within_limits(run)
    factor, certificate = certify(run, at, energy, most, covered)
    sent, splits = memory.sent, settings.account.apart.is_apart and settings.account.axes.by_hand and factor < 1.0
    for i in range(len(torques)):
        commands.torques[place][i] = torques[i] if splits else sent[i]
        commands.dampers[place][i] = damper[i] if splits else factor * damper[i]
        commands.modulated[place][i] = modulated[i] if splits else factor * modulated[i]
    if splits:
        certificate = split(run, place, most, energy, certificate)
    group.oldest = next_place(commands, place)
    return new(Rendering, (factor * rendered, certificate))


def write_wish(world: GroupModel, run: GuardedRun, under_way: QueuedTorques) -> float:
    """Write the requested efforts at the predicted motor positions; returns the same as `write_efforts`.

    Motion inside a network is not predicted: it continues as in the last hold, and the motors with it.
    """
    settings, state, memory = run
    loop, motion, followed, request = settings.loop.motion, state.group.motion, memory.group.motion, memory.request
    way, steady = memory.way, memory.steady
    for i in range(len(way)):
        for hold in range(under_way.holds):
            memory.column[hold] = under_way.torques[under_way.first + hold][i]
        travel = followed.velocity[i] * loop.sample_time
        steady[i] = settings.lead * travel
        way[i], memory.step[i] = predicted(settings.prediction[i], memory.predicted[i], memory.column, 0, travel)
    moves = internal_motion(world.tables, followed.network.room) != 0.0
    ahead = new(MotionAhead, (settings.lead, steady if moves else way, memory.step, state.was_engaged and not moves))
    speed = write_efforts(world, loop, motion, followed, ahead, request)
    if moves:
        for i in range(len(way)):
            way[i] = steady[i]
    elif state.account.h_s < motion.energy:  # going in, more may be taken in where the account is short
        further = least = 0.0
        for i in range(len(way)):
            further += request.spring[i] * steady[i]
            least += request.spring[i] * way[i]
        if further > 0.0 and further > least:
            for i in range(len(way)):
                way[i] = steady[i]
            write_springs(world, motion, followed, settings.lead, way, request)
    return speed


def split(run: GuardedRun, place: int, most: float, energy: float, certificate: int) -> int:
    """Set a command to the larger part of the requested torques, by a common share or by inward torques first.

    Returns:
        Certificate of the command.
    """
    settings, _, memory = run
    account, commands, together, found = settings.account, memory.group.commands, memory.sent, memory.scaled
    for i in range(len(found)):
        memory.asked[i] = most * memory.torques[i]
    apart, mover_motion = memory.account.apart, memory.account.mover_motion
    inward_first(account.axes, account.apart, apart, mover_motion, memory.asked, settings.quanta, energy, found)
    more = 0.0
    for i in range(len(found)):
        more += (found[i] - together[i]) * memory.asked[i] * account.apart.responses[i]
    take_applied(commands, place, found if more > 0.0 else together)
    return _BY_FORCE if more > 0.0 else certificate


def within_limits(run: GuardedRun) -> float:
    """Largest share of the requested torques, up to 1, that no limiter reduces: see `drive.profile.limiter`.

    Reducing one axis after all were certified together would turn the torque of the group.
    """
    settings, state, memory = run
    loop, torques, most = settings.loop, memory.torques, 1.0
    newest, moved = memory.group.commands.torques[state.group.oldest - 1], memory.group.ended.displacement
    time = state.group.motion.holds * loop.motion.sample_time
    for i in range(len(torques)):
        sign = 1.0 if torques[i] > 0.0 else -1.0
        size, limit = sign * torques[i], loop.largest[i]
        limit = min(limit, loop.rises[i] + max(0.0, sign * newest[i]))
        if sign * moved[i] > 0.0:
            limit = min(limit, loop.powers[i] * time / (sign * moved[i]))
        if size > limit:
            most = min(most, limit / size)
    return most


def certify(run: GuardedRun, at: Accounting, energy: float, most: float, covered: bool) -> tuple[float, int]:
    """Write the torques to send; return their share of the requested ones, and the certificate."""
    torques, sent = run.memory.torques, run.memory.sent
    if not acts(torques):
        for i in range(len(sent)):
            sent[i] = torques[i]
        return 1.0, _UNBOUNDED
    by_force, by_damping, by_speed = shares(at, torques, energy)
    factor, largest = most, max(by_force, by_damping, by_speed)
    if factor > largest:
        factor, covered = largest, False
    certificate = _UNBOUNDED
    if not covered or factor < 1.0:
        certificate = _BY_SPEED
        if by_damping >= factor > 0.0:  # of no share at all, what `split` adds is by hand force
            certificate = _BY_DAMPING
        elif by_force >= factor:
            certificate = _BY_FORCE
    if run.settings.quantised:
        return put_on_grid(run, at, energy, factor), certificate
    for i in range(len(sent)):
        sent[i] = factor * torques[i]
    return factor, certificate


def acts(torques: Buffer) -> bool:
    """Return whether any torque is not zero."""
    for torque in torques:
        if torque != 0.0:
            return True
    return False


def put_on_grid(run: GuardedRun, at: Accounting, energy: float, factor: float) -> float:
    """Write torques rounded towards 0 to the drives' quanta, and certified as such; return their share.

    Rounding a single axis is safe; rounding several turns the force a little, so that it is certified again.
    """
    sent = run.memory.sent
    for _ in range(_GRID_TRIES):
        for i in range(len(sent)):
            sent[i] = towards_zero(factor * run.memory.torques[i], run.settings.quanta[i])
        if len(sent) == 1 or not acts(sent):
            return factor
        by_force, by_damping, by_speed = shares(at, sent, energy)
        share = max(by_force, by_damping, by_speed)
        if share >= 1.0:
            return factor
        factor *= _GRID_BACK * share
    for i in range(len(sent)):
        sent[i] = 0.0
    return 0.0


def write_dampers(run: GuardedRun, share: float) -> float:
    """Write the efforts of the damper and of the modulated damper (eq. 19); return the damping rendered."""
    settings, state, memory = run
    request, damper, modulated, h_dis = memory.request, memory.damper, memory.modulated, state.account.h_dis
    square = along = extra = 0.0
    for i in range(len(damper)):
        damper[i] = share * request.damper[i]
        square += request.velocity[i] * request.velocity[i]
        along += damper[i] * request.velocity[i]
    rendered = along / square if square != 0.0 else 0.0
    if settings.alpha > 0.0 and h_dis > 0.0 and square != 0.0:
        sample_time = settings.loop.motion.sample_time
        extra = modulated_damping(
            settings.alpha, h_dis, rendered, settings.loop.least_cap, sqrt(square) * sample_time, sample_time
        )
    for i in range(len(modulated)):
        modulated[i] = extra * request.velocity[i]
    return rendered + extra


def shares_of_wish(run: GuardedRun, internal_speed: float, energy: float) -> tuple[float, float, float, bool]:
    """Shares of spring, lead and damper to render, and whether the account covers all of them."""
    settings, _, memory = run
    request, caps = memory.request, settings.loop.caps
    size, lead_size = capped_norm(request.spring, caps), capped_norm(request.lead, caps)
    damper_size = capped_norm(request.damper, caps)
    speed = 0.0
    for i in range(len(caps)):
        speed += caps[i] * request.velocity[i] * request.velocity[i]
    speed = sqrt(speed)
    if internal_speed != 0.0:
        speed += sqrt(settings.loop.most_cap) * internal_speed
    room, share, lead_share, damper_share = speed, 1.0, 1.0, min(1.0, speed / damper_size) if damper_size > 0.0 else 1.0
    permitted = permitted_square(run, size, energy)
    covered = permitted >= 1.0
    if not covered:
        share = sqrt(permitted)
        inward = opposed = 0.0
        for i in range(len(caps)):
            inward += request.spring[i] * request.velocity[i]
            opposed += request.lead[i] * request.spring[i] / caps[i]
        if inward > 0.0:
            catch_up = min(size - share * size, inward / size, room)
            share += catch_up / size
            room -= catch_up
        if opposed < 0.0 and lead_size > share * size:  # a spring does not stick
            lead_share = share * size / lead_size
    if damper_share * damper_size > room:
        damper_share, covered = room / damper_size, False
    lead, led = capped_norm(request.lead, settings.calm), 0.0
    for i in range(len(caps)):
        led += settings.calm[i] * memory.way[i] * memory.way[i]
    led = sqrt(led)
    if lead_share * lead > led:
        lead_share = led / lead
    return share, lead_share, damper_share, covered


def permitted_square(run: GuardedRun, size: float, energy: float) -> float:
    """Return the square of the share of the springs that the account covers; may be above 1."""
    settings, state, memory = run
    request, account = memory.request, state.account
    if size == 0.0:
        return 1.0
    permitted = 0.0
    if settings.account.axes.by_hand:
        calm = capped_norm(request.spring, settings.calm)
        permitted = quotient(2.0 * energy, calm * calm)
    if settings.account.axes.by_damping:
        total = needed = 0.0
        for i in range(len(settings.damped)):
            spring, stiffness = request.spring[i], settings.damped[i]
            whole = spring + request.lead[i] + request.damper[i]
            total += 0.5 * (whole * whole) / stiffness
            needed += 0.5 * spring * spring / stiffness
        keep(account, energy, state.group.motion.energy + total)
        permitted = max(permitted, quotient(energy + account.dissipated, needed))
    if settings.path > 0.0 and energy > 0.0:
        travelled = 0.0
        for spring in request.spring:
            travelled += abs(spring)
        ratio = quotient(energy, settings.path * travelled)
        permitted = max(permitted, ratio * ratio)
    return permitted


def capped_norm(efforts: Buffer, caps: Buffer) -> float:
    """Return the norm of efforts in which every axis has its own damping cap."""
    total = 0.0
    for i in range(len(efforts)):
        total += efforts[i] * efforts[i] / caps[i]
    return sqrt(total)
