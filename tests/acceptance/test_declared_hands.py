"""What rests on a declared hand keeps its promise; forms that leave a term out do not (a study, no controller)."""

import pytest

from tools.displays.declared_hands import SPRING_RIGS, MassRig, below, mass_energies, spring_energies


@pytest.mark.slow
def test_a_spring_behind_a_lagging_drive_takes_nothing_out() -> None:
    least, moves = spring_energies(SPRING_RIGS[1], 24, 3, seconds=0.1)
    assert below(least) == 0
    assert moves > 0.05
    simple, _ = spring_energies(SPRING_RIGS[1], 24, 3, seconds=0.1, simple=True)
    assert below(simple) >= 12


@pytest.mark.slow
def test_a_mass_takes_nothing_out_where_the_way_to_a_stop_stays_open() -> None:
    least, moves = mass_energies(MassRig(), 60, 4, seconds=0.2)
    assert below(least) == 0
    assert moves > 0.3
    short, _ = mass_energies(MassRig(), 60, 4, seconds=0.2, brakes=False)
    assert below(short) >= 9
