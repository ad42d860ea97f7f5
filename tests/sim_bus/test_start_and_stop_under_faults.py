"""A start survives lost SDO answers while the drive's watchdog of the master runs; a stop outlives a short bus-off."""

from pathlib import Path

import pytest

from canhaptic.canopen.objects import NmtState
from canhaptic.cycle import run
from canhaptic.errors import LinkError
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from canhaptic.sim.drive.profile.state_machine import DriveState

DEMO = Path(__file__).resolve().parents[2] / "configs" / "demo.yaml"


@pytest.mark.slow_but("0", "18")
@pytest.mark.parametrize("seed", range(25))
def test_a_lost_sdo_answer_during_the_start_is_asked_for_again_before_the_watchdog_bites(seed: int) -> None:
    scene = load_scene(DEMO, ["simulation.bus.drop=0.02", "simulation.bus.bring_up=true", f"simulation.seed={seed}"])
    with build(scene, "free") as experiment:
        experiment.rig.start()
        assert experiment.rig.is_running
        experiment.rig.stop(ramp=False)


def test_when_a_bus_comes_back_soon_the_stop_still_takes_the_torque_away_at_once() -> None:
    scene = load_scene(DEMO, ["environment.position=0.0", "simulation.bus={bus_off: [{begin: 0.2, duration: 0.05}]}"])
    with build(scene, "free") as experiment:
        with pytest.raises(LinkError):
            run(experiment.cycle, 2000)
        assert experiment.far_side is not None
        [drive] = experiment.far_side.drives
        assert drive.torque == 0.0
        assert drive.state is not DriveState.OPERATION_ENABLED
        assert drive.nmt_state == NmtState.PRE_OPERATIONAL
        # its own watchdog would have taken 100 ms; the master was there as soon as the bus was
        assert experiment.clock.now() < 700_000_000
