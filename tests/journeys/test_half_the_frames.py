"""Half the frames are gone: a person reads why the run ended, and finds no way to go on with a useless account."""

import pytest

from canhaptic.logs.energy_reader import EnergyLog
from tests.journeys.person import CONFIGS, Person

DEMO = str(CONFIGS / "demo.yaml")
HALF = (
    *("--set", "simulation.bus={drop: 0.5, ids: [0x181]}", "--set", "simulation.user.rest=-0.2 m"),
    *("--set", "environment.stiffness=800 N/m", "--set", "simulation.user.motion.frequency=2 Hz"),
)


@pytest.mark.slow
def test_half_the_frames_are_gone(person: Person) -> None:
    shown = person.types("run", DEMO, *HALF, "--pace", "free", "--log", "run.h5", status=3)
    assert "% of SYNCs answered" in shown
    assert "FAILED" in shown
    assert "[FRAMES_LOST]" in person.errors
    assert "bus.loss_limit" in person.errors
    with EnergyLog.open(person.folder / "run.h5") as log:
        [share] = [event.text for event in log.events if event.kind == "link"]
        assert log.status.startswith("failed")
        assert log.rows < 300
        assert not log.ports["handle"].read("torque_command", log.rows - 1, log.rows)[0]
    assert share.split()[0] in person.types("inspect", "run.h5", status=1)

    person.types("run", DEMO, *HALF, "--pace", "free", "--set", "bus.loss_limit=1", "--duration", "4", status=3)
    assert "[ENERGY_UNCERTAIN]" in person.errors  # what was turned off by hand is found by the account
    assert "energy_uncertainty_limit" in person.errors

    port = person.runs_one(DEMO, "--duration", "1", *HALF[2:], "--set", "simulation.bus={drop: 0.01, ids: [0x181]}")
    assert port["passive"] in ("yes", "in doubt")  # the remedy: the cable
