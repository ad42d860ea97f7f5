"""Algorithms of the literature: each keeps the rule of its source, promises nothing, and has a true account."""

import importlib
import random
from collections import deque
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from canhaptic.control.balance import Certificate
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import LITERATURE, LoopProperties, build_controller
from canhaptic.control.passivity.internal_dissipation import Storage
from canhaptic.control.passivity.stepped import Hold
from canhaptic.control.passivity.unprotected import Asked
from canhaptic.errors import ParameterError
from canhaptic.lab.batch.scalar import render
from canhaptic.lab.rivals import (
    a_priori_dissipation,
    adaptive_reference,
    bounded_observer,
    energy_bounding,
    energy_tank,
    force_augmentation,
    force_gradient,
    ultimate_passivity,
    windowed_observer,
)
from canhaptic.lab.rivals.tank_admittance import TankAdmittance, TankAdmittanceParameters
from canhaptic.registry import load
from tests.lab.batch.loops import scalar_case

WALL = SpringDamperWall(stiffness=5000.0, damping=0.0)
LOOP = LoopProperties(sample_time=1e-3, moving_mass=0.25)


def rendered(algorithm, positions, parameters=None, wall=WALL, delay=0):
    """Returns controller, torques commanded and balances along the positions; torques act at once."""
    made = build_controller(wall, algorithm, parameters, LOOP.model_copy(update={"delay": delay}))
    balances, held = [], 0.0
    for position in positions:
        balances.append(made.step(position, held))
        held = balances[-1].torque
    return made, np.array([balance.torque for balance in balances]), balances


def presses(depth=-2e-3, steps=40, count=1):
    """Positions of a hand that presses to a depth and goes back to a tenth of it, again and again."""
    way = np.linspace(0.1 * depth, depth, steps)
    return [0.001, 0.0, *np.concatenate([np.concatenate([way, way[::-1]]) for _ in range(count)])]


@pytest.mark.slow_but("energy_tank-1", "adaptive_reference-1")
@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("algorithm", LITERATURE)
def test_it_promises_nothing_and_books_what_the_plant_took(algorithm, delay):
    run = render(scalar_case("spring_damper_wall", algorithm, delay=delay), 1500)
    assert not run.ended
    assert abs(run.believed_error) <= 1e-9 * max(1.0, float(np.abs(run.interaction).max()))
    _, _, balances = rendered(algorithm, presses(), delay=delay)
    assert {balance.certificate for balance in balances[1:]} == {Certificate.NONE}


@pytest.mark.parametrize(
    "algorithm", ["adaptive_reference", "force_gradient", "ultimate_passivity", "windowed_observer"]
)
def test_a_damper_without_any_bound_is_refused(algorithm):
    with pytest.raises(ParameterError, match=f"{algorithm}: got neither damping_limit nor moving_mass"):
        build_controller(WALL, algorithm, None, LoopProperties(sample_time=1e-3))


def test_the_reference_energy_is_fitted_while_energy_comes_in_and_followed_while_it_goes_out():
    state = adaptive_reference._AdaptiveReferenceState()
    state.model.true = -0.002
    assert adaptive_reference.below_reference(state, 0.01, 0.001) == 0.0
    assert state.coefficient == pytest.approx(0.01 / 0.002**2)
    state.model.true = -0.001  # the reference falls to a quarter
    assert adaptive_reference.below_reference(state, 0.002, -0.008) == pytest.approx(0.002 - 0.0025)
    assert adaptive_reference.below_reference(state, 0.003, -0.007) == 0.0


def test_the_damper_of_the_reference_acts_where_the_observer_still_waits():
    way = np.linspace(0.0, -2e-3, 21)
    positions = [0.001, *way, *way[-2:9:-1]]  # back to half the depth: more comes out there than went in
    _, adaptive, _ = rendered("adaptive_reference", positions)
    _, observed, _ = rendered("passivity_observer", positions)
    _, plain, _ = rendered("unprotected", positions)
    assert np.array_equal(observed, plain)
    assert np.array_equal(adaptive[:22], plain[:22])
    assert np.all(adaptive[23:] < plain[23:])  # less force outward while it goes out


def test_what_was_dissipated_long_ago_is_forgotten_only_where_the_sum_stays_above_zero():
    state, recent = windowed_observer._WindowedObserverState(), [0.0] * 3
    for brought, remembered in ((2.0, 2.0), (1.0, 3.0), (0.0, 3.0), (0.5, 1.5), (-0.2, 0.3), (-0.5, -0.2), (0.0, -0.2)):
        windowed_observer.remember(state, recent, brought)
        assert state.energy == pytest.approx(remembered)
    long_since = presses(count=1) + [0.001] * 40  # out of contact for longer than the window
    damped = SpringDamperWall(stiffness=5000.0, damping=20.0)
    made, _, balances = rendered("windowed_observer", long_since, wall=damped)
    assert sum(balance.h_i for balance in balances) > 20.0 * made._state.energy > 0.0


