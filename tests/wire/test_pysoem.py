"""The simulated drives judged by a foreign master on a wire, and the scene run by it."""

import json
import re
import signal
import struct
import subprocess
from collections.abc import Iterator, Sequence

import pytest

from canhaptic.commission.sequence import commission
from canhaptic.commission.session import CommissioningLimits, Session, Unattended
from canhaptic.cycle import run
from canhaptic.errors import LinkError, RigError
from canhaptic.host import capabilities
from canhaptic.scene.build import Experiment, build
from canhaptic.scene.load import load_scene
from tests.wire.far_end import Watch
from tests.wire.veth import REALTIME, SCENE, FarEnd, command, require, sets, veth, wait

pytestmark = pytest.mark.slow


@pytest.fixture
def ends() -> Iterator[tuple[str, str]]:
    require("pysoem")
    with veth() as both:
        yield both


def on(interface: str, *overrides: str) -> Experiment:
    return build(load_scene(SCENE, [f"bus.interface={interface}", *REALTIME, *overrides]))


@pytest.mark.parametrize("assign_activate", [0x0300, 0x0700])
def test_pysoem_leaves_the_same_writes_and_registers_as_the_thin_master(
    ends: tuple[str, str], assign_activate: int
) -> None:
    given = f"bus.assign_activate={assign_activate}"
    with FarEnd(ends[1]) as far, on(ends[0], given) as experiment:
        experiment.rig.start()
        [seen] = far.ask()
        experiment.rig.stop()
        [after] = far.ask()
    with build(load_scene(SCENE, [given]), "free") as thin:
        assert thin.far_side is not None
        watch = Watch(thin.far_side.drives[0])  # type: ignore[arg-type]
        thin.rig.start()
        expected = watch.state()
        thin.rig.stop()
    assert [list(write) for write in watch.writes] == after["writes"]
    assert len(after["writes"]) > len(seen["writes"]) > 10
    assert expected["registers"] == seen["registers"]
    assert seen["registers"]["assign_activate"] == struct.pack("<H", assign_activate).hex()
    assert (seen["al_state"], seen["state"]) == (8, "OPERATION_ENABLED")
    assert (after["al_state"], after["torque"], after["registers"]["assign_activate"]) == (2, 0.0, "0000")


def test_a_scene_runs_from_start_to_an_account(ends: tuple[str, str]) -> None:
    with FarEnd(ends[1]) as far:
        words = command("run", str(SCENE), "--json", "--duration", "2", *sets(f"bus.interface={ends[0]}", *REALTIME))
        done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
        [seen] = far.ask()
    account = json.loads(done.stdout)
    assert (done.returncode, account["status"], account["cycles"]) == (0, "completed", 2000)
    assert seen["torques"] > 100  # the wall was rendered
    assert (seen["al_state"], seen["torque"]) == (2, 0.0)
    assert account["ports"]["handle"]["verdict"] != "no"


@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGKILL])
def test_the_torque_is_zero_within_the_watchdog_however_the_master_ends(
    ends: tuple[str, str], sent: signal.Signals
) -> None:
    with FarEnd(ends[1]) as far:
        words = command("run", str(SCENE), *sets(f"bus.interface={ends[0]}", *REALTIME, "bus.watchdog=20 ms"))
        master = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            for _ in range(400):
                wait(0.05)
                if far.ask()[0]["torque"]:
                    break
            master.send_signal(sent)
            master.wait(timeout=20)
            wait(0.1)
            [seen] = far.ask()
        finally:
            master.kill()
            master.wait()
    assert seen["torques"] > 0
    assert seen["torque"] == 0.0
    if sent is signal.SIGKILL:
        assert seen["silence"] == 20_000_000
        assert (seen["al_state"], seen["al_code"]) == (4, 0x1B)
    else:
        assert seen["silence"] < 20_000_000
        assert seen["al_state"] == 2


def test_an_emergency_ends_the_run_and_is_named(ends: tuple[str, str]) -> None:
    with FarEnd(ends[1]) as far, on(ends[0]) as experiment:
        experiment.rig.start()
        far.ask("fault 0x7305")
        with pytest.raises(RigError, match=r"0x7305|FAULT"):
            run(experiment.cycle, 500)
        assert far.ask()[0]["torque"] == 0.0


def test_the_capabilities_are_lowered_once_the_interface_is_open(ends: tuple[str, str]) -> None:
    with on(ends[0]):
        assert capabilities.effective() == frozenset()
    with on(ends[0]):  # and it can be opened again
        assert capabilities.permitted() == {"CAP_NET_RAW", "CAP_NET_ADMIN"}


def test_a_wire_without_drives_is_named(ends: tuple[str, str]) -> None:
    with on(ends[0]) as experiment, pytest.raises(RigError, match="presence: got 0 drives on the line"):
        experiment.rig.start()


def test_an_interface_that_cannot_be_opened_is_named(ends: tuple[str, str]) -> None:
    with pytest.raises(LinkError, match=re.escape("bus.interface 'nothing0': got no such interface, expected one of")):
        on("nothing0")


class _Person(Unattended):
    """Knows the inertia of the handle, and does not measure how far it moved."""

    def number(self, question: str, unit: str, truth: float | None) -> float | None:
        return 0.001 if "moving mass" in question else 0.05 if "from both ends" in question else None

    def choose(self, question: str, answers: Sequence[str], truth: str) -> str:
        return "mass"


@pytest.mark.parametrize("scale", [1.0, 0.8])
def test_commission_finds_hold_scale_watchdog_and_phase_on_a_wire(ends: tuple[str, str], scale: float) -> None:
    line = ("simulation.user=null", "bus.rate=250", "bus.watchdog=40 ms")  # a rate that a loaded computer keeps
    drive = (
        f"simulation.drive.rated_torque={1.27 * scale}",
        f"simulation.drive.rated_torque_resolution={1e-3 * scale}",
    )
    scene = load_scene(SCENE, [f"bus.interface={ends[0]}", *REALTIME, *line])
    with FarEnd(ends[1], SCENE, *line, *drive) as far:
        session = Session(scene, _Person(lambda _: None), CommissioningLimits(), lambda: False)
        commission(session, 0.5)
        [seen] = far.ask()
    rows = {found.item: (found.verdict.value, found.found) for found in session.report.findings}
    assert (seen["al_state"], seen["torque"]) == (2, 0.0)
    assert rows["torque sign"][0] == "agrees"
    assert float(rows["torque scale"][1]) == pytest.approx(scale, rel=0.02)
    assert rows["torque scale"][0] == ("agrees" if scale == 1.0 else "differs")
    assert rows["watchdog"] == ("agrees", "FAULT")
    assert rows["phase of the frames"][0] == "agrees"
    if scale == 1.0:
        assert rows["command to motion"][0] == "agrees"
        assert rows["command to motion"][1].startswith("1 SYNC")
        assert rows["moving mass"][0] == "agrees"
