"""What late torques give out in a group, against its sums written anew at three shares of the torques asked for."""

import math
import random
from collections.abc import Sequence
from typing import NamedTuple

import pytest

from canhaptic.control.multi_axis.group_account import (
    Accounting,
    AccountMemory,
    AccountSettings,
    GroupAccount,
    QueuedTorques,
    account_memory,
    free_energy,
    norms_of,
    older_needs,
    older_size,
    share_of_late,
    shares,
    uncertainty_of_late_gap,
    uncertainty_of_late_group,
)
from canhaptic.control.multi_axis.group_certificates import (
    AxisLimits,
    axes_of,
    pass_range,
    per_axis_limits,
    response_to_late,
)
from canhaptic.control.multi_axis.group_kernel import no_group_holds
from canhaptic.control.passivity import LoopProperties

T, MASSES = 1e-3, (0.25, 0.6)
Range = tuple[list[float], list[float]]


class Group(NamedTuple):
    """Two axes with torques under way."""

    axes: AxisLimits
    memory: AccountMemory
    under_way: list[list[float]]
    asked: list[float]


def close(found: float, expected: float) -> bool:
    return math.isclose(found, expected, rel_tol=1e-9, abs_tol=1e-18)


def group_of(seed: int) -> Group:
    draw = random.Random(seed)
    damping, pull, speed = draw.choice([(0.5, 5.0, None), (2.0, None, None), (None, 5.0, 0.3), (None, None, 0.3)])
    window, lag = draw.choice([(2e-4, 0.0), (1e-4, 8e-5)])
    loops = tuple(
        LoopProperties(
            sample_time=T, delay=1, moving_mass=mass, encoder_count=draw.choice([0.0, 1e-6]), device_damping=damping,
            device_damping_bound=4.0, sync_jitter=0.02, torque_window=window, current_lag=lag,
        )
        for mass in MASSES
    )  # fmt: skip
    axes = axes_of(loops, pull, speed)
    memory = account_memory(per_axis_limits(axes, 1, 0))
    for i in range(2):
        torque = draw.uniform(-3.0, 3.0)
        memory.displacement[i], memory.torques[i] = draw.uniform(-2e-5, 2e-5), torque
        memory.position_uncertainty[i] = draw.choice([0.0, 3e-7])
        memory.before.highest[i], memory.before.lowest[i] = (
            torque + draw.uniform(0.0, 2.0),
            torque - draw.uniform(0.0, 2.0),
        )
    rows = [[draw.uniform(-3.0, 3.0), draw.uniform(-3.0, 3.0)] for _ in range(2)]
    return Group(axes, memory, rows, [draw.uniform(-3.0, 3.0), draw.choice([0.0, draw.uniform(-3.0, 3.0)])])


def passed(axes: AxisLimits, older: tuple[Sequence[float], Sequence[float]], held: Sequence[float]) -> Range:
    """The range of torques after a hold: of what exceeds the torque held, c is left."""
    pairs = list(zip(axes.timing.left, held, strict=True))
    high = [f + c * max(0.0, g - f) for (c, f), g in zip(pairs, older[0], strict=True)]
    low = [f - c * max(0.0, f - g) for (c, f), g in zip(pairs, older[1], strict=True)]
    return high, low


def test_the_timing_of_a_group_is_that_of_its_axes() -> None:
    loop = LoopProperties(
        sample_time=T, delay=1, moving_mass=0.25, device_damping_bound=4.0, sync_jitter=0.02, torque_window=1e-4,
        current_lag=8e-5,
    )  # fmt: skip
    axes = axes_of((loop, loop.model_copy(update={"moving_mass": 0.6})), 5.0, 0.3)
    timing, longest, shortest, late = axes.timing, 1.02 * T, 0.98 * T, 1.8e-4
    assert timing.is_uneven
    assert timing.growth == pytest.approx(longest / shortest)
    assert timing.share == pytest.approx([late / shortest] * 2)
    assert timing.counted == pytest.approx([2.0 * late / shortest] * 2)
    assert timing.left == pytest.approx([math.exp(-(shortest - 1e-4) / 8e-5)] * 2)
    assert timing.roots == pytest.approx([longest / math.sqrt(mass) for mass in MASSES])
    assert timing.hand == pytest.approx(5.0 * longest * math.sqrt(sum(1.0 / mass for mass in MASSES)))
    fading = [4.0 * longest / mass for mass in MASSES]
    assert timing.swing == pytest.approx([y / (1.0 - math.exp(-y)) for y in fading])
    assert timing.tail == pytest.approx([late / (longest + late)] * 2)
    assert timing.tail_path == pytest.approx(0.3 * late)
    assert axes.path == pytest.approx(0.3 * (longest + late))
    assert axes.lost == pytest.approx([1.0 - math.exp(-y) for y in fading])
    damped = axes_of((loop.model_copy(update={"device_damping": 2.0}),) * 2, None, None)
    assert damped.squares == pytest.approx([4.0 * 2.0 / (longest + late)] * 2)
    free = axes_of((loop.model_copy(update={"device_damping_bound": None}),), None, None)
    assert free.timing.swing == [1.0]
    exact = loop.model_copy(update={"sync_jitter": 0.0, "torque_window": 0.0, "current_lag": 0.0})
    assert not axes_of((exact,), 5.0, None).timing.is_uneven
    assert axes_of((exact.model_copy(update={"sync_jitter": 0.02}),), 5.0, None).timing.is_uneven
    assert axes_of((exact.model_copy(update={"torque_window": 0.6 * T}),), 5.0, None).timing.counted == [1.0]
    assert axes_of((exact.model_copy(update={"device_damping": 1e-4}),), None, None).by_damping


