"""Sums and limits of a single hold, by numbers worked out by hand."""

import math

import pytest

from canhaptic.control.damping import (
    VelocityWindow,
    modulated_damping,
    restart,
    update,
)
from canhaptic.control.passivity.stepped import (
    Axis,
    AxisMemory,
    Commands,
    HoldSettings,
    clipped,
    efforts_inside,
    let_samples_pass,
    open_hold,
    repeat,
    send,
    towards_zero,
)

T, MASS = 1e-3, 0.25


def test_the_modulated_damper_is_proportional_to_the_surplus_up_to_its_cap_and_to_what_the_hold_can_take() -> None:
    assert modulated_damping(200.0, 0.01, 1.0, 10.0, 0.0, T) == pytest.approx(2.0)
    assert modulated_damping(200.0, 0.02, 1.0, 10.0, 0.0, T) == pytest.approx(4.0)
    assert modulated_damping(200.0, 0.2, 1.0, 10.0, 0.0, T) == pytest.approx(9.0)
    assert modulated_damping(200.0, 0.2, 12.0, 10.0, 0.0, T) == 0.0
    assert modulated_damping(200.0, -0.1, 1.0, 10.0, 0.0, T) == 0.0
    taken = modulated_damping(1e6, 1e-6, 0.0, 1e9, 1e-3, T)
    assert taken == pytest.approx(1e-6 * T / 1e-6)  # all of the surplus, along 1 mm in 1 ms
    assert modulated_damping(1e6, 1e-6, 0.0, 1e9, 1e-6, T) == pytest.approx(1.0)


def test_a_window_in_a_ring_keeps_each_sample_in_its_place() -> None:
    ring, window = [0.0] * 6, VelocityWindow()
    restart(window, ring, 0.1)
    for place in range(1, 14):
        update(window, ring, 1e-6, T, 0.1 + 1e-4 * place)
        assert ring[place % 6] == pytest.approx(0.1 + 1e-4 * place)
        assert window.newest == place % 6
        assert window.length <= 5
        assert window.velocity == pytest.approx(0.1)


def test_efforts_inside_a_torque_that_was_cut_are_cut_as_much() -> None:
    commands = Commands([-4.0], [1.0], [0.5])
    assert efforts_inside(commands, 0, -4.0) == (1.0, 0.5)
    assert efforts_inside(commands, 0, -2.0) == (0.5, 0.25)
    assert efforts_inside(commands, 0, 2.0) == (0.0, 0.0)
    assert efforts_inside(commands, 0, -8.0) == (1.0, 0.5)
    assert efforts_inside(Commands([0.0], [1.0], [-1.0]), 0, 2.0) == (0.0, 0.0)


def test_commands_wait_in_their_order_and_the_newest_is_repeated() -> None:
    commands = Commands([1.0, 2.0, 3.0], [0.1, 0.2, 0.3], [0.0, 0.0, 0.0])
    assert send(commands, 1, 5.0, 0.5, 0.05) == 2
    assert commands.torques == [1.0, 5.0, 3.0]
    assert repeat(commands, 2) == 0
    assert (commands.torques, commands.dampers, commands.modulated) == (
        [1.0, 5.0, 5.0],
        [0.1, 0.5, 0.5],
        [0, 0.05, 0.05],
    )


def test_a_torque_is_clipped_and_rounded_towards_zero() -> None:
    assert [clipped(torque, 2.0) for torque in (-3.0, -1.0, 2.5)] == [-2.0, -1.0, 2.0]
    assert [towards_zero(torque, 0.5) for torque in (-1.4, 1.4, 0.4)] == [-1.0, 1.0, 0.0]
    assert towards_zero(1.4, 0.0) == 1.4


def axis_of(torques: list[float], **values: float) -> tuple[Axis, AxisMemory]:
    axis = Axis(started=True, position=0.0, **values)  # type: ignore[arg-type]
    zeros = [0.0] * len(torques)
    return axis, AxisMemory([0.0] * 6, Commands(list(torques), list(zeros), list(zeros)))


def test_lost_samples_leave_open_each_torque_along_the_excursion() -> None:
    axis, memory = axis_of([3.0, 1.0], missed=2, moved=-0.01)
    assert let_samples_pass(axis, memory.commands, 0.05, 1.0, 2.5) == pytest.approx((1.5 + 0.0) * (0.05 + 2 * 0.01))
    assert (axis.missed, axis.oldest, memory.commands.torques) == (0, 0, [1.0, 1.0])
    axis, memory = axis_of([1.0, 1.0], missed=1, moved=0.01)
    assert let_samples_pass(axis, memory.commands, 0.05, 1.0, 2.5) == 0.0  # all of them are the one that acted
    axis, memory = axis_of([3.0, 1.0], missed=1, moved=0.01, hold_length=3.0)
    assert let_samples_pass(axis, memory.commands, 0.05, 1.0, 9.0) == pytest.approx((2.0 + 2 * 2.0) * (0.05 + 3 * 0.01))


@pytest.mark.parametrize(("missed", "hold_length"), [(1, 1.0), (0, 2.0), (2, 1.0)])
def test_a_velocity_from_a_window_begins_anew_after_a_hold_of_several_sample_times(
    missed: int, hold_length: float
) -> None:
    settings = HoldSettings(T, 1, math.inf, 1e-6, 5, 0)
    axis, memory = axis_of([0.0, 0.0])
    for place in range(1, 4):
        hold = open_hold(settings, axis, memory, 1e-4 * place, 0.0)
    assert hold.velocity == pytest.approx(0.1)
    axis.missed, axis.hold_length = missed, hold_length
    hold = open_hold(settings, axis, memory, 7e-4, 0.0)
    holds = missed + hold_length
    assert (hold.elapsed, hold.velocity) == pytest.approx((holds * T, 4e-4 / (holds * T)))
    assert (axis.window.length, axis.window.anchor, axis.hold_length) == (0, 7e-4, 1.0)
