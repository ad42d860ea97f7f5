"""The parts of `guarded` one by one: what is predicted, permitted and passed on, by numbers worked out by hand."""

from dataclasses import replace
from math import cos, inf
from types import SimpleNamespace
from typing import Any

import pytest

from canhaptic.control.balance import Certificate, residual
from canhaptic.control.certificates.certified_torque import TorqueBound
from canhaptic.control.environments.detents import Detents
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.asked_torque import AskedState, GuardedProgram, granted
from canhaptic.control.passivity.guarded import (
    Guarded,
    GuardedParameters,
    GuardedSettings,
    GuardedState,
    PredictedMotion,
    PredictionSettings,
    efforts,
    energy_permitted,
    hand_response,
    memory_of,
    motion_inside,
    permitted_size,
    predicted,
    settings_of,
    soft_and_further,
    take_stretch,
    within_limits,
)
from canhaptic.control.passivity.internal_dissipation import (
    InternalDissipation,
    StoredModelParameters,
    dissipation,
)
from canhaptic.control.passivity.stepped import Hold
from canhaptic.control.passivity.unprotected import SampledModel, settle
from canhaptic.kernels import Run, list_of_zeros

T = 1e-3
WALL, DETENTS = SpringDamperWall(stiffness=100.0, position=0.0), Detents(peak=0.5, pitch=0.02, position=0.001)
KNOWN = {"sample_time": T, "moving_mass": 0.2, "device_damping_bound": 0.1}


def loop(**values: Any) -> LoopProperties:
    return LoopProperties(**(KNOWN | values))


def settings(environment: Any = WALL, given: dict[str, Any] | None = None, **values: Any) -> GuardedSettings:
    return settings_of(environment, GuardedParameters(**(given or {})), loop(**values))


def test_nothing_is_declared_of_a_hand_but_that_it_does_not_pull() -> None:
    given = GuardedParameters()
    assert (given.hand_force, given.hand_push, given.hand_speed, given.max_consecutive_losses) == (0.0, None, None, 0)


def test_a_prediction_goes_on_for_the_delay_and_the_time_beyond_it() -> None:
    """Without a mass the motion is steady; one below the noise is mixed with the measured one."""
    of = PredictionSettings(0.0, 0.0, 2, 0.5, 4e-6)
    assert predicted(of, PredictedMotion(step=1e-5), [0.0] * 4, 0, 1e-5) == pytest.approx((2.5e-5, 1e-5))
    way, step = predicted(of, PredictedMotion(step=3e-6), [0.0] * 4, 0, 1e-6)
    assert (way, step) == pytest.approx((2.5 * (1e-6 + 0.25 * 2e-6), 1e-6 + 0.25 * 2e-6))
    assert predicted(of, PredictedMotion(step=3e-6), [0.0] * 4, 0, 0.0) == (0.0, 0.0)
    heavy = PredictionSettings(2.0, 0.0, 2, 0.5, 0.0)  # two torques of 1 and -1 are under way
    way, step = predicted(heavy, PredictedMotion(step=1.0), [9.0, 1.0, -1.0, 9.0], 1, 1.0)
    assert (way, step) == (1.0 + 1.0 + 3.0 - 1.0 + 0.5 * 1.0, 1.0)


@pytest.mark.parametrize(
    ("newest", "sign", "moved", "most"),
    [
        (0.0, 1.0, 0.0, 0.5), (2.0, 1.0, 0.0, 2.5), (2.0, -1.0, 0.0, 0.5), (9.0, 1.0, -1e-3, 8.0),
        (9.0, 1.0, 1e-3, 3.0), (-9.0, -1.0, -2e-3, 1.5), (-9.0, -1.0, 2e-3, 8.0),
    ],
)  # fmt: skip
def test_a_torque_rises_by_its_rate_and_gives_no_more_than_the_power(
    newest: float, sign: float, moved: float, most: float
) -> None:
    of = settings(torque_limit=8.0, torque_rate_limit=500.0, power_limit=3.0)
    assert within_limits(of, newest, sign, moved) == pytest.approx(most)


def test_without_limits_there_are_none() -> None:
    of = settings()
    assert within_limits(of, 0.0, 1.0, 1.0) == inf
    assert of.least_limit == inf
    assert settings(torque_limit=8.0).least_limit == 8.0
    assert settings(torque_limit=8.0, power_limit=3.0).least_limit == 0.0


@pytest.mark.parametrize("delay", [0, 1, 2])
def test_the_path_of_a_hand_is_that_of_the_holds_that_a_torque_takes(delay: int) -> None:
    assert settings(given={"hand_speed": 0.5}, delay=delay).path == pytest.approx(0.5 * T * (1 + delay))
    assert settings(delay=delay).path == 0.0


