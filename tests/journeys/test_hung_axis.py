"""An axis that hangs from its brake: started, stopped, and left alone by a computer that stands still for a while."""

import signal
import threading

import pytest

from canhaptic.logs.energy_reader import EnergyLog
from tests.acceptance.two_processes import canhaptic, pushed, shared_bus
from tests.journeys.person import CONFIGS, Person

__all__ = ["shared_bus"]  # a fixture

DEMO = str(CONFIGS / "demo.yaml")
WEIGHT = ("--set", "simulation.user={push: -5 N}")
BRAKE = "axes.0.brake={release_time: 30 ms, set_time: 50 ms"


@pytest.mark.slow
def test_a_hung_axis_is_held_by_a_stop_until_its_brake_holds_and_check_says_where_it_would_sink(person: Person) -> None:
    forgotten = person.types("check", DEMO, "--full", "--set", f"{BRAKE}}}", status=None)
    assert "declare brake.holds_weight" in " ".join(forgotten.split())
    brake = ("--set", f"{BRAKE}, holds_weight: 5 N}}")
    assert "declare brake.holds_weight" not in person.types("check", DEMO, "--full", *brake, status=None)
    port = person.runs_one(DEMO, *brake, *WEIGHT, "--duration", "1.2", "--log", "run.h5")
    assert port["passive"] == "yes"
    with EnergyLog.open(person.folder / "run.h5") as log:
        [begin] = [event.sync_index for event in log.events if event.kind == "stopping"]
        position = log.ports["handle"].read("position", begin, log.rows)
        torque = log.ports["handle"].read("torque_command", begin, log.rows)
    assert list(torque[:50]) == [5.0] * 50
    assert torque[-1] == 0.0
    assert max(position) - min(position) < 2e-3  # it is at rest on a soft wall, and goes on as it moved
    person.types("inspect", "run.h5")


@pytest.mark.slow
def test_a_hung_axis_does_not_fall_while_its_computer_stands_still_and_the_run_says_so_afterwards(shared_bus, tmp_path):
    """SIGSTOP and SIGCONT: the drive's own watchdog takes the torque away and sets the brake meanwhile."""
    listener, on_bus = shared_bus
    words = [*on_bus, "--set", f"{BRAKE}, holds_weight: 5 N}}", *WEIGHT]
    with canhaptic("drive", DEMO, *words):
        listener.wait_for(lambda frame: frame.can_id == 0x701 and frame.data == b"\0")
        log = tmp_path / "run.h5"
        with canhaptic("run", DEMO, *words, "--pace", "real", "--duration", "60", "--log", str(log)) as master:
            listener.wait_for(pushed)
            master.send_signal(signal.SIGSTOP)
            listener.wait_for(lambda frame: frame.can_id == 0x081 and frame.data[:2] == bytes.fromhex("30 81"))
            threading.Event().wait(0.5)  # until the brake holds
            held = listener.upload(0x6064)
            assert not listener.upload(0x6074)
            assert listener.upload(0x6041) & 0x6F != 0x27
            threading.Event().wait(1.0)
            assert listener.upload(0x6064) == held
            begin = len(listener.frames)
            master.send_signal(signal.SIGCONT)
            while master.poll() is None:
                listener.hear(0.02)
            assert master.returncode == 3
            assert master.stderr is not None
            said = master.stderr.read()
        assert "[SYNCS_SKIPPED]" in said or "[SECOND_MASTER]" in said  # who asked the drive meanwhile is heard too
        after = [frame for frame in listener.frames[begin:] if frame.can_id == 0x201]
        assert not any(frame.data[2:4] != b"\0\0" for frame in after)
        assert listener.upload(0x6064) == held
    with EnergyLog.open(log) as kept:
        assert kept.status.startswith("failed")
