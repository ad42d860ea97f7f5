"""The algorithm `guarded` for a group of axes: one energy account limits all torques of the group together.

The network advances its own state by the measured motion; only the torques are limited.
On one axis with a spring and a damper it equals `passivity.guarded` to rounding. On several axes the account is scalar.
Efforts are compared in the norm in which every axis has its own damping cap, |f|^2 = sum(f_i^2 / cap_i), and are scaled
together, so that a limited force keeps its direction. They are requested as far as the account covers them, and sent as
far as the certificates permit.
"""

from dataclasses import dataclass, field
from math import sqrt
from typing import ClassVar, Final, NamedTuple, TypeAlias

from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance
from canhaptic.control.certificates.certified_torque import keep
from canhaptic.control.damping import modulated_damping
from canhaptic.control.multi_axis import group_account, group_certificates, group_kernel
from canhaptic.control.multi_axis.along import certainly_free, certified_shares
from canhaptic.control.multi_axis.group_account import (
    Accounting,
    QueuedTorques,
    certain_energy,
    end_group_gap,
    end_group_hold,
    fade,
    quotient,
    uncertainty_of_mover,
)
from canhaptic.control.multi_axis.group_certificates import inward_first, taken_by_mover
from canhaptic.control.multi_axis.group_kernel import (
    GroupHold,
    MotionAhead,
    begin_group,
    end_holds,
    follow,
    next_place,
    norm,
    send_nothing,
    take_applied,
    write_carried,
    write_efforts,
    write_springs,
)
from canhaptic.control.passivity import LoopProperties, guarded
from canhaptic.control.passivity.guarded import observe, observe_mean, predicted
from canhaptic.control.passivity.stepped import settle, towards_zero
from canhaptic.control.port_hamiltonian.sampled_network import internal_motion
from canhaptic.errors import ParameterError
from canhaptic.kernels import Buffer, Kernel, Run, list_of_zeros, new
from canhaptic.units import Parameters

_FREE, _START, _EXACT = Branch.FREE.value, Branch.START.value, Branch.EXACT.value
_DEPLETED, _EXIT = Branch.DEPLETED.value, Branch.EXIT.value
_UNBOUNDED, _BY_FORCE = Certificate.EXACT.value, Certificate.HAND_FORCE.value
_BY_DAMPING, _BY_SPEED = Certificate.DEVICE_DAMPING.value, Certificate.HAND_SPEED.value

_FADE: Final = 0.8
_GRID_TRIES: Final = 3
_GRID_BACK: Final = 0.99


class GuardedGroupSettings(NamedTuple):
    """Constants of a `guarded` group in one run."""

    loop: group_kernel.GroupLoop
    account: group_account.AccountSettings
    allowance: float  # energy that may be given out before any came in [J]
    alpha: float  # [s/m^2 or s/rad^2]
    lead: float  # prediction [holds]
    prediction: list[guarded.PredictionSettings]  # of each axis
    calm: Buffer  # stiffness of the largest spring that the rate renders, (axes,) [N/m or N*m/rad]
    damped: Buffer  # the same by the damping of the devices, (axes,); 0 where it is not declared [N/m or N*m/rad]
    path: float  # of the hand in the holds that a torque takes; 0 without a hand speed [m or rad]
    quanta: Buffer  # of the torque commands, (axes,); 0: ideal [N*m or N]
    quantised: bool


@dataclass(slots=True)
class GuardedGroupState:
    """State of a `guarded` group, kept from SYNC to SYNC."""

    was_engaged: bool = False
    group: group_kernel.Group = field(default_factory=group_kernel.Group)
    account: group_account.GroupAccount = field(default_factory=group_account.GroupAccount)


class GuardedGroupMemory(NamedTuple):
    """Buffers of a `guarded` group."""

    group: group_kernel.GroupMemory
    account: group_account.AccountMemory
    predicted: list[guarded.PredictedMotion]  # of each axis
    column: Buffer  # torques under way of one axis, (delay + 1,) [N*m or N]
    way: Buffer  # of the motors until the next torques act, (axes,) [rad or m]
    steady: Buffer  # the same by the last motion alone
    step: Buffer  # motion in a hold then
    request: group_kernel.RequestedEfforts
    damper: Buffer  # efforts to be sent, (axes,) [N*m or N]
    modulated: Buffer
    torques: Buffer  # requested
    sent: Buffer
    asked: Buffer  # as far as no limiter cuts them
    scaled: Buffer


GuardedRun: TypeAlias = Run[GuardedGroupSettings, GuardedGroupState, GuardedGroupMemory]
"""Settings, state and memory of a `guarded` group."""