def test_an_older_torque_moves_the_group_along_a_torque_by_half_the_sum_of_both_ways() -> None:
    for seed in range(40):
        group = group_of(seed)
        axes, held = group.axes, group.under_way[0]
        high, low = group.memory.before.highest, group.memory.before.lowest
        size = math.sqrt(sum(r * w * w for r, w in zip(axes.during, group.asked, strict=True)))
        expected = 0.0
        for i, w in enumerate(group.asked):
            ways = [max(0.0, size * math.sqrt(axes.during[i]) + sign * w * axes.during[i]) for sign in (1.0, -1.0)]
            reply = max(max(0.0, high[i] - held[i]) * ways[0], max(0.0, held[i] - low[i]) * ways[1])
            expected += 0.5 * axes.timing.counted[i] * reply
        assert close(response_to_late(axes, group.asked, high, low, held, axes.during), expected)
        rows = passed(axes, (high, low), held)
        pass_range(axes, high, low, held)
        assert (high, low) == (pytest.approx(rows[0]), pytest.approx(rows[1]))


def reach(group: Group, i: int, sign: float, hold: int, norm: float) -> float:
    """X of (2)."""
    axes, memory, s = group.axes, group.memory, group.axes.timing.share[i]
    moved = sign * memory.displacement[i] + axes.counts[i] + memory.position_uncertainty[i]
    if moved < 0.0:
        moved *= (1.0 - axes.lost[i]) ** (hold - 1) / axes.timing.growth
    step = axes.timing.roots[i] * norm
    return s * max(0.0, moved + (hold - 1) * step) + s * (0.5 + s) * step


def norms(group: Group, holds: int, size: float) -> tuple[float, float]:
    """N of the torques that may act, with the hand, and what a part of those asked for adds to it."""
    memory, timing = group.memory, group.axes.timing
    sizes = [
        max(abs(memory.torques[i]), memory.before.highest[i], -memory.before.lowest[i],
            *(abs(row[i]) for row in group.under_way[:holds]))
        for i in range(2)
    ]  # fmt: skip
    least = math.sqrt(sum((r * f) ** 2 for r, f in zip(timing.roots, sizes, strict=True))) + timing.hand
    grown = [max(0.0, (size * w) ** 2 - f**2) for w, f in zip(group.asked, sizes, strict=True)]
    return least, math.sqrt(sum(r**2 * extra for r, extra in zip(timing.roots, grown, strict=True)))


@pytest.mark.parametrize("holds", [0, 1, 2])
def test_older_torques_give_out_no_more_than_a_parabola_of_the_share(holds: int) -> None:
    """Between no share and all of it what they exceed the torque by is its chord, and so is the norm that acts."""
    for seed in range(60):
        group, size = group_of(seed), 0.7 if seed % 2 else 1.0
        axes, memory, timing = group.axes, group.memory, group.axes.timing
        least, more = norms(group, holds, size)
        found_norms = norms_of(axes, memory, QueuedTorques(group.under_way, 0, holds), group.asked, size)
        assert found_norms == pytest.approx((least, more))
        older = passed(axes, (memory.before.highest, memory.before.lowest), memory.torques)
        given = 0.0
        for number in range(1, holds + 1):
            held = group.under_way[number - 1]
            for i in range(2):
                given += max(0.0, older[0][i] - held[i]) * reach(group, i, 1.0, number, least)
                given += max(0.0, held[i] - older[1][i]) * reach(group, i, -1.0, number, least)
            older = passed(axes, older, held)
        whole = [size * w for w in group.asked]
        bends = [size * response_to_late(axes, group.asked, *older, held, axes.during) for held in ([0.0, 0.0], whole)]
        for share in (0.0, 0.5, 1.0):
            expected = given + (1.0 - share) * share * bends[0] + share**2 * bends[1]
            for i in range(2):
                s, c = timing.share[i], timing.left[i]
                further = share * timing.roots[i] * more
                for sign, g in ((1.0, older[0][i]), (-1.0, -older[1][i])):
                    w = sign * whole[i]
                    apart = (1.0 - share) * max(0.0, g) + share * max(0.0, g - w)
                    after = (1.0 - share) * max(0.0, c * g) + share * max(0.0, w + c * max(0.0, g - w))
                    expected += apart * (reach(group, i, sign, holds + 1, least) + s**2 * further)
                    expected += after * (reach(group, i, sign, holds + 2, least) + s * (1.0 + s) * further)
            found = share_of_late(axes, memory, QueuedTorques(group.under_way, 0, holds), group.asked, size)
            assert close(found.constant + share * found.linear + share**2 * found.square, expected), (seed, share)
        squares = [sum(r * max(high, -low) ** 2 for r, high, low in zip(axes.during, *older, strict=True))]
        squares.append(sum(r * w * w for r, w in zip(axes.during, group.asked, strict=True)))
        expected_size = math.sqrt(squares[0] / squares[1]) if squares[1] else 0.0
        assert close(older_size(axes, memory, group.asked), expected_size)


