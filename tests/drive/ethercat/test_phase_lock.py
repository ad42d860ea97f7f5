"""The host's cycle locks onto SYNC0, from any phase and against any quartz."""

import random

import pytest

from canhaptic.drive.ethercat.phase_lock import PhaseLock

PERIOD = 1_000_000


def run(begin: int, ppm: float, cycles: int) -> tuple[list[int], PhaseLock]:
    lock, now, errors = PhaseLock(PERIOD, PERIOD // 4), begin, []
    lock.begin(0)
    for _ in range(cycles):
        correction = lock.follow(round(now * (1.0 + ppm * 1e-6)))
        errors.append(abs(lock.error))
        now += PERIOD - correction
    return errors, lock


@pytest.mark.slow_but("0-*", "25-*", "50-*", "75-*")
@pytest.mark.parametrize("ppm", [-100.0, -20.0, 0.0, 20.0, 100.0])
@pytest.mark.parametrize("share", range(0, 100, 5))
def test_it_is_within_5_percent_in_50_cycles_from_any_phase(ppm: float, share: int) -> None:
    errors, lock = run(7 * PERIOD + share * PERIOD // 100, ppm, 1200)
    assert max(errors[50:]) <= 0.05 * PERIOD
    assert max(errors[-100:]) <= 0.002 * PERIOD
    assert lock.is_locked


def test_it_is_locked_only_after_a_second_within_5_percent() -> None:
    assert not run(PERIOD // 4, 0.0, 999)[1].is_locked
    assert run(PERIOD // 4, 0.0, 1000)[1].is_locked


@pytest.mark.parametrize(("good", "locked_after"), [(30, 1539), (9, None)])
def test_a_deadline_that_was_not_kept_takes_back_ten(good: int, locked_after: int | None) -> None:
    lock, found = PhaseLock(PERIOD, PERIOD // 4), None
    lock.begin(0)
    for cycle in range(1, 5001):
        lock.follow(cycle * PERIOD + PERIOD // 4 + (PERIOD // 10 if cycle % (good + 1) == 0 else 0))
        if lock.is_locked:
            found = cycle
            break
    assert found == locked_after


def test_a_quartz_beyond_belief_is_never_locked() -> None:
    assert not run(0, 20_000.0, 3000)[1].is_locked


def test_a_loaded_host_locks_by_its_deadlines_and_frames_that_took_long_say_nothing() -> None:
    dice, lock, due, before = random.Random(3), PhaseLock(PERIOD, PERIOD // 4), 0, 0.0
    lock.begin(0)
    for _ in range(1400):
        late = dice.randrange(PERIOD // 2) if dice.random() < 0.3 else dice.randrange(PERIOD // 50)
        held_up = dice.randrange(PERIOD) if dice.random() < 0.1 else 0  # between departure and reference clock
        correction = lock.follow(round((due + late + held_up) * 1.00004), late, 2_000 + held_up)
        due += PERIOD - correction
        before = due * 1.00004
    assert lock.is_locked
    assert abs((before - PERIOD // 4 + PERIOD // 2) % PERIOD - PERIOD // 2) < 0.01 * PERIOD
