"""The account of a run on an EtherCAT line, derived again from the capture of its frames."""

import json
import struct
from pathlib import Path
from typing import Any

import pytest
import yaml

from canhaptic.cli.main import main
from canhaptic.errors import InputError, LogFormatError
from canhaptic.logs.ethercat_frames import datagrams_of, read_capture
from tests.view import typed
from tools.on_ethercat import on_ethercat

CONFIGS = Path(__file__).parents[2] / "configs"
SCENE = CONFIGS / "ethercat.yaml"
FAULTS = "simulation.bus={drift: 40 ppm, late: 0.02, lost: 0.02, answer_lost: 0.02, low_counter: 0.02}"


def recorded(folder: Path, scene: Path = SCENE, duration: str = "1.3", *overrides: str) -> tuple[Path, Path]:
    energy, bus = folder / "run.h5", folder / "run.pcap"
    words = ["run", str(scene), "--duration", duration, "--pace", "free", "--log", str(energy), "--bus-log", str(bus)]
    assert main([*words, "--json", *(word for of in overrides for word in ("--set", of))]) == 0
    return energy, bus


def records_of(bus: Path) -> list[bytes]:
    """Records of a capture, each with its head."""
    content, at, found = bus.read_bytes(), 24, []
    while at < len(content):
        size = 16 + struct.unpack_from("<IIII", content, at)[2]
        found.append(content[at : at + size])
        at += size
    return found


def with_records(bus: Path, records: list[bytes]) -> Path:
    changed = bus.with_name("changed.pcap")
    changed.write_bytes(bus.read_bytes()[:24] + b"".join(records))
    return changed


def reads_of(records: list[bytes], command: int = 10) -> list[int]:
    """Places of the answers to the frames of the cycle with this command, in a capture of the thin master."""
    return [n for n, of in enumerate(records) if of[22] & 2 and len(of) > 66 and of[66] == command]


def rederived(energy: Path, bus: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    capsys.readouterr()
    status = typed.inspect(energy, "--bus-log", bus, "--json")
    found: dict[str, Any] = json.loads(capsys.readouterr().out)["rederived"]
    assert status == (1 if found["differences"] or found["damage"] else 0)
    return found


def test_a_capture_alone_gives_the_logged_account_bit_for_bit_and_a_flipped_bit_is_named(tmp_path, capsys) -> None:
    energy, bus = recorded(tmp_path, SCENE, "0.06", "bus.rate=200", "bus.watchdog=50 ms")
    found = rederived(energy, bus, capsys)
    assert (found["cycles"], found["differences"], found["remarks"]) == (12, [], [])
    records = records_of(bus)
    chosen = reads_of(records)[-9]  # 2 cycles of the stop and 2 that disable come after it
    records[chosen] = records[chosen][:78] + bytes([records[chosen][78] ^ 1]) + records[chosen][79:]
    [first, *_] = rederived(energy, with_records(bus, records), capsys)["differences"]
    assert (first["quantity"], first["port"]) == ("position", "handle")


@pytest.mark.slow
@pytest.mark.parametrize(
    "override", [FAULTS, "bus.frames=1", "axes.0.read_back=actual", "axes.0.demand_reported=after"]
)
def test_the_account_is_derived_whatever_the_line_loses_and_the_drive_reports(override: str, tmp_path, capsys) -> None:
    energy, bus = recorded(tmp_path, SCENE, "1.5", override, "bus.loss_limit=0.5")
    found = rederived(energy, bus, capsys)
    assert (found["differences"], found["damage"]) == ([], [])
    assert 1500 <= found["cycles"] <= 1510  # the stop leaves the wall
    assert bool(found["remarks"]) is (override == FAULTS)  # answers that did not come, and low counters


@pytest.mark.slow
@pytest.mark.parametrize("name", ["xy_box.yaml", "admittance/wall.yaml"])
def test_the_account_of_a_group_and_of_a_display_is_derived(name: str, tmp_path, capsys) -> None:
    scene = tmp_path / "line.yaml"
    scene.write_text(yaml.safe_dump(on_ethercat(yaml.safe_load((CONFIGS / name).read_text()))))
    found = rederived(*recorded(tmp_path, scene, "0.5"), capsys)
    assert (found["cycles"], found["differences"], found["remarks"]) == (503, [], [])


@pytest.mark.slow
def test_what_was_altered_or_is_missing_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    energy, bus = recorded(tmp_path)
    records = records_of(bus)
    writes, reads = reads_of(records, 11), reads_of(records)

    def named(changed: list[bytes]) -> str:
        found = rederived(energy, with_records(bus, changed), capsys)
        return f"{found['damage']} {found['differences']}"

    def flipped(place: int, byte: int) -> list[bytes]:
        one = bytearray(records[place])
        one[byte] ^= 0x10
        return [*records[:place], bytes(one), *records[place + 1 :]]

    write, read = writes[-100], reads[-100]
    assert f"frame {write}: and its answer differ" in named(flipped(write, 76))  # outputs as they came back
    assert f"frame {write}: and its answer differ" in named(flipped(write - 1, 76))  # and as they were sent
    assert "datagrams do not end" in named(flipped(read, 72))  # the length of a datagram
    assert "answers a frame that is not in the capture" in named([*records[: read - 1], *records[read:]])
    assert "comes after a gap in the numbers" in named([*records[: write - 1], *records[write + 1 :]])
    assert "'quantity': 'position'" in named([*records[: read - 1], *records[write + 1 :]])  # a whole cycle
    assert "'quantity': 'position'" in named([*records[:read], *records[read + 1 :]])  # one answer
    assert "'quantity': 'cycles'" in named(records[: reads[-200]])


@pytest.mark.slow
def test_a_capture_alone_can_be_inspected_with_its_scene_and_no_other(tmp_path, capsys) -> None:
    _, bus = recorded(tmp_path)
    assert typed.inspect(bus, "--config", SCENE, "--check", "deficit == 0") == 0
    assert "derived from the frames of run.pcap" in capsys.readouterr().out
    assert typed.inspect(bus, "--why", "--config", SCENE) == 0
    with pytest.raises(LogFormatError, match="is a capture of Ethernet, expected the frames of a CAN bus"):
        typed.inspect(bus, "--config", CONFIGS / "demo.yaml")
    with pytest.raises(InputError, match="no SYNC was answered in OPERATION ENABLED"):  # its start is missing
        typed.inspect(with_records(bus, records_of(bus)[6000:]), "--config", SCENE)


@pytest.mark.slow
def test_every_frame_of_the_capture_decodes(tmp_path: Path) -> None:
    _, bus = recorded(tmp_path)
    assert all(datagrams_of(content) for _, content in read_capture(bus))
