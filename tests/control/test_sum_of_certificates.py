"""The sum of certificates against a search over displacements, and against hands that place the axis anywhere."""

import math
import random
from dataclasses import replace

import numpy as np
import pytest

from canhaptic.control.balance import AT_REST, Certificate
from canhaptic.control.certificates.certified_torque import (
    BoundMemory,
    Declared,
    TorqueBound,
    bound_memory,
    free_energy,
    free_of_even_holds,
    free_of_late_torques,
    largest_of_even_holds,
    largest_torques,
    taken,
)
from canhaptic.control.certificates.scalar_bounds import (
    NO_RESPONSE,
    displacement_response,
    hold_timing,
    next_displacement,
)
from canhaptic.control.environments.free_space import FreeSpace
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.guarded import Guarded, GuardedParameters
from canhaptic.errors import ParameterError
from canhaptic.kernels import list_of_zeros
from canhaptic.lab.figures.figures import metrics_of
from canhaptic.lab.figures.meter import Meter, MeterSettings, take
from tests.adversary.axis import MASS, guarded, run

T = 1e-3
ROUNDING = 1e-12


def declared(*, hand_force=None, damping=0.0, friction=0.0, speed=0.0, delay=1):
    response = NO_RESPONSE if hand_force is None else displacement_response(T, MASS, hand_force, damping, damping)
    return Declared(T, delay, 0, hand_force is not None, response, damping, speed, 0.0, friction=friction)


@pytest.mark.slow_but("0.005-*", "-0.001-*-0.5")
@pytest.mark.parametrize("torque", [0.1, 0.5, 3.0])
@pytest.mark.parametrize(("damping", "friction"), [(0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5), (20.0, 0.2)])
@pytest.mark.parametrize("reach", [-1e-3, 0.0, 2e-4, 5e-3])
def test_no_displacement_within_reach_takes_more(torque, damping, friction, reach):
    known = declared(damping=damping, friction=friction)
    ways = [reach - 1e-2 * step / 4000 for step in range(4001)]
    most = max(torque * way - damping / T * way * way - friction * abs(way) for way in ways)
    found = taken(known, torque, reach)
    assert found >= most - ROUNDING
    assert reach > 0.0 or found == torque * reach  # energy that comes in for certain, with friction or without
    if reach > 0.0:
        assert found == pytest.approx(most, abs=1e-7)


@pytest.mark.slow_but("?", "[12]?")
@pytest.mark.parametrize("seed", range(120))
def test_the_largest_torque_is_where_what_is_taken_meets_what_is_left(seed):
    draw = random.Random(seed)
    known = declared(
        hand_force=draw.choice([None, 0.0, 5.0]),
        damping=draw.choice([0.0, 0.5, 20.0, 250.0, 2000.0]),
        friction=draw.choice([0.0, 0.5]),
        speed=draw.choice([0.0, 0.3]),
    )
    fastest = draw.choice([2e-4, 2e-3])
    bound = TorqueBound(displacement=draw.uniform(-fastest, 2e-4), torque=draw.uniform(0.0, 3.0), out=1.0)
    bound.dissipated = bound.certain = draw.uniform(0.0, 2e-3)
    energy = draw.uniform(0.0, 2e-3)
    under_way = [draw.uniform(0.0, 0.4), 0.0]
    memory = bound_memory(known, under_way, list_of_zeros)
    largest, for_all, by_force = largest_of_even_holds(known, bound, memory, 1.0, energy)
    assert largest >= by_force >= for_all
    for torque, is_left in ((0.999 * largest, True), (1.001 * largest + 1e-6, False)):
        left = energy + bound.dissipated - needed(known, bound, memory, torque)
        assert (left >= -ROUNDING) is is_left or (is_left and torque <= known.friction)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_by_the_hand_force_alone_the_largest_torque_is_that_of_the_sum(sign):
    for seed in range(150):
        draw = random.Random(seed)
        known = declared(hand_force=draw.choice([0.0, 5.0]), delay=draw.choice([0, 1, 3]))
        known = replace(known, response=replace(known.response, push=draw.choice([7.0, math.inf])))
        bound = TorqueBound(
            displacement=draw.uniform(-2e-4, 2e-4), torque=draw.uniform(-3.0, 3.0), position_uncertainty=1e-6
        )
        bound.out, bound.turns = draw.choice([1.0, -1.0]), draw.choice([False, False, True])
        memory = bound_memory(known, [draw.uniform(-1.0, 1.0) for _ in range(4)], list_of_zeros)
        energy = draw.uniform(-1e-4, 2e-3)
        expected = largest_of_even_holds(known, bound, memory, sign, energy)
        found = largest_torques(replace(known, by_hand_force_alone=True), bound, memory, sign, energy)
        assert found == pytest.approx(expected, rel=1e-9), seed
        assert found[1] == 0.0