def test_a_hold_with_late_torques_is_in_doubt_by_what_they_differ_by_over_how_far_they_are_carried() -> None:
    for seed in range(80):
        group, draw = group_of(seed), random.Random(1000 + seed)
        axes, memory, timing = group.axes, group.memory, group.axes.timing
        moved, held = [draw.uniform(-4e-5, 4e-5) for _ in range(2)], group.under_way[0]
        high, low = [*memory.before.highest], [*memory.before.lowest]
        most = [max(abs(held[i]), abs(memory.torques[i]), high[i], -low[i]) for i in range(2)]
        push = math.sqrt(sum((r * f) ** 2 for r, f in zip(timing.roots, most, strict=True))) + timing.hand
        by_hand = damped = 0.0
        for i in range(2):
            s, torque = timing.share[i], memory.torques[i]
            apart = abs(held[i] - torque) + timing.left[i] * max(high[i] - torque, torque - low[i])
            path = abs(moved[i]) + axes.counts[i]
            start = abs(memory.displacement[i]) + memory.position_uncertainty[i] + axes.counts[i]
            step = timing.swing[i] * (0.5 + s) * timing.roots[i] * push
            by_hand += apart * s * (max(start, timing.swing[i] * path) + step if axes.by_hand else axes.path)
            damped += apart * s * (path + apart / (4.0 * axes.damping[i])) if axes.by_damping else 0.0
        expected = by_hand if axes.by_hand or axes.path else damped
        found = uncertainty_of_late_group(axes, memory, moved, held)
        assert close(found[0], expected), seed
        assert close(found[1], damped), seed
        rows = passed(axes, (high, low), memory.torques)
        assert (memory.before.highest, memory.before.lowest) == (pytest.approx(rows[0]), pytest.approx(rows[1]))


@pytest.mark.parametrize("missed", [1, 3])
def test_lost_samples_with_late_torques_are_in_doubt_by_the_range_of_all_of_them(missed: int) -> None:
    for seed in range(60):
        group, draw = group_of(seed), random.Random(2000 + seed)
        axes, memory, ended = group.axes, group.memory, no_group_holds(2, 1)
        for i in range(2):
            ended.applied[i], ended.displacement[i] = draw.uniform(-3.0, 3.0), draw.uniform(-4e-5, 4e-5)
            for row in ended.lost:
                row[i] = draw.uniform(-4.0, 4.0)
        for i in range(2):
            acted = [memory.before.highest[i], memory.before.lowest[i], memory.torques[i]]
            acted += [row[i] for row in ended.lost[:missed]]
            apart = max(*acted, ended.applied[i]) - min(*acted, ended.applied[i])
            s, holds = axes.timing.share[i], missed + 1
            if axes.by_hand:
                expected = holds * apart * s * axes.timing.swing[i] * 2.0 * 5e-5
            elif axes.path:
                expected = holds * apart * s * axes.path
            else:
                path = abs(ended.displacement[i]) + axes.counts[i]
                expected = apart * s * (path + holds * 3.0 * apart / (4.0 * axes.damping[i]))
            assert close(uncertainty_of_late_gap(axes, memory, ended, missed, i, 5e-5), expected), seed
            assert (memory.before.highest[i], memory.before.lowest[i]) == (max(acted), min(acted))