def settings_of(
    world: group_kernel.GroupModel, parameters: guarded.GuardedParameters, loops: tuple[LoopProperties, ...]
) -> GuardedGroupSettings:
    """Return the constants of a `guarded` group.

    Raises:
        ParameterError: No declared property certifies any torque, or a key is not supported for groups.
    """
    _refuse_keys_of_one_axis(parameters)
    sample_time, delay = loops[0].sample_time, loops[0].delay
    late = max([loop.timing.late for loop in loops]) / sample_time
    axes = group_certificates.axes_of(loops, parameters.hand_force, parameters.hand_speed)
    _require_certificates(axes, loops)
    loop = group_kernel.group_loop(world, loops)
    limits = group_certificates.per_axis_limits(axes, delay, parameters.max_consecutive_losses)
    quanta = [loop.torque_quantum for loop in loops]
    return GuardedGroupSettings(
        loop,
        group_account.AccountSettings(axes, limits, loop.motion.moves),
        allowance=parameters.energy_allowance,
        alpha=parameters.alpha,
        lead=guarded.PREDICTION_HOLDS + delay + late,
        prediction=[guarded.prediction_settings(loop, guarded.PREDICTION_HOLDS + late) for loop in loops],
        calm=[guarded.calm_stiffness_of(loop) for loop in loops],
        damped=[2.0 * b / (1 + delay) for b in axes.damping],
        path=axes.path * (1 + delay),
        quanta=quanta,
        quantised=any(quanta),
    )


def _refuse_keys_of_one_axis(parameters: guarded.GuardedParameters) -> None:
    """Refuse keys that only the certificates of a single axis can use.

    Raises:
        ParameterError: Such a key is declared.
    """
    push, pull = parameters.hand_push or 0.0, parameters.hand_force or 0.0
    if push > pull:
        raise ParameterError(
            f"guarded group: got hand_push {push:g}, expected at most hand_force ({pull:g}); a group cannot tell which "
            "direction leads out of a contact, so it assumes hand_force in every direction: declare hand_force "
            f"{push:g}, or leave out hand_push"
        )
    for key in ("earned_energy", "drag"):
        if value := getattr(parameters, key):
            raise ParameterError(
                f"guarded group: got {key} {value:g}, expected 0; a group keeps no energy for later contacts: leave it "
                "out, and declare energy_allowance where a contact must start faster"
            )


def _require_certificates(axes: group_certificates.AxisLimits, loops: tuple[LoopProperties, ...]) -> None:
    if not (axes.by_hand or axes.by_damping or axes.path):
        raise ParameterError(
            "guarded group: got neither moving_mass of every axis with hand_force, nor device_damping of every "
            "axis, nor hand_speed, expected one of them; without one of them no torque can be certified"
        )
    if axes.by_hand and any(loop.device_damping_bound is None for loop in loops):
        raise ParameterError(
            "guarded group: got hand_force without device_damping_bound of every axis, expected the largest damping "
            "that each device can have; measure it (canhaptic commission), or declare hand_force: null and another "
            "certificate"
        )


def memory_of(world: group_kernel.GroupModel, settings: GuardedGroupSettings) -> GuardedGroupMemory:
    """Return the buffers of a group at rest."""
    axes, one, limits = len(settings.quanta), list_of_zeros, settings.account.apart
    return GuardedGroupMemory(
        group_kernel.group_memory(world, settings.loop, 0), group_account.account_memory(limits),
        [guarded.PredictedMotion() for _ in settings.quanta], one(settings.loop.delay + 1), one(axes), one(axes),
        one(axes),
        group_kernel.RequestedEfforts(one(axes), one(axes), one(axes), one(axes)),
        one(axes), one(axes), one(axes), one(axes), one(axes), one(axes),
    )  # fmt: skip


