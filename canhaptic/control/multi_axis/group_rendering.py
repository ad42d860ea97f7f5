"""The torques of a guarded group: efforts as far as the account covers them, sent as far as they are certified."""

from math import sqrt
from typing import Final, NamedTuple

from canhaptic.control.balance import Certificate
from canhaptic.control.certificates.torque_bound import keep
from canhaptic.control.multi_axis.group_account import certain_energy, fade, quotient
from canhaptic.control.multi_axis.group_commands import next_place, send_nothing, take_applied
from canhaptic.control.multi_axis.group_motion import Ahead, World, write_efforts, write_springs
from canhaptic.control.multi_axis.group_shares import UnderWay, shares
from canhaptic.control.multi_axis.guarded_state import GuardedGroupMemory, GuardedGroupSettings, GuardedGroupState
from canhaptic.control.multi_axis.per_axis_certificates import inward_first
from canhaptic.control.passivity.in_flight import towards_zero
from canhaptic.control.passivity.prediction import predicted
from canhaptic.control.port_hamiltonian.sampled_network import internal_motion
from canhaptic.control.recovery import modulated_damping
from canhaptic.kernels import Buffer, new

_UNBOUNDED, _BY_FORCE = Certificate.EXACT.value, Certificate.HAND_FORCE.value
_BY_DAMPING, _BY_SPEED = Certificate.DEVICE_DAMPING.value, Certificate.HAND_SPEED.value

_FADE: Final = 0.8
_GRID_TRIES: Final = 3
_GRID_BACK: Final = 0.99


class Rendering(NamedTuple):
    """Damping rendered in a hold, and its certificate."""

    damping: float  # rendered along the motion [N*s/m or N*m*s/rad]
    certificate: int


def render(
    world: World,
    settings: GuardedGroupSettings,
    state: GuardedGroupState,
    memory: GuardedGroupMemory,
    under_way: UnderWay,
) -> Rendering:
    """Send the torques for the next free hold."""
    group, commands, wish = state.group, memory.group.commands, memory.wish
    place = group.oldest
    if not group.motion.engaged:
        group.oldest = send_nothing(commands, place)
        fade(state.account, _FADE)
        return new(Rendering, (0.0, _UNBOUNDED))
    speed = write_wish(world, settings, state, memory, under_way)
    energy = certain_energy(state.account, settings.credit)
    share, lead_share, damper_share, covered = shares_of_wish(settings, state, memory, speed, energy)
    rendered = write_dampers(settings, state, memory, damper_share)
    damper, modulated, torques = memory.damper, memory.modulated, memory.torques
    for i in range(len(torques)):
        torques[i] = -(share * wish.spring[i] + lead_share * wish.lead[i] + damper[i] + modulated[i])
    most = within_limits(settings, state, memory)
    factor, certificate = certify(settings, state, memory, under_way, energy, most, covered)
    sent, splits = memory.sent, settings.account.apart.is_apart and settings.account.axes.by_hand and factor < 1.0
    for i in range(len(torques)):
        commands.torques[place][i] = torques[i] if splits else sent[i]
        commands.dampers[place][i] = damper[i] if splits else factor * damper[i]
        commands.modulated[place][i] = modulated[i] if splits else factor * modulated[i]
    if splits:
        certificate = split(settings, memory, place, most, energy, certificate)
    group.oldest = next_place(commands, place)
    return new(Rendering, (factor * rendered, certificate))


