"""The parts of `guarded` on several axes one by one, by numbers worked out by hand."""

from types import SimpleNamespace
from typing import Any

import pytest

from canhaptic.control.mechanisms.kinematics import Identity
from canhaptic.control.multi_axis import build_group_controller
from canhaptic.control.multi_axis.group_certificates import write_courses, write_tail
from canhaptic.control.multi_axis.group_kernel import motion_memory, motion_settings, world_of
from canhaptic.control.multi_axis.guarded_group import permitted_square
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.guarded import GuardedParameters
from canhaptic.control.port_hamiltonian.shapes.plane import Plane

WALL = Plane(normal=(1.0, 0.0), stiffness=1000.0)


def loops(**known: Any) -> tuple[LoopProperties, LoopProperties]:
    one = LoopProperties(sample_time=1e-3, moving_mass=0.25, device_damping_bound=0.2, **known)
    return one, one


def parabolas_of(pieces: int, **known: Any) -> Any:
    """Buffers for parabolas in the share of a torque, without any yet."""
    empty = {name: [0.0] * pieces for name in ("constant", "linear", "square")}
    return SimpleNamespace(**empty, starts=[[1e-3, 2e-3]], lost=[[1e-5, 2e-5]], **known)


def test_the_tail_of_older_torques_takes_the_larger_of_two_ways_of_the_hold_before() -> None:
    axes: Any = SimpleNamespace(timing=SimpleNamespace(share=[0.2], roots=[0.05]))
    limits: Any = SimpleNamespace(delay=1)
    memory = parabolas_of(4)
    assert write_tail(axes, limits, memory, 0, 1, 3, 0.4, 0.6, 2.0, 5.0, 0) == 4
    pace, rise = 2e-5 + 0.05 * 0.4, 0.05 * 0.6
    moved, grown, slope = 2e-3 + 3 * pace, 2 * rise, 0.2 * 0.7  # the torque acts in the last two of three holds
    turning, onward = slope * (moved / 1.5 + pace), 0.2 * moved + slope * pace
    more_turning, more_onward = slope * (grown / 1.5 + rise), 0.2 * grown + slope * rise
    assert memory.constant == pytest.approx([2.0 * turning, 0.0, 2.0 * onward, 0.0])
    assert memory.linear == pytest.approx([2.0 * more_turning, 5.0 * turning, 2.0 * more_onward, 5.0 * onward])
    assert memory.square == pytest.approx([0.0, 5.0 * more_turning, 0.0, 5.0 * more_onward])


def test_a_torque_grows_with_its_share_from_the_hold_on_in_which_it_acts() -> None:
    limits: Any = SimpleNamespace(roots=[0.05], holds=2, delay=1, first=0.25)
    memory = parabolas_of(6, along=[[3.0], [1.0]], against=[[0.0], [0.0]], ends=[0, 0])
    assert write_courses(limits, memory, [[0.0], [0.0]], 2.0, 0.0, 0.4, 0.6, 0, 0) == 6
    assert memory.ends == [2, 6]
    pace, rise = 1e-5 + 0.05 * 0.4, 0.05 * 0.6
    first, second, slope = 1e-3 + pace, 1e-3 + 2 * pace, 0.25 * rise
    whole, half = [first, 0.5 * first + 0.25 * pace], [second, 0.5 * second + 0.25 * pace]
    grown = [slope, 0.5 * slope + 0.25 * rise]
    assert memory.constant == pytest.approx([3.0 * whole[0], 3.0 * whole[1], half[0], 0.0, half[1], 0.0])
    assert memory.linear == pytest.approx([0.0, 0.0, grown[0], 2.0 * half[0], grown[1], 2.0 * half[1]])
    assert memory.square == pytest.approx([0.0, 0.0, 0.0, 2.0 * grown[0], 0.0, 2.0 * grown[1]])


@pytest.mark.parametrize(("path", "square"), [(1e-3, 0.0625), (0.0, 0.0)])
def test_the_way_of_a_hand_pays_for_the_springs_of_all_axes(path: float, square: float) -> None:
    axes, spring = SimpleNamespace(by_hand=False, by_damping=False), [3.0, -5.0]
    run: Any = (
        SimpleNamespace(account=SimpleNamespace(axes=axes), path=path),
        SimpleNamespace(account=None),
        SimpleNamespace(request=SimpleNamespace(spring=spring)),
    )
    assert permitted_square(run, 1.0, 2e-3) == pytest.approx(square)  # of 8 mJ in a hold
    assert permitted_square(run, 0.0, 2e-3) == 1.0
    assert permitted_square(run, 1.0, -2e-3) == 0.0


def test_what_the_modulated_dampers_took_is_summed_over_the_axes() -> None:
    group: Any = build_group_controller(WALL, Identity(axes=2), "guarded", GuardedParameters(), loops())
    group.step([0.01, 0.0], [0.0, 0.0])
    commands = group._step.args[1].memory.group.commands
    commands.modulated[0][:] = [2.0, -3.0]
    account = group.step([0.011, -0.002], [0.0, 0.0]).account
    assert account.h_pas == pytest.approx(2.0 * 1e-3 + 3.0 * 2e-3)


@pytest.mark.parametrize(("count", "samples"), [(0.0, 1), (1e-4, 21)])
def test_the_velocity_of_a_coarse_encoder_comes_from_twenty_milliseconds_at_most(count: float, samples: int) -> None:
    known = loops(encoder_count=count)
    world = world_of(WALL, Identity(axes=2), known)
    memory = motion_memory(world, motion_settings(world, known))
    assert [len(row) for row in memory.samples] == [samples, samples]
