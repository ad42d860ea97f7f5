"""`step_scaling` part by part: balances along a line, eq. 18 and the ends of contacts, against their closed forms."""

from math import sqrt
from typing import Any

import pytest

from canhaptic.control.balance import Branch
from canhaptic.control.mechanisms.kinematics import Identity
from canhaptic.control.multi_axis import build_group_controller, group_kernel
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.stepped import HoldAccount
from canhaptic.control.port_hamiltonian.network import DoubleWell, Network, QuadraticForm, Spring, UserEnergy
from canhaptic.control.port_hamiltonian.sampled_network import settle_network
from canhaptic.control.port_hamiltonian.shapes.box import Box
from canhaptic.control.port_hamiltonian.shapes.plane import Plane
from canhaptic.lab.rivals import scaled_group
from canhaptic.lab.rivals.scaled_group import ScaledGroupParameters, StepBalance, line_memory

K, X = 1000.0, 0.01
STORED = 0.5 * K * X * X  # at X [J]
DELAY = 2
LOOP = LoopProperties(sample_time=1e-3, moving_mass=0.25, delay=DELAY)


def line_of(storage, received, state, step, loss=0.0):
    """Returns the balance of a network of one storage on the line from a state along a step."""
    network, line = Network([storage], gain=[[1.0]]), line_memory(1)
    line.state[0], line.step[0] = state, step
    return StepBalance(network.tables, network.functions, line, received, loss)


def spring_line(received, step=X, loss=0.0):
    """Returns the balance along which a spring at X takes STORED ((1 + l step / X)^2 - 1)."""
    return line_of(Spring(stiffness=K), received, X, step, loss)


WALL = Plane(normal=(1.0,), stiffness=K, damping=0.0)


def begun(position, environment=WALL, **own):
    """Returns a group of one axis that has seen its first position."""
    group: Any = build_group_controller(
        environment, Identity(axes=1), "step_scaling", ScaledGroupParameters(**own), [LOOP]
    )  # fmt: skip
    group.step([position], [0.0])
    return group


def touching(position=-X, environment=WALL, **own):
    """Returns world and run of a group of one axis that has begun inside a wall."""
    return begun(position, environment, **own)._step.args


def strained(step, environment=WALL, **own):
    """Returns world and run at a state of -X, of which the model wants to go on by a step."""
    world, run = touching(-X, environment, **own)
    network = run.memory.group.motion.network
    network.state[0], network.room.step[0] = -X, step
    settle_network(world, run.state.group.motion.network, network)
    run.state.h_s = run.state.group.motion.network.energy
    assert run.state.h_s == pytest.approx(STORED)
    return world, run


def test_a_spring_takes_along_a_line_what_its_square_says_and_the_loss_its_share():
    energy, slope = scaled_group.taken(spring_line(0.0, loss=3e-3), 0.5)
    assert energy == pytest.approx(STORED * (1.5**2 - 1.0) + 1.5e-3)
    assert slope == pytest.approx(K * X * 1.5 * X + 3e-3)
    at = spring_line(0.0, step=0.5 * X)
    assert scaled_group.stiffness_along(at.tables, at.line) == pytest.approx(K * (0.5 * X) ** 2)


@pytest.mark.parametrize("solve", [scaled_group.solve_scale, scaled_group.search_scale])
@pytest.mark.parametrize("share", [0.5, 1.5, -0.5])
def test_the_share_of_a_spring_is_the_root_of_its_square(solve, share):
    found = solve(spring_line(STORED * ((1.0 + share) ** 2 - 1.0)), 2.0)
    assert found.found
    assert found.share == pytest.approx(share)
    assert found.evaluations <= 14  # Newton's method: halving alone takes fifty


def test_an_energy_given_as_a_function_is_taken_like_that_of_a_spring():
    given = UserEnergy(1, lambda x: 0.5 * K * x[0] ** 2, lambda x: [K * x[0]])
    energy, slope = scaled_group.taken(line_of(given, 0.0, X, X), 0.5)
    assert energy == pytest.approx(STORED * (1.5**2 - 1.0))
    assert slope == pytest.approx(K * X * 1.5 * X)


def test_the_share_of_a_spring_that_hardens_is_searched_for():
    received = STORED * (1.5**2 - 1.0) + 0.25 * 1e7 * X**4 * (1.5**4 - 1.0)
    found = scaled_group.solve_scale(line_of(Spring(stiffness=K, hardening=1e7), received, X, X), 2.0)
    assert found.found
    assert found.share == pytest.approx(0.5)


def test_coupled_states_are_as_stiff_along_a_line_as_their_form():
    network, line = Network([QuadraticForm(matrix=[[4.0, 1.0], [1.0, 3.0]])], gain=[[1.0], [0.0]]), line_memory(2)
    line.step[:] = [2.0, -1.0]
    assert scaled_group.stiffness_along(network.tables, line) == pytest.approx(4.0 * 4.0 - 2.0 * 2.0 + 3.0)