def step(
    world: group_kernel.GroupModel, run: GuardedRun, missed: int, positions: Buffer, torques_applied: Buffer
) -> GroupHold:
    """Book the hold that ended, and compute the next torques; see `canhaptic.kernels.Kernel`.

    Of the energies that late torques leave possible in one hold, the middle is booked, and half of the width is
    reserved as dissipated: torques are computed from the least energy. Of lost samples the least energy is booked.
    """
    settings, state, memory = run
    group, motion, ended, commands = state.group, state.group.motion, memory.group.ended, memory.group.commands
    if not group.started:
        begin(world, run, positions)
        return new(GroupHold, (AT_REST, 0.0, 0.0, 0, 0))
    group.oldest = end_holds(commands, ended, settings.loop.largest, group.oldest, missed, positions, torques_applied)
    follow(world, settings.loop.motion, motion, memory.group.motion, positions, ended.displacement, missed + 1)
    supplied, uncertainty, further = end(world, run, missed)
    h_i, h_pas, lost = taken_in(run, missed)
    h_i = h_i + supplied - uncertainty
    under_way = new(QueuedTorques, (commands.torques, group.oldest - settings.loop.delay, settings.loop.delay))
    at = Accounting(settings.account, state.account, memory.account, under_way)
    h_r, deficit, leak, paid = book(run, at, h_i, h_pas, lost + motion.internal)
    rendered, certificate = render(world, run, at)
    account, branch = state.account, branch_of(state, h_i, leak, deficit)
    if missed == 0:
        h_i, h_r, uncertainty = h_i + uncertainty, h_r + uncertainty, 0.0
    state.was_engaged = motion.engaged
    balance = new(EnergyBalance, (
        norm(commands.torques[group.oldest - 1]), h_i, h_pas, h_i - h_pas, h_r, account.h_s, account.h_dis, 0.0,
        deficit, leak, paid, branch, rendered, certificate, memory.group.motion.network.state[0],
        supplied,
    ))  # fmt: skip
    return new(GroupHold, (balance, uncertainty, further, motion.limit, group.oldest - 1))


def taken_in(run: GuardedRun, missed: int) -> tuple[float, float, float]:
    """Observe the motion of the holds that ended; return the energies of the motors, and of both dampers' parts [J]."""
    settings, state, memory = run
    ended, commands, oldest = memory.group.ended, memory.group.commands, state.group.oldest
    h_i = h_pas = lost = 0.0
    for i in range(len(ended.interactions)):
        h_i += ended.interactions[i]
        if missed == 0:
            observe(settings.prediction[i], memory.predicted[i], ended.displacement[i], ended.applied[i])
            h_pas += commands.modulated[oldest][i] * ended.displacement[i]
            lost += commands.dampers[oldest][i] * ended.displacement[i]
        else:  # the dampers' share of the motion is not known
            observe_mean(memory.predicted[i], ended.displacement[i] / (missed + 1))
    return h_i, h_pas, lost


def begin(world: group_kernel.GroupModel, run: GuardedRun, positions: Buffer) -> None:
    """Start a run at the first positions, at rest."""
    settings, state, memory = run
    group, motion, loop = state.group, memory.group.motion, settings.loop.motion
    begin_group(world, loop, group, memory.group, positions)
    if loop.moves:
        for hold in range(settings.account.apart.holds):
            write_carried(world, loop, group.motion, motion, hold, memory.account.mover_motion[hold])


def end(world: group_kernel.GroupModel, run: GuardedRun, missed: int) -> tuple[float, float, float]:
    """Book the holds that ended; return the energy that a mover supplied, and bounds of the account's error [J].

    The bounds are the largest shortfall, which is subtracted from the booked energy, and the largest excess. The motion
    of a mover is booked as it was certified, at the same pose: another pose of the same hold could book less energy.
    """
    settings, state, memory = run
    ended, account, limits = memory.group.ended, memory.account, settings.account.apart
    supplied = uncertainty = moved = 0.0
    if settings.loop.motion.moves:
        for hold in range(missed + 1):
            write_passed(world, run, hold, missed + 1)
            supplied += taken_by_mover(ended.applied, account.passing)
            if hold < missed:
                moved += uncertainty_of_mover(account, ended, hold)
        for hold in range(limits.holds):
            later, into = hold + missed + 1, account.mover_motion[hold]
            if later < limits.holds:
                for i in range(len(into)):
                    into[i] = account.mover_motion[later][i]
            else:
                write_carried(world, settings.loop.motion, state.group.motion, memory.group.motion, hold, into)
    if missed == 0:
        uncertainty = end_group_hold(settings.account, state.account, account, ended)
        return 0.0 - supplied, uncertainty, uncertainty
    uncertainty, further = end_group_gap(settings.account, state.account, account, ended, missed)
    uncertainty += moved
    return 0.0 - supplied, uncertainty if uncertainty > 0.0 else 0.0, further + 2.0 * moved


def write_passed(world: group_kernel.GroupModel, run: GuardedRun, hold: int, holds: int) -> None:
    """Store the mover's motion in one of the holds that ended, in motor coordinates [rad or m]."""
    settings, state, memory = run
    motion, account = memory.group.motion, memory.account
    if hold < settings.account.apart.holds:
        for i in range(len(account.passing)):
            account.passing[i] = account.mover_motion[hold][i]
    else:
        write_carried(world, settings.loop.motion, state.group.motion, motion, hold - holds, account.passing)


