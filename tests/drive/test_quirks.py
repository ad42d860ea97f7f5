"""Every named quirk against its twin: a whole start through the bus, and what happens to a master that knows nothing.

The twin is the simulated drive as `scene.far_side` makes it; what reaches the motor is judged by the motor.
"""

from typing import Any

import pytest

from canhaptic.drive.can.pdo_map import check_dictionary, choose_map
from canhaptic.drive.profile.fitness import Verdict
from canhaptic.drive.profile.quirks import _QUIRKS, TWINS
from canhaptic.errors import CommandLostError, DictionaryError, StartError
from canhaptic.scene.far_side import _twin_of
from tests.drive.drive_bench import OUR_EDS, RATED_TORQUE, REPOSITORY, Bench, MakeBench, axis, dictionary

ALONE: dict[str, str] = {
    # quirk -> what a master without it says to its twin
    "rated_torque_micro": r"rated_torque: got 10, but the drive states 0x6076 = 10000000, which is 10000",
    "rated_torque_absent": r"rated torque: got read 0x6076:00 .* 0x06020000",
    "torque_per_cent": "",
    "torque_per_ten_thousand": "",
    "max_torque_absent": r"torque limit: got write 0x6072:00 .* 0x06020000.*quirks: max_torque_absent",
    "demand_absent": r"PDO map: got write 0x1a00:03 .*quirks: demand_absent",
    "slow_enable": r"enable: got SWITCHED ON .*quirks: slow_enable",
    "late_following": "",
    "abort_disable_voltage": r"watchdog: got write 0x6007:00 .* 0x06090030.*see the quirks abort_",
    "abort_quick_stop": r"watchdog: got write 0x6007:00 .* 0x06090030.*see the quirks abort_",
    "manufacturer_event": r"PDO map: got write 0x1400:02 .*manufacturer_event",
    "no_interpolation_period": r"interpolation period: got write 0x60c2:0. .*quirks: \[no_interpolation_period\]",
    "rated_torque_written": "",
    "sdo_size_not_indicated": "",
    "mode_when_enabled": r"mode of operation: got 0x6061 = 0, expected 10 within 1 s \(step_timeout\).*mode_when_en",
    "acts_at_once": "",
    "acts_a_sync_late": "",
    "acts_two_syncs_late": "",
}


def benched(bench: MakeBench, twin: str, quirks: tuple[str, ...], **values: Any) -> Bench:
    bus = {"rpdo": "event"} if twin == "manufacturer_event" else {}
    return bench([axis(quirks=quirks, **values)], bus, drive_values=_twin_of({"quirks": [twin]}))


def pushed(made: Bench) -> float:
    """Torque at the motor after 1 N was commanded for a while [N]."""
    with made.rig:
        made.run(30, torque=1.0)
        return made.drives[0].torque


def test_every_quirk_has_a_twin_and_a_test() -> None:
    assert set(_QUIRKS) == set(TWINS) == set(ALONE)


@pytest.mark.slow_for("slow_enable")
@pytest.mark.parametrize("name", sorted(_QUIRKS))
def test_a_drive_with_a_quirk_comes_up_and_gives_the_torque_that_was_asked_for(bench: MakeBench, name: str) -> None:
    assert pushed(benched(bench, name, (name,))) == pytest.approx(1.0, rel=1e-9)


@pytest.mark.slow_for("slow_enable-*")
@pytest.mark.parametrize(("name", "refusal"), [(name, text) for name, text in sorted(ALONE.items()) if text])
def test_without_its_quirk_the_start_is_refused_and_the_drive_stays_disabled(bench: MakeBench, name: str, refusal: str):
    made = benched(bench, name, ())
    with pytest.raises(StartError, match=refusal):
        made.rig.start()
    assert made.drives[0].torque == 0.0
    assert not made.drives[0].servo.is_running