def test_the_force_of_the_bounded_observer_is_bounded_at_rest_and_turns_nothing_round():
    loop = LoopProperties(sample_time=1e-3)
    given = bounded_observer.BoundedObserverParameters(force_limit=3.0)
    settings = bounded_observer.settings_of(WALL, given, loop)
    rng = random.Random(3)
    for _ in range(300):
        state = bounded_observer._BoundedObserverState(integral=rng.uniform(0.0, 5.0))
        moved, wanted = rng.choice([1e-12, 1e-6, 1e-3, 0.0]) * rng.choice([1.0, -1.0]), rng.uniform(-5.0, 5.0)
        hold = Hold(moved, 0.0, 0.0, 0.0, 1e-3, moved / 1e-3, 0.0, 0)
        force = bounded_observer.controlling_force(settings, state, -rng.uniform(0.0, 1.0), hold, wanted)
        assert abs(force) <= 3.0 or force == -wanted
        assert (wanted + force) * wanted >= 0.0
    state = bounded_observer._BoundedObserverState(integral=1.0)
    bounded_observer.controlling_force(settings, state, 0.0, hold, 1.0)
    assert state.integral == 0.0


def test_the_force_that_follows_changes_is_the_spring_until_the_controller_acts_and_keeps_what_that_did():
    positions = presses()
    _, gradient, _ = rendered("force_gradient", positions)
    _, plain, _ = rendered("unprotected", positions)
    assert gradient[:60] == pytest.approx(plain[:60], abs=1e-9)  # the observer has nothing to win back till then
    assert gradient[-1] != pytest.approx(plain[-1])
    state = force_gradient._ForceGradientState(wanted=-5.0, force=-4.0, depth=-1e-3)  # one newton taken away before
    assert force_gradient.gradient_force(1e-3, state, -6.0, -1.2e-3) == pytest.approx(-5.0)
    assert force_gradient.gradient_force(1e-3, state, -3.0, -0.6e-3) == pytest.approx(-2.0)
    assert force_gradient.gradient_force(1e-3, state, -0.5, -0.1e-3) == 0.0  # never pulls


@pytest.mark.slow
def test_a_force_that_is_augmented_meets_the_stiffness_in_the_end_and_gives_back_that_of_the_soft_spring():
    given = force_augmentation.ForceAugmentationParameters(feedback_stiffness=500.0)
    way = np.linspace(-1.95e-3, -2e-3, 11)
    positions = [0.001, *np.linspace(0.0, -2e-3, 41), *np.concatenate([np.concatenate([way[::-1], way])] * 400)]
    _, torques, balances = rendered("force_augmentation", positions, given)
    assert torques[1:42] == pytest.approx(-5000.0 * np.array(positions[1:42]))  # the first press is the wall
    assert torques[53] == pytest.approx(500.0 * 1.95e-3, rel=0.2)  # and its release soft
    assert torques[-1] == pytest.approx(5000.0 * 2e-3, rel=0.02)  # K, in the middle of the way
    assert np.diff(torques[-22:-11]) / np.diff(positions[-22:-11]) == pytest.approx(-500.0)
    assert sum(balance.h_i for balance in balances) > 0.0


def test_a_tank_gives_no_more_than_is_in_it_to_a_motion_that_goes_on():
    rng = random.Random(5)
    for _ in range(200):
        given = energy_tank.EnergyTankParameters()
        state = energy_tank._EnergyTankState(brought=rng.choice([0.0, rng.uniform(0.0, 0.01)]))
        moved, variable, damper = rng.uniform(-1e-3, 1e-3), rng.uniform(-20.0, 20.0), rng.uniform(-1.0, 1.0)
        hold = Hold(moved, 0.0, 0.0, 0.0, 1e-3, moved / 1e-3, 0.0, 0)
        share = energy_tank.allowed_share(given, state, hold, variable, damper)
        assert 0.0 <= share <= 1.0
        assert -share * variable * moved <= state.brought + max(0.0, damper * moved) + 1e-15
        if variable * moved >= 0.0:
            assert share == 1.0


def test_a_full_tank_renders_the_wall_and_an_empty_one_only_its_constant_part():
    inside = [0.0, *[-1e-3] * 5, -0.5e-3, -0.4e-3]  # entered in one step: the spring gives back what it never took
    for energy, share in ((10.0, 1.0), (0.0, 0.2)):
        given = energy_tank.EnergyTankParameters(constant_stiffness=1000.0, initial_energy=energy, most_energy=20.0)
        _, torques, _ = rendered("energy_tank", inside, given)
        assert torques[-1] == pytest.approx(share * 5000.0 * 0.4e-3)


