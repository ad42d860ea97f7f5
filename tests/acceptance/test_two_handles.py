"""Two handles over one bus at 1 kHz, delay 1, one frame in a hundred lost: passive together, and no drift."""

from pathlib import Path

import numpy as np
import pytest

from canhaptic.logs.energy_reader import EnergyLog
from tests.acceptance.group_runs import identity, logged

STIFFNESS = 1000.0  # of the coupling in the scene [N/m]


def zero_force_extension(log: EnergyLog, seconds: float) -> float:
    """Returns the true extension at which the coupling was without force in the last seconds [m].

    Median of x + F / k: what the delay, the damper and a torque limited for a while add is of both signs. F is the
    stronger of the two torques; where frames may be lost, the one that gives energy out is limited first.
    """
    rows = slice(-round(seconds * 1000), None)
    extension = log.truth["first"]["position"] - log.truth["second"]["position"]
    first, second = (log.ports[name]["torque_applied"][rows] for name in ("first", "second"))
    stronger = np.where(np.abs(first) >= np.abs(second), first, -second)
    return float(np.median(extension[rows] + stronger / STIFFNESS))


def check_together(log: EnergyLog, lost: float) -> None:
    first, second, coupling = (log.ports[name] for name in ("first", "second", "coupling"))
    heard = (first["fresh"] & second["fresh"]).astype(bool)
    assert 1.0 - heard.mean() == pytest.approx(lost, rel=0.3)
    assert (-log.truth["coupling"]["motor"]).min() >= -1e-6
    assert identity(coupling).max() <= 1e-12
    extension = first["position"] - second["position"]
    follows = np.abs(coupling["state"] - extension)[1:]  # before the first hold the row is that of rest
    assert follows[heard[1:]].max() < 1e-12  # however often it was held
    assert abs(zero_force_extension(log, 1.5)) < 1e-4
    passed_on = [-float(log.truth[name]["motor"].min()) for name in ("first", "second")]
    assert max(passed_on) > 0.05  # energy does go from hand to hand


@pytest.mark.slow
def test_two_handles_are_passive_together_under_loss(tmp_path: Path) -> None:
    with logged("two_handles", 2100, tmp_path) as (experiment, log):
        assert experiment.scene.axes[0].loop.delay == 1
        assert experiment.faulty_buses
        check_together(log, 0.029)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize(("seed", "cycles"), [(7, 15_000), pytest.param(8, 60_000, marks=pytest.mark.campaign)])
def test_two_handles_have_not_drifted(seed: int, cycles: int, tmp_path: Path) -> None:
    with logged("two_handles", cycles, tmp_path, [f"simulation.seed={seed}"]) as (_, log):
        check_together(log, 0.029)
