"""The guard with a hand declared as spring, damper and mass, against such hands (AD9 with a controller)."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from canhaptic.control.admittance.declared_hand import DeclaredHand, HeardForce
from canhaptic.control.admittance.margins import ByDeclaredHand
from canhaptic.control.admittance.port import AdmittanceProperties
from canhaptic.control.admittance.velocity_loop import GuardedAdmittanceParameters, loop_settings
from canhaptic.errors import ParameterError
from tools.displays.declared_loop import DeclaredOutcome, DeclaredRig, _follow, _Hold, random_rig, with_true_bounds
from tools.displays.judge import false_claims
from tools.displays.random_display import random_display
from tools.displays.random_display import with_true_bounds as with_true_display

_LIGHT = DeclaredRig(virtual_mass=0.1, stiffness=1000.0, speed=0.3, damping=1.0, mass=0.05, seed=1)


@pytest.mark.slow_but("1-0")
@pytest.mark.parametrize("batch", range(4))
@pytest.mark.parametrize("axes", [1, 2])
def test_no_hand_as_declared_gets_more_than_it_gave(axes: int, batch: int) -> None:
    used = 0
    for seed in range(5 * batch, 5 * batch + 5):
        found = with_true_bounds(replace(random_rig(seed), axes=axes), 0.3)
        if found is not None:
            assert found[1].least >= -found[0].allowance - 1e-9, seed
            used += found[1].by_hand
    assert used > 50


@pytest.mark.slow_but("5-1")
@pytest.mark.parametrize(("seed", "axes"), [(5, 1), (34, 1), (5, 2)])
def test_a_hand_stiffer_than_declared_takes_more_than_it_gave(seed: int, axes: int) -> None:
    rig = replace(random_rig(seed), axes=axes)
    found = with_true_bounds(replace(rig, share=0.2), 0.4)
    assert found is not None
    assert found[1].least < -rig.allowance - 1e-4


@pytest.mark.slow
def test_a_mass_much_lighter_than_the_drive_is_carried() -> None:
    found = with_true_bounds(_LIGHT, 0.6)
    assert found is not None
    rig, outcome = found
    assert outcome.by_hand > 0.8 * outcome.moving
    assert outcome.least >= -rig.allowance
    assert outcome.travel > 0.03


def _known(**declared: float | None) -> tuple[GuardedAdmittanceParameters, AdmittanceProperties]:
    properties = AdmittanceProperties(
        sample_time=1e-3, delay=1, sampling="mean", force_slew=1e3, handle_acceleration=10.0, speed_limit=2.0,
        acceleration_limit=500.0,
    )  # fmt: skip
    given = {
        "drive_mass": 2.0,
        "loop_gain": 628.0,
        "spread": 0.0,
        "hand_stiffness": 1000.0,
        "drive_friction": 0.0,
        **declared,
    }
    return GuardedAdmittanceParameters.model_validate(given), properties


def _worst(speed: float, **declared: float) -> tuple[float, float]:
    """Returns what one command for one hold costs by the formula, and what the worst hand known takes of it [J]."""
    known, properties = _known(**declared)
    still = DeclaredHand(known, loop_settings(known, properties), properties)
    still.up = still.down = still.up_with_mass = still.down_with_mass = 0.0
    said = still.loss([0.0] * 4, 0, speed)
    rig = DeclaredRig(
        moved=2.0, bandwidth=628.0 / (2.0 * math.pi * 2.0), stiffness=known.hand_stiffness,
        speed=known.hand_speed, mass=known.hand_mass, damping=known.hand_damping,
    )  # fmt: skip
    half, energy, least = _Hold(rig, 0.5 * rig.time / 10), 0.0, 0.0
    state = half.matrix[0] * 0.0
    for hold in range(40):
        state[5] = speed if hold == still.holds else 0.0
        if hold == still.holds and known.hand_damping == 0.0:
            state[3] = -known.hand_speed  # the far side draws away as the motion begins
        gained = _follow(half, state, DeclaredOutcome())
        least, energy = min(least, energy + float(gained.min())), energy + float(gained[-1])
    return said, -least


@pytest.mark.parametrize(
    ("declared", "share"),
    [
        ({"hand_stiffness": 100.0}, 0.98),
        ({}, 0.9),
        ({"hand_speed": 0.02}, 0.8),
        ({"hand_damping": 2.0}, 0.7),
        ({"hand_mass": 0.05}, 0.7),
        ({"hand_mass": 0.3}, 0.5),
    ],
)
def test_what_a_command_costs_is_what_a_hand_can_take_and_little_more(declared: dict[str, float], share: float) -> None:
    said, taken = _worst(0.3, **declared)
    assert share * said <= taken <= said + 1e-12


def test_commands_are_followed_as_a_loop_of_first_order_follows() -> None:
    known, properties = _known()
    hand = DeclaredHand(known, loop_settings(known, properties), properties)
    for _ in range(10):
        hand.go_on(0.5)
    assert hand.speed == pytest.approx(0.5 * (1.0 - math.exp(-10e-3 * 628.0 / 2.0)))
    assert hand.speeds == [hand.speed]


def test_the_lightest_mass_is_that_of_the_spring_for_a_hand_at_rest() -> None:
    """K_e (nT + aT + l)^2, and little more for what the drive yields."""
    known, properties = _known()
    way = 2.0 / 628.0 + 2e-3
    carried = DeclaredHand(known, loop_settings(known, properties), properties).lightest(0.5)
    assert 1.0 <= carried / (1000.0 * way * way) < 1.1


@pytest.mark.slow
def test_random_displays_use_it_and_claim_nothing_false() -> None:
    used = 0
    for seed in (1012, 1024):
        judged = with_true_display(random_display(seed, "guarded"), 250)
        if judged is not None:
            assert not false_claims(*judged), seed
            used += judged[1].by_declared
    assert used > 0


@pytest.mark.parametrize(
    ("declared", "jitter", "words"),
    [
        ({"hand_stiffness": 0.0, "hand_mass": 1.0}, 0.0, "hand_mass: got 1, expected 0 without hand_stiffness"),
        ({"max_consecutive_losses": 1}, 0.0, "max_consecutive_losses: got 1, expected 0 with hand_stiffness"),
        ({"integral_gain": 10.0}, 0.0, "hand_stiffness: got 1000.0, expected 0 with an integral_gain"),
        ({"drive_friction": None}, 0.0, "drive_friction: got none with hand_stiffness"),
        ({}, 0.05, "sync_jitter: got 0.05, expected 0 with hand_stiffness"),
    ],
)
def test_what_contradicts_the_proof_is_refused(declared: dict[str, float | None], jitter: float, words: str) -> None:
    known, properties = _known(**declared)
    with pytest.raises(ParameterError, match=words):
        loop_settings(known, properties.model_copy(update={"jitter": jitter}))


def heard(moved: float, force: float) -> HeardForce:
    return HeardForce(moved, 0.02, force, 0.0, at_limit=False)


def test_the_least_force_of_a_hand_is_less_by_the_error_of_the_sensor_in_either_direction() -> None:
    known, properties = _known()
    found = []
    for error in (0.0, 0.25):
        given = properties.model_copy(update={"force_error": error})
        hand = DeclaredHand(known, loop_settings(known, given), given)
        for _ in range(3):
            hand.go_on(0.02)
            hand.hear(heard(2e-5, 4.0))
        assert hand.up <= 4.0 - error
        assert hand.down <= -4.0 - error
        found.append((hand.up, hand.down))
    assert [exact - wrong for exact, wrong in zip(*found, strict=True)] == pytest.approx([0.25, 0.25])


def test_behind_a_filter_a_hold_proves_no_gain_of_the_margin() -> None:
    """What is known there is the energy less what the drive stores at most."""
    known, properties = _known()
    margins = []
    for filtered in (0.0, 100.0):
        given = properties.model_copy(update={"filter": filtered, "force_error": 0.0})
        axis: Any = SimpleNamespace(declared=DeclaredHand(known, loop_settings(known, given), given))
        margin = ByDeclaredHand([axis])
        for k in range(5):
            axis.declared.go_on(0.02)
            margin.hear(1e-3 * (k < 1), [heard(2e-5, 4.0)])
        margins.append(margin.known)
    assert margins[0] > 0.0 > margins[1]
