"""The share that all declarations permit a group's torques together: G13 of docs/theory/torques_of_a_group.md."""

import math
import random

import pytest

from canhaptic.control.certificates.certified_torque import (
    Declared,
    TorqueBound,
    bound_memory,
    largest_of_even_holds,
    taken_by_queue,
)
from canhaptic.control.certificates.scalar_bounds import displacement_response
from canhaptic.control.multi_axis.along import adds_up, certified_shares, share_in_sum
from canhaptic.control.multi_axis.group_account import (
    Accounting,
    AccountSettings,
    GroupAccount,
    QueuedTorques,
    account_memory,
    shares,
)
from canhaptic.control.multi_axis.group_certificates import axes_of, per_axis_limits
from canhaptic.control.passivity import LoopProperties
from canhaptic.kernels import list_of_zeros
from tools.attack.along import least_energy

T = 1e-3


def group_of(axes: int, delay: int, *, losses: int = 0, speed: float | None = None, damping: float = 3.0) -> Accounting:
    most = max(4.0, damping)
    loops = tuple(
        LoopProperties(sample_time=T, delay=delay, moving_mass=0.25, device_damping=damping, device_damping_bound=most)
        for _ in range(axes)
    )
    known = axes_of(loops, 2.0, speed)
    limits = per_axis_limits(known, delay, losses)
    rows = [[0.0] * axes for _ in range(delay + 1)]
    settings = AccountSettings(known, limits, moves=False)
    return Accounting(settings, GroupAccount(), account_memory(limits), QueuedTorques(rows, 0, delay))


@pytest.mark.parametrize("delay", [0, 1, 2])
@pytest.mark.parametrize("speed", [None, 0.2])
def test_the_share_of_one_axis_is_the_torque_that_its_own_certificates_permit(delay: int, speed: float | None) -> None:
    draw, compared = random.Random(delay), 0
    response = displacement_response(T, 0.25, 2.0, 3.0, 4.0)
    known = Declared(T, delay, 0, True, response, 3.0, speed or 0.0, 0.0)
    for _ in range(200):
        at, energy = group_of(1, delay, speed=speed), draw.choice([0.0, 1e-5, 1e-3])
        at.account.dissipated = dissipated = draw.choice([0.0, 1e-4])
        moved, held = draw.gauss(0.0, 2e-4), draw.uniform(-3.0, 3.0)
        queued = [draw.uniform(0.0, 1.0) for _ in range(delay)]
        at.memory.displacement[0], at.memory.torques[0] = moved, held
        for row, torque in zip(at.under_way.torques, queued, strict=False):
            row[0] = torque
        bound = TorqueBound(displacement=moved, torque=held, dissipated=dissipated)
        memory = bound_memory(known, [*queued, 0.0], list_of_zeros)
        if taken_by_queue(known, bound, memory, 1.0, speed or 0.0)[0] > energy + dissipated:
            continue  # a queue that this bound would not have let pass
        expected = largest_of_even_holds(known, bound, memory, 1.0, energy)[0]
        found = share_in_sum(at, [1.0], energy, (speed or 0.0) * T)
        if found > 0.0:
            assert found == pytest.approx(expected, rel=1e-9)
            compared += 1
    assert compared > 50


def test_no_greedy_hand_on_a_coupled_plant_takes_more_than_came_in_and_was_dissipated() -> None:
    held = 0
    for seed in range(6):
        least, holds = least_energy(seed)
        assert least >= -1e-12, seed
        held += holds
    assert held > 300
    assert min(least_energy(seed, 1.5)[0] for seed in range(6)) < -1e-6  # the hand has teeth


def test_what_rests_on_the_speed_of_the_hand_is_said_to_do_so() -> None:
    at = group_of(2, 0, speed=0.05)
    at.memory.displacement[:] = [5e-4, 5e-4]
    by_force, _, by_speed = certified_shares(at, [20.0, 20.0], 1e-3)
    assert by_speed > 1.5 * by_force > 0.0
    assert by_force == certified_shares(group_at_speed_unknown(at), [20.0, 20.0], 1e-3)[0]


def group_at_speed_unknown(at: Accounting) -> Accounting:
    settings = at.settings._replace(axes=at.settings.axes._replace(path=0.0))
    return at._replace(settings=settings)


def test_it_counts_only_where_it_bounds_the_same_queue_and_enlarges_a_share() -> None:
    at = group_of(2, 0)
    at.memory.displacement[:] = [2e-4, -1e-4]
    at.account.dissipated = 1e-4
    asked = [4.0, 2.0]
    assert adds_up(at)
    assert certified_shares(at, asked, 1e-4)[0] > 1.05 * max(shares(at, asked, 1e-4))
    edge = math.nextafter(2.0 * 0.25 / T, 0.0)  # there q rounds to 1, and the share had no end
    for other in (group_of(2, 0, losses=1), group_of(2, 0, damping=0.0), group_of(2, 0, damping=edge)):
        assert not adds_up(other)
        assert certified_shares(other, asked, 1e-4) == shares(other, asked, 1e-4)
    assert share_in_sum(at, [1e-200, 0.0], 1e-4, 0.0) == 0.0  # its square is 0