def test_only_an_environment_with_several_ways_out_turns() -> None:
    wall, knob = settings(), settings(DETENTS, {"hand_push": 1.0})
    assert (abs(wall.outside), wall.turns, wall.knows_turns) == (1.0, False, False)
    assert (knob.outside, knob.turns, knob.knows_turns) == (0.0, True, True)
    damped = settings(DETENTS, {"hand_force": None}, device_damping=1.0)  # any hand: no turn matters
    assert (damped.turns, damped.knows_turns) == (False, False)


def test_only_friction_beyond_the_cogging_brakes_and_only_where_the_axis_creeps_by_a_known_stiffness() -> None:
    def brake(**values: float) -> float:
        return hand_response(GuardedParameters(hand_force=1.0), loop(device_friction_bound=0.5, **values)).brake

    stiff = {"presliding_stiffness": 1e8}
    assert (brake(), brake(**stiff), brake(device_cogging_bound=0.2)) == (0.0, 0.0, 0.0)
    most = brake(**stiff, device_cogging_bound=0.0)
    assert most > 0.0
    assert brake(**stiff, device_cogging_bound=0.2) == pytest.approx(0.6 * most)
    assert brake(**stiff, device_cogging_bound=0.7) == 0.0


@pytest.mark.parametrize(
    ("position", "out", "below", "above"),
    [(0.003, -1.0, 0.002, 0.008), (-0.004, 1.0, 0.005, 0.005), (0.012, 1.0, 0.001, 0.009), (0.001, 0.0, 0.0, 0.0)],
)
def test_the_stretch_around_a_position_in_detents_ends_at_rest_and_at_the_crest(
    position: float, out: float, below: float, above: float
) -> None:
    """They rest at 1 mm + n 20 mm; the crest is half way."""
    bound = TorqueBound()
    true = DETENTS.true_state(position, 0.0, 0.0)
    take_stretch(DETENTS, settings(DETENTS, {"hand_push": 1.0}), bound, position, true)
    assert (bound.out, bound.below, bound.above) == pytest.approx((out, below, above))


def test_what_the_account_covers_is_the_larger_of_the_calm_and_the_damped_spring() -> None:
    plain = replace(settings(), earned=0.0, calm_stiffness=100.0, damped_stiffness=0.0)
    bound = TorqueBound()
    bound.dissipated, bound.certain = 0.25, 0.125
    assert energy_permitted(plain, bound, 0.0, 0.5, 9.0) == pytest.approx(2.0 * 100.0 * 0.75)
    damped = replace(plain, damped_stiffness=400.0)
    assert energy_permitted(damped, bound, 0.0, 0.5, 9.0) == pytest.approx(2.0 * 400.0 * 0.625)
    assert bound.dissipated == 0.25
    energy_permitted(damped, bound, 20.0, 0.0, 0.0)  # an effort of 20 needs 0.5 J of a spring of 400
    assert bound.dissipated == 0.25
    energy_permitted(damped, bound, 8.0, 0.0, 0.0)
    assert bound.dissipated == pytest.approx(0.5 * 64.0 / 400.0)
    energy_permitted(replace(damped, earned=0.05), bound, 0.0, 0.0, 0.01)
    assert bound.dissipated == pytest.approx(0.06)


def test_the_part_of_a_motion_inside_a_wall_is_that_behind_its_surface() -> None:
    run: Any = SimpleNamespace(settings=SimpleNamespace(longest_window=0), state=None)
    assert motion_inside(WALL, run, -2e-3, -3e-3, 1.0, -2e-3, same=True) == pytest.approx((-2e-3, -3e-3))
    travel, inside = motion_inside(WALL, run, 9.0, -3e-3, 2.0, -2e-3, same=False)  # 1 mm of it was outside
    assert (travel, inside) == pytest.approx((-1.5e-3, -1e-3))


def test_a_lost_sample_repeats_the_torque_and_says_nothing_of_damping_and_certificate() -> None:
    controller = Guarded(WALL, GuardedParameters(), loop(delay=1))
    controller.step(0.001, 0.0)
    before = controller.step(-0.002, 0.0)
    lost = controller.sample_lost()
    assert lost.torque == before.torque != 0.0
    assert (lost.damping_rendered, lost.certificate) == (0.0, Certificate.EXACT.value)


def test_a_program_keeps_of_the_dissipation_what_the_torque_it_asks_for_needs() -> None:
    of = replace(settings(), earned=0.0, damped_stiffness=400.0, torque_limit=8.0)
    for asked, kept in ((4.0, 0.5 * 16.0 / 400.0), (-4.0, 0.5 * 16.0 / 400.0), (20.0, 0.5 * 64.0 / 400.0)):
        run = Run(of, AskedState(), memory_of(of, list_of_zeros))
        run.state.bound.dissipated = 1.0
        granted(run, asked, 0.0)
        assert run.state.bound.dissipated == pytest.approx(kept)


