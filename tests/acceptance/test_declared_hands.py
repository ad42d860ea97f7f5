"""What rests on a declared hand keeps its promise; forms that leave a term out do not (a study, no controller)."""

import pytest

from tools.displays.declared_hands import SPRING_RIGS, MassRig, SpringRig, below, mass_energies, spring_energies

CAMPAIGN = (pytest.mark.campaign, pytest.mark.timeout(1800))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rig", "hands", "seconds", "by_simple"),
    [(SPRING_RIGS[1], 24, 0.1, 12), *(pytest.param(rig, 120, 1.5, 100, marks=CAMPAIGN) for rig in SPRING_RIGS)],
)
def test_a_spring_behind_a_lagging_drive_takes_nothing_out(
    rig: SpringRig, hands: int, seconds: float, by_simple: int
) -> None:
    least, moves = spring_energies(rig, hands, 3, seconds=seconds)
    assert below(least) == 0
    assert moves > 0.05
    simple, _ = spring_energies(rig, hands, 3, seconds=seconds, simple=True)
    assert below(simple) >= by_simple


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ramp", "hands", "seconds", "by_short"),
    [(MassRig().ramp, 60, 0.2, 9), *(pytest.param(ramp, 1000, 0.5, 50, marks=CAMPAIGN) for ramp in (3.0, 10.0, 30.0))],
)
def test_a_mass_takes_nothing_out_where_the_way_to_a_stop_stays_open(
    ramp: float, hands: int, seconds: float, by_short: int
) -> None:
    least, moves = mass_energies(MassRig(ramp=ramp), hands, 4, seconds=seconds)
    assert below(least) == 0
    assert moves > 0.3
    short, _ = mass_energies(MassRig(ramp=ramp), hands, 4, seconds=seconds, brakes=False)
    assert below(short) >= by_short
