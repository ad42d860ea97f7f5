"""Torque that the drive adds to its target (0x60B2), as a vendor's tool may have left it: taken away, or refused."""

from pathlib import Path

import pytest

from canhaptic.cli.main import main
from canhaptic.drive.profile.fitness import Verdict, profile_findings
from canhaptic.drive.survey import survey
from canhaptic.errors import SdoError, StartError
from canhaptic.replay import replay_bus_log
from canhaptic.scene.load import load_scene
from tests.drive.drive_bench import OUR_EDS, REPOSITORY, MakeBench, axis, dictionary, started

LEFT = 300  # per mille of 10 N: 3 N
WRITE_ZERO = bytes.fromhex("2b b2 60 00 00 00 00 00")


def eds_with_offset(folder: Path, access: str = "rww", data_type: str = "0x0003") -> Path:
    path = folder / "offset.eds"
    lines = f"ParameterName=Torque offset\nObjectType=0x7\nDataType={data_type}\nAccessType={access}\nPDOMapping=1\n"
    path.write_text(f"{OUR_EDS.read_text(encoding='utf-8')}\n[60B2]\n{lines}", encoding="utf-8")
    return path


@pytest.mark.parametrize("read_back", ["demand", "actual", "none"])
def test_the_start_takes_an_offset_away_before_the_drive_is_enabled(bench: MakeBench, tmp_path, read_back: str) -> None:
    b = started(bench, [axis(eds=eds_with_offset(tmp_path), read_back=read_back)], objects={0x60B2: LEFT})
    requests = b.sent(0x605)
    assert requests.index(WRITE_ZERO) < requests.index(bytes.fromhex("2f 60 60 00 0a 00 00 00"))  # the mode
    b.run(20)
    assert b.drives[0].servo.motor.velocity == 0.0


def test_a_drive_adds_the_offset_to_its_target(bench: MakeBench, tmp_path: Path) -> None:
    """What the start prevents: 3 N that no RPDO asks for."""
    b = bench([axis(eds=eds_with_offset(tmp_path), read_back="none")], objects={0x60B2: LEFT})
    b.rig.drives[0].left_out = frozenset({0x60B2})
    b.rig.start()
    b.run(100)
    assert set(b.torques_sent()) == {0}
    assert b.drives[0].servo.motor.velocity == pytest.approx(3.0 * 0.1, rel=0.05)  # [m/s] of 1 kg after 0.1 s


def test_a_read_only_offset_is_refused_unless_it_is_zero(bench: MakeBench, tmp_path: Path) -> None:
    eds = eds_with_offset(tmp_path, access="ro")
    with pytest.raises(StartError, match=r"0x60b2:00 Torque offset = 300, read-only.*expected 0.*vendor's tool"):
        bench([axis(eds=eds)], objects={0x60B2: LEFT}).rig.start()
    bench([axis(eds=eds)], objects={0x60B2: 0}).rig.start()


def test_a_dictionary_whose_offset_cannot_be_zero_is_refused(tmp_path: Path) -> None:
    wrong = axis(eds=eds_with_offset(tmp_path, data_type="0x0008"))  # REAL32
    found = {finding.item: finding for finding in profile_findings(dictionary(wrong), wrong)}
    assert found["0x60b2 offset"].verdict is Verdict.REFUSED
    assert [row.item for row in survey(dictionary(wrong), wrong).reasons] == ["0x60b2 offset"]


def test_no_thread_writes_an_offset_during_the_run(bench: MakeBench, tmp_path: Path) -> None:
    b = started(bench, [axis(eds=eds_with_offset(tmp_path))])
    with pytest.raises(SdoError, match="it belongs to the cycle"):
        b.rig.sdo(0).write(0x60B2, 0, 100)


@pytest.mark.slow
def test_a_recording_of_an_older_master_is_replayed_without_the_offset(tmp_path: Path) -> None:
    """The write and its answer taken out of the log of a run: the start leaves them out and says so."""
    log = tmp_path / "run.log"
    given = [f"--set=axes.0.eds={eds_with_offset(tmp_path)}", "--set=simulation.drive.objects={0x60B2: 0}"]
    scene = REPOSITORY / "configs" / "demo.yaml"
    assert main(["run", str(scene), "--pace", "free", "--duration", "0.05", "--bus-log", str(log), *given]) == 0
    lines = log.read_text().splitlines(keepends=True)
    old = [line for line in lines if "B26000" not in line.upper()]
    assert len(old) == len(lines) - 8  # read, write, read back, compare at the end: each with its answer
    log.write_text("".join(old))
    result = replay_bus_log(log, load_scene(scene, [text.removeprefix("--set=") for text in given]))
    assert (result["status"], result["reads_left_out"]) == ("identical", ["handle: 0x60B2"])
