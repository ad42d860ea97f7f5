"""Sums of environments: what cannot be added, where their force reverses (N2, N3), their stiffest slope (N4)."""

import math
from typing import Any

import numpy as np
import pytest

from canhaptic.control.environments import LinearSpring, outside_of, plain
from canhaptic.control.environments.coulomb_surface import CoulombSurface
from canhaptic.control.environments.detents import Detents
from canhaptic.control.environments.free_space import FreeSpace
from canhaptic.control.environments.own_environment import OwnEnvironment
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.environments.sum_of_parts import added
from canhaptic.control.environments.two_sided_wall import TwoSidedWall
from canhaptic.control.environments.viscoelastic_medium import ViscoelasticMedium
from canhaptic.control.environments.viscous_medium import ViscousMedium
from canhaptic.control.passivity import LoopProperties, build_controller
from canhaptic.control.passivity.guarded import GuardedParameters
from canhaptic.errors import ParameterError

MASS, PERIOD, PARTS_OF_A_HOLD = 0.2, 1e-3, 20


class Rubber(OwnEnvironment):
    """Softens with the displacement."""

    def effort(self, state: float) -> float:
        return 5.0 * math.tanh(80.0 * state)


class Bristle(LinearSpring):
    """Follows the axis from where it was touched first."""


class Notches(OwnEnvironment):
    def contact(self, position: float) -> int:
        return 1 + math.floor(position)


def a_sum(chance):
    """Notches, stops and perhaps a spring to the middle and a medium; the notches do not begin at the stops."""
    low, high = sorted(chance.uniform(-0.012, 0.012, 2))
    pitch = float(chance.uniform(0.1, 0.9) * (high - low))
    detents = Detents(peak=float(chance.uniform(0.3, 4.0)), pitch=pitch, position=float(chance.uniform(low, high)))
    stops = TwoSidedWall(stiffness=float(10.0 ** chance.uniform(1.5, 3.5)), lower=float(low), upper=float(high))
    named = [("detents", detents), ("stops", stops)]
    if chance.random() < 0.5:
        named.append(("spring", SpringDamperWall(stiffness=200.0, position=detents.position, side="above")))
    if chance.random() < 0.5:
        named.append(("medium", ViscousMedium(damping=2.0)))
    return plain(added(named))


def brute_force_turns(environment, low, high):
    """Whether the force has both signs on an interval, by what it is at many places of it."""
    places = np.linspace(max(low, -0.05), min(high, 0.05), 250)[1:-1]
    forces = [environment.effort(environment.true_state(place, 0.0, 0.0)) for place in places]
    return min(forces) < -1e-9 and max(forces) > 1e-9


def test_the_force_keeps_its_direction_where_a_sum_says_so():
    chance, wide = np.random.default_rng(3), 0
    for _ in range(15):
        environment = a_sum(chance)
        for position in chance.uniform(-0.03, 0.03, 6):
            low, high = environment.one_way(position)
            assert low <= position <= high
            wide += high > low
            assert not brute_force_turns(environment, low, high), (environment, position)
    assert wide > 70


def test_a_sum_also_reverses_where_no_part_does():
    """N3: a notch that pulls outward and a stop that pushes inward balance between the places where either turns."""
    detents = Detents(peak=2.0, pitch=0.01)
    stops = TwoSidedWall(stiffness=300.0, lower=-0.012, upper=0.012)
    knob = added([("detents", detents), ("stops", stops)])
    begin, end = 0.0162, 0.0195  # inside one flank of a notch, and inside one stop
    assert detents.one_way(begin) == detents.one_way(end)
    assert stops.one_way(begin) == stops.one_way(end)
    assert knob.effort(knob.true_state(begin, 0.0, 0.0)) < 0.0 < knob.effort(knob.true_state(end, 0.0, 0.0))
    assert knob.one_way(begin)[1] < end


def test_what_is_stored_is_at_least_that_of_a_spring_with_the_sum_of_the_slopes():
    chance = np.random.default_rng(5)
    for _ in range(25):
        environment = a_sum(chance)
        for position in chance.uniform(-0.03, 0.03, 6):
            state = environment.true_state(position, 0.0, 0.0)
            force, stored = environment.effort(state), environment.stored_energy(state)
            assert stored >= (1.0 - 1e-9) * force * force / (2.0 * environment.steepest)


def words_of(environment, position, pull, push):
    """(least, largest) force of a hand that keeps its words where the handle is."""
    effort = environment.effort(environment.true_state(position, 0.0, 0.0))
    return (-push, push) if effort == 0.0 else (-pull, push) if effort > 0.0 else (-push, pull)


