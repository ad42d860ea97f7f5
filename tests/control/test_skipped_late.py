"""SYNCs that are skipped while torques come late: the energy is no farther from the booked one than is stated.

The plant is that of `late_plant`, in closed form; a small hill climb over the hand, the changes of the torque and the
places of the long holds searches the largest error beyond the stated resolution.
"""

import random
from typing import Any

import pytest

from canhaptic.control.certificates import certified_torque
from tests.adversary.late_axis import PARTS, Late
from tests.control.test_late_torque import made

HOLDS = 24
CASES = {
    "window, 10 T": (1e-3, 0, 10, 3e-4, 0.0, 20.0),
    "window and lag, 20 T": (1e-3, 0, 20, 5.2e-4, 1e-4, 20.0),
    "lag, 10 T, one late": (2e-3, 1, 10, 0.0, 1e-4, 20.0),
}
"""Sample time [s], delay, length of a long hold, window [s], lag [s], force of the hand [N]; 0.25 kg on 2 kN/m."""


def beyond(case: str, hand: list[list[float]], late: list[float], first: int, speed: float) -> float:
    """Returns the largest error of the booked sum beyond the stated resolution [J]."""
    sample_time, delay, length, window, lag, force = CASES[case]
    known = {"torque_window": window, "current_lag": lag}
    controller: Any = made(sample_time, delay, 2000.0, 0.0, {"hand_force": force}, known)
    plant, held, pending = Late(0.25, lag, 2e-4, speed), 0.0, [0.0] * delay
    booked, worst, periods = 0.0, -1.0, 1
    for hold, (forces, change) in enumerate(zip(hand, late, strict=True)):
        if periods > 1:
            controller.note_skipped_syncs(float(periods))
        balance = controller.step(plant.position, held)
        booked += balance.h_i
        true = -plant.given
        worst = max(worst, abs(booked - true) - controller.energy_resolution)
        pending.append(balance.torque)
        new, begin, periods = pending.pop(0), 0.0, length if hold >= first and (hold - first) % 6 == 0 else 1
        time = sample_time * periods
        for part in range(PARTS):
            end = time * (part + 1) / PARTS
            middle = min(max(window * change, begin), end)
            plant.move(held, forces[part], middle - begin)
            plant.move(new, forces[part], end - middle)
            begin = end
        held = new
    return worst


def climb(case: str, seed: int, steps: int) -> float:
    draw, force = random.Random(seed), CASES[case][-1]
    choices = (-60.0, -20.0, 0.0, force, 0.5 * force)
    hand = [[draw.choice(choices)] * PARTS for _ in range(HOLDS)]
    late, first, speed = [draw.choice((0.0, 1.0)) for _ in range(HOLDS)], draw.randrange(3, 9), -draw.uniform(0.02, 0.4)
    best = beyond(case, hand, late, first, speed)
    for _ in range(steps):
        tried, changes, place = [list(part) for part in hand], list(late), draw.randrange(HOLDS)
        for one in range(place, min(HOLDS, place + draw.randrange(1, 6))):
            tried[one] = [draw.choice(choices) for _ in range(PARTS)]
            changes[one] = draw.choice((0.0, 1.0))
        begin, quick = draw.choice((first, draw.randrange(3, 9))), speed * draw.choice((1.0, 0.7, 1.4))
        found = beyond(case, tried, changes, begin, quick)
        if found >= best:
            best, hand, late, first, speed = found, tried, changes, begin, quick
    return best


@pytest.mark.slow_but("window and lag, 20 T")
@pytest.mark.parametrize("case", CASES)
def test_a_skipped_sync_leaves_no_more_open_than_is_stated(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert climb(case, 4, 30) <= 1e-12
    of_hold: Any = certified_torque.reach_by_older_torques
    monkeypatch.setattr(certified_torque, "reach_by_older_torques", lambda *known: of_hold(*known[:-1], 1.0))
    assert climb(case, 4, 30) > 1e-4  # of a hold of one sample time


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_no_hand_that_a_search_finds_leaves_more_open(case: str) -> None:
    assert max(climb(case, seed, 60) for seed in range(24)) <= 1e-12
