"""Wireshark as an independent judge of the frames; skips, visibly, where tshark is not installed (Debian: tshark)."""

import re
import shutil
import subprocess
from collections import Counter
from pathlib import Path

import pytest

from canhaptic.cli.main import main
from canhaptic.logs.bus_reader import convert, read_bus_log
from canhaptic.logs.decoder import BusDecoder

DEMO = Path(__file__).parents[2] / "configs" / "demo.yaml"
KINDS = (  # how Wireshark begins its words, and how we do
    ("NMT Error Control", "heartbeat"),
    ("NMT", "NMT"),
    ("SYNC", "SYNC"),
    ("Default-SDO", "SDO"),
    ("PDO1 (rx)", "RPDO1"),
    ("PDO1 (tx)", "TPDO1"),
    ("EMCY", "EMCY"),
)


def tshark(path: Path, *words: str) -> list[str]:
    program = shutil.which("tshark")
    if program is None:
        pytest.skip("tshark is not installed (apt-get install tshark)")
    command = [program, "-r", str(path), "-d", "can.subdissector,canopen", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def our_kinds(path: Path) -> list[str]:
    decoder = BusDecoder()
    return [decoder.decode(frame.can_id, frame.data).kind for frame in read_bus_log(path)]


def wireshark_kinds(path: Path) -> list[str]:
    found = []
    for line in tshark(path, "-T", "fields", "-e", "_ws.col.Info"):
        found.append(next((ours for theirs, ours in KINDS if line.startswith(theirs)), line))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".log", ".blf"])
def test_wireshark_finds_no_malformed_frame_in_the_demo_and_names_each_as_we_do(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"demo{suffix}"
    assert main(["run", str(DEMO), "--pace", "free", "--duration", "2", "--bus-log", str(path), "--json"]) == 0
    kinds = our_kinds(path)
    if suffix == ".log":  # Wireshark reads candump text without the direction at the end of each line
        path.write_text(re.sub(r" [TR]$", "", path.read_text(), flags=re.MULTILINE))
    assert tshark(path, "-Y", "_ws.malformed") == []
    # 0x100C and 0x60B2, which the start asks for and few drives have
    assert len(tshark(path, "-Y", "canopen.sdo.abort_code")) == 2
    assert wireshark_kinds(path) == kinds
    assert Counter(kinds)["TPDO1"] >= 2000
    assert Counter(kinds)["SDO"] > 100


@pytest.mark.slow
def test_wireshark_reads_the_emergency_that_we_read(tmp_path: Path) -> None:
    recording = DEMO.parents[1] / "tests" / "recordings" / "emergency.log"
    path = tmp_path / "emergency.blf"
    convert(recording, path)
    fields = ["-T", "fields", "-e", "canopen.em.err_code", "-e", "canopen.em.err_reg"]
    (line, *_) = tshark(path, "-Y", "can.id == 0x81", *fields)
    assert line.split() == ["0x5000", "0x01"]
    assert wireshark_kinds(path) == our_kinds(path)