def test_no_step_takes_nothing_and_cannot_give():
    assert scaled_group.search_scale(spring_line(0.0), 2.0) == (0.0, True, 0)
    assert scaled_group.solve_scale(spring_line(1e-3, step=0.0), 2.0) == (0.0, True, 1)
    assert scaled_group.solve_scale(spring_line(-1e-3, step=0.0), 2.0) == (0.0, False, 1)
    assert scaled_group.search_scale(line_of(Spring(stiffness=K), -1e-3, 0.0, X), 2.0) == (0.0, False, 1)


def test_an_energy_is_bracketed_where_the_step_ends_or_on_its_way():
    assert scaled_group.bracket_upwards(spring_line(7.0 * STORED), 2.0) == (2.0, True, 1)  # of 8
    well = DoubleWell(hardening=4.0, well=1.0)  # (x^2 - 1)^2: from one well over the hill at 0 to the other
    assert scaled_group.bracket_upwards(line_of(well, 1.0, -1.0, 1.0), 2.0) == (1.0, True, 5)
    assert scaled_group.bracket_upwards(line_of(well, 1.01, -1.0, 1.0), 2.0) == (2.0, False, 8)


def test_the_bottom_of_a_spring_is_found_and_gives_no_more_than_is_stored():
    assert scaled_group.bracket_downwards(spring_line(-0.9 * STORED, step=-X), 2.0) == (1.0, True, 2)
    assert scaled_group.search_scale(spring_line(-1.1 * STORED, step=-X), 2.0) == (1.0, False, 21)
    assert scaled_group.solve_scale(spring_line(-1.1 * STORED, step=-X), 2.0) == (0.0, False, 1)


def test_the_surplus_is_kept_unless_a_damping_of_it_is_asked():
    assert ScaledGroupParameters().alpha == 0.0


@pytest.mark.parametrize("step", [0.2 * X, -0.2 * X])
def test_without_a_root_the_state_takes_what_the_damper_leaves(step):
    world, run = strained(step)
    account = scaled_group.approximate(world, run, -0.4 * STORED, 0.2 * STORED, 0.0)  # of 0.6 the damper takes 0.2
    assert account == pytest.approx((Branch.FALLBACK.value, 0.2 * STORED, 0.0, 0.0, 0.0))
    assert run.state.h_s == pytest.approx(0.4 * STORED)
    back = (1.0 - sqrt(0.4)) * X
    assert run.memory.group.motion.network.state[0] == pytest.approx(back - X)
    assert run.state.pace == pytest.approx(back / step)


def test_without_a_step_of_the_model_the_state_has_no_pace():
    world, run = strained(0.0)
    scaled_group.approximate(world, run, -0.4 * STORED, 0.2 * STORED, 0.0)
    assert run.state.h_s == pytest.approx(0.4 * STORED)
    assert run.state.pace == 0.0


def test_where_the_damper_takes_everything_the_spring_is_empty():
    world, run = strained(0.2 * X)
    account = scaled_group.approximate(world, run, -0.4 * STORED, STORED, 0.0)
    assert account == pytest.approx((Branch.FALLBACK.value, 0.6 * STORED, 0.0, 0.0, 0.0))
    assert run.state.h_s == 0.0
    assert run.state.pace == pytest.approx(X / (0.2 * X))


def test_a_contact_generates_its_energy_once_and_pays_nothing_back_without_a_leak():
    group = begun(1e-3)
    accounts = [group.step([position], [0.0]).account for position in (-X, -X)]
    assert [each.branch for each in accounts] == [Branch.START.value, Branch.EXACT.value]
    assert [each.gen for each in accounts] == pytest.approx([STORED, 0.0])
    assert [each.h_dis for each in accounts] == pytest.approx([STORED, STORED])
    assert [each.paid for each in accounts] == [0.0, 0.0]


def test_a_start_ends_where_the_hand_no_longer_pushes_inward():
    group = begun(1e-3)
    group.step([-X], [0.0])
    state = group._step.args[1].state
    assert state.blind == DELAY
    group.step([-0.5 * X], [0.0])
    assert state.blind == 0


def test_a_leak_pays_for_no_surplus_below_zero():
    group = begun(1e-3)
    group.step([-X], [0.0])
    _, run = group._step.args
    state, commands = run.state, run.memory.group.commands
    state.h_dis, commands.modulated[state.group.oldest][0] = 0.0, 2.0  # which takes 22 mJ on the way out
    account = group.step([1e-3], [0.0]).account
    assert account.h_pas == pytest.approx(2.0 * 1.1 * X)
    assert account.leak == pytest.approx(STORED - account.h_pas)
    assert (account.paid, account.h_dis) == (0.0, pytest.approx(-account.h_pas))


