"""The largest torque of the next hold by all certificates, and the energy reserved for the torques under way."""

from math import inf

from canhaptic.control.certificates.late_torque import free_of_late, largest_of_late
from canhaptic.control.certificates.scalar_bounds import hand_force_bound, next_displacement
from canhaptic.control.certificates.sum_of_certificates import free_in_sum, largest_in_sum
from canhaptic.control.certificates.torque_bound import BoundMemory, Declared, TorqueBound, hand_along, outward


def free_energy(declared: Declared, bound: TorqueBound, memory: BoundMemory, energy: float) -> float:
    """Part of `energy` [J] that the certificates of the torques under way do not need."""
    if declared.losses == 0 and declared.late == 0.0:
        return free_in_sum(declared, bound, memory, energy)
    return free_of_late(declared, bound, memory, energy)


def largest_torques(
    declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, energy: float
) -> tuple[float, float, float]:
    """Largest torque along `sign` [N or N*m]: by all certificates, for any hand, and without the hand speed.

    `energy` [J] is the budget, without what the device dissipated.
    """
    if declared.losses or declared.late > 0.0:
        return largest_of_late(declared, bound, memory, sign, energy)
    if declared.by_hand_force_alone:
        force = by_hand_force(declared, bound, memory, sign, energy)
        return force, 0.0, force
    return largest_in_sum(declared, bound, memory, sign, energy)


def by_hand_force(declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, energy: float) -> float:
    """Return the largest torque along `sign` [N or N*m] for a hand within its declared force.

    It is that of `largest_in_sum` where nothing else is declared. `energy` [J] is the budget.
    """
    response, before, hand = declared.response, sign * bound.torque, hand_along(declared, bound, sign)
    if hand == inf:  # the hand is unknown along it
        return 0.0
    if declared.encoder_count > 0.0:
        displacement = outward(declared, bound, memory, sign)
    else:
        displacement = sign * bound.displacement + bound.blur
    if declared.delay:
        opposed = False
        for place in range(bound.first, bound.first + declared.delay):
            along = sign * memory.under_way[place]
            displacement = next_displacement(displacement, before, along, response, hand)
            if along >= 0.0:
                energy -= along * displacement
            else:
                opposed = True
            before = along
        if opposed:
            energy -= worst_out(declared, bound, memory, -sign)
    base = next_displacement(displacement, before, 0.0, response, hand)
    return hand_force_bound(energy, base, response.during)


def worst_out(declared: Declared, bound: TorqueBound, memory: BoundMemory, sign: float) -> float:
    """Return the most energy [J] that the torques under way may give out along `sign`, >= 0."""
    displacement, before = outward(declared, bound, memory, sign), sign * bound.torque
    hand = hand_along(declared, bound, sign)
    given = 0.0
    for place in range(bound.first, bound.first + declared.delay):
        along = sign * memory.under_way[place]
        displacement = next_displacement(displacement, before, along, declared.response, hand)
        if along > 0.0:
            given += along * displacement
        before = along
    return max(0.0, given)  # less at first while the axis goes inward, then more
