"""What the bound of one axis remembers and doubts, against searches and formulas written anew."""

import math
import random
from dataclasses import replace

import pytest

from canhaptic.control.certificates.certified_torque import (
    BoundMemory,
    Declared,
    TorqueBound,
    acted,
    bound_memory,
    displacement_by_hand,
    end_gap,
    end_hold,
    keep,
    look_for_turn,
    outward,
    reaches_turn,
    shorten,
    take_late,
    uncertainty_of_late,
)
from canhaptic.control.certificates.scalar_bounds import (
    NO_RESPONSE,
    WINDOW,
    HoldTiming,
    displacement_response,
    hold_timing,
)
from canhaptic.kernels import list_of_zeros

T, MASS, PULL, GAP = 1e-3, 0.25, 5.0, -7.0


def declared_of(draw: random.Random, **given: float) -> Declared:
    damping = draw.choice([0.0, 0.5, 2.0])
    by_force = draw.random() < 0.7
    jitter, window = draw.choice([0.0, 0.02]), draw.choice([0.0, 2e-4])
    timing = hold_timing(T, jitter, window, draw.choice([0.0, 6e-5]), (0.5 * window, 0.0))
    push = draw.choice([9.0, math.inf])
    response = displacement_response(T, MASS, PULL, damping, 2.0 * damping + 0.4, push, timing)
    known = Declared(
        timing.longest, draw.choice([0, 1, 2]), draw.choice([0, 2]), by_force, response if by_force else NO_RESPONSE,
        damping, draw.choice([0.0, 0.3]), draw.choice([0.0, 1e-6]), timing.late, timing.late / timing.shortest,
        timing.left, draw.choice([0.0, 0.4]),
    )  # fmt: skip
    return replace(known, **given)  # type: ignore[arg-type]


def bound_of(draw: random.Random) -> TorqueBound:
    torque = draw.uniform(-3.0, 3.0)
    bound = TorqueBound(
        displacement=draw.uniform(-1e-5, 1e-5), torque=torque, position_uncertainty=draw.choice([0.0, 3e-7])
    )
    bound.highest, bound.lowest = torque + draw.choice([0.0, 0.9]), torque - draw.choice([0.0, 0.7])
    bound.most, bound.least = torque + draw.uniform(0.0, 0.5), torque - draw.uniform(0.0, 0.5)
    bound.out, bound.turns = draw.choice([1.0, -1.0, 0.0]), draw.choice([False, False, True])
    bound.dissipated = bound.certain = draw.uniform(0.0, 1e-3)
    bound.changes, bound.kept, bound.upward, bound.downward = 2e-6, 3, 1.0, 2.0
    bound.slope = -torque + draw.choice([0.0, 0.3])
    return bound


def close(found: float, expected: float) -> bool:
    return math.isclose(found, expected, rel_tol=1e-9, abs_tol=1e-18)


