"""The bounds of groups are reached: an exact mass driven as they fear gives out what they say, and never more."""

import math
import random

import pytest

from canhaptic.control.multi_axis.group_account import (
    Gap,
    account_memory,
    uncertainty_of,
    uncertainty_of_axis,
    uncertainty_of_mover,
)
from canhaptic.control.multi_axis.group_certificates import axes_of, per_axis_limits
from canhaptic.control.multi_axis.group_kernel import GroupHolds
from canhaptic.control.passivity import LoopProperties
from tests.control.network.networks import AxesApart

T, MASS, PULL = 2e-3, 0.3, 1.5


def apart_of(axes, delay, losses, pull, friction=0.0):
    loop = LoopProperties(sample_time=T, delay=delay, moving_mass=MASS, device_damping_bound=friction or None)
    return AxesApart(axes_of((loop,) * axes, pull, None), delay, losses)


class Mass:
    """One mass, exact; the torque and the hand are constant in each hold."""

    def __init__(self, velocity, friction=0.0):
        self.v, self._b = velocity, friction

    def hold(self, force):
        """Returns the displacement of one hold."""
        y = self._b * T / MASS
        if y == 0.0:
            moved, self.v = T * self.v + 0.5 * T * T * force / MASS, self.v + T * force / MASS
            return moved
        end, fade = force / self._b, math.exp(-y)
        moved = end * T + (self.v - end) * (1.0 - fade) * T / y
        self.v = end + (self.v - end) * fade
        return moved


@pytest.mark.slow_but("0.05-0.02-*-2", "-0.02-0.0-1-*", "0.0--0.3-0-*")
@pytest.mark.parametrize("losses", [1, 2, 4])
@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize(("velocity", "mover"), [(-0.02, 0.0), (0.0, 0.0), (0.05, 0.0), (0.05, 0.02), (0.0, -0.3)])
def test_a_torque_that_stays_for_all_losses_gives_out_the_whole_budget(losses, delay, velocity, mover):
    """The share that `share_per_axis` admits is the largest: 0.9 of the bound would admit more than there is.

    What a mover takes counts with what the motor gives out.
    """
    budget, wanted = 1e-3, 500.0
    apart, mass = apart_of(1, delay, losses, PULL), Mass(velocity)
    last = mass.hold(PULL)  # the hand pulls before, without a torque
    carried = ((mover * T,),) * (delay + 1 + losses)
    apart.take((last,), (0.0,), (0.0,), [(0.0,)] * delay, carried if mover else ())
    torque = apart.share_per_axis((wanted,), budget) * wanted
    assert 0.0 < torque < wanted
    for _ in range(delay):
        mass.hold(PULL)
    given = sum(torque * (mass.hold(PULL + torque) - mover * T) for _ in range(losses + 1))
    assert given <= budget * (1.0 + 1e-9)
    assert given >= 0.98 * budget


def test_the_need_of_torques_under_way_is_what_they_give_out():
    apart, mass, torque = apart_of(1, 0, 2, PULL), Mass(0.03), 2.0
    apart.take((mass.hold(PULL + torque),), (0.0,), (torque,), [])
    given = sum(torque * mass.hold(PULL + torque) for _ in range(2))
    assert given <= apart.needed_by_hand() * (1.0 + 1e-12)
    assert given >= 0.98 * apart.needed_by_hand()


def test_without_energy_only_axes_that_take_some_in_get_a_torque_and_never_give_any_out():
    apart, random_of = apart_of(2, 1, 1, 0.0), random.Random(4)
    raised = 0
    for _ in range(300):
        speeds = random_of.uniform(-0.3, 0.3), random_of.uniform(-0.3, 0.3)
        wanted = random_of.uniform(-5.0, 5.0), random_of.uniform(-5.0, 5.0)
        masses = [Mass(v) for v in speeds]
        apart.take(tuple(m.hold(0.0) for m in masses), (0.0, 0.0), (0.0, 0.0), [(0.0, 0.0)])
        found = apart.inward_first(wanted, -1e-3)
        for torque, asked, speed, mass in zip(found, wanted, speeds, masses, strict=True):
            assert 0.0 <= torque / asked <= 1.0
            if torque:
                raised += 1
                assert torque * speed < 0.0
                mass.hold(0.0)
                first = torque * mass.hold(torque)
                assert max(first, first + torque * mass.hold(torque)) <= 1e-12
    assert raised > 50