def test_free_is_what_torques_under_way_in_both_directions_leave():
    for seed in range(80):
        draw = random.Random(seed)
        known = declared(hand_force=5.0, damping=draw.choice([0.0, 0.5]), delay=2)
        bound = TorqueBound(displacement=draw.uniform(-2e-4, 2e-4), torque=draw.uniform(-3.0, 3.0), dissipated=1e-4)
        under_way = [draw.uniform(-1.0, 1.0) for _ in range(3)]
        memory, left = bound_memory(known, under_way, list_of_zeros), 1e-3 + 1e-4
        for sign in (1.0, -1.0):
            hand = known.response.push if sign * bound.out < 0.0 else known.response.hand
            way, before, total, worst = sign * bound.displacement, sign * bound.torque, 0.0, 0.0
            for torque in under_way[:2]:
                way = next_displacement(way, before, sign * torque, known.response, hand)
                total += taken(known, sign * torque, way) if sign * torque > 0.0 else 0.0
                before, worst = sign * torque, max(worst, total)
            left -= worst
        assert free_energy(known, bound, memory, 1e-3) == pytest.approx(max(0.0, left))
        assert free_energy(known, bound, memory, -1.0) == 0.0


def test_in_debt_the_speed_of_the_hand_allows_no_torque_beyond_friction():
    known = declared(damping=20.0, friction=0.5, speed=0.3, delay=0)
    memory = bound_memory(known, [0.0], list_of_zeros)
    assert largest_of_even_holds(known, TorqueBound(), memory, 1.0, -1e-6)[0] == 0.5


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_in_debt_what_moves_inward_for_certain_allows_a_torque_as_without_friction(friction):
    known = declared(hand_force=5.0, friction=friction, damping=20.0, delay=0)
    memory, moved, debt = bound_memory(known, [0.0], list_of_zeros), -4e-4, -1e-4
    base = next_displacement(moved, 0.0, 0.0, known.response, known.response.hand)
    found = largest_of_even_holds(known, TorqueBound(displacement=moved), memory, 1.0, debt)[0]
    assert found * (base + known.response.during * found) == pytest.approx(debt)


@pytest.mark.parametrize(("losses", "late"), [(0, 0.0), (1, 0.0), (0, 2e-4)])
def test_late_torques_and_lost_frames_are_certified_by_rules_of_their_own(losses, late):
    timing = hold_timing(T, 0.0, late, 0.0)
    response = displacement_response(T, MASS, 5.0, timing=timing)
    known = Declared(T, 1, losses, True, response, 0.0, 0.0, 0.0, late, late / T, timing.left)
    bound = TorqueBound(displacement=1e-4, torque=1.0, most=1.0, highest=1.0, lowest=0.5)
    memory = bound_memory(known, [0.5, 0.0], list_of_zeros)
    ways = [rule(known, bound, memory, 1e-3) for rule in (free_of_even_holds, free_of_late_torques)]
    assert (losses or late) == 0 or ways[1] < ways[0]
    assert free_energy(known, bound, memory, 1e-3) == ways[1 if losses or late else 0]