def least_of_all_motions(known: Declared, holds: list[tuple[int, float]], parts: int) -> float:
    """Least energy that came in and was dissipated beyond the booked one; searched among all places of the axis."""
    least = dict.fromkeys(range(-parts // 2, parts // 2 + 1), 0.0)
    for moved, torque in holds:
        least = {
            end: min(
                energy - torque * (end - start) + known.friction * abs(moved + end - start)
                for start, energy in least.items()
            )
            for end in least
        }
    return min(least.values())


@pytest.mark.parametrize("friction", [0.0, 0.4])
@pytest.mark.parametrize("step", [4, 1])
def test_no_motion_within_counts_of_the_encoder_dissipates_less_than_is_counted(friction: float, step: int) -> None:
    """Places are whole numbers, of which four are a count; what an encoder shows in parts of one is not used up."""
    draw, parts = random.Random(1), 4
    known = declared_of(draw, late=0.0, damping=0.0, by_hand_force=False, friction=friction, encoder_count=float(parts))
    for _ in range(40):
        holds = [(step * draw.randint(-2, 2), draw.choice([0.0, draw.uniform(-3.0, 3.0)])) for _ in range(12)]
        bound, memory = TorqueBound(), bound_memory(known, [0.0], list_of_zeros)
        for moved, torque in holds:
            end_hold(known, bound, memory, moved, torque)
        exact = least_of_all_motions(known, holds, parts)
        if step == parts:
            assert close(bound.dissipated - bound.uncertainty, exact)
        assert bound.dissipated - bound.uncertainty <= exact + 1e-12


def test_dither_over_one_edge_costs_nothing_and_travel_costs_what_friction_pays_for() -> None:
    """A spring of k = 2 f_c / c over one edge, and of f_c / c over many; more than that each is paid by the account."""
    count, friction = 3e-5, 0.04
    known = declared_of(random.Random(0), late=0.0, damping=0.0, by_hand_force=False, friction=friction,
                        encoder_count=count)  # fmt: skip
    for stiffness, places, is_free in [
        (2.0 * friction / count, [20, 21], True),
        (2.1 * friction / count, [20, 21], False),
        (friction / count, list(range(20, 40)), True),
        (1.05 * friction / count, list(range(20, 40)), False),
    ]:
        bound, memory, place, booked = TorqueBound(), bound_memory(known, [0.0], list_of_zeros), 20, 0.0
        sums = []
        for step in range(40):
            for following in places if step % 2 == 0 else places[::-1]:
                torque = stiffness * count * place
                end_hold(known, bound, memory, count * (place - following), torque)
                booked += torque * count * (following - place)
                place = following
                end_hold(known, bound, memory, 0.0, stiffness * count * place)
            sums.append(booked + bound.dissipated - bound.uncertainty)
        lost = sums[3] - sums[-1]
        assert (abs(lost) < 1e-12) if is_free else (lost > 1e-7)


def test_a_hold_is_kept_with_what_the_device_dissipated_and_what_the_encoder_leaves_open() -> None:
    for seed in range(40):
        draw = random.Random(seed)
        known = declared_of(draw, late=0.0, **({"friction": 0.0} if seed % 2 else {"encoder_count": 0.0}))
        half = 0.5 * known.encoder_count
        bound, memory = TorqueBound(), bound_memory(known, [0.0], list_of_zeros)
        bound.position_uncertainty = 1.0
        holds = [(draw.uniform(-4e-6, 4e-6), draw.uniform(-3.0, 3.0)) for _ in range(draw.choice([3, WINDOW + 5]))]
        dissipated = changes = before = 0.0
        for moved, torque in holds:
            bound.upward = bound.downward = 1.0
            assert end_hold(known, bound, memory, moved, torque) == 0.0
            dissipated += known.damping / known.sample_time * max(0.0, abs(moved) - known.encoder_count) ** 2
            dissipated += known.friction * abs(moved)
            changes, before = changes + half * abs(torque - before), torque
        assert close(bound.dissipated, dissipated)
        assert close(bound.certain, dissipated)
        assert (bound.displacement, bound.torque, bound.position_uncertainty) == (*holds[-1], 0.0)
        if half:
            assert close(bound.changes, changes)
            assert close(bound.uncertainty, changes + half * abs(before))
            assert bound.kept == min(len(holds), WINDOW)
            assert math.isnan(bound.upward)
            assert math.isnan(bound.downward)
            for back, (moved, torque) in enumerate(reversed(holds[-bound.kept :])):
                assert memory.displacements[bound.newest - back] == moved
                assert memory.torques[bound.newest - back] == torque


def test_the_farthest_displacement_is_the_least_that_any_mean_allows() -> None:
    """The encoder rounds a true motion: each hold goes beyond the one before by no more than forces allow."""
    used = 0
    for seed in range(60):
        draw = random.Random(seed)
        known = declared_of(draw, by_hand_force=True, encoder_count=1e-4, late=draw.choice([0.0, 1e-4]))
        if not known.response.before:
            continue
        response, count = known.response, known.encoder_count
        bound, memory = TorqueBound(out=draw.choice([1.0, -1.0])), bound_memory(known, [0.0], list_of_zeros)
        speed, place, torques, moves, counted = draw.uniform(-0.3, 0.3), 0.0, [], [], []
        for _ in range(draw.choice([1, 2, 5, 20])):
            torque, hand = draw.choice([0.0, draw.uniform(-2.0, 2.0)]), draw.uniform(-PULL, PULL)
            last, place = place, place + (speed + 0.5 * (torque + hand) / MASS * T) * T
            speed += (torque + hand) / MASS * T
            moves.append((math.floor(place / count) - math.floor(last / count)) * count)
            torques.append(torque)
            end_hold(known, bound, memory, moves[-1], torque)
            counted.append((bound.most, -bound.least))
        for sign in (1.0, -1.0):
            hand = displacement_by_hand(known, bound, sign)
            acting = [max(0.0, sign * torque) for torque in torques]
            if known.late:
                acting = [max(0.0, both[0] if sign > 0.0 else both[1]) for both in counted]
            bounds, total, raised, raises = [], 0.0, 0.0, 0.0
            for back in range(len(moves)):
                along = sign * moves[-1 - back]
                if back:
                    raised += response.before * acting[-1 - back] + response.during * acting[-back] + hand
                    raised += (1.0 - response.retained) * max(0.0, count - along)
                    raised += (response.growth - 1.0) * max(0.0, along + count)
                total, raises = total + along, raises + raised
                bounds.append((total + count + raises) / (back + 1))
                if back and raised * (back + 1) > 2.0 * count:
                    break
            expected = min(bounds) if len(moves) > 1 else sign * moves[-1] + count
            for _ in range(2):  # the second time it is remembered
                assert close(outward(known, bound, memory, sign), expected), seed
            used += len(bounds) > 2
    assert used > 10


def test_older_torques_are_left_as_the_timing_says() -> None:
    for seed in range(30):
        draw = random.Random(seed)
        known, bound, torque = declared_of(draw), bound_of(draw), draw.uniform(-3.0, 3.0)
        above, below = max(0.0, bound.highest - torque), max(0.0, torque - bound.lowest)
        take_late(known, bound, torque)
        assert close(bound.most, torque + known.response.late * above)
        assert close(bound.least, torque - known.response.late * below)
        assert close(bound.highest, torque + known.left * above)
        assert close(bound.lowest, torque - known.left * below)
        for sign in (1.0, -1.0):
            counted = bound.most if sign > 0.0 else -bound.least
            assert acted(known, bound, sign) == (counted if known.late else sign * bound.torque)


def both_ends(known: Declared, before: TorqueBound, out: float, moved: float, torque: float) -> tuple[float, float]:
    """Returns -L and U of docs/theory/late_torques.md, by trying many times of the change [m]."""
    ends, timing = [], known.response
    for way in (out, -out):
        pushes = before.turns or way == -before.out
        hand = timing.push if pushes else timing.hand
        force = hand / (timing.hand / 5.0) + max(
            0.0, way * torque, way * (before.highest if way > 0 else before.lowest)
        )
        least = way * moved - known.encoder_count
        mean = least / known.sample_time if least > 0.0 else timing.swing * least / timing.shortest
        if force == math.inf:
            ends.append(math.inf)
            continue
        bend = 0.5 * timing.swing * force / MASS
        middle = 0.5 * (known.sample_time - mean / bend)
        times = timing.early, known.late, min(max(middle, timing.early), known.late)
        ends.append(max(time * (bend * (known.sample_time - time) - mean) for time in times))
    return ends[0], ends[1]


def test_a_late_torque_leaves_in_doubt_what_it_differs_by_over_how_far_it_is_carried() -> None:
    ways = set()
    for seed in range(300):
        draw = random.Random(seed)
        known, bound = declared_of(draw, late=draw.choice([1e-4, 3e-4])), bound_of(draw)
        moved, torque, r = (
            draw.uniform(-1e-5, 1e-5),
            draw.choice([bound.torque, draw.uniform(-3.0, 3.0)]),
            known.response,
        )
        change, count = torque - bound.torque, known.encoder_count
        rest = max(bound.highest - bound.torque, bound.torque - bound.lowest)
        differs, before = abs(change) + rest, replace(bound)
        found = uncertainty_of_late(known, bound, moved, torque)
        share, b = known.late_share, known.damping
        for_all = differs * 2.0 * share * (max(abs(moved), abs(before.displacement)) + count)
        if b:
            for_all = differs * share * (abs(moved) + count) + differs**2 * known.late / (4.0 * b)
        if known.by_hand_force:
            out = -1.0 if before.out < 0.0 else 1.0
            strongest = max(0.0, out * torque, before.highest if out > 0.0 else -before.lowest)
            counted = max(0.0, before.most if out > 0.0 else -before.least)
            up = (
                r.share * max(0.0, out * before.displacement + count + before.position_uncertainty)
                + r.tail_before * counted
            )
            by_hand = r.tail_hand * (r.push if before.turns and r.push < math.inf else r.hand)
            up += r.tail_during * strongest + by_hand
            down = r.share * max(0.0, count - out * moved) + r.tail_before * strongest + by_hand
            down *= r.swing
            rising, further = out * change > 0.0, rest * max(up, down)
            down, up = (min(way) for way in zip((down, up), both_ends(known, before, out, moved, torque), strict=True))
            less, more = (abs(change) * way for way in ((down, up) if rising else (up, down)))
            less, more = less + further, more + further
        elif known.hand_speed:
            less = more = differs * known.hand_speed * known.late
        else:
            less = more = for_all
        ways.add((known.by_hand_force, bool(known.hand_speed), bool(b)))
        assert close(found, less if differs else 0.0), seed
        assert close(bound.resolution, less + more if differs else 0.0), seed
        promised = less - for_all if b and (known.by_hand_force or known.hand_speed) and differs else 0.0
        assert close(bound.certain, before.certain + promised), seed
    assert len(ways) == 8


@pytest.mark.parametrize("hold_length", [1.5, 4.0])
def test_a_longer_hold_counts_by_its_last_sample_time_give_or_take_what_forces_gain(hold_length: float) -> None:
    for seed in range(60):
        draw = random.Random(seed)
        known, bound = declared_of(draw), bound_of(draw)
        r, before = known.response, replace(bound)
        shorten(known, bound, hold_length)
        torque = max(abs(before.torque), *((before.most, -before.least) if known.late else (0.0,)))
        step = (r.before + r.during) * torque + (r.push if r.push < math.inf else r.hand)
        excursion = abs(before.displacement) + known.encoder_count + hold_length**2 * step
        assert close(bound.displacement, before.displacement / hold_length)
        assert close(bound.position_uncertainty, 0.5 * (hold_length - 1.0) * step + (r.growth - r.retained) * excursion)
        assert bound.kept == 0
        path = max(0.0, abs(before.displacement) - known.encoder_count)
        taken = known.damping / known.sample_time * path**2 * (1.0 - 1.0 / hold_length)  # (D/n)^2 n in place of D^2
        assert close(bound.dissipated, before.dissipated - taken)
        assert close(bound.certain, before.certain - taken)


def acting_in(known: Declared, before: TorqueBound, torque: float, sent: float, differ: float) -> tuple[float, float]:
    """The largest torque that may have acted in a lost hold, and the most by which one differs from the last.

    Of late torques the width of the range of all that may have acted.
    """
    largest, apart = sent, differ
    if known.losses:
        largest, apart = max(largest, abs(before.torque)), max(apart, abs(before.torque - torque))
    if known.late:
        acting = [torque - apart, torque + apart, before.torque, before.highest, before.lowest]
        largest, apart = max(largest, max(acting), -min(acting)), max(acting) - min(acting)
    return largest, apart


@pytest.mark.parametrize("holds", [2, 4])
def test_lost_samples_leave_in_doubt_the_difference_of_torques_over_the_farthest_excursion(holds: int) -> None:
    ways = set()
    for seed in range(300):
        draw = random.Random(seed)
        known, bound = declared_of(draw), bound_of(draw)
        moved, torque, sent = draw.uniform(-1e-5, 1e-5), draw.uniform(-3.0, 3.0), draw.uniform(0.0, 3.0)
        differ, r, count, before = draw.uniform(0.0, 3.0), known.response, known.encoder_count, replace(bound)
        found = end_gap(known, bound, moved, torque, holds, sent, differ)
        largest, apart = acting_in(known, before, torque, sent, differ)
        uncertain = holds + 2 if known.late else holds - 1
        if known.late:
            assert (bound.most, bound.least) == (bound.highest, bound.lowest)
            assert close(bound.highest - bound.lowest, apart)
            assert bound.lowest <= min(before.lowest, before.torque, torque - differ)
        for_all, earned, b = 0.0, 0.0, known.damping / known.sample_time
        if b:
            earned = b * max(0.0, abs(moved) - count) ** 2 / holds
            for_all = uncertain * apart * ((abs(moved) + count) / holds + apart / (4.0 * b))
        if known.friction:
            earned += known.friction * max(0.0, abs(moved) - count) - 0.5 * count * abs(before.slope + before.torque)
        uncertainty = for_all
        if known.by_hand_force:
            step = (r.before + r.during) * largest + (r.push if r.push < math.inf else r.hand)
            begin, grown = abs(before.displacement) + before.position_uncertainty + count, r.growth**holds
            excursion = abs(moved) + count + grown * holds * (begin + holds * step)
            uncertainty = uncertain * apart * excursion
            position_uncertainty = (
                0.5 * (holds - 1) * step + (1.0 - r.retained) * holds * excursion + (grown - 1.0) * excursion
            )
            assert close(bound.position_uncertainty, position_uncertainty), seed
        elif known.hand_speed:
            uncertainty = uncertain * apart * known.hand_speed * known.sample_time
        ways.add((known.by_hand_force, bool(known.hand_speed), bool(b), bool(known.losses), known.late > 0.0))
        assert close(found, uncertainty), seed
        assert close(bound.resolution, 2.0 * uncertainty), seed
        assert close(bound.dissipated, before.dissipated + earned), seed
        assert close(bound.certain, before.certain + earned + (uncertainty - for_all if b else 0.0)), seed
        assert close(bound.changes, before.changes + holds * count * largest), seed
        assert close(bound.uncertainty, before.changes + holds * count * largest + 0.5 * count * abs(torque)), seed
        assert (bound.displacement, bound.torque) == (moved / holds, torque)
        assert bound.kept == 0
        assert math.isnan(bound.upward)
        assert math.isnan(bound.downward)
    assert len(ways) == 32


def test_a_handle_that_may_stand_still_earns_nothing_from_friction_over_lost_samples() -> None:
    """One count down while samples are lost, one up in the hold after, ten times: the encoder alone may do that."""
    count = 1e-6
    known = declared_of(random.Random(1), friction=0.4, damping=0.0, late=0.0, encoder_count=count)
    bound = TorqueBound()
    memory = bound_memory(known, list_of_zeros(3), list_of_zeros)
    for _ in range(10):
        end_gap(known, bound, -count, 0.0, 2, 0.0, 0.0)
        end_hold(known, bound, memory, count, 0.0)
    assert bound.dissipated == pytest.approx(bound.uncertainty)
    end_gap(known, bound, 5.0 * count, 0.0, 2, 0.0, 0.0)
    assert bound.dissipated - bound.uncertainty == pytest.approx(0.4 * 4.0 * count)


def stretch_of(draw: random.Random, known: Declared, out: float) -> tuple[TorqueBound, BoundMemory]:
    """Bound in the middle of a stretch, with torques under way."""
    bound = TorqueBound(displacement=draw.uniform(-1e-5, 1e-5), torque=draw.uniform(-3.0, 3.0), out=out)
    bound.most = bound.least = bound.torque
    bound.kept = 5
    under_way = [draw.uniform(-3.0, 3.0) for _ in range(known.delay + 1)]
    return bound, bound_memory(known, under_way, list_of_zeros)


def farthest(known: Declared, bound: TorqueBound, memory: BoundMemory, sign: float, torque: float) -> float:
    """Written out: uniform steps by the largest torque along, with the hand's own word that way."""
    r = known.response
    largest = max(0.0, sign * torque, sign * bound.torque, *(sign * sent for sent in memory.under_way))
    if known.late:
        largest = max(largest, sign * (bound.most if sign > 0.0 else bound.least))
    moved = sign * bound.displacement + known.encoder_count
    way = known.encoder_count
    for _ in range(known.delay + known.losses + 2):
        moved *= r.growth if moved > 0.0 else r.retained
        moved += largest * (r.before + r.during) + (r.hand if sign == bound.out else r.push)
        way += max(0.0, moved)
    return way


@pytest.mark.parametrize("out", [1.0, -1.0])
def test_the_hand_counts_for_its_push_either_way_where_a_hold_can_contain_a_turn(out: float) -> None:
    for seed in range(60):
        draw = random.Random(seed)
        known = declared_of(draw, by_hand_force=True, delay=draw.choice([0, 1]), losses=draw.choice([0, 2]))
        known = replace(known, response=replace(known.response, hand=1e-6, push=6e-6))
        for share, turns in ((1.001, False), (0.999, True)):
            for edge in (1.0, -1.0):
                bound, memory = stretch_of(draw, known, out)
                if (way := share * farthest(known, bound, memory, edge, 0.0)) == 0.0:
                    continue
                bound.above, bound.below = (way, 1.0) if edge > 0.0 else (1.0, way)
                look_for_turn(known, bound, memory, 0.0, 1.0)
                assert bound.turns is turns
                along = [displacement_by_hand(known, bound, sign) for sign in (out, -out)]
                assert along == ([6e-6, 6e-6] if turns else [1e-6, 6e-6])
                assert bound.kept == (0 if turns else 5)
                new = edge * draw.uniform(3.0, 9.0)
                way = share * farthest(known, bound, memory, edge, new)
                assert way > 0.0
                bound.above, bound.below = (way, 1.0) if edge > 0.0 else (1.0, way)
                assert reaches_turn(known, bound, memory, new) is turns


def test_a_turn_counts_from_the_hold_before_it_to_the_one_after_it() -> None:
    known = declared_of(random.Random(3), by_hand_force=True)
    known = replace(known, response=replace(known.response, hand=1e-6, push=6e-6))
    bound, memory = TorqueBound(out=1.0, above=1.0, below=1.0), bound_memory(known, [0.0] * 2, list_of_zeros)
    found = []
    for moved, holds in (
        (0.0, 1.0),
        (2.0, 1.0),
        (0.0, 1.0),
        (0.0, 1.0),
        (-2.0, 1.0),
        (0.0, 2.0),
        (0.0, 1.0),
        (0.0, 1.0),
    ):
        look_for_turn(known, bound, memory, moved, holds)
        found.append(bound.turns)
    # from outside on either side, after a gap, and each time once more
    assert found == [False, True, True, False, True, True, True, False]
    bound.above = known.encoder_count
    look_for_turn(known, bound, memory, 0.0, 1.0)
    assert bound.turns


@pytest.mark.parametrize(("energy", "left"), [(1.0, 4.0), (3.0, 2.0), (6.0, 0.0)])
def test_what_the_device_dissipated_is_kept_as_far_as_it_is_enough(energy: float, left: float) -> None:
    bound = TorqueBound(dissipated=4.0)
    keep(bound, energy, 5.0)
    assert bound.dissipated == left


def lagging(state: list[float], before: float, torque: float, hand: float, tim: HoldTiming, lag: float) -> None:
    """Move a mass through a hold whose torque comes late and lags; state: position, speed, torque, energy in."""
    parts, window = 40, tim.late - lag
    step = T / parts
    for part in range(parts):
        demand = before if part * step < window else torque
        state[2] += (demand - state[2]) * -math.expm1(-step / lag)
        moved = state[1] * step + 0.5 * (state[2] + hand) / MASS * step * step
        state[1] += (state[2] + hand) / MASS * step
        state[0], state[3] = state[0] + moved, state[3] - state[2] * moved


def test_no_motion_in_lost_holds_with_late_torques_gives_more_than_is_booked_with_its_resolution() -> None:
    tightest = math.inf
    for seed in range(150):
        draw = random.Random(seed)
        lag, window, lost = draw.choice([5e-5, 2e-4, 5e-4]), draw.choice([0.0, 2e-4]), draw.choice([2, 3, 5])
        tim = hold_timing(T, 0.0, window, lag)
        response = displacement_response(T, MASS, PULL, 0.0, 0.5, 9.0, tim)
        known = Declared(
            T, 1, draw.choice([0, 2]), True, response, 0.0, 0.0, 0.0, tim.late, tim.late / tim.shortest, tim.left
        )
        bound, memory = TorqueBound(out=1.0), bound_memory(known, list_of_zeros(3), list_of_zeros)
        state, booked, before = [0.0, draw.uniform(-0.1, 0.1), 0.0, 0.0], 0.0, 0.0
        near = draw.choice([0.05, 3.0])
        for hold, holds in enumerate((1, 1, 1, lost, 1, 1)):  # the first has no torque, and shows the speed
            torques = [2.0 + draw.uniform(-near, near) if hold else 0.0 for _ in range(holds)]
            place = state[0]
            for torque in torques:
                lagging(state, before, torque, draw.choice([PULL, -9.0]), tim, lag)
                before = torque
            moved, apart = state[0] - place, max(abs(torque - before) for torque in torques)
            booked -= before * moved
            if holds == 1:
                booked -= end_hold(known, bound, memory, moved, before)
            else:
                booked -= end_gap(known, bound, moved, before, holds, max(map(abs, torques)), apart)
            assert -1e-12 <= state[3] - booked <= bound.resolution + 1e-12, seed
        tightest = min(tightest, (state[3] - booked) / bound.resolution)
    assert tightest < 0.5