def test_torques_at_the_last_sync_need_damping_and_way_for_their_tail_alone() -> None:
    for seed in range(40):
        group = group_of(seed)
        axes, memory = group.axes, group.memory
        high, low = passed(axes, (memory.before.highest, memory.before.lowest), memory.torques)
        older = [max(one, -other) for one, other in zip(high, low, strict=True)]
        needs = [f * f * t / q if q else 0.0 for f, t, q in zip(older, axes.timing.tail, axes.squares, strict=True)]
        found = older_needs(axes, memory)
        assert close(found[0], sum(needs))
        assert close(found[1], sum(older) * axes.timing.tail_path)
    ideal = axes_of(
        (LoopProperties(sample_time=T, delay=1, moving_mass=0.25, device_damping_bound=4.0),) * 2, 5.0, None
    )
    assert older_needs(ideal, group.memory) == (0.0, 0.0)


def test_where_axes_act_apart_damping_and_speed_pay_for_all_that_may_act_and_its_tail() -> None:
    """The share that meets the budget, as a square by damping and as it is by the hand's speed."""
    used = set()
    for seed in range(60):
        group, draw = group_of(seed), random.Random(3000 + seed)
        axes, apart = group.axes, per_axis_limits(group.axes, 1, 1)
        memory, account = account_memory(apart), GroupAccount(dissipated=draw.uniform(0.0, 1e-2))
        for name in ("displacement", "torques"):
            getattr(memory, name)[:] = getattr(group.memory, name)
        memory.before.highest[:], memory.before.lowest[:] = group.memory.before
        settings, energy = AccountSettings(axes, apart, moves=False), draw.uniform(0.0, 2e-2)
        damped, paths = older_needs(axes, memory)
        found = shares(Accounting(settings, account, memory, QueuedTorques(group.under_way, 0, 1)), group.asked, energy)
        sent = [[memory.torques[i], group.under_way[0][i]] for i in range(2)]
        strongest = [max(map(abs, row)) for row in sent]
        for i in range(2):  # any of both acts in the next two holds, the new one in the two after the first
            assert max(memory.apart.along[0][i], memory.apart.against[0][i]) == pytest.approx(strongest[i])
        if axes.by_damping:
            needs = sum(old / q for old, q in zip(memory.apart.old, axes.squares, strict=True))
            grown = sum(new / q for new, q in zip(memory.apart.new, axes.squares, strict=True))
            left = energy + account.dissipated - needs - damped
            assert found[1] ** 2 * grown == pytest.approx(max(0.0, left))
        if axes.path:
            left = energy - axes.path * sum(memory.apart.old) - paths
            assert found[2] * axes.path * sum(memory.apart.new) == pytest.approx(max(0.0, left))
        used.add((axes.by_damping, axes.path > 0.0))
    assert len(used) == 2


@pytest.mark.parametrize("losses", [0, 1])
def test_free_and_share_are_what_torques_under_way_leave_of_damping_and_of_the_way_of_the_hand(losses: int) -> None:
    used = set()
    for seed in range(80):
        group, draw = group_of(seed), random.Random(4000 + seed)
        axes, limits = group.axes, per_axis_limits(group.axes, 1, losses)
        if axes.by_hand:
            continue
        memory, account = account_memory(limits), GroupAccount(dissipated=draw.uniform(0.0, 3e-3))
        for name in ("displacement", "torques"):
            getattr(memory, name)[:] = getattr(group.memory, name)
        memory.before.highest[:], memory.before.lowest[:] = group.memory.before
        settings, energy = AccountSettings(axes, limits, moves=False), draw.uniform(-1e-3, 1e-2)
        damped, paths = older_needs(axes, memory)
        before, acting = [*map(abs, memory.torques)], [*map(abs, group.under_way[0])]
        held = [
            [one, other] if losses else [other] for one, other in zip(map(max, before, acting), acting, strict=True)
        ]
        squares = sum(sum(f * f for f in row) / q for row, q in zip(held, axes.squares, strict=True) if q) + damped
        ways = axes.path * sum(map(sum, held)) + paths
        under_way = QueuedTorques(group.under_way, 0, 1)
        left_damped, left_way = energy + account.dissipated - squares, energy - ways
        free = max(left_damped if axes.by_damping else 0.0, left_way if axes.path else 0.0, 0.0)
        assert free_energy(Accounting(settings, account, memory, under_way), energy) == pytest.approx(free), seed
        if losses == 0:
            _, by_damping, by_speed = shares(Accounting(settings, account, memory, under_way), group.asked, energy)
            need = sum(w * w / q for w, q in zip(group.asked, axes.squares, strict=True) if q)
            assert by_damping == pytest.approx(math.sqrt(max(0.0, left_damped) / need) if axes.by_damping else 0.0)
            way = axes.path * sum(map(abs, group.asked))
            assert by_speed == pytest.approx(max(0.0, left_way) / way if axes.path else 0.0)
        used.add((axes.by_damping, axes.path > 0.0))
    assert len(used) == 2