def test_what_sampling_creates_or_loses_is_the_rest_of_the_account() -> None:
    model = SampledModel(true=-0.02, h_s=0.5)
    assert settle(WALL, model, 1.0, 0.25, 0.125) == pytest.approx((0.0, 0.5 + 0.25 - 0.125 - 0.02))  # lost
    assert (model.state, model.h_s) == pytest.approx((-0.02, 0.02))
    assert settle(WALL, model, 0.5, -0.03, 0.01) == pytest.approx((0.03 + 0.01 + 0.005 - 0.02, 0.0))  # created
    assert (model.state, model.h_s) == pytest.approx((-0.01, 0.005))


def test_the_spring_that_friction_sustains_keeps_its_reserve() -> None:
    of = settings(device_friction=0.5, encoder_count=1e-5)
    assert of.sustained > 0.0
    run = Run(of, GuardedState(), memory_of(of, list_of_zeros))
    depth, energy = 1e-5, 5e-3
    soft, further = soft_and_further(of, run.state.bound, 50.0, depth, energy)
    assert soft == pytest.approx(of.sustained * depth)
    assert soft + further < 50.0
    spring, _, _, covered = efforts(run, depth, -50.0, 0.0, 0.0, 0.0, 0.0, energy, 1.0)
    assert -spring == pytest.approx(soft + further)
    assert not covered
    assert -spring < 0.99 * energy_permitted(of, run.state.bound, 50.0, energy, 1.0) ** 0.5


def test_a_program_sees_a_slow_motion_through_a_window_of_twenty_milliseconds() -> None:
    program = GuardedProgram(GuardedParameters(), loop(encoder_count=1e-5))
    program.velocity(0.0, 0)
    seen = [program.velocity(1e-5 * (place // 10), 1) for place in range(1, 100)]
    assert all(0.5e-3 < velocity < 2e-3 for velocity in seen[40:])  # a count each ten samples: 1 mm/s
    assert program.velocity(2e-3, 4) == pytest.approx((2e-3 - 9e-5) / 4e-3)  # after skipped SYNCs the mean


def test_a_program_with_an_ideal_encoder_sees_more_than_the_last_hold() -> None:
    program = GuardedProgram(GuardedParameters(), loop())
    program.velocity(0.0, 0)
    for place in range(1, 60):
        velocity = program.velocity(1e-4 * place + 4e-10 * (place % 2), 1)
    assert velocity == pytest.approx(0.1, abs=1e-7)  # the last hold alone is wrong by four times that


def test_a_damper_dissipates_the_square_of_its_effort_over_its_damping() -> None:
    hold = Hold(0.0, 3.0, 0.0, 0.0, 2e-3, 0.0, 0.0, 0)
    assert dissipation(10.0, hold) == pytest.approx(2e-3 * 9.0 / 10.0)
    assert dissipation(0.0, hold) == 0.0


def test_what_the_modulated_damper_takes_is_not_received_by_the_model() -> None:
    wall = SpringDamperWall(stiffness=500.0, damping=5.0, position=0.0)
    controller = InternalDissipation(wall, StoredModelParameters(alpha="200 s/m^2"), loop(delay=1))
    under_way, before, taken = [0.0], 0.0, 0.0
    for place in range(400):
        balance = controller.step(0.01 * cos(0.05 * place), under_way.pop(0))
        under_way.append(balance.torque)
        assert abs(residual(balance, before)) < 1e-12
        before, taken = balance.h_s, taken + abs(balance.h_pas)
    assert taken > 1e-6


def test_a_torque_that_may_reach_a_crest_is_permitted_as_one_beside_it() -> None:
    of = settings(DETENTS, {"hand_force": 1.0, "hand_push": 4.0})
    sizes = []
    for knows in (True, False):
        run = Run(of, GuardedState(), memory_of(of, list_of_zeros))
        bound = run.state.bound
        bound.out, bound.kept, bound.turns, bound.is_near = 1.0, 3 * (not knows), knows, knows
        bound.above = bound.below = 1e-9  # the crest is within a nanometre
        bound.displacement = 1e-5
        sizes.append(permitted_size(run, 50.0, 1e-4, 0.0)[0])
        assert (bound.turns, bound.is_near) == (True, True)
        assert knows or bound.kept == 0
    assert sizes[0] == sizes[1]
    far = Run(of, GuardedState(), memory_of(of, list_of_zeros))
    far.state.bound.out, far.state.bound.displacement = 1.0, 1e-5
    assert permitted_size(far, 50.0, 1e-4, 0.0)[0] > 1.2 * sizes[0]
    assert not far.state.bound.turns