def test_a_damper_is_sent_as_far_as_the_cap_of_the_velocity_reaches():
    world, run = strained(0.0, Plane(normal=(1.0,), stiffness=K, damping=1e3))
    run.state.engaged, run.state.pace, run.state.group.motion.elapsed = True, 0.5, 1e-3
    run.memory.group.ended.displacement[0] = run.memory.group.motion.displacement[0] = -1e-4
    place, (cap,) = run.state.group.oldest, scaled_group.settings_of(world, ScaledGroupParameters(), (LOOP,)).loop.caps
    assert scaled_group.send(world, run) == pytest.approx(cap)
    assert cap < 1e3
    assert run.memory.group.commands.dampers[place][0] == pytest.approx(cap * 0.5 * -0.1)
    assert run.memory.group.commands.power[place] == pytest.approx(cap * 0.05**2 * 1e-3)


def test_a_model_beyond_its_upper_edge_keeps_its_spring():
    world, run = touching(X, Box(lower=(-1.0,), upper=(0.0,), side="inside", stiffness=K, damping=0.0))
    network = run.memory.group.motion.network
    network.state[0] = X
    settle_network(world, run.state.group.motion.network, network)
    kept = HoldAccount(Branch.EXACT.value, 0.0, 0.0, 0.0, 0.0)
    assert scaled_group.leave(world, run, kept, True, True) == kept
    assert run.state.h_s == pytest.approx(STORED)


def test_a_model_that_left_its_wall_leaks_what_the_spring_still_has_and_one_inside_keeps_it():
    world, run = strained(0.0)
    kept = HoldAccount(Branch.EXACT.value, 0.0, 0.0, 0.0, 0.0)
    assert scaled_group.leave(world, run, kept, True, True) == kept
    assert run.state.h_s == pytest.approx(STORED)
    run.memory.group.motion.coordinates[0] = 0.5 * X
    left = scaled_group.leave(world, run, kept, False, True)
    assert left == pytest.approx((Branch.EXIT.value, 0.0, 0.0, 0.0, STORED))
    assert run.state.h_s == 0.0
    assert (run.state.engaged, run.state.pace, run.state.blind) == (False, 0.0, 0)


@pytest.mark.parametrize(("position", "step", "inward"), [
    (-X, -1e-4, True), (-X, 1e-4, False), (-X, 0.0, False), (0.5 * X, 1e-4, True), (0.5 * X, -1e-4, True),
])  # fmt: skip
def test_a_step_goes_inward_where_it_stores_or_meets_nothing(position, step, inward):
    world, run = touching(position)
    run.memory.group.motion.network.room.step[0] = step
    run.memory.model[0] = position
    assert scaled_group.is_pushed_inward(world, run.memory) is inward


def test_motion_that_begins_again_books_the_difference_to_the_energy_at_hand():
    for received, deficit, leak in ((2e-3, 0.0, 2e-3), (-2e-3, 2e-3, 0.0)):
        world, run = touching()
        run.state.group.motion.began = True
        account = scaled_group.exchange(world, run, received, 0.0, 0.0)
        assert account == pytest.approx((Branch.EXIT.value, 0.0, 0.0, deficit, leak))


def test_over_lost_holds_the_energy_is_unsure_by_the_torques_apart_times_the_farthest_way():
    _, run = touching()
    memory, ended = run.memory, run.memory.group.ended
    ended.displacement[0], ended.applied[0], memory.previous[0] = 1e-3, 3.0, -2e-3
    for place, torque in enumerate((1.0, 4.0, 6.0)):
        ended.lost[place][0] = torque
    assert group_kernel.uncertainty_of_gap(ended, memory.previous, 0) == 0.0
    assert memory.previous[0] == 1e-3
    ended.displacement[0] = -3e-3  # in three holds, of which two were lost
    assert group_kernel.uncertainty_of_gap(ended, memory.previous, 2) == pytest.approx((2.0 + 1.0) * (3e-3 + 2 * 1e-3))


def test_the_surplus_is_damped_along_the_motion():
    world, run = strained(0.0, alpha="100 s/m^2")
    run.state.engaged, run.state.h_dis = True, 1e-3
    run.memory.group.ended.displacement[0] = moved = 1e-4
    run.state.group.motion.elapsed = 1e-3
    place = run.state.group.oldest
    extra = scaled_group.send(world, run)
    commands = run.memory.group.commands
    assert extra > 0.0
    assert commands.modulated[place][0] == pytest.approx(extra * moved / 1e-3)
    assert commands.torques[place][0] == pytest.approx(K * X - extra * moved / 1e-3)