@pytest.mark.slow
def test_all_quirks_that_go_together_come_up_together(bench: MakeBench) -> None:
    names = (
        *("rated_torque_micro", "rated_torque_written", "max_torque_absent", "demand_absent", "slow_enable"),
        *("late_following", "abort_quick_stop", "no_interpolation_period", "sdo_size_not_indicated"),
    )
    made = bench([axis(quirks=names)], drive_values=_twin_of({"quirks": list(names)}))
    assert pushed(made) == pytest.approx(1.0, rel=1e-9)


# --- what each does beyond coming up ------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "scale"), [("torque_per_cent", 10.0), ("torque_per_ten_thousand", 0.1)])
def test_a_torque_in_another_unit_is_wrong_by_its_factor_without_the_quirk(bench: MakeBench, name: str, scale: float):
    assert pushed(benched(bench, name, ())) == pytest.approx(scale, rel=1e-9)


@pytest.mark.parametrize(
    ("name", "target", "limit"), [("torque_per_cent", "32 00", 80), ("torque_per_ten_thousand", "88 13", 8000)]
)
def test_limit_and_target_are_in_the_unit_of_the_drive(bench: MakeBench, name: str, target: str, limit: int) -> None:
    """5 N of 10 N rated: 50 per cent, 5000 of ten thousand; the limit of 8 N is 80 and 8000."""
    made = benched(bench, name, (name,))
    with made.rig:
        made.run(5, torque=5.0)
        written = made.drives[0].store.find(0x6072)
        assert written is not None
        assert written.number == limit
        assert made.sent(0x205)[-1][2:4] == bytes.fromhex(target)
        assert made.rig.sync()[0].torque_applied == pytest.approx(5.0)


def test_a_rated_torque_of_zero_is_written_once_and_read_back(bench: MakeBench) -> None:
    made = benched(bench, "rated_torque_written", ("rated_torque_written",))
    with made.rig:
        writes = [data for data in made.sent(0x605) if data[0] & 0xE0 == 0x20 and data[1:3] == b"\x76\x60"]
        assert writes == [bytes.fromhex("23 76 60 00 10 27 00 00")]  # 10000 mN


def test_a_rated_torque_that_the_drive_has_is_never_written(bench: MakeBench) -> None:
    made = bench([axis(quirks=("rated_torque_written",))])
    with made.rig:
        assert not [data for data in made.sent(0x605) if data[0] & 0xE0 == 0x20 and data[1:3] == b"\x76\x60"]


def test_a_rated_torque_of_zero_needs_that_of_the_configuration(bench: MakeBench) -> None:
    values = {"rated_torque_stated": False}
    with pytest.raises(StartError, match="0x6076 is 0 by the drive and the configuration has none"):
        bench([axis(rated_torque=None)], drive_values=values).rig.start()
    assert pushed(bench([axis()], drive_values=values)) == pytest.approx(1.0)


def test_a_drive_that_follows_late_loses_its_first_torques_unless_the_start_waits(bench: MakeBench) -> None:
    made = benched(bench, "late_following", ())
    made.rig.start()
    with pytest.raises(CommandLostError):
        made.run(150, torque=1.0)
    made = benched(bench, "late_following", ("late_following",))
    with made.rig:
        before = made.drives[0].servo.now
        made.run(3, torque=1.0)
        assert made.drives[0].torque == pytest.approx(1.0)
        assert before > 200_000_000


@pytest.mark.parametrize(
    ("quirk", "rated_torque", "item", "verdict", "words"),
    [
        ("rated_torque_absent", 10.0, "0x6076", Verdict.UNKNOWN, "10 from the configuration alone"),
        ("rated_torque_absent", None, "0x6076", Verdict.REFUSED, "the configuration has no rated_torque; set it"),
        ("max_torque_absent", 10.0, "0x6072", Verdict.UNKNOWN, "the master alone keeps 8"),
    ],
)
def test_the_check_of_a_dictionary_knows_the_quirks(quirk, rated_torque, item, verdict: Verdict, words) -> None:
    parameters = axis(quirks=(quirk,), rated_torque=rated_torque)
    [finding] = [f for f in check_dictionary(dictionary(parameters), parameters) if f.item.startswith(item)]
    assert finding.verdict is verdict
    assert words in finding.text