@pytest.mark.parametrize("delay", [0, 1, 2])
def test_over_lost_samples_a_tank_holds_what_came_in(delay):
    """With a variable spring alone every torque is out of the tank, also a repeated one."""
    rng, sent, position = random.Random(delay), deque([0.0] * (delay + 1)), 1e-3
    made: Any = build_controller(WALL, "energy_tank", None, LOOP.model_copy(update={"delay": delay}))
    known = 0.0
    for _ in range(300):
        position = min(1e-3, max(-2e-3, position + rng.uniform(-2e-4, 2e-4)))
        applied = sent.popleft()
        balance = made.sample_lost() if rng.random() < 0.2 else made.step(position, applied)
        sent.append(balance.torque)
        known += balance.h_i
        assert made._state.brought == pytest.approx(known, abs=1e-12)
    assert known != 0.0


def test_the_switch_of_ultimate_passivity_has_hysteresis():
    given = ultimate_passivity.UltimatePassivityParameters(lower=-0.5, upper=0.5, counted_holds=7)
    state = ultimate_passivity._UltimatePassivityState()
    modes = []
    for brought in (-0.4, -0.2, 0.5, 0.5, 0.2, -0.8, 0.0, -0.4):
        ultimate_passivity.switch(given, state, brought)
        modes.append(state.conservative)
    assert modes == [False, True, True, True, False, False, False, False]
    assert state.energy == -0.4  # set to zero at the seventh hold
    with pytest.raises(ValueError, match="upper > lower"):
        ultimate_passivity.UltimatePassivityParameters(lower=-0.1, upper=-0.2)


def test_every_one_names_its_source_and_its_departures():
    for name in LITERATURE:
        module = importlib.import_module(load(LITERATURE, name, "algorithm").__module__)
        doc = " ".join((module.__doc__ or "").split())
        assert "which was read" in doc or "which was." in doc
        assert "Departures:" in doc
        assert "It promises nothing" in doc or "that it promises nothing" in doc


def test_the_damping_that_an_observer_adds_is_its_force_over_the_velocity():
    hold, asked = Hold(-1e-3, 0.0, -0.5, 0.0, 1e-3, -1.0, 0.0, 0), Asked(0, 0.0, True, 4.0, 0.0, 2.0)
    loop, given = LoopProperties(sample_time=1e-3), bounded_observer.BoundedObserverParameters(force_limit=3.0)
    bounded: Any = SimpleNamespace(
        state=bounded_observer._BoundedObserverState(), settings=bounded_observer.settings_of(WALL, given, loop)
    )
    windowed: Any = SimpleNamespace(
        state=windowed_observer._WindowedObserverState(),
        settings=SimpleNamespace(limit=50.0),
        memory=SimpleNamespace(own=[0.0] * 3),
    )
    for respond, run in ((bounded_observer.respond, bounded), (windowed_observer.respond, windowed)):
        for speed in (-1.0, -0.25):
            moved = hold._replace(displacement=1e-3 * speed, velocity=speed)
            stored, spring, _, force, damping = respond(run, moved, asked)
            assert (stored, spring) == (1.0, 4.0)
            assert force < 0.0
            assert damping == pytest.approx(2.0 + force / speed)


def test_no_force_is_augmented_where_the_contact_has_no_depth():
    given, state = force_augmentation.ForceAugmentationParameters(), force_augmentation._ForceAugmentationState()
    assert force_augmentation.augmented_force(given, state, 0.0, 0.5) == 0.5


@pytest.mark.parametrize(("spring", "share"), [(5.0, 0.2), (-5.0, 0.2), (0.0, 1.0)])
def test_an_empty_tank_sends_the_constant_part_of_the_spring_and_counts_that_part_as_stored(spring, share):
    given, state = energy_tank.EnergyTankParameters(constant_stiffness=1000.0), energy_tank._EnergyTankState()
    state.model.true = 1e-3 * (spring / 5.0)
    run: Any = SimpleNamespace(settings=SimpleNamespace(given=given), state=state, memory=SimpleNamespace(own=[0.0]))
    out = Hold(-1e-4 if spring > 0.0 else 1e-4, 0.0, 0.0, 0.0, 1e-3, 0.0, 0.0, 0)
    reply = energy_tank.respond(run, out, Asked(0, 0.0, True, spring, 0.0, 2.0))
    assert reply == pytest.approx((share, share * spring, 0.0, 0.0, 2.0))


