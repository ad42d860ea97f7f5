"""How large a share of a group's torques all its declarations permit together: the torques as one axis along them.

Statement G13 of `docs/theory/torques_of_a_group.md`: the torques W define one coordinate y = W . D, in which the torque
is the share l, and the certificates of one axis add up as they do there (A4, A5).
"""

from math import sqrt

from canhaptic.control.certificates.certified_torque import torque_by_hand_speed, torque_by_reach
from canhaptic.control.multi_axis.group_account import Accounting, extraction_of, free_energy, shares, worst_case
from canhaptic.control.multi_axis.group_certificates import AxisLimits, damping_need, path_need, work_gain
from canhaptic.control.port_hamiltonian.network import dot
from canhaptic.kernels import Buffer


def certified_shares(at: Accounting, torques: Buffer, energy: float) -> tuple[float, float, float]:
    """Return the result of `shares`, enlarged: by hand force and damping in one sum, and with hand speed too."""
    by_force, by_damping, by_speed = shares(at, torques, energy)
    if by_force < 1.0 and by_damping < 1.0 and adds_up(at):
        by_force = max(by_force, share_in_sum(at, torques, energy, 0.0))
        path = path_need(at.settings.axes, torques)
        if by_force < 1.0 and path > 0.0:
            by_speed = max(by_speed, share_in_sum(at, torques, energy, path))
    return by_force, by_damping, by_speed


def certainly_free(at: Accounting, energy: float) -> float:
    """Return the result of `free_energy`, enlarged to what all declarations together leave."""
    free = free_energy(at, energy)
    return max(free, left_in_sum(at, energy)) if adds_up(at) else free


def adds_up(at: Accounting) -> bool:
    """Return whether damping and hand force are declared of every axis, and G13 bounds the same queue as the others."""
    settings = at.settings
    return settings.axes.damps_slowly and settings.apart.losses == 0 and not settings.moves


def taken_in_sum(axes: AxisLimits, torques: Buffer, reach: float, by_speed: bool) -> float:
    """Return the most that torques of one hold take from the energy, less what the devices dissipate in it [J].

    Args:
        axes: Properties of the motor axes.
        torques: Torques of the hold, (axes,) [N*m or N].
        reach: Largest work of them in the hold, without the dissipation [J].
        by_speed: Whether the declared hand speed counts.
    """
    if by_speed:
        reach = min(reach, path_need(axes, torques))
    if reach <= 0.0:
        return reach
    whole = damping_need(axes, torques)  # T / 4b, b the damping along the torques
    return whole if reach >= 2.0 * whole else reach * (1.0 - 0.25 * reach / whole)


def left_in_sum(at: Accounting, energy: float) -> float:
    """Return what the queued torques leave of energy and dissipation at every instant [J]; 0 if they exceed it."""
    least = left = energy + at.account.dissipated
    for hold in range(at.under_way.holds):
        acting = at.under_way.torques[at.under_way.first + hold]
        left -= taken_in_sum(at.settings.axes, acting, extraction_of(at, hold), False)
        least = min(least, left)
    return max(0.0, least)


def share_in_sum(at: Accounting, torques: Buffer, energy: float, path: float) -> float:
    """Return the share of torques that hand force, damping and hand speed permit together; may exceed 1.

    A queue that has more to take than is there permits no share.

    Args:
        at: Account of the group.
        torques: Requested torques W of the next free hold [N*m or N].
        energy: Energy that torques may give out [J].
        path: Most that W gives out at the declared hand speed [J]; 0: hand speed does not count.
    """
    axes, under_way, needed = at.settings.axes, at.under_way, damping_need(at.settings.axes, torques)
    if needed == 0.0:  # torques whose squares are no numbers above 0
        return 0.0
    budget = left = energy + at.account.dissipated
    for hold in range(under_way.holds):
        acting = under_way.torques[under_way.first + hold]
        taken = taken_in_sum(axes, acting, extraction_of(at, hold), path > 0.0)
        left -= taken
        if left < 0.0:
            return 0.0
        budget -= taken if dot(acting, torques) >= 0.0 else max(0.0, taken)
    base, gain = worst_case(at, torques, under_way.holds), work_gain(axes, torques)
    damped = 0.25 / needed
    any_hand = sqrt(4.0 * damped * budget) if budget > 0.0 else 0.0
    share = max(any_hand, torque_by_reach(damped, 0.0, gain, budget, base, any_hand))
    if path > 0.0 and budget > 0.0:
        share = max(share, torque_by_hand_speed(damped, 0.0, budget, path, any_hand))
    return share