def needed(known: Declared, bound: TorqueBound, memory: BoundMemory, torque: float) -> float:
    """What the torque under way and one more take at most [J]."""
    way, before, total = bound.displacement, bound.torque, 0.0
    for acting in (memory.under_way[0], torque):
        reach = math.inf
        if known.by_hand_force:
            reach = way = next_displacement(way, before, acting, known.response, known.response.hand)
        if known.hand_speed:
            reach = min(reach, known.hand_speed * T)
        total += taken(known, acting, reach)
        before = acting
    return total


@pytest.mark.slow_but("0.0-0.5-1e-05-1", "3.0-0.0-0.0-0", "0.5-0.5-0.0-1")
@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("count", [0.0, 1e-5])
@pytest.mark.parametrize(("damping", "friction"), [(0.0, 0.5), (0.5, 0.5), (3.0, 0.0)])
def test_no_hand_at_any_speed_takes_more_than_came_in_and_the_device_dissipates(damping, friction, count, delay):
    loop = LoopProperties(
        sample_time=T, delay=delay, moving_mass=MASS, device_damping=damping or None, device_friction=friction or None,
        device_friction_bound=friction, encoder_count=count,
    )  # fmt: skip
    for seed in range(6):
        draw = random.Random(seed)
        one = Guarded(
            SpringDamperWall(stiffness=2500.0, damping=draw.choice([0.0, 5.0])),
            GuardedParameters(hand_force=None, earned_energy=0.03, drag=draw.choice([0.0, 0.3])),
            loop,
        )
        position, total, strongest, waiting, held = 0.01, 0.0, 0.0, [0.0] * delay, 0.0
        speed = 0.0
        for _ in range(1500):
            seen = round(position / count) * count if count else position
            waiting.append(one.step(seen, held).torque)
            held = waiting.pop(0)
            if draw.random() < 0.05:
                speed = draw.choice([-0.1, 0.1, draw.uniform(-3.0, 3.0)])
            if held > 1.0 and draw.random() < 0.3:
                speed = (held - friction) / (2.0 * damping) if damping else 3.0  # what takes most
            if abs(position) > 0.02:
                speed = -math.copysign(0.2, position)
            moved = speed * T
            position += moved
            total += damping / T * moved * moved + friction * abs(moved) - held * moved
            strongest = max(strongest, abs(held))
            assert total >= -ROUNDING
        assert strongest > 0.4


@pytest.mark.parametrize(
    ("damping", "friction", "used"),
    [
        (None, 0.5, {Certificate.DEVICE_FRICTION}),
        (3.0, 0.5, {Certificate.DEVICE_DAMPING}),
        (3.0, None, {Certificate.DEVICE_DAMPING}),
    ],
)
def test_a_torque_that_dry_friction_holds_is_named_after_it(damping, friction, used):
    loop = LoopProperties(sample_time=T, moving_mass=MASS, device_damping=damping, device_friction=friction)
    one = Guarded(SpringDamperWall(stiffness=20_000.0, damping=0.0), GuardedParameters(hand_force=None), loop)
    torque, named = 0.0, set()
    for k in range(60):
        balance = one.step(2e-3 * math.cos(0.1 * k), torque)
        if torque := balance.torque:
            named.add(Certificate(balance.certificate))
            if balance.certificate != Certificate.EXACT:
                is_small = friction is not None and abs(torque) <= friction
                assert (balance.certificate == Certificate.DEVICE_FRICTION) is is_small
    assert named - {Certificate.EXACT} == used


