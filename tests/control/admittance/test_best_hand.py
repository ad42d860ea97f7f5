"""The best hand without feedback against an admittance display: it finds a guard that was given 0.7 of the mass."""

from dataclasses import replace

import numpy as np
import pytest

from tools.displays.best_hand import AttackedRig, attacked, best_hands, random_attacked_rig, with_true_acceleration

_ROUNDING = 1e-9  # [J]


def _hand(rig: AttackedRig, holds: int) -> tuple[float, np.ndarray]:
    energies, forces = best_hands(rig, holds)
    return float(energies[0]), forces[:, 0]


@pytest.mark.parametrize("delay", [0, 2])
def test_the_closed_form_is_the_energy_that_an_unhindered_hand_gets_out(delay: int) -> None:
    rig = AttackedRig(bandwidth=5.0, delay=delay, share=0.7)
    rig = replace(rig, asked=1.2 * rig.lightest)
    energy, hand = _hand(rig, 40)
    found = with_true_acceleration(rig, hand)
    assert found is not None
    assert found.cut == 0
    assert energy < -1e-7
    assert found.least == pytest.approx(energy, rel=1e-6)


def test_no_hand_gets_energy_out_of_a_mass_that_the_drive_carries_safely() -> None:
    rig = AttackedRig(delay=0)
    assert _hand(replace(rig, asked=2.0 * rig.lightest), 60)[0] > 0.0
    assert _hand(replace(rig, asked=0.7 * rig.lightest), 60)[0] < 0.0


def test_a_guard_with_seven_tenths_of_the_mass_is_found_and_the_true_one_is_not() -> None:
    found = attacked(AttackedRig(share=0.7), (40,))
    assert found is not None
    assert found[0] < -1e-4
    assert found[1] >= -_ROUNDING


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_it_is_found_on_every_rig_on_which_the_best_hand_gets_energy_out() -> None:
    exposed = 0
    for seed in range(24):
        found = attacked(random_attacked_rig(seed, 0.7))
        if found is not None:
            assert found[0] < -_ROUNDING, seed
            assert found[1] >= -_ROUNDING, seed
            exposed += 1
    assert exposed > 20