def book(run: GuardedRun, at: Accounting, h_i: float, h_pas: float, lost: float) -> tuple[float, float, float, float]:
    """Book one hold into stored energy and surplus; return (h_r, deficit, leak, paid) of `EnergyBalance` [J].

    Args:
        run: Run of the group; its state is changed.
        at: Account of the group at this SYNC.
        h_i: Interaction energy of the hold, supplied energy included [J].
        h_pas: Energy taken by the modulated damper [J].
        lost: Energy that the network's dissipators took [J]; negative values count as 0.
    """
    account, ceiling = at.account, run.state.group.motion.energy
    h_s, surplus = account.h_s + h_i - h_pas, account.h_dis - h_pas
    slack = 0.0
    if lost > 0.0 or h_s > ceiling:
        free = certainly_free(at, h_s - surplus + run.settings.allowance)
        slack = min(free, h_s)
    account.h_s, account.h_dis, h_r, deficit, leak, paid = settle(h_s, surplus, lost, ceiling, slack)
    account.unrecovered += h_r + leak - paid
    return h_r, deficit, leak, paid


def branch_of(state: GuardedGroupState, h_i: float, leak: float, deficit: float) -> int:
    """Return the value of the `Branch` (case of the account's formula) by which a hold was booked."""
    if deficit > 0.0:
        return _DEPLETED
    if state.group.motion.engaged:
        return _EXACT if state.was_engaged else _START
    return _EXIT if state.was_engaged or h_i != 0.0 or leak != 0.0 else _FREE


def render(world: group_kernel.GroupModel, run: GuardedRun, at: Accounting) -> tuple[float, int]:
    """Compute the torques of the next free hold; return the damping rendered along the motion, and the certificate."""
    settings, state, memory = run
    group, commands, request = state.group, memory.group.commands, memory.request
    place = group.oldest
    if not group.motion.engaged:
        group.oldest = send_nothing(commands, place)
        fade(state.account, _FADE)
        return 0.0, _UNBOUNDED
    speed = write_request(world, run, at.under_way)
    energy = certain_energy(state.account, settings.allowance)
    share, lead_share, damper_share, covered = shares_of_request(run, speed, energy)
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
    return factor * rendered, certificate


def write_request(world: group_kernel.GroupModel, run: GuardedRun, under_way: QueuedTorques) -> float:
    """Compute the efforts that the network requests at the predicted motor positions; return as `write_efforts` does.

    If masses move inside the network, the prediction is that they and the motors move on as in the last hold.
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
    """Set the command to one share of all requested torques, or to the torques of `inward_first` if these render more.

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
    """Return the largest share, up to 1, of the requested torques that no limiter cuts; see `drive.safety.limiter`.

    A cut of one axis, after all were certified together, would change the direction of the group's torque.
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
    """Scale the requested torques to what the certificates permit; return the share sent, and its certificate."""
    torques, sent = run.memory.torques, run.memory.sent
    if not acts(torques):
        for i in range(len(sent)):
            sent[i] = torques[i]
        return 1.0, _UNBOUNDED
    by_force, by_damping, by_speed = certified_shares(at, torques, energy)
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
    """Round the torques towards 0 to the drives' quanta, certify them again, and return the share that remains.

    Rounding a single axis is safe; rounding several changes the direction of the force a little.
    """
    sent = run.memory.sent
    for _ in range(_GRID_TRIES):
        for i in range(len(sent)):
            sent[i] = towards_zero(factor * run.memory.torques[i], run.settings.quanta[i])
        if len(sent) == 1 or not acts(sent):
            return factor
        by_force, by_damping, by_speed = certified_shares(at, sent, energy)
        share = max(by_force, by_damping, by_speed)
        if share >= 1.0:
            return factor
        factor *= _GRID_BACK * share
    for i in range(len(sent)):
        sent[i] = 0.0
    return 0.0


def write_dampers(run: GuardedRun, share: float) -> float:
    """Compute the efforts of the network's damper and the modulated damper (eq. 19); return the damping rendered."""
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


def shares_of_request(run: GuardedRun, internal_speed: float, energy: float) -> tuple[float, float, float, bool]:
    """Return the rendered shares of springs, predicted change (lead) and dampers, and whether the energy covers all."""
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
    """Return the square of the share of the spring efforts that the energy covers; may be above 1."""
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
    """Return the norm of efforts, weighted by the damping cap of each axis: sqrt(sum(f_i^2 / cap_i))."""
    total = 0.0
    for i in range(len(efforts)):
        total += efforts[i] * efforts[i] / caps[i]
    return sqrt(total)


class GuardedGroup(group_kernel.SteppedGroup):
    """A controller that renders a network as far as the certificates permit."""

    parameters_type: ClassVar[type[Parameters]] = guarded.GuardedParameters
    kernel: ClassVar[Kernel] = Kernel(settings_of, GuardedGroupState, memory_of, step)
