"""Every algorithm of one axis where SYNCs are skipped: the hold lasts longer, and its motion was no faster."""

from typing import Any

import pytest

from canhaptic.control.damping import DamperVelocity
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.environments.viscoelastic_medium import ViscoelasticMedium
from canhaptic.control.passivity import LoopProperties, build_controller
from tests.control.cases import algorithms, controller, loop

MOVED = 1e-4  # in a sample time, inward [m]
DAMPED = SpringDamperWall(stiffness=10.0, damping=6.0)
RELAXING = ViscoelasticMedium(stiffness=500.0, relaxation_time=5e-3)


def torque_after(made, holds, *, skipped, lost=0):
    """The torque after 20 holds of steady motion and so many more, each SYNC reported or the last alone."""
    torque = 0.0
    for hold in range(20):
        torque = made.step(-hold * MOVED, torque).torque
    for hold in range(20, 20 + holds - 1):
        if not skipped:
            torque = made.step(-hold * MOVED, torque).torque
    if skipped:
        for _ in range(lost):
            made.sample_lost()
        made.note_skipped_syncs(float(holds - lost))
    return made.step(-(19 + holds) * MOVED, torque).torque


@pytest.mark.slow_but("guarded-*", "unprotected-damped-0", "internal_dissipation-*", "energy_tank-damped-1")
@pytest.mark.parametrize("lost", [0, 1])
@pytest.mark.parametrize("environment", [DAMPED, RELAXING], ids=["damped", "relaxing"])
@pytest.mark.parametrize("algorithm", algorithms())
def test_no_motion_is_taken_for_a_faster_one(algorithm, environment, lost):
    """Three sample times taken for one rendered three times the damper, and a medium that had not relaxed."""
    every, one = (torque_after(controller(algorithm, environment), 3, skipped=skipped, lost=lost) for skipped in (0, 1))
    assert one == pytest.approx(every, rel=0.15)


@pytest.mark.parametrize("parameters", [DamperVelocity(velocity="windowed"), None])
def test_a_windowed_velocity_is_the_mean_of_the_whole_hold(parameters):
    known = LoopProperties.model_validate({**dict(loop()), "encoder_count": 1e-6})
    made: Any = build_controller(DAMPED, "unprotected" if parameters else "guarded", parameters, known)
    torque = torque_after(made, 5, skipped=True)
    if parameters:
        assert torque == pytest.approx(6.0 * MOVED / 1e-3, rel=0.1)
    else:
        assert made._axis.window.velocity == pytest.approx(-MOVED / 1e-3)


def test_skips_before_the_first_sample_and_several_in_a_gap_are_counted():
    made = controller("unprotected", DAMPED)
    made.note_skipped_syncs(9.0)
    made.step(0.0, 0.0)
    assert made.step(-MOVED, 0.0).torque == pytest.approx(0.6, rel=0.01)
    made.note_skipped_syncs(3.0)
    made.sample_lost()
    made.note_skipped_syncs(2.0)
    assert made.step(-6.0 * MOVED, 0.6).torque == pytest.approx(0.6, rel=0.02)


def test_what_a_skip_inside_a_gap_leaves_open_is_taken_off():
    """A torque of 0.6 N, then one of 0: either may have acted while the SYNCs were skipped."""
    books = []
    for skipped in (0.0, 4.0):
        made = controller("unprotected", DAMPED)
        made.step(0.0, 0.0)
        made.step(-MOVED, 0.0)
        made.sample_lost()
        made.note_skipped_syncs(1.0 + skipped)
        books.append(made.step(-2.0 * MOVED, 0.0).h_i)
    assert books[1] < 5.0 * books[0] < 0.0
