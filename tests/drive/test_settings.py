"""What somebody changed in a drive since commissioning is named with both values, and refused before it is enabled."""

from pathlib import Path
from typing import Any

import pytest

from canhaptic.drive.profile.drive_objects import settings_of, settings_text
from canhaptic.drive.profile.drive_settings import recorded_settings
from canhaptic.errors import DictionaryError, StartError
from tests.drive.drive_bench import OUR_EDS, Bench, MakeBench, axis, started

KEPT = "0x6072=1000 0x6075=5000 0x6076=10000 0x607E=0 0x6091.1=1 0x6091.2=1 0x60E0=1000 0x60E1=1000"
THEN: dict[str | int, int] = {"0x6072": 1000, "0x6075": 5000, "0x6076": 10000}


@pytest.fixture
def eds(tmp_path: Path) -> Path:
    """Our dictionary with a polarity and with torque limits of either sign."""
    text, path = OUR_EDS.read_text(encoding="utf-8"), tmp_path / "settings.eds"
    for index, kind, default in ((0x607E, 5, 0), (0x60E0, 6, 1000), (0x60E1, 6, 1000)):
        text += f"\n[{index:04X}]\nParameterName=Setting\nObjectType=0x7\nDataType=0x000{kind}\nAccessType=rw\n"
        text += f"DefaultValue={default}\nPDOMapping=0\n"
    path.write_text(text, encoding="utf-8")
    return path


def rig(bench: MakeBench, eds: Path, now: dict[str | int, int], **of: Any) -> Bench:
    return bench([axis(eds=eds, **of)], objects={**THEN, **now})


def test_a_drive_as_commissioned_starts_and_its_text_is_what_commissioning_records(bench: MakeBench, eds: Path) -> None:
    b = rig(bench, eds, {}, settings_checked=KEPT)
    assert settings_text(recorded_settings(b.rig.drives[0])) == KEPT
    b.rig.start()
    b.rig.stop()  # 0x6072 keeps the limit of the run
    assert "0x6072" not in settings_text(recorded_settings(b.rig.drives[0]))
    b.rig.start()
    assert b.rig.drives[0].remarks == []


@pytest.mark.slow_but("now1*", "now3*")
@pytest.mark.parametrize(
    ("now", "named"),
    [
        ({"0x607E": 0x80}, "0x607e:00 Setting = 128, 0 at commissioning .polarity"),
        ({"0x6075": 4000}, "0x6075:00 Motor rated current = 4000, 5000 at commissioning"),
        ({"0x6072": 1001}, "0x6072:00 Max torque = 1001, 1000 at commissioning"),
        ({"0x60E1": 999, "0x6091.2": 2}, "0x6091:02 .* = 2, 1 .*0x60e1:00 Setting = 999, 1000"),
    ],
)
def test_a_difference_is_refused_before_anything_is_set_and_may_be_accepted(bench: MakeBench, eds, now, named) -> None:
    b = rig(bench, eds, now, settings_checked=KEPT)
    with pytest.raises(StartError, match=f"settings: got {named}") as raised:
        b.rig.start()
    writes = {data[1:3].hex() for data in b.sent(0x605) if data[0] & 0xE0 == 0x20}
    assert writes <= {"1710", "4060", "1610"}  # heartbeats and disable
    accepted = str(raised.value).rpartition("settings_accepted: ")[2]
    assert settings_of(accepted) == settings_of(" ".join(f"{key}={value}" for key, value in now.items()))
    again = rig(bench, eds, now, settings_checked=KEPT, settings_accepted=accepted)
    again.rig.start()
    assert again.rig.is_running


@pytest.mark.parametrize(
    ("kept", "named"),
    [
        (KEPT.replace("0x607E=0 ", ""), "0x607e:00 Setting = 0, absent at commissioning"),
        (f"{KEPT} 0x60A8=7", "0x60a8:00 = absent, 7 at commissioning"),
    ],
)
def test_what_came_or_went_is_a_difference(bench: MakeBench, eds: Path, kept: str, named: str) -> None:
    with pytest.raises(StartError, match=f"settings: got {named}"):
        rig(bench, eds, {}, settings_checked=kept).rig.start()


@pytest.mark.parametrize("left", [1000, 800, 10])
def test_a_limit_that_a_run_may_have_left_is_no_difference(bench: MakeBench, eds: Path, left: int) -> None:
    """0x6072 is written at every start: 800 per mille are the 8 N of this scene."""
    rig(bench, eds, {"0x6072": left}, settings_checked=KEPT).rig.start()


def test_a_rated_torque_that_the_start_writes_is_no_difference(bench: MakeBench, eds: Path) -> None:
    kept = KEPT.replace("0x6076=10000", "0x6076=0")
    rig(bench, eds, {}, settings_checked=kept, quirks=("rated_torque_written",)).rig.start()
    with pytest.raises(StartError, match=r"0x6076:00 .* = 10000, 0 at commissioning"):
        rig(bench, eds, {}, settings_checked=kept).rig.start()


def test_without_an_answer_the_start_is_refused(bench: MakeBench, eds: Path) -> None:
    b = rig(bench, eds, {}, settings_checked=KEPT)
    b.tampered.on_receive = lambda frame: None if bytes(frame.data[1:3]) == b"\x75\x60" else frame
    with pytest.raises(StartError, match="settings: read 0x6075:00"):
        b.rig.start()


def test_what_no_commissioning_has_seen_is_said(bench: MakeBench, eds: Path) -> None:
    b = rig(bench, eds, {"0x607E": 0x80, "0x60E0": 799, "0x60E1": 800})
    b.rig.start()
    polarity, limit = b.rig.drives[0].remarks
    assert polarity.startswith("0x607e:00 Setting = 128, 0 in the dictionary: it turns signs")
    assert limit == "0x60e0:00 Setting = 799, below torque_limit (800): the drive cuts what is sent"
    b.rig.start()
    assert len(b.rig.drives[0].remarks) == 2


def test_below_the_least_limit_of_a_drive_the_master_limits_alone_where_the_scene_says_so(bench: MakeBench, tmp_path):
    text, path = OUR_EDS.read_text(encoding="utf-8"), tmp_path / "least.eds"
    begin = text.index("[6072]")
    path.write_text(text[:begin] + "[6072]\nLowLimit=100" + text[begin + 6 :], encoding="utf-8")
    with pytest.raises(DictionaryError, match=r"limited to 100\.\..*, but the scene needs 50"):
        bench([axis(eds=path, torque_limit=0.5)])
    b = started(bench, [axis(eds=path, torque_limit=0.5, limit_by_master=True)])
    assert b.rig.drives[0].sdo.read(0x6072) == 100
    b.run(3, torque=8.0)
    assert b.torques_sent()[-1] == 50


def test_a_turned_polarity_turns_the_position_of_the_simulated_drive(bench: MakeBench, eds: Path) -> None:
    for polarity, sign in ((0x00, 1), (0x40, 1), (0x80, -1)):
        b = rig(bench, eds, {"0x607E": polarity})
        b.rig.start()
        assert b.run(1)[0].position == pytest.approx(sign * 0.01, abs=2e-5)


@pytest.mark.parametrize("text", ["0x6075", "0x6075=a lot", "0x6040=15", "6075=1 0x6040=2"])
def test_a_text_that_is_no_list_of_settings_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="expected"):
        axis(settings_checked=text)