def write_wish(
    world: World,
    settings: GuardedGroupSettings,
    state: GuardedGroupState,
    memory: GuardedGroupMemory,
    under_way: UnderWay,
) -> float:
    """Write the requested efforts at the predicted motor positions; return as `write_efforts`.

    What moves inside a network is not predicted: it goes on as in the last hold, and the motors with it.
    """
    loop, motion, followed, wish = settings.loop.motion, state.group.motion, memory.group.motion, memory.wish
    way, steady = memory.way, memory.steady
    for i in range(len(way)):
        for hold in range(under_way.holds):
            memory.column[hold] = under_way.torques[under_way.first + hold][i]
        travel = followed.velocity[i] * loop.sample_time
        steady[i] = settings.lead * travel
        way[i], memory.step[i] = predicted(settings.prediction[i], memory.predicted[i], memory.column, 0, travel)
    moves = internal_motion(world.tables, followed.network.room) != 0.0
    ahead = new(Ahead, (settings.lead, steady if moves else way, memory.step, state.was_engaged and not moves))
    speed = write_efforts(world, loop, motion, followed, ahead, wish)
    if moves:
        for i in range(len(way)):
            way[i] = steady[i]
    elif state.account.h_s < motion.energy:  # going in, more may be taken in where the account is short
        further = least = 0.0
        for i in range(len(way)):
            further += wish.spring[i] * steady[i]
            least += wish.spring[i] * way[i]
        if further > 0.0 and further > least:
            for i in range(len(way)):
                way[i] = steady[i]
            write_springs(world, motion, followed, settings.lead, way, wish)
    return speed


def split(
    settings: GuardedGroupSettings,
    memory: GuardedGroupMemory,
    place: int,
    most: float,
    energy: float,
    certificate: int,
) -> int:
    """Set a command to the larger part of the requested torques: one share of all, or inward torques first.

    Returns:
        Its certificate.
    """
    account, commands, together, found = settings.account, memory.group.commands, memory.sent, memory.scaled
    for i in range(len(found)):
        memory.asked[i] = most * memory.torques[i]
    apart, coming = memory.account.apart, memory.account.coming
    inward_first(account.axes, account.apart, apart, coming, memory.asked, settings.quanta, energy, found)
    more = 0.0
    for i in range(len(found)):
        more += (found[i] - together[i]) * memory.asked[i] * account.apart.responses[i]
    take_applied(commands, place, found if more > 0.0 else together)
    return _BY_FORCE if more > 0.0 else certificate


def within_limits(settings: GuardedGroupSettings, state: GuardedGroupState, memory: GuardedGroupMemory) -> float:
    """Largest share of the requested torques, up to 1, that no limiter cuts: see `drive.profile.limiter`.

    What is cut of one axis after all were certified together turns the torque of the group.
    """
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


def certify(
    settings: GuardedGroupSettings,
    state: GuardedGroupState,
    memory: GuardedGroupMemory,
    under_way: UnderWay,
    energy: float,
    most: float,
    covered: bool,
) -> tuple[float, int]:
    """Write the torques to send; return their share of those asked for, and the certificate."""
    torques, sent = memory.torques, memory.sent
    if not acts(torques):
        for i in range(len(sent)):
            sent[i] = torques[i]
        return 1.0, _UNBOUNDED
    by_force, by_damping, by_speed = shares(settings.account, state.account, memory.account, under_way, torques, energy)
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
    if settings.quantised:
        return put_on_grid(settings, state, memory, under_way, energy, factor), certificate
    for i in range(len(sent)):
        sent[i] = factor * torques[i]
    return factor, certificate


def acts(torques: Buffer) -> bool:
    """Return whether any torque is not zero."""
    for torque in torques:
        if torque != 0.0:
            return True
    return False


def put_on_grid(
    settings: GuardedGroupSettings,
    state: GuardedGroupState,
    memory: GuardedGroupMemory,
    under_way: UnderWay,
    energy: float,
    factor: float,
) -> float:
    """Write torques rounded towards 0 to what the drives apply, and certified as such; return their share.

    Rounding one axis alone is safe; of several it turns the force a little, so that the certificate is asked again.
    """
    sent = memory.sent
    for _ in range(_GRID_TRIES):
        for i in range(len(sent)):
            sent[i] = towards_zero(factor * memory.torques[i], settings.quanta[i])
        if len(sent) == 1 or not acts(sent):
            return factor
        by_force, by_damping, by_speed = shares(
            settings.account, state.account, memory.account, under_way, sent, energy
        )
        share = max(by_force, by_damping, by_speed)
        if share >= 1.0:
            return factor
        factor *= _GRID_BACK * share
    for i in range(len(sent)):
        sent[i] = 0.0
    return 0.0