def gap_of(random_of, holds, pull, friction, largest):
    """Returns (gap, torques of its holds, true displacements) of a hand within its force; torques of either sign."""
    sign = random_of.choice((-1.0, 1.0))
    torques = [sign * random_of.uniform(0.0, largest) for _ in range(holds + 1)]
    if random_of.random() < 0.2:
        torques[random_of.randrange(holds + 1)] *= -1.0
    mass, moved = Mass(random_of.uniform(-0.05, 0.05), random_of.choice((0.0, friction))), []
    for place, torque in enumerate(torques):
        later = torques[max(1, place) :]
        most = pull if any(t > 0.0 for t in later) else random_of.choice((0.0, 30.0))
        least = -pull if any(t < 0.0 for t in later) else -random_of.choice((0.0, 30.0))
        moved.append(mass.hold(torque + random_of.choice((most, least, random_of.uniform(least, most)))))
    response = T * T / MASS
    step = response * (max(map(abs, torques)) + pull)
    return Gap(holds, sum(moved[1:]), moved[0], 0.0, 0.0, step, 1.0 - math.exp(-friction * T / MASS)), torques, moved


def held(torques):
    """Returns the buffers of one axis in which these torques were held, the first before the holds."""
    lost = [[f] for f in torques[1:-1]]
    limits = per_axis_limits(axes_of((LoopProperties(sample_time=T, moving_mass=MASS),), 0.0, None), 0, 0)
    memory = account_memory(limits)
    memory.torques[0] = torques[0]
    return memory, GroupHolds([0.0], [0.0], [torques[-1]], lost, [])


@pytest.mark.slow_but("3.0-1.5-3.0", "60.0-*")
@pytest.mark.parametrize(
    ("friction", "pull", "largest"),
    [(0.0, 0.0, 3.0), (0.0, PULL, 3.0), (3.0, 0.0, 3.0), (3.0, PULL, 3.0), (60.0, 0.0, 1e-3)],
)
def test_what_lost_samples_leave_in_doubt_covers_every_motion(friction, pull, largest):
    """Booked with the last torque, the energy is too high by no more than the bound; and it comes close to that."""
    random_of, closest = random.Random(8), -math.inf
    for _ in range(1500):
        holds = random_of.choice((2, 2, 3, 5))
        gap, torques, moved = gap_of(random_of, holds, pull, friction, largest)
        too_much = sum((f - torques[-1]) * d for f, d in zip(torques[1:], moved[1:], strict=True))
        bound = sum(uncertainty_of(gap, hold, f, torques[-1]) for hold, f in enumerate(torques[1:-1], 1))
        assert too_much <= bound + 1e-15
        size = sum(abs(f - torques[-1]) for f in torques[1:-1]) * gap.step
        if bound > 0.3 * size:
            closest = max(closest, too_much / bound)
    assert closest > 0.9


def test_what_lost_samples_leave_in_doubt_for_every_hand_is_what_the_devices_dissipate_less():
    random_of, closest, damping = random.Random(9), -math.inf, 700.0
    loop = LoopProperties(sample_time=T, device_damping=damping * T)
    for _ in range(1200):
        holds = random_of.choice((2, 3))
        torques = [random_of.uniform(-3.0, 3.0) for _ in range(holds)]
        more = [f - torques[-1] for f in torques]
        moved = [random_of.gauss(0.0, 1e-3) for _ in torques]
        if random_of.random() < 0.5:  # the worst for their sum
            mean, half = sum(more) / holds, 0.5 / damping
            moved = [sum(moved) / holds + half * (m - mean) for m in more]
        gap = Gap(holds, sum(moved), 0.0, 0.0, 0.0, 0.0, 0.0)
        short = sum(m * d - damping * d * d for m, d in zip(more, moved, strict=True)) + damping * gap.moved**2 / holds
        memory, ended = held([torques[0], *torques])
        bound = uncertainty_of_axis(axes_of((loop,), None, None), memory, ended, gap, holds - 1, 0)
        assert short <= bound + 1e-12
        closest = max(closest, short / bound if bound > 1e-4 else 0.0)
    assert closest > 0.9


def test_a_mover_in_holds_of_lost_samples_is_booked_at_its_worst():
    random_of, closest = random.Random(3), -math.inf
    for _ in range(500):
        torques = [random_of.uniform(0.0, 3.0) for _ in range(2)]
        acted = (torques[0], torques[0], torques[1])  # the second is an older one, or the same again
        memory, ended = held(acted)
        memory.passing[0] = random_of.uniform(-0.01, 0.01)
        too_much = (acted[2] - acted[1]) * memory.passing[0]
        uncertainty = uncertainty_of_mover(memory, ended, 0)
        assert too_much <= uncertainty + 1e-12
        closest = max(closest, too_much / uncertainty if uncertainty > 1e-3 else 0.0)
    assert closest > 0.98