def least_energy_under_attack(environment, seed, holds, delay):
    """Least sum of the energy into the environment; a free mass, exact in every part of a hold.

    The hand moves the handle along the torque that is held, as hard as its words allow, or to and fro.
    """
    chance, pull, push = np.random.default_rng(seed), 0.4, 6.0
    loop = LoopProperties(sample_time=PERIOD, delay=delay, moving_mass=MASS, device_damping_bound=0.0)
    known = GuardedParameters(hand_force=pull, hand_push=push)
    made = build_controller(environment, "guarded", known, loop)
    position, speed, energy, least = float(chance.uniform(-0.01, 0.01)), 0.0, 0.0, 0.0
    queue, wish, sent, step = [0.0] * delay, 1.0, 0.0, PERIOD / PARTS_OF_A_HOLD
    torque = 0.0
    for _ in range(holds):
        balance = made.step(position, torque)
        queue.append(balance.torque)
        sent += abs(balance.torque)
        torque = queue.pop(0)
        attacks = chance.random() < 0.7
        if chance.random() < 0.02:
            wish = -wish
        for _ in range(PARTS_OF_A_HOLD):
            direction = math.copysign(1.0, torque) if attacks and torque else wish
            least_force, largest = words_of(environment, position, pull, push)
            far = position + 2.0 * (abs(speed) + step * push / MASS) * step * direction
            other = words_of(environment, far, pull, push)
            force = min(largest, other[1]) if direction > 0.0 else max(least_force, other[0])
            way = speed * step + 0.5 * (torque + force) / MASS * step * step
            speed += (torque + force) / MASS * step
            position, energy = position + way, energy - torque * way
            least = min(least, energy)
    return least, sent


@pytest.mark.slow_for("[2-9]", "1?")
@pytest.mark.parametrize("seed", range(20))
def test_no_hand_that_keeps_its_words_takes_energy_from_a_sum(seed):
    for run in range(6 if seed > 1 else 1):
        environment = a_sum(np.random.default_rng([seed, run]))
        least, sent = least_energy_under_attack(environment, seed, 1500 if seed > 1 else 300, seed % 2)
        assert least >= -1e-12
        assert sent > 1.0


NOTCHED = ("axes.detents", Detents(peak=1.0, pitch=0.01))
STOPS = ("axes.stops", TwoSidedWall(stiffness=100.0, lower=-0.004, upper=0.004))
REFUSED: dict[str, tuple[list[Any], str]] = {
    "two notches": ([NOTCHED, ("b", Detents(peak=1.0, pitch=0.003))], "axes.detents and b: cannot be added: have"),
    "two strains": (
        [("a", CoulombSurface(friction=1.0, stiffness=9.0)), ("b", ViscoelasticMedium(stiffness=1, relaxation_time=1))],
        "a and b: cannot be added: need a strain each",
    ),
    "a strain and a position": (
        [("a", CoulombSurface(friction=1.0, stiffness=9.0)), STOPS],
        "a and axes.stops: .*depend on its strain.*N5.*take viscous_medium for a: it adds",
    ),
    "press": ([STOPS, ("b", SpringDamperWall(stiffness=9.0, position=0.005))], "b and axes.stops: .*press against"),
    "no notch": ([("a", Detents(peak=1.0, pitch=0.02, position=0.01)), STOPS], "a: .* no notch from -0.004 to 0.004"),
    "own zones": ([("my.py:Notches", Notches()), STOPS], "my.py:Notches: .*zones of contact of its own"),
    "a bristle": ([("my.py:Bristle", Bristle(stiffness=9.0)), STOPS], "my.py:Bristle: .*where it rests is not known"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_added_is_refused_by_name(case):
    named, text = REFUSED[case]
    with pytest.raises(ParameterError, match=text):
        added(named)


def test_energy_and_force_of_a_bristle_and_a_stop_are_no_function_of_one_number():
    bristle = CoulombSurface(friction=10.0, stiffness=100.0)
    stop = SpringDamperWall(stiffness=400.0, damping=0.0, position=0.0, side="below")

    def both(z, q):
        return np.array([bristle.stored_energy(z) + stop.stored_energy(q), bristle.effort(z) + stop.effort(q)])

    for z, q in ((0.02, -0.01), (-0.03, -0.01), (0.05, -0.002)):
        by_z, by_q = ((both(z + a, q + b) - both(z - a, q - b)) / 2e-6 for a, b in ((1e-6, 0.0), (0.0, 1e-6)))
        assert np.linalg.det([by_z, by_q]) == pytest.approx(100.0 * 400.0 * (z - q), rel=1e-6)


def test_a_strain_adds_to_media_and_free_space_adds_nothing():
    friction = CoulombSurface(friction=1.0, stiffness=900.0, damping=0.5)
    both = added([("a", friction), ("b", ViscousMedium(damping=3.0)), ("c", FreeSpace())])
    assert both == friction.model_copy(update={"damping": 3.5})


def test_a_sum_has_a_way_out_only_where_all_its_parts_have_it():
    wall, behind = SpringDamperWall(stiffness=100.0), SpringDamperWall(stiffness=900.0, position=-0.01)
    assert outside_of(added([("a", wall), ("b", behind), ("c", Rubber(side="below"))])) == 1.0
    assert outside_of(added([("a", wall), ("b", ViscousMedium(damping=1.0))])) == 0.0
    assert outside_of(added([("a", Rubber()), STOPS])) == 0.0


def test_the_damping_of_a_sum_is_that_of_the_parts_in_contact():
    water = plain(added([("a", SpringDamperWall(stiffness=100.0, damping=4.0)), ("b", ViscousMedium(damping=6.0))]))
    assert [water.damping_at(water.true_state(place, 0.0, 0.0)) for place in (-1e-3, 1e-3)] == [10.0, 6.0]
    made = build_controller(
        water, "guarded", GuardedParameters(hand_push=5.0),
        LoopProperties(sample_time=1e-3, moving_mass=0.2, device_damping=0.5, device_damping_bound=0.5),
    )  # fmt: skip
    rendered = [made.step(2e-3 - 1e-5 * k, 0.0).damping_rendered for k in range(300)]
    assert rendered[100] == pytest.approx(6.0)
    assert rendered[250] == pytest.approx(10.0)