def test_without_a_demand_the_measured_torque_is_read_back(bench: MakeBench) -> None:
    parameters = axis(quirks=("demand_absent",))
    assert choose_map(dictionary(parameters), parameters).read_back == "actual"
    with pytest.raises(DictionaryError, match="its quirks have demand_absent"):
        choose_map(dictionary(parameters), parameters.model_copy(update={"read_back": "demand"}))


def test_negative_torques_survive_answers_without_length(bench: MakeBench) -> None:
    """INTEGER16 -100 in an answer 0x42 has two bytes behind it that are no part of it."""
    made = benched(bench, "sdo_size_not_indicated", ())
    with made.rig:
        made.run(5, torque=-1.0)
        drive = made.rig.drives[0]
        assert drive.sdo.read(0x6071) == -100
        assert drive.sdo.read(0x6074) == -100
        assert any(data[0] == 0x42 for data in made.received(0x585))


@pytest.mark.parametrize(("data_type", "access", "written"), [("0x0003", "rw", 800), ("0x0006", "ro", None)])
def test_a_max_torque_of_another_kind_needs_no_quirk(bench: MakeBench, tmp_path, data_type, access, written) -> None:
    """INTEGER16 is written as it is; read-only is left alone."""
    text = OUR_EDS.read_text()
    old = "[6072]\nParameterName=Max torque\nObjectType=0x7\nDataType=0x0006\nAccessType=rww"
    assert old in text
    path = tmp_path / "max_torque.eds"
    path.write_text(text.replace(old, old.replace("0x0006", data_type).replace("rww", access)))
    made = bench([axis(eds=path)])
    assert pushed(made) == pytest.approx(1.0)
    limit = made.drives[0].store.find(0x6072)
    assert limit is not None
    assert limit.number == (1000 if written is None else written)


# --- direction ------------------------------------------------------------------------------------------------------


def test_a_drive_mounted_the_other_way_round_is_set_right_by_direction(bench: MakeBench) -> None:
    """The motor starts at +10 mm; a positive torque drives it up, seen from the axis."""
    made = bench([axis(direction=-1)], drive_values={"direction": -1})
    with made.rig:
        first = made.run(1)[0]
        assert first.position == pytest.approx(0.01, abs=1e-5)
        samples = made.run(50, torque=1.0)
        assert made.drives[0].torque == pytest.approx(1.0)
        assert samples[-1].position > first.position
        assert made.torques_sent()[-1] == -100
        assert samples[-1].torque_applied == pytest.approx(1.0)


def test_a_reversed_drive_that_nobody_told_turns_position_and_torque_together(bench: MakeBench) -> None:
    made = bench([axis()], drive_values={"direction": -1})
    with made.rig:
        samples = made.run(50, torque=1.0)
        assert samples[0].position == pytest.approx(-0.01, abs=1e-5)
        assert samples[-1].position > samples[0].position
        assert made.drives[0].torque == pytest.approx(-1.0)


@pytest.mark.parametrize(("wrong", "position", "torque"), [("encoder", -0.01, 1.0), ("torque", 0.01, -1.0)])
def test_a_wrong_wiring_turns_one_of_them_alone(bench: MakeBench, wrong: str, position: float, torque: float) -> None:
    made = bench([axis()], drive_values={"reversed": wrong})
    with made.rig:
        samples = made.run(50, torque=1.0)
        assert samples[0].position == pytest.approx(position, abs=1e-5)
        assert made.drives[0].torque == pytest.approx(torque)
        assert samples[-1].position < samples[0].position


def test_the_rated_torque_of_the_bench_is_what_the_literal_bytes_above_assume() -> None:
    assert RATED_TORQUE == 10.0


def test_every_quirk_is_described() -> None:
    described = (REPOSITORY / "docs" / "drives.md").read_text(encoding="utf-8")
    assert [name for name in _QUIRKS if f"`{name}`" not in described] == []
