"""The simulated five-bar against open chains with multipliers (DOP853), its order, and its energy account."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canhaptic.errors import ParameterError
from canhaptic.sim.plant.mechanism.five_bar_linkage import FiveBarLinkage
from canhaptic.sim.plant.mechanism.task_hand import TaskHand
from tests.drawn import examples
from tests.plant.mechanism.mechanism_scenes import LINKS, MS, OpenChains, five_bar, integrated, run, wavy

LEFT = st.floats(1.7, 2.9)
RIGHT = st.floats(0.2, 1.4)


def reference(count: int, period: float = 1e-3) -> np.ndarray:
    chains = OpenChains()
    return integrated(chains.rates, chains.start(), wavy(count), period)  # type: ignore[arg-type]


def stored_error(mechanism: Any) -> float:
    """Energy of the state minus the accounts of both motors [J], from a start without stored energy."""
    return float(mechanism.stored - sum(mechanism.energy(axis).stored for axis in (0, 1)))


@pytest.mark.slow
def test_motion_and_works_are_those_of_two_open_chains_held_together_by_multipliers():
    mechanism, torques = five_bar(substeps=64), wavy(300)
    positions = run(mechanism, torques)
    expected = reference(300)
    assert np.ptp(expected[:, 0]) > 0.1
    assert np.abs(positions - expected[:, :2]).max() < 2e-7
    assert np.abs(np.array(mechanism.velocities) - expected[-1, 4:6]).max() < 2e-6
    for axis in (0, 1):
        work = sum(pair[axis] * step for pair, step in zip(torques, np.diff(expected[:, axis]), strict=True))
        assert mechanism.energy(axis).motor == pytest.approx(work, abs=1e-7)
    kinetic = kinetic_energy(expected[-1])
    assert sum(mechanism.energy(axis).stored for axis in (0, 1)) == pytest.approx(kinetic, abs=1e-6)
    assert mechanism.stored == pytest.approx(kinetic, abs=1e-6)


def kinetic_energy(z: np.ndarray) -> float:
    """Energy of the open chains, from the velocities of points."""
    a, b, v = LINKS["proximal"], LINKS["distal"], z[4:]
    total = 0.0
    for side in (0, 1):
        elbow = a * v[side] * np.array([-math.sin(z[side]), math.cos(z[side])])
        swing = b * v[side + 2] * np.array([-math.sin(z[side + 2]), math.cos(z[side + 2])])
        centre = elbow + swing / 2
        total += 0.5 * LINKS["motor_inertia"] * v[side] ** 2
        total += 0.5 * LINKS["distal_mass"] * (centre @ centre + b * b * v[side + 2] ** 2 / 12)
        if side == 0:
            tip = elbow + swing
            total += 0.5 * LINKS["handle_mass"] * tip @ tip
    return total


@pytest.mark.slow
@given(left=LEFT, right=RIGHT, seed=st.integers(0, 10_000))
@settings(max_examples=examples(30), deadline=None)
def test_no_joule_is_lost_at_any_pose_even_at_coarse_steps(left: float, right: float, seed: int):
    mechanism = five_bar(
        period=5 * MS, initial_angles=(left, right), elbow_stop={"least": 0.05, "most": 0.39, "stiffness": 2e4}
    )
    random = np.random.default_rng(seed)
    mechanism.begin(0)
    at_start = mechanism.stored  # of the stop, where the elbows begin in it
    for k in range(60):
        mechanism.advance_to((k + 1) * 5 * MS, tuple(random.uniform(-0.3, 0.3, 2)))
    largest = max(abs(value) for axis in (0, 1) for value in mechanism.energy(axis))
    assert abs(stored_error(mechanism) - at_start) <= 1e-10 * max(largest, 1.0)
    assert all(mechanism.energy(axis).dissipated >= 0.0 for axis in (0, 1))


def test_a_hand_that_stands_still_gives_back_what_it_got_and_never_more():
    hand = TaskHand(stiffness=200, rest=(0.02, 0.24))
    mechanism = five_bar(hand, damping=0.0)
    mechanism.begin(0)
    start = np.array(mechanism.handle) - hand.rest
    energy, stored = [], []
    for k in range(1000):
        mechanism.advance_to((k + 1) * MS, (0.0, 0.0))
        apart = np.array(mechanism.handle) - hand.rest
        stored.append(mechanism.stored)
        energy.append(mechanism.stored + 100.0 * (apart @ apart) - 100.0 * (start @ start))
    assert max(stored) > 0.5 * 100.0 * (start @ start)  # most of the energy of the hand is in the links for a while
    assert np.abs(energy).max() < 1e-11  # of 0.05 J: the solver stops at 1e-15 rad


def test_the_motor_is_booked_torque_times_displacement_also_inside_a_sample_time():
    mechanism = five_bar()
    mechanism.begin(0)
    booked, last = np.zeros(2), np.array(mechanism.positions)
    for now, torques in ((300_000, (0.2, -0.1)), (1_000_000, (-0.3, 0.1)), (1_700_000, (0.1, 0.0))):
        mechanism.advance_to(now, torques)
        booked += np.array(torques) * (np.array(mechanism.positions) - last)
        last = np.array(mechanism.positions)
    assert [mechanism.energy(axis).motor for axis in (0, 1)] == pytest.approx(booked, abs=1e-18)


def test_a_singular_pose_is_refused_with_its_place_and_a_remedy():
    with pytest.raises(ParameterError, match=r"elbows are 0\.4 m apart.*singular.*elbow_stop"):
        five_bar(initial_angles=(math.pi, 0.0))
    mechanism = five_bar(None)
    mechanism.begin(0)
    with pytest.raises(ParameterError, match="singular pose"):
        run(mechanism, [(0.5, -0.5)] * 2000)


FLUNG: dict[str, Any] = {  # light motors, a handle without friction and a hand that pushes hard: 75 rad/s after 70 ms
    **LINKS, "motor_inertia": 6.546e-5, "distal_mass": 0.0, "handle_mass": 0.1252, "damping": 0.0,
    "initial_angles": (2.983, 0.9964),
}  # fmt: skip
THROWER = TaskHand(stiffness=82.6, push=(12.44, -11.36), rest=(0.0444, 0.1287))


@pytest.mark.slow
def test_a_mechanism_flung_about_at_coarse_steps_keeps_its_energy_and_converges_to_the_reference():
    period, torques = 5 * MS, wavy(14, 0.16)
    chains = OpenChains(FLUNG, THROWER)
    expected = integrated(chains.rates, chains.start(), torques, 5e-3)  # type: ignore[arg-type]
    errors = []
    for substeps in (1, 8, 32):
        mechanism = FiveBarLinkage(**FLUNG).build(THROWER, period, substeps)
        errors.append(np.abs(run(mechanism, torques, period) - expected[:, :2]).max())
        assert abs(stored_error(mechanism)) <= 1e-9 * mechanism.stored
    assert np.abs(expected[:, 4:6]).max() > 50.0
    assert errors[-1] < 2e-4
    assert 1.8 < np.log(errors[1] / errors[2]) / np.log(4.0) < 2.2


@pytest.mark.slow
def test_any_force_moves_the_links_or_is_told_the_singular_pose_it_drove_them_into():
    told = []
    for seed in range(30, 60):  # among them light links at 20 ms with 20 N at the handle, and no stop
        random = np.random.default_rng(seed)
        period, size = (MS, 5 * MS, 20 * MS)[seed % 3], 10 ** random.uniform(-2.0, 0.5)
        stop = {"least": 0.0, "most": 0.399, "stiffness": 10 ** random.uniform(3.0, 7.0)} if seed % 2 else None
        hand = TaskHand(stiffness=10 ** random.uniform(0.0, 5.0), rest=(0, 0.25), push=random.uniform(-20.0, 20.0, 2))
        inertia, handle = 10 ** random.uniform(-5.0, -2.5), 10 ** random.uniform(-3.0, 0.0)
        mechanism = five_bar(hand, period=period, motor_inertia=inertia, handle_mass=handle, elbow_stop=stop)
        torques = [(float(left), float(right)) for left, right in size * random.uniform(-1.0, 1.0, (20, 2))]
        told.append(pushed_about(mechanism, torques, period))  # type: ignore[arg-type]
        largest = max(abs(value) for axis in (0, 1) for value in mechanism.energy(axis))
        assert abs(stored_error(mechanism)) <= 1e-8 * max(largest, 1.0)
    assert 0 < sum(map(bool, told)) < 10
    assert all("singular pose" in error for error in told if error)


def pushed_about(mechanism: Any, torques: list[tuple[float, ...]], period: int) -> str:
    """Moves a mechanism; returns the error that stopped it."""
    mechanism.begin(0)
    for k, pair in enumerate(torques):
        try:
            mechanism.advance_to((k + 1) * period, pair)
        except ParameterError as error:
            return str(error)
    return ""


@pytest.mark.slow
def test_the_elbow_stop_keeps_the_links_from_stretching():
    mechanism = five_bar(None, elbow_stop={"most": 0.38, "stiffness": 1e5}, damping=0.05)
    mechanism.begin(0)
    spans = []
    for k in range(1900):
        mechanism.advance_to((k + 1) * MS, (0.05, -0.05))
        left, right = mechanism.positions
        across, along = math.sin(right) - math.sin(left), math.cos(right) - math.cos(left)
        spans.append(math.hypot(0.1 + 0.15 * along, 0.15 * across))
    assert max(spans) < 0.381
    assert spans[-1] == pytest.approx(0.38, abs=1e-4)
    assert abs(stored_error(mechanism)) < 1e-10


def test_a_stop_beyond_the_singular_pose_is_refused():
    with pytest.raises(ParameterError, match=r"expected least < most < 0\.4"):
        FiveBarLinkage(**{**LINKS, "elbow_stop": {"most": 0.41, "stiffness": 1e5}})


def test_time_does_not_go_back():
    mechanism = five_bar()
    mechanism.begin(0)
    mechanism.advance_to(MS, (0.0, 0.0))
    with pytest.raises(ParameterError, match="time went back"):
        mechanism.advance_to(MS - 1000, (0.0, 0.0))
