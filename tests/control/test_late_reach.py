"""The reach of the hand after torques that come late, against its formulas solved by bisection or as quadratics."""

import math
import random

import pytest

from canhaptic.control.certificates.certified_torque import (
    LateMotion,
    absorbing_torque,
    torque_below_older,
    torque_by_late_reach,
)
from tests.control.late_formulas import (
    after,
    case_of,
    largest,
)


@pytest.mark.slow_but("1")
@pytest.mark.parametrize("losses", [1, 3])
def test_a_torque_that_may_be_held_on_takes_what_is_left_in_the_worst_number_of_holds(losses: int) -> None:
    """n sum(D) + g (X_1 + c sum(X)) + n x and the tail (n + c g) X, for as many holds as it may act in."""
    used = 0
    for seed in range(150):
        case = case_of(seed, losses=(losses,))
        known, r, draw = case.known, case.known.response, random.Random(seed)
        if not known.by_hand_force:
            continue
        inward = draw.choice([6e-5, 3e-4])
        motion = LateMotion(draw.uniform(-inward, 3e-5), draw.uniform(0.0, 2.0), draw.uniform(0.0, 3.0), 0.0)
        friction, energy, hand = draw.choice([0.0, 0.7]), draw.uniform(0.0, 3e-3), r.hand
        older, inward_now = max(0.0, motion.highest - friction), max(0.0, -motion.displacement)
        base = after(case, motion.displacement, motion.counted, r.late * motion.highest, hand)
        falls = (1.0 - r.retained) * max(0.0, -base)
        first = r.share * max(0.0, motion.displacement) + r.tail_before * motion.counted + r.tail_hand * hand
        first += r.tail_during * motion.highest

        def needs(net: float, holds: int) -> float:
            torque, moved, rise, whole, ahead, gains = net + friction, base, r.during, 0.0, 0.0, 0.0  # noqa: B023
            for number in range(holds):
                if number:
                    moved = moved * (r.growth if moved > 0.0 else 1.0) + hand + falls  # noqa: B023
                    rise = r.growth * rise + r.before + r.during  # noqa: B023
                whole, ahead, gains = whole + moved + rise * torque, ahead + max(0.0, moved), gains + rise
            late = r.behind * (inward_now + known.left * (holds - 1) * max(0.0, -base))  # noqa: B023
            reach = r.share * (ahead + gains * torque) + r.tail_hand * hand  # noqa: B023
            reach += (r.tail_before + r.tail_during) * (motion.highest + torque)  # noqa: B023
            early = older * (first + r.tail_during * torque)  # noqa: B023
            return net * (whole + late) + early + (net + known.left * older * holds) * reach  # noqa: B023

        if max(needs(0.0, holds) for holds in range(1, losses + 2)) > energy:
            continue
        expected = largest(lambda net: max(needs(net, holds) for holds in range(1, losses + 2)), energy)
        found = torque_by_late_reach(known, hand, motion, friction, energy)
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-9), seed
        used += 1
    assert used > 30


def root_of(square: float, linear: float, energy: float) -> float:
    """The larger root of square n^2 + linear n = energy, the vertex where there is none, and never below 0."""
    under = linear * linear + 4.0 * square * energy
    return max(0.0, (-linear + math.sqrt(max(0.0, under))) / (2.0 * square))


def test_a_torque_below_the_older_ones_pays_for_what_they_give_out_meanwhile() -> None:
    """n D + (g - n) X + x n (g - l) / g and the tail (c g + (1 - c) n) X', with the tail's motion inward or not."""
    for seed in range(300):
        case = case_of(seed, losses=(0,))
        known, r, draw = case.known, case.known.response, random.Random(seed)
        if not known.by_hand_force:
            continue
        friction, hand, c = draw.choice([0.0, 0.4]), r.hand, known.left
        highest = draw.uniform(0.5, 3.0)
        motion = LateMotion(draw.uniform(-6e-5, 3e-5), draw.uniform(0.0, 2.0), highest, draw.uniform(0.0, highest))
        energy = draw.choice([draw.uniform(0.0, 1e-3), draw.uniform(-1e-4, 1e-4)])
        g, least = highest - friction, max(0.0, motion.lowest - friction)
        early = r.share * max(0.0, motion.displacement) + r.tail_before * motion.counted
        early += r.tail_during * highest + r.tail_hand * hand
        late = r.behind * max(0.0, -motion.displacement) * (g - least) / g
        found = []
        for outward in (0.0, r.share):

            def needs(n: float, outward: float = outward) -> float:
                torque = n + friction  # noqa: B023
                counted = r.late * highest + (1.0 - r.late) * torque  # noqa: B023
                left = c * highest + (1.0 - c) * torque  # noqa: B023
                moved = after(case, motion.displacement, motion.counted, 0.0, hand) + r.during * counted  # noqa: B023
                tail = outward * moved + r.tail_before * counted + r.tail_during * left + r.tail_hand * hand  # noqa: B023
                return n * moved + (g - n) * early + n * late + (c * g + (1.0 - c) * n) * tail  # noqa: B023

            constant = needs(0.0)
            square = 0.5 * (needs(2.0) - 2.0 * needs(1.0) + constant)
            found.append(root_of(square, needs(1.0) - constant - square, energy - constant))
        assert torque_below_older(known, hand, motion, friction, energy) == pytest.approx(
            min(found), rel=1e-6, abs=1e-9
        ), seed


def test_in_debt_a_torque_takes_in_by_itself_what_is_asked_for_or_as_much_as_it_can() -> None:
    """Where it meets the debt the tail's motion is inward, so that it counts as none."""
    met = 0
    for seed in range(300):
        case = case_of(seed, losses=(0,))
        known, r, draw = case.known, case.known.response, random.Random(seed)
        if not known.by_hand_force:
            continue
        friction, hand, highest = draw.choice([0.0, 0.4]), r.hand, draw.uniform(0.0, 3.0)
        motion = LateMotion(draw.uniform(-9e-5, 1e-5), draw.uniform(0.0, 2.0), highest, 0.0)
        energy = -draw.uniform(0.0, 1e-4)
        base = after(case, motion.displacement, motion.counted, r.late * highest, hand)
        late = r.behind * max(0.0, -motion.displacement)

        def needs(n: float, outward: float = 0.0) -> float:
            torque = n + friction  # noqa: B023
            moved = base + r.during * torque  # noqa: B023
            tail = outward * max(0.0, moved) + r.tail_before * (r.late * highest + torque)  # noqa: B023
            tail += r.tail_during * (known.left * highest + torque) + r.tail_hand * hand  # noqa: B023
            return n * (moved + late + tail)  # noqa: B023

        square = 0.5 * (needs(2.0) - 2.0 * needs(1.0))
        expected = root_of(square, needs(1.0) - square, energy)
        found = absorbing_torque(known, hand, motion, friction, energy)
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-9), seed
        assert needs(found, r.share) <= 0.0, seed
        met += found > 0.0 and needs(found, r.share) <= energy * (1.0 - 1e-9)
    assert met > 5