def test_the_weakest_certificate_of_a_run_goes_by_what_it_promises_and_not_by_its_number():
    found = []
    for certificates in ((7, 1, 7), (7, 2), (0, 1), (2, 4, 7)):
        meter = Meter()
        for cycle, number in enumerate(certificates):
            take(FreeSpace(), MeterSettings(), meter, cycle, 0.0, 0.0, 0.0, 0.0, AT_REST._replace(certificate=number))
        found.append(int(metrics_of(["certificate"], {"certificate": np.array([meter.certificate])})["certificate"][0]))
    assert found == [
        Certificate.DEVICE_FRICTION, Certificate.HAND_FORCE, Certificate.DEVICE_DAMPING, Certificate.NONE,
    ]  # fmt: skip


def test_energy_earned_by_device_and_drag_holds_a_wall_that_a_slow_hand_does_not_meet_without():
    def depth(**more):
        controller = guarded(10_000.0, 0.0, 1000, 1, hand_force=20.0, most=0.5, **more)
        begin, speed = 0.7, 0.1

        def hand(t, q, v, _f):
            if t < begin:
                return 300.0 * (0.07 - speed * t - q) - 10.0 * (v + speed)
            return -5.0 * min(1.0, (t - begin) / 0.3)

        truth = run(controller, hand, 1000, 4000, delay=1, damping=0.5, position=0.07)
        free = [abs(f) for q, f in zip(truth.positions, truth.torques, strict=True) if q > 0.0]
        assert truth.least >= -ROUNDING
        return -truth.positions[-1], max(free)

    deep, without = depth()
    held, felt = depth(drag=0.1, earned_energy=5e-3, certain=0.25)
    assert held == pytest.approx(5.0 / 10_000.0, rel=0.05)
    assert deep > 2.0 * held
    assert felt == pytest.approx(0.1)
    assert without == 0.0


def test_a_drag_that_earns_nothing_is_refused():
    with pytest.raises(ParameterError, match=r"guarded: got drag 0\.1 with earned_energy 0, expected"):
        guarded(1000.0, 0.0, 1000, drag=0.1, earned_energy=0.0)


def test_a_wall_that_is_left_keeps_no_more_than_is_declared():
    controller = guarded(2000.0, 0.0, 1000, hand_force=0.0, earned_energy=1e-3)
    state = [controller.step(0.01 - 1e-4 * k, 0.0) for k in range(150)][-1]
    held = state.torque
    for k in range(300):
        state = controller.step(-0.005 + 1e-4 * k, held)
        held = state.torque
    assert 0.0 <= state.h_s <= 1e-3


def test_a_declared_certificate_more_never_costs_torque():
    bound = TorqueBound(displacement=-5e-5, torque=1.0, out=1.0)
    whole = declared(hand_force=5.0, damping=0.5, friction=0.5, speed=0.2)
    memory = bound_memory(whole, [0.8, 0.0], list_of_zeros)
    most = largest_of_even_holds(whole, bound, memory, 1.0, 1e-3)[0]
    for left_out in ({"by_hand_force": False}, {"friction": 0.0}, {"hand_speed": 0.0}, {"damping": 0.0}):
        assert largest_of_even_holds(replace(whole, **left_out), bound, memory, 1.0, 1e-3)[0] <= most + ROUNDING


@pytest.mark.parametrize(("kept", "is_held"), [(0.0, False), (None, True)])
def test_what_a_bounce_brought_in_holds_the_contact_after_it(kept, is_held):
    """The second contact is slower than any that starts from no energy."""
    controller = guarded(10_000.0, 20.0, 1000, 1, hand_force=20.0, earned_energy=kept)

    def hand(t, q, v, _f):
        turn = 2.0 * math.pi * t
        return 300.0 * (0.03 * math.cos(turn) - q) - 3.0 * (v + 0.06 * math.pi * math.sin(turn))

    truth = run(controller, hand, 1000, 500, delay=1, position=0.03)
    assert truth.least >= -ROUNDING
    deepest = -min(truth.positions[300:])
    assert (deepest < 1.3e-3) is is_held
