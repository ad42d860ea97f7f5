"""The account of `guarded` between two SYNCs: internal relaxation, and holds in which SYNCs were skipped."""

import math

import pytest

from canhaptic.control.environments.detents import Detents
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.environments.viscoelastic_medium import ViscoelasticMedium
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.guarded import (
    Guarded,
    GuardedParameters,
    GuardedSettings,
    GuardedState,
    Memory,
    end,
    memory_of,
    relax,
    settings_of,
)
from canhaptic.kernels import Run, list_of_zeros

T = 1e-3
LOOP = LoopProperties(sample_time=T, delay=1, moving_mass=0.25, device_damping_bound=0.0)


@pytest.mark.parametrize(("stored", "share"), [(1.0, 1.0), (1e-6, 1.0), (1.0, 0.5)])
def test_what_a_medium_relaxes_is_dissipated_and_no_more_than_is_stored(stored: float, share: float) -> None:
    """At `share` 0.5 the medium holds more than the account has for it, so that nothing is lost by its relaxation."""
    medium = ViscoelasticMedium(stiffness=500.0, relaxation_time=0.01, damping=0.0)
    settings = settings_of(medium, GuardedParameters(hand_force=1.0), LOOP)
    state = GuardedState(h_s=stored, unrecovered=0.25)
    before = medium.stored_energy(2e-3)
    run = Run(settings, state, memory_of(settings, list_of_zeros))
    relaxed, left, lost = relax(medium, run, 2e-3, share * before, 2)
    assert relaxed == pytest.approx(medium.relaxed(2e-3, 2.0 * T))
    assert left == medium.stored_energy(relaxed)
    assert left < 0.9 * before
    assert lost == (0.0 if share < 1.0 else min(stored, before - left))
    assert (state.h_s, state.unrecovered) == (stored - lost, 0.25 + lost)


def begun() -> tuple[GuardedSettings, GuardedState, Memory]:
    settings = settings_of(SpringDamperWall(stiffness=500.0), GuardedParameters(hand_force=1.0), LOOP)
    state, memory = GuardedState(), memory_of(settings, list_of_zeros)
    for place, torque in enumerate((0.5, 2.0)):
        memory.axis.commands.torques[place] = torque
    state.axis.position, state.bound.first = 0.01, -1
    return settings, state, memory


@pytest.mark.parametrize("hold_length", [1.0, 2.0, 4.0])
def test_of_a_hold_that_lasted_longer_the_mean_motion_goes_on_and_the_next_one_is_a_usual_one(
    hold_length: float,
) -> None:
    settings, state, memory = begun()
    state.axis.hold_length = hold_length
    displacement, _, _, _ = end(Run(settings, state, memory), 0.013, 0.5)
    assert displacement == pytest.approx(0.003)
    assert state.bound.displacement == pytest.approx(0.003 / hold_length)
    assert hold_length == 1.0 or state.motion.step == pytest.approx(0.003 / hold_length)
    assert (state.bound.position_uncertainty > 0.0) is (hold_length > 1.0)
    assert state.axis.hold_length == 1.0


def test_behind_lost_samples_the_newest_torque_acts_and_the_difference_from_the_older_one_is_in_doubt() -> None:
    settings, state, memory = begun()
    state.axis.missed = 1
    displacement, damper, modulated, uncertainty = end(Run(settings, state, memory), 0.014, 2.0)
    assert (displacement, damper, modulated) == (pytest.approx(0.004), 0.0, 0.0)
    assert state.bound.displacement == state.motion.step == pytest.approx(0.002)
    assert uncertainty == pytest.approx(state.bound.resolution / 2.0)
    assert uncertainty > 1.5 * 0.004
    assert (state.axis.oldest, state.axis.missed, state.bound.first) == (1, 0, 0)
    assert memory.axis.commands.torques[0] == 2.0


def test_what_a_controller_may_survive_and_owe_is_known_of_it() -> None:
    parameters = GuardedParameters(hand_force=1.0, max_consecutive_losses=2, energy_allowance=1e-3)
    one = Guarded(SpringDamperWall(stiffness=500.0), parameters, LOOP)
    assert (one.max_consecutive_losses, one.energy_allowance, one.energy_resolution) == (2, 1e-3, 0.0)


def detent_run(push: float | None, hand_force: float, after: float) -> tuple[Guarded, float]:
    """Detents climbed to a crest at 4 mm and passed, an ideal encoder; the last torque is `after` beyond it."""
    made = Guarded(
        Detents(peak=5.0, pitch=0.008),
        GuardedParameters(hand_force=hand_force, hand_push=push, energy_allowance=1.0),
        LoopProperties(sample_time=T, moving_mass=0.25, device_damping_bound=0.0),
    )
    torque, position = 0.0, 1e-3
    while position < 4e-3 + after:
        torque, position = made.step(position, torque).torque, position + 5e-5
    return made, torque


def test_beyond_a_crest_the_effort_is_rendered_and_near_it_the_hand_counts_for_its_push() -> None:
    made, torque = detent_run(20.0, 5.0, 1e-3)
    assert torque == pytest.approx(5.0 * math.sin(0.25 * math.pi), rel=0.1)  # it pulls to the next rest
    assert (made._state.bound.out, made._state.bound.turns) == (1.0, False)
    at_crest, _ = detent_run(20.0, 5.0, 6e-5)
    assert at_crest._state.bound.turns
    assert not made.lacks_push
    lacking, _ = detent_run(None, 5.0, 6e-5)
    assert lacking.lacks_push
    assert lacking._last.torque == 0.0


def test_what_is_kept_for_contacts_that_turn_holds_the_hands_push() -> None:
    kept = [
        settings_of(Detents(peak=5.0, pitch=0.008), GuardedParameters(hand_force=5.0, hand_push=push), LOOP).earned
        for push in (5.0, 20.0)
    ]
    assert kept[1] == pytest.approx(16.0 * kept[0])
