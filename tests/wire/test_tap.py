"""The bus log of a run on a wire: every frame is in it, and Wireshark finds nothing malformed."""

import shutil
import subprocess
from pathlib import Path

import pytest

from canhaptic.cycle import run
from canhaptic.logs.ethercat_frames import command_name, datagrams_of, read_capture
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from tests.wire.veth import REALTIME, SCENE, FarEnd, require, veth

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    require("pysoem")
    path = tmp_path_factory.mktemp("tap") / "run.pcap"
    with veth() as ends, FarEnd(ends[1]):
        with build(load_scene(SCENE, [f"bus.interface={ends[0]}", *REALTIME]), bus_log=path) as experiment:
            run(experiment.cycle, 500)
        assert experiment.tap is not None
        assert (experiment.tap.dropped, experiment.tap.frames > 4000) == (0, True)
    return path


def test_every_frame_decodes_and_the_frames_of_the_cycle_have_their_counter(log: Path) -> None:
    frames = [datagrams_of(content) for _, content in read_capture(log)]
    assert None not in frames
    cyclic = [frame for frame in frames if frame and command_name(frame[0].command) == "LRW"]
    assert len(cyclic) > 2000
    assert sum(frame[0].counter == 3 for frame in cyclic) >= 2 * 490  # answers in SAFE-OP and OP; 0 while it locks


def test_wireshark_finds_nothing_malformed(log: Path) -> None:
    if (program := shutil.which("tshark")) is None:
        pytest.skip("tshark is not installed (apt-get install tshark)")
    words = [program, "-r", str(log), "-Y", "_ws.malformed"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout == ""
    seen = subprocess.run(
        [program, "-r", str(log), "-Y", "ecat"], capture_output=True, text=True, timeout=120, check=True
    )
    assert len(seen.stdout.splitlines()) == len(read_capture(log))