def test_the_bound_of_energy_counts_what_an_encoder_hides_and_limits_spring_and_damper_together():
    device, hold = energy_bounding.Device(0.5, 1e-3, 1e-4, 0.0), Hold(1e-3, 0.0, 2e-3, 0.0, 1e-3, 1.0, 3.0, 0)
    state = energy_bounding._EnergyBoundingState()
    dissipated = 0.5 / 1e-3 * (1e-3 - 1e-4) ** 2
    known = 2e-3 + dissipated - 0.5 * 1e-4 * (3.0 + 3.0)  # at rest before, so that 3 N are the change as well
    assert energy_bounding.known_energy(device, 1e-3, state, hold) == pytest.approx(known)
    run: Any = SimpleNamespace(
        settings=SimpleNamespace(given=device, hold=SimpleNamespace(sample_time=1e-3)),
        state=energy_bounding._EnergyBoundingState(),
        memory=SimpleNamespace(axis=SimpleNamespace(commands=SimpleNamespace(torques=[0.0]))),
    )
    share = np.sqrt(4.0 * 0.5 / 1e-3 * known) / 3.5
    assert share < 1.0
    reply = energy_bounding.respond(run, hold, Asked(0, 0.0, True, 4.0, -0.5, 2.0))
    assert reply == pytest.approx((share, share * 4.0, share * -0.5, 0.0, share * 2.0))


def test_a_storage_from_which_the_damper_took_everything_is_at_rest():
    stored = 0.5 * 5000.0 * 1e-3**2
    storage = Storage(zone=1, true=-1e-3, state=-1e-3, velocity=-1.0, h_s=stored)
    settings: Any = SimpleNamespace(damping=2.0, by_place=False)
    hold = Hold(-1e-4, -20.0, 0.0, 0.0, 1e-3, -0.1, 0.0, 0)  # its damper would dissipate 0.2 J
    account = a_priori_dissipation.exchange(WALL, settings, storage, hold)
    assert account.h_r == pytest.approx(stored)
    assert (storage.state, storage.velocity, storage.h_s) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(("energy", "speed"), [(0.0, 0.0), (1e-3, 0.125), (5e-3, 0.5)])
def test_the_tank_of_a_display_scales_down_a_speed_that_would_overdraw_it(energy, speed):
    tank: Any = SimpleNamespace(_energy=energy, _time=1e-3, axes=1)
    assert TankAdmittance._protected(tank, [0.5], [-8.0])[0] == pytest.approx([speed])  # the next hold gives out 4 mJ


def test_the_tank_of_several_axes_pays_for_all_of_them_together():
    assert TankAdmittanceParameters().initial == 0.0
    tank: Any = SimpleNamespace(_energy=1e-3, _time=1e-3, axes=2)
    request, slips = TankAdmittance._protected(tank, [0.5, 0.25], [-8.0, 2.0])  # 4 mJ out and 0.5 mJ in
    assert request == pytest.approx([0.5 / 3.5, 0.25 / 3.5])
    assert slips == [0.0, 0.0]
    assert TankAdmittance._protected(tank, [0.5, 0.25], [8.0, -2.0])[0] == [0.5, 0.25]


@pytest.mark.parametrize(("initial", "brought", "filled"), [(1.0, 0.0, 2e-3), (1.0, 2.5, 0.0), (0.0, 2.5, 2e-3)])
def test_a_damper_fills_a_tank_below_its_most_energy(initial, brought, filled):
    state = energy_tank._EnergyTankState(brought=brought)
    hold = Hold(1e-3, 2.0, 4e-3, 0.0, 1e-3, 1.0, 0.0, 0)
    energy_tank.fill(energy_tank.EnergyTankParameters(initial_energy=initial), state, hold, 0.25)
    assert state.brought == pytest.approx(brought + 1e-3 + filled)


@pytest.mark.parametrize(("wanted", "force"), [(5.0, 1.5 / 1.01), (-1.0, 1.0), (-4.0, 1.5 / 1.01)])
def test_the_force_of_the_bounded_observer_is_missing_power_over_a_speed_and_stops_where_it_would_pull(wanted, force):
    settings = bounded_observer.settings_of(WALL, bounded_observer.BoundedObserverParameters(), LOOP)
    state = bounded_observer._BoundedObserverState(integral=0.5, force=0.25)
    hold = Hold(1e-3, 0.0, 0.0, 0.0, 1e-3, 1.0, 0.0, 0)
    assert bounded_observer.controlling_force(settings, state, -1e-3, hold, wanted) == pytest.approx(force)
    assert state.integral == pytest.approx(0.5 + (1.0 - 0.25) / 10.0)
