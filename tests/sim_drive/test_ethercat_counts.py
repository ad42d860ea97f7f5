"""Held torques are counted by the host, by the frames without answer and by the drives; the three counts obey a law.

drive <= host <= drive + frames without answer, for faults in any order. For isolated faults both are equations.
"""

import random
from collections.abc import Mapping
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canhaptic.sim.drive.ethercat.cable import Cable, CableEffects, Fault
from canhaptic.sim.drive.ethercat.drive_node import ClockParameters
from tests.drawn import examples
from tests.sim_drive.ethercat_line import PERIOD, Line, make_drive, plan

KINDS = (Fault.LATE, Fault.LOST, Fault.ANSWER_LOST, Fault.LOW_COUNTER)


def line_with(faults: Mapping[int, Fault], cycles: int, **second: Any) -> Line:
    """Run two drives of -40 and -10 ppm with faults of the second frame, and five cycles without at the end."""
    clock = ClockParameters(**({"drift_ppb": -10_000, "epoch": 77_777_777_777} | second))
    line = Line(make_drive(ClockParameters(drift_ppb=-40_000)), make_drive(clock))
    line.start()
    draw = plan(dict(faults))
    line.cable.draw = lambda: next(draw)
    for k in range(cycles + 5):
        line.cycle(k % 200 - 100, k % 100)
    return line


def obeys(line: Line) -> bool:
    drives = [line.missed_by(n) for n in range(2)]
    return all(drive <= line.missed <= drive + line.unanswered for drive in drives)


def isolated(cycles: int, share: float, seed: int) -> dict[int, Fault]:
    dice = random.Random(seed)
    return {k: dice.choice(KINDS[:3]) for k in range(3, cycles - 3, 3) if dice.random() < share}


@settings(max_examples=examples(20), deadline=None)
@given(st.dictionaries(st.integers(0, 39), st.sampled_from(KINDS), max_size=20), st.integers(0, 99))
def test_faults_in_any_order_obey_the_law(faults: dict[int, Fault], seed: int) -> None:
    line = line_with(faults, 40)
    assert obeys(line), (line.missed, line.unanswered, [line.missed_by(n) for n in range(2)])


def check_equations(cycles: int, share: float, seed: int) -> None:
    faults = isolated(cycles, share, seed)
    line = line_with(faults, cycles)
    late, lost, answers = (list(faults.values()).count(kind) for kind in KINDS[:3])
    assert line.missed == late + lost + answers
    assert [line.missed_by(n) for n in range(2)] == [line.missed - answers] * 2
    assert (line.unanswered, line.twice) == (lost + answers, late)


def test_isolated_faults_are_counted_exactly() -> None:
    check_equations(300, 0.3, seed=1)


@pytest.mark.slow
def test_isolated_faults_of_a_long_run_are_counted_exactly() -> None:
    check_equations(20_000, 0.05, seed=4)


@pytest.mark.slow
@pytest.mark.parametrize("batch", range(8))
def test_the_law_holds_for_a_third_of_all_frames_in_any_order(batch: int) -> None:
    for seed in range(25 * batch, 25 * batch + 25):
        dice = random.Random(seed)
        line = line_with({k: dice.choice(KINDS) for k in range(250) if dice.random() < 0.3}, 250)
        assert obeys(line), seed


def test_a_drive_without_drift_servo_is_caught() -> None:
    assert obeys(line_with({}, 300, drift_ppb=2_000_000))
    assert not obeys(line_with({}, 300, drift_ppb=2_000_000, has_servo=False))


def test_effects_of_a_scene_begin_in_op_and_are_the_same_every_time() -> None:
    effects = CableEffects.model_validate(
        {"drift": 40e-6, "late": "1 %", "lost": 0.02, "answer_lost": 0.03, "low_counter": 0.04}
    )
    runs = []
    for _ in range(2):
        line = Line(effects=effects, seed=5)
        line.start()
        for _ in range(400):
            line.cycle(10)
        runs.append((line.cable.counts, line.missed, line.unanswered, line.missed_by(0)))
    assert runs[0] == runs[1]
    counts = runs[0][0]
    assert all(0.5 < counts[kind] / (8.4 * n) < 1.6 for n, kind in enumerate(KINDS, 1))


def test_a_drive_leaves_op_and_the_cable_breaks_at_the_times_of_the_scene() -> None:
    effects = CableEffects(falls_to_safe_op=0.02, broken_at=0.03)
    line = Line(make_drive(), make_drive(), effects=effects)
    line.start()
    states, counters = set(), set()
    for _ in range(40):
        counters.add(line.cycle(10, 10) is not None)
        states |= {drive.al_state for drive in line.drives}
    assert states == {4, 8}
    assert counters == {True, False}


def test_a_cable_of_one_drive_that_breaks_brings_nothing_back() -> None:
    line = Line(effects=CableEffects(broken_at=0.0))
    line.start()
    before = line.clock.now()
    assert line.cycle(10) is None
    assert line.clock.now() - before <= 2 * PERIOD
    assert isinstance(line.cable, Cable)
