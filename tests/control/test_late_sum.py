"""Certificates as one where torques come late or frames are lost: against motions, and against hands."""

import math
import random
from dataclasses import replace

import pytest

from canhaptic.control.certificates.certified_torque import (
    Declared,
    LateMotion,
    TorqueBound,
    bound_memory,
    largest_of_late_torques,
    taken_in_hold,
)
from canhaptic.control.certificates.scalar_bounds import displacement_response, hold_timing, next_displacement
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.guarded import Guarded, GuardedParameters
from canhaptic.kernels import list_of_zeros
from tools.attack.plant import DISSIPATED, TAKEN_IN, Rig, V, X, hold

T, MASS, PULL = 1e-3, 0.25, 5.0
ROUNDING = 1e-12


def declared(*, friction=0.0, damping=0.0, speed=0.0, late=2e-4, losses=0, delay=1):
    timing = hold_timing(T, 0.0, late, 0.0)
    response = displacement_response(T, MASS, PULL, 0.0, 0.0, timing=timing)
    return Declared(
        T, delay, losses, True, response, damping, speed, 0.0, late, late / T, timing.left, friction=friction
    )  # fmt: skip


@pytest.mark.slow_but("0.0001-*-0.0", "0.0-*-2.0")
@pytest.mark.parametrize(("friction", "damping"), [(0.0, 0.0), (0.5, 0.0), (0.0, 2.0), (0.5, 2.0), (9.0, 0.0)])
@pytest.mark.parametrize("late", [0.0, 1e-4, 3e-4])
def test_no_motion_within_reach_takes_more_of_a_hold_whose_torque_comes_late(friction, damping, late):
    """The fastest motion, and slower ones, with the torque before held on for a part of the hold."""
    draw, known, parts = random.Random(1), declared(friction=friction, damping=damping, late=late), 400
    for _ in range(60):
        before, now = draw.uniform(0.0, 6.0), draw.uniform(0.0, 6.0)
        moved = draw.uniform(-4e-4, 2e-4)
        motion = LateMotion(moved, before, before, before)
        counted = now + known.response.late * max(0.0, before - now)
        following = next_displacement(moved, before, counted, known.response, known.response.hand)
        most = taken_in_hold(known, known.response.hand, 0.0, motion, now, now, following)
        speed = moved / T + 0.5 * T * (before + PULL) / MASS  # at the SYNC, after the largest force throughout
        shape, slower = draw.choice([0.0, 0.3, 1.0, 3.0]), draw.uniform(0.0, 0.2)
        taken = 0.0
        for part in range(parts):
            t = (part + 0.5) * T / parts
            torque = before if t < late else now
            fastest = speed + (torque + PULL) / MASS * T / parts * 0.5
            speed += (torque + PULL) / MASS * T / parts
            v = fastest - slower * draw.random() ** 2 * shape
            taken += (torque * v - damping * v * v - friction * abs(v)) * T / parts
        assert taken <= most + ROUNDING


@pytest.mark.parametrize(("losses", "late"), [(0, 2e-4), (1, 0.0), (1, 2e-4), (3, 2e-4)])
def test_a_certificate_more_never_costs_torque(losses, late):
    draw = random.Random(3)
    for _ in range(40):
        whole = declared(friction=0.5, damping=2.0, speed=0.3, late=late, losses=losses)
        bound = TorqueBound(displacement=draw.uniform(-3e-4, 2e-4), torque=draw.uniform(0.0, 3.0), out=1.0)
        bound.most = bound.highest = bound.lowest = bound.least = bound.torque
        bound.dissipated = bound.certain = draw.uniform(0.0, 2e-3)
        memory, energy = bound_memory(whole, [draw.uniform(0.0, 2.0), 0.0], list_of_zeros), draw.uniform(0.0, 2e-3)
        most = largest_of_late_torques(whole, bound, memory, 1.0, energy)[0]
        for left_out in ({"by_hand_force": False}, {"friction": 0.0}, {"hand_speed": 0.0}, {"damping": 0.0}):
            assert largest_of_late_torques(replace(whole, **left_out), bound, memory, 1.0, energy)[0] <= most * (
                1 + 1e-9
            )


def test_a_debt_is_met_with_a_torque_that_takes_energy_in_by_itself_or_with_none():
    """It comes late by all of the window, or not at all."""
    draw, sent = random.Random(5), 0
    for _ in range(400):
        known = declared(late=draw.choice([1e-4, 3e-4]), delay=0)
        moved, before = draw.uniform(-6e-4, 1e-4), draw.uniform(0.0, 6.0)
        bound = TorqueBound(displacement=moved, torque=before, out=1.0)
        bound.most = bound.highest = bound.lowest = bound.least = before
        memory = bound_memory(known, [0.0], list_of_zeros)
        torque = largest_of_late_torques(known, bound, memory, 1.0, -draw.uniform(0.0, 1e-2))[0]
        sent += torque > 0.0
        fastest = moved / T + 0.5 * T * (before + PULL) / MASS
        for begin in (0.0, known.late):  # it acts from the SYNC on, or from the end of the window
            way = (fastest + (before + PULL) / MASS * begin) * (T - begin)
            assert torque * (way + 0.5 * (torque + PULL) / MASS * (T - begin) ** 2) <= ROUNDING
    assert sent > 100


@pytest.mark.slow_but("0", "1", "5", "7", "10")
@pytest.mark.parametrize("seed", range(12))
def test_no_hand_takes_more_than_came_in_and_the_device_dissipates_where_frames_are_lost(seed):
    draw = random.Random(seed)
    delay, losses, late = seed % 2, draw.choice([1, 2]), draw.choice([0.0, 2e-4])
    damping, friction = draw.choice([(2.0, 0.0), (0.5, 0.5), (0.0, 2.0)])
    rig = Rig(T, MASS, damping, friction, window=late, delay=delay)
    loop = LoopProperties(
        sample_time=T, delay=delay, moving_mass=MASS, device_damping=damping or None, device_friction=friction or None,
        device_damping_bound=damping, device_friction_bound=friction, torque_window=late,
    )  # fmt: skip
    wall = SpringDamperWall(stiffness=draw.choice([500.0, 5e3]), position=0.0)
    one = Guarded(wall, GuardedParameters(hand_force=20.0, max_consecutive_losses=losses, earned_energy=0.02), loop)
    plant, pending, held, missed, hand, strongest = [0.0] * 8, [0.0] * delay, 0.0, 0, -5.0, 0.0
    plant[X], plant[V] = 0.004, -0.1
    one.step(plant[X], 0.0)
    for _ in range(500):
        if draw.random() < 0.15:
            hand = draw.choice([20.0, 20.0, -5.0, -20.0, 0.0])
        if abs(plant[X]) > 0.02:
            hand = -math.copysign(10.0, plant[X])
        hold(rig, plant, held, hand, T)
        assert plant[TAKEN_IN] + plant[DISSIPATED] >= -1e-10
        pending.append(one.step(plant[X], held).torque)
        sent, strongest = pending.pop(0), max(strongest, abs(held))
        missed = missed + 1 if missed < losses and draw.random() < 0.5 else 0
        held = held if missed else sent
    assert strongest > 1.0
