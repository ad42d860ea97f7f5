"""The account of a group between holds, against sums written anew and, for one axis, the formulas of one axis."""

import math
import random
from typing import Any, NamedTuple

import pytest

from canhaptic.control.multi_axis.group_account import (
    AccountMemory,
    AccountSettings,
    Gap,
    GroupAccount,
    account_memory,
    certain_energy,
    end_group_gap,
    end_group_hold,
    fade,
    largest_of,
    quotient,
    uncertainty_of,
    uncertainty_of_axis,
    uncertainty_of_mover,
)
from canhaptic.control.multi_axis.group_certificates import (
    axes_of,
    damping_need,
    path_need,
    per_axis_limits,
    per_axis_memory,
    taken_at_most,
    taken_by_mover,
)
from canhaptic.control.multi_axis.group_kernel import (
    GroupHolds,
    end_holds,
    no_group_commands,
    no_group_holds,
    norm,
    send_nothing,
    take_applied,
    torque_held,
)
from canhaptic.control.passivity import LoopProperties

T, DELAY = 1e-3, 1


class Group(NamedTuple):
    """Two axes, what is declared of them, and holds that ended."""

    settings: AccountSettings
    memory: AccountMemory
    ended: GroupHolds
    account: GroupAccount
    loops: tuple[LoopProperties, ...]
    pull: float


def close(found: float, expected: float) -> bool:
    return math.isclose(found, expected, rel_tol=1e-9, abs_tol=1e-18)


def group_of(seed: int, **given: Any) -> Group:
    """A group whose torques are never late."""
    draw = random.Random(seed)
    jitter = draw.choice([0.0, 0.03])
    damped, count, pull = draw.choice([0.0, 2.0]), draw.choice([0.0, 1e-6]), draw.choice([None, 5.0])
    bound = draw.choice([2.0, 8.0])
    loops = tuple(
        LoopProperties(
            sample_time=T, delay=DELAY, moving_mass=mass, encoder_count=count, device_damping=damped * mass or None,
            device_damping_bound=bound, sync_jitter=jitter,
        )
        for mass in (0.25, 0.6)
    )  # fmt: skip
    speed = draw.choice([None, 0.3])
    if damped == 0.0 and pull is None and speed is None:
        pull = 5.0
    axes = axes_of(loops, pull, speed)
    limits = per_axis_limits(axes, DELAY, 2)
    memory, ended = account_memory(limits), no_group_holds(2, DELAY)
    for i in range(2):
        memory.displacement[i], memory.torques[i] = draw.uniform(-2e-5, 2e-5), draw.uniform(-3.0, 3.0)
        memory.position_uncertainty[i] = draw.choice([0.0, 3e-7])
        memory.before.highest[i] = memory.torques[i] + draw.choice([0.0, 5.0])
        memory.before.lowest[i] = memory.torques[i] - draw.choice([0.0, 5.0])
        ended.displacement[i], ended.applied[i] = draw.uniform(-4e-5, 4e-5), draw.uniform(-3.0, 3.0)
        for row in ended.lost:
            row[i] = draw.uniform(-4.0, 4.0)
    account = GroupAccount(dissipated=draw.uniform(0.0, 1e-3), changes=draw.choice([0.0, 2e-6]))
    return Group(AccountSettings(axes, limits, moves=False), memory, ended, account, loops, pull or 0.0)


def largest(group: Group, missed: int, axis: int) -> float:
    memory, ended = group.memory, group.ended
    sizes = [abs(memory.torques[axis]), abs(ended.applied[axis])]
    sizes += [memory.before.highest[axis], -memory.before.lowest[axis]]
    return max(*sizes, *(abs(row[axis]) for row in ended.lost[:missed]))