def write_dampers(
    settings: GuardedGroupSettings, state: GuardedGroupState, memory: GuardedGroupMemory, share: float
) -> float:
    """Write the efforts of the damper and of the modulated one (eq. 19); return the damping rendered."""
    wish, damper, modulated, h_dis = memory.wish, memory.damper, memory.modulated, state.account.h_dis
    square = along = extra = 0.0
    for i in range(len(damper)):
        damper[i] = share * wish.damper[i]
        square += wish.velocity[i] * wish.velocity[i]
        along += damper[i] * wish.velocity[i]
    rendered = along / square if square != 0.0 else 0.0
    if settings.alpha > 0.0 and h_dis > 0.0 and square != 0.0:
        sample_time = settings.loop.motion.sample_time
        extra = modulated_damping(
            settings.alpha, h_dis, rendered, settings.loop.least_cap, sqrt(square) * sample_time, sample_time
        )
    for i in range(len(modulated)):
        modulated[i] = extra * wish.velocity[i]
    return rendered + extra


def shares_of_wish(
    settings: GuardedGroupSettings,
    state: GuardedGroupState,
    memory: GuardedGroupMemory,
    internal_speed: float,
    energy: float,
) -> tuple[float, float, float, bool]:
    """Shares of spring, lead and damper to render, and whether the account covers all of them."""
    wish, caps = memory.wish, settings.loop.caps
    size, lead_size = capped_norm(wish.spring, caps), capped_norm(wish.lead, caps)
    damper_size = capped_norm(wish.damper, caps)
    speed = 0.0
    for i in range(len(caps)):
        speed += caps[i] * wish.velocity[i] * wish.velocity[i]
    speed = sqrt(speed)
    if internal_speed != 0.0:
        speed += sqrt(settings.loop.most_cap) * internal_speed
    room, share, lead_share, damper_share = speed, 1.0, 1.0, min(1.0, speed / damper_size) if damper_size > 0.0 else 1.0
    permitted = permitted_square(settings, state, memory, size, energy)
    covered = permitted >= 1.0
    if not covered:
        share = sqrt(permitted)
        inward = opposed = 0.0
        for i in range(len(caps)):
            inward += wish.spring[i] * wish.velocity[i]
            opposed += wish.lead[i] * wish.spring[i] / caps[i]
        if inward > 0.0:
            catch_up = min(size - share * size, inward / size, room)
            share += catch_up / size
            room -= catch_up
        if opposed < 0.0 and lead_size > share * size:  # a spring does not stick
            lead_share = share * size / lead_size
    if damper_share * damper_size > room:
        damper_share, covered = room / damper_size, False
    lead, led = capped_norm(wish.lead, settings.calm), 0.0
    for i in range(len(caps)):
        led += settings.calm[i] * memory.way[i] * memory.way[i]
    led = sqrt(led)
    if lead_share * lead > led:
        lead_share = led / lead
    return share, lead_share, damper_share, covered


def permitted_square(
    settings: GuardedGroupSettings, state: GuardedGroupState, memory: GuardedGroupMemory, size: float, energy: float
) -> float:
    """Return the square of the share of the springs that the account covers; may be above 1."""
    wish, account = memory.wish, state.account
    if size == 0.0:
        return 1.0
    permitted = 0.0
    if settings.account.axes.by_hand:
        calm = capped_norm(wish.spring, settings.calm)
        permitted = quotient(2.0 * energy, calm * calm)
    if settings.account.axes.by_damping:
        total = needed = 0.0
        for i in range(len(settings.damped)):
            spring, stiffness = wish.spring[i], settings.damped[i]
            whole = spring + wish.lead[i] + wish.damper[i]
            total += 0.5 * (whole * whole) / stiffness
            needed += 0.5 * spring * spring / stiffness
        keep(account, energy, state.group.motion.energy + total)
        permitted = max(permitted, quotient(energy + account.dissipated, needed))
    if settings.path > 0.0 and energy > 0.0:
        travelled = 0.0
        for spring in wish.spring:
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
