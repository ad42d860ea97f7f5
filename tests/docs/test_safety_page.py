"""What the page on safety says of a host that stalls is so."""

import pytest

from canhaptic.cycle import run
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from tests.docs.documents import ROOT

STALLED = [
    "bus.rate=250",
    "bus.heartbeat_timeout=1",
    "bus.stop_cycles=5000",  # and no end of the run, which is for the rig and not for the account
    "axes.0.energy_loss_limit=none",
    "axes.0.speed_limit=100 m/s",
    "passivity.hand_push=0",  # and with it all the torque that sticks
    "simulation.bus={stall: [{begin: 1.15, duration: 0.06, every: 0.0713}]}",  # up to 15 SYNCs in a row
]


def stalled_run(max_consecutive_losses: int) -> tuple[float, float, int]:
    """Returns the least energy believed and true [J], and the SYNCs skipped."""
    scene = load_scene(
        ROOT / "configs" / "demo.yaml", [*STALLED, f"passivity.max_consecutive_losses={max_consecutive_losses}"]
    )
    with build(scene) as experiment:
        run(experiment.cycle, cycles=600)
        account = experiment.cycle.ledgers[0].summary()
        return account.least_interaction, experiment.cycle.judge.least[0], experiment.rig.skipped_syncs


def test_holds_longer_than_certified_give_energy_out_and_the_account_says_so() -> None:
    accounted, true, skipped = stalled_run(max_consecutive_losses=0)
    assert skipped > 200
    assert true < -1e-3
    assert abs(accounted - true) < 1e-4


@pytest.mark.slow
def test_lost_frames_help_against_stalls() -> None:
    accounted, true, skipped = stalled_run(max_consecutive_losses=16)
    assert skipped > 200
    assert 0.2 * stalled_run(max_consecutive_losses=0)[1] < true
    assert abs(accounted - true) < 1e-4
