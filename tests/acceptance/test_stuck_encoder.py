"""TPDOs that say the same for long: it may be a handle held still, so the run goes on, and the energy log notes it."""

from pathlib import Path

import can
import pytest

from canhaptic.cycle import run
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from tests.drive.drive_bench import TamperedBus

DEMO = Path(__file__).resolve().parents[2] / "configs" / "demo.yaml"
IN_THE_WALL = ["environment.position=0.05 m"]  # from the first contact of the hand on


def events(folder: Path, *, frozen: bool) -> list[tuple[str, str]]:
    """What the energy log notes of a run of 4 s in whose last 3 the position may stay at one value."""
    kept: list[bytes] = []
    syncs = 0

    def freeze(message: can.Message) -> can.Message:
        nonlocal syncs
        if message.arbitration_id == 0x080:
            syncs += 1
        if message.arbitration_id == 0x181 and syncs > 1500:
            kept.append(bytes(message.data))
            message.data[2:6] = kept[0][2:6]  # the position
        return message

    with build(load_scene(DEMO, IN_THE_WALL), "free", folder / "run.h5") as experiment:
        link = experiment.rig.drives[0].link
        bus = link._bus = TamperedBus(link._bus)
        bus.on_send = freeze
        bus.on_receive = freeze if frozen else bus.on_receive
        run(experiment.cycle, 4000)
    with EnergyLog.open(folder / "run.h5") as log:
        return [(event.kind, event.port) for event in log.events if event.kind == "unchanged"]


@pytest.mark.slow
def test_a_position_that_stays_with_a_torque_is_noted_once(tmp_path: Path) -> None:
    assert events(tmp_path, frozen=True) == [("unchanged", "handle")]


@pytest.mark.slow
def test_a_hand_that_moves_is_not(tmp_path: Path) -> None:
    assert events(tmp_path, frozen=False) == []