def test_a_hold_of_a_group_counts_what_each_device_dissipated_and_each_encoder_leaves_open() -> None:
    seen = set()
    for seed in range(40):
        group = group_of(seed)
        memory, ended, before = group.memory, group.ended, group.account.dissipated
        counted, earned, open_ends = group.account.changes, 0.0, 0.0
        damps, coarse = group.loops[0].device_damping is not None, group.loops[0].encoder_count > 0.0
        for i in range(2):
            loop, torque = group.loops[i], ended.applied[i]
            if damps or coarse:
                path = max(0.0, abs(ended.displacement[i]) - loop.encoder_count)
                earned += (loop.device_damping or 0.0) / loop.timing.longest * path**2
                counted += 0.5 * loop.encoder_count * abs(torque - memory.torques[i])
                open_ends += 0.5 * loop.encoder_count * abs(torque)
        assert end_group_hold(group.settings, group.account, memory, ended) == 0.0
        assert close(group.account.dissipated, before + earned)
        assert close(group.account.changes, counted)
        assert close(group.account.uncertainty, counted + open_ends)
        assert (memory.displacement, memory.torques) == (ended.displacement, ended.applied)
        assert memory.position_uncertainty == [0.0, 0.0]
        seen.add((damps, coarse))
    assert len(seen) == 4


@pytest.mark.parametrize("missed", [1, 2, 4])
def test_lost_samples_of_a_group_are_in_doubt_by_each_axis_for_itself(missed: int) -> None:
    seen = set()
    for seed in range(40):
        group = group_of(seed)
        axes, memory, ended, holds = group.settings.axes, group.memory, group.ended, missed + 1
        norm = math.sqrt(sum((axes.before[i] + axes.during[i]) * largest(group, missed, i) ** 2 for i in range(2)))
        uncertainty, counted, changes, earned, blurs = 0.0, 0.0, group.account.changes, group.account.dissipated, []
        for i in range(2):
            loop, moved = group.loops[i], ended.displacement[i]
            most, count = largest(group, missed, i), loop.encoder_count
            step = math.sqrt(axes.before[i] + axes.during[i]) * (norm + axes.hand) if group.pull else 0.0
            start, growth = abs(memory.displacement[i]) + memory.position_uncertainty[i] + count, axes.timing.growth
            excursion = abs(moved) + count + holds * (start * growth + holds * step)
            uneven = (growth - 1.0) * excursion
            error, position_uncertainty = count + holds * uneven, memory.position_uncertainty[i] + count + uneven
            gap = Gap(holds, moved, memory.displacement[i], error, position_uncertainty, step, axes.lost[i])
            uncertainty += uncertainty_of_axis(axes, memory, ended, gap, missed, i)
            lost = axes.lost[i] * holds * excursion + uneven
            blurs.append(0.5 * missed * step + lost if group.pull else 0.0)
            changes += holds * count * most
            counted += 0.5 * count * abs(ended.applied[i])
            earned += axes.damping[i] * max(0.0, abs(moved) - count) ** 2 / holds
            assert largest_of(memory, ended, missed, i) == most
        found, further = end_group_gap(group.settings, group.account, memory, ended, missed)
        assert close(found, uncertainty)
        assert further == 0.0
        assert close(group.account.changes, changes)
        assert close(group.account.uncertainty, changes + counted)
        assert close(group.account.dissipated, earned)
        assert all(close(one, other) for one, other in zip(memory.position_uncertainty, blurs, strict=True))
        assert memory.displacement == [moved / holds for moved in ended.displacement]
        assert memory.torques == ended.applied
        seen.add((bool(group.pull), axes.path > 0.0))
    assert len(seen) == 4


@pytest.mark.parametrize("missed", [1, 2, 4])
def test_in_each_lost_hold_any_torque_sent_until_then_may_have_acted(missed: int) -> None:
    for seed in range(40):
        group = group_of(seed)
        axes, memory, ended = group.settings.axes, group.memory, group.ended
        gap = Gap(missed + 1, 3e-5, 1e-5, 1e-6, 2e-6, 1e-5, 0.05)
        for axis in range(2):
            last, b, total = ended.applied[axis], axes.damping[axis], 0.0
            for hold in range(1, missed + 1):
                sent = [memory.torques[axis], *(row[axis] for row in ended.lost[:hold])]
                apart = [torque - last for torque in sent]
                if group.pull:
                    total += max(uncertainty_of(gap, hold, torque, last) for torque in sent)
                elif axes.path > 0.0:
                    total += max(map(abs, apart)) * 0.3 * group.loops[0].timing.longest
                else:
                    total += max(more * gap.moved + abs(more) * gap.error for more in apart) / gap.holds
                    total += max(more**2 for more in apart) / (4.0 * b)
            assert close(uncertainty_of_axis(axes, memory, ended, gap, missed, axis), total), seed


def test_a_mover_gives_with_the_torques_that_may_have_acted() -> None:
    group = group_of(1)
    memory, ended = group.memory, group.ended
    memory.passing[:] = [2e-5, -3e-5]
    for hold in range(3):
        expected = 0.0
        for i in range(2):
            sent = [memory.torques[i], *(row[i] for row in ended.lost[: hold + 1])]
            expected += max((ended.applied[i] - torque) * memory.passing[i] for torque in sent)
        assert close(uncertainty_of_mover(memory, ended, hold), expected)


def test_holds_that_ended_book_each_axis_with_the_torque_applied_and_what_was_inside_it() -> None:
    for seed in range(30):
        draw = random.Random(seed)
        commands, ended = no_group_commands(2, 1, 1), no_group_holds(2, 1)
        for place in range(2):
            for rows in (commands.torques, commands.dampers, commands.modulated):
                rows[place][:] = [draw.uniform(-3.0, 3.0), draw.uniform(-3.0, 3.0)]
            commands.ports[place][0], commands.power[place] = draw.uniform(-3.0, 3.0), draw.uniform(0.0, 1.0)
        sent = [[*row] for row in commands.torques]
        dampers, modulated = [[*row] for row in commands.dampers], [[*row] for row in commands.modulated]
        ports, power = [row[0] for row in commands.ports], [*commands.power]
        oldest, missed, limit = draw.choice([0, 1]), draw.choice([0, 1, 2, 3]), 1.5
        ended.position[:] = [1e-3, -2e-3]
        positions = [draw.uniform(-1e-3, 1e-3), draw.uniform(-1e-3, 1e-3)]
        queue = [oldest, 1 - oldest]  # places of the commands in their order; the newest goes on
        acting = queue[0] if missed == 0 else queue[1]
        applied = [draw.choice([1.0, 0.5, -1.0, 2.0]) * sent[acting][0], sent[acting][1]]
        place = end_holds(commands, ended, [limit, limit], oldest, missed, positions, applied)
        assert place == (oldest + missed) % 2
        for lost in range(min(missed, 2)):
            assert ended.lost[lost] == [max(-limit, min(limit, torque)) for torque in sent[queue[lost]]]
        for i in range(2):
            moved = positions[i] - [1e-3, -2e-3][i]
            assert close(ended.displacement[i], moved)
            assert close(ended.interactions[i], -applied[i] * moved)
            share = max(0.0, min(1.0, applied[i] / sent[acting][i]))
            assert close(commands.dampers[place][i], share * dampers[acting][i])
            assert close(commands.modulated[place][i], share * modulated[acting][i])
            assert torque_held(ended, missed, missed, i) == applied[i]
            if missed:
                assert torque_held(ended, missed - 1, missed, i) == ended.lost[min(missed, 2) - 1][i]
        along = sum(a * b for a, b in zip(applied, sent[acting], strict=True))
        whole = max(0.0, min(1.0, along / sum(torque**2 for torque in sent[acting])))
        assert close(commands.ports[place][0], whole * ports[acting])
        assert close(commands.power[place], whole**2 * power[acting])
        assert (ended.position, ended.applied, commands.torques[place]) == (positions, applied, applied)


def test_of_a_command_without_torque_nothing_is_left() -> None:
    commands = no_group_commands(1, 1, 0)
    commands.dampers[0][0], commands.ports[0][0], commands.power[0] = 1.0, 1.0, 1.0
    take_applied(commands, 0, [2.0])
    assert (commands.dampers[0][0], commands.ports[0][0], commands.power[0]) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(("unrecovered", "left"), [(0.0, 1.5), (0.2, 1.7), (0.9, 2.0)])
def test_what_encoders_leave_open_is_covered_by_what_was_kept_back(unrecovered: float, left: float) -> None:
    account = GroupAccount(h_s=2.5, h_dis=1.0, uncertainty=0.5, unrecovered=unrecovered)
    assert certain_energy(account, 0.5) == pytest.approx(left)


@pytest.mark.parametrize(
    ("stored", "dissipated", "left"),
    [
        (1.5, 0.0, 0.0),
        (1.5, 2.0, 1.25),
        (1.5, -1.0, -1.0),
        (3.5, -1.0, -1.0),
        (0.625, 0.25, 0.15625),
        (0.0, 0.25, 0.25),
    ],
)
def test_past_dissipation_fades_with_the_account(stored: float, dissipated: float, left: float) -> None:
    """What is lacking does not: it would be energy for every hand that none was dissipated for."""
    account = GroupAccount(h_s=stored, h_dis=0.5, dissipated=dissipated)
    fade(account, 0.75)
    assert account.dissipated == left


def test_a_quotient_of_nothing_is_infinite_and_one_without_a_budget_nothing() -> None:
    assert (quotient(3.0, 2.0), quotient(0.0, 0.0), quotient(-1.0, 0.0)) == (1.5, math.inf, 0.0)
    assert quotient(math.nan, 1.0) == 0.0


def test_a_command_of_nothing_has_no_effort_of_any_kind() -> None:
    commands = no_group_commands(2, 1, 1)
    for rows in (commands.torques, commands.dampers, commands.modulated, commands.ports):
        rows[1][:] = [1.0] * len(rows[1])
    commands.power[1] = 1.0
    assert send_nothing(commands, 1) == 0
    assert (commands.torques[1], commands.dampers[1], commands.modulated[1]) == ([0.0] * 2, [0.0] * 2, [0.0] * 2)
    assert (commands.ports[1], commands.power[1]) == ([0.0], 0.0)


def test_what_torques_need_and_a_mover_takes_are_sums_over_the_axes() -> None:
    loops = tuple(
        LoopProperties(sample_time=T, delay=1, moving_mass=0.25, device_damping=b, device_damping_bound=8.0)
        for b in (1.0, 4.0)
    )
    axes = axes_of(loops, 5.0, 0.3)
    assert damping_need(axes, [2.0, -3.0]) == pytest.approx(T / 4.0 * (4.0 / 1.0 + 9.0 / 4.0))
    assert path_need(axes, [2.0, -3.0]) == pytest.approx(0.3 * T * 5.0)
    assert taken_by_mover([2.0, -3.0], [1e-3, 2e-3]) == pytest.approx(4e-3)
    assert norm([3.0, -4.0]) == 5.0
    assert axes.during == pytest.approx([0.5 * T * T / 0.25] * 2)  # damping on one axis may push another
    assert axes_of(loops[:1], 5.0, 0.3).during[0] < 0.5 * T * T / 0.25


def test_a_mover_takes_of_the_torque_that_gives_it_most_in_each_hold_and_of_a_new_one_what_is_more() -> None:
    """Delay 1 and one loss: both torques sent may act in the next hold, the later one in the hold after it."""
    limits = per_axis_limits(group_of(0).settings.axes, 1, 1)
    memory, draw = per_axis_memory(limits), random.Random(1)
    for _ in range(40):
        for row in memory.sent:
            row[:] = [draw.uniform(-3.0, 3.0), draw.uniform(-3.0, 3.0)]
        mover_motion = [[draw.uniform(-1e-4, 1e-4), draw.uniform(-1e-4, 1e-4)] for _ in range(3)]
        asked, old, new = [draw.uniform(-6.0, 6.0), draw.uniform(-6.0, 6.0)], 0.0, 0.0
        for number, places in enumerate(((0, 1), (1,), ())):
            for i in range(2):
                held = max(0.0, *(-memory.sent[place][i] * mover_motion[number][i] for place in places), 0.0)
                old += held
                new += max(0.0, -asked[i] * mover_motion[number][i] - held) if number >= 1 else 0.0
        assert taken_at_most(limits, memory, mover_motion, asked) == pytest.approx((old, new))
