"""Objects of CiA 301 that a dictionary may list: stored parameters, the SYNC counter, node guarding."""

from pathlib import Path

import can
import pytest

from tests.sim_drive.drive_on_bus import Rig

MS = 1_000_000

OUR_EDS = Path(__file__).resolve().parents[2] / "eds" / "cia402_servo.eds"
SECTION = """
[{name}]
ParameterName=object {name}
ObjectType={kind}
{entries}
PDOMapping=0
"""


@pytest.fixture
def listing(tmp_path: Path) -> Path:
    """Our dictionary with 0x1010, 0x1011, 0x1019 and the guarding objects besides."""
    text = OUR_EDS.read_text(encoding="utf-8")
    for name, data_type, value in (("100C", 6, 0), ("100D", 5, 0), ("1019", 5, 0)):
        entries = f"DataType={data_type}\nAccessType=rw\nDefaultValue={value}"
        text += SECTION.format(name=name, kind="0x7", entries=entries)
    for name in ("1010", "1011"):
        text += SECTION.format(name=name, kind="0x8", entries="SubNumber=2")
        text += SECTION.format(name=f"{name}sub0", kind="0x7", entries="DataType=5\nAccessType=ro\nDefaultValue=1")
        text += SECTION.format(name=f"{name}sub1", kind="0x7", entries="DataType=7\nAccessType=rw\nDefaultValue=1")
    path = tmp_path / "more.eds"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(("index", "signature"), [(0x1010, b"save"), (0x1011, b"load")])
def test_parameters_are_stored_and_restored_by_their_signature_alone(
    listing: Path, index: int, signature: bytes
) -> None:
    with Rig(listing) as rig:
        assert rig.write(index, 1, 1, 4) == "08000020"
        assert rig.write(index, 1, int.from_bytes(signature[::-1], "little"), 4) == "08000020"
        assert rig.write(index, 1, int.from_bytes(signature, "little"), 4) == "ok"
        assert rig.read(index, 1) == "01 00 00 00"  # what the device can do, never the signature


def test_the_sync_counter_is_set_while_the_cycle_period_is_0_and_to_what_cia_301_allows(listing: Path) -> None:
    with Rig(listing) as rig:
        assert [rig.write(0x1019, 0, value, 1) for value in (1, 241, 240, 2, 0)] == ["06090030"] * 2 + ["ok"] * 3
        assert rig.write(0x1006, 0, 1000, 4) == "ok"
        assert rig.write(0x1019, 0, 2, 1) == "08000022"


@pytest.mark.parametrize(("data_type", "size"), [("0x10", 3), ("0x12", 5), ("0x13", 6), ("0x14", 7), ("0x16", 3)])
def test_integers_of_unusual_sizes_have_their_size(tmp_path: Path, data_type: str, size: int) -> None:
    entries = f"DataType={data_type}\nAccessType=rw\nDefaultValue=5"
    path = tmp_path / "odd.eds"
    path.write_text(OUR_EDS.read_text(encoding="utf-8") + SECTION.format(name="2100", kind="0x7", entries=entries))
    with Rig(path) as rig:
        entry = rig.drive.store.find(0x2100)
        assert entry is not None
        assert entry.size == size
        expected = "ok" if size <= 4 else "06070013"  # too short
        assert rig.write(0x2100, 0, 5, min(size, 4)) == expected


def request_state(rig: Rig, node_id: int = 5) -> list[tuple[int, str]]:
    """A guard request, and the frames that answer it."""
    rig.bus.send(can.Message(arbitration_id=0x700 + node_id, is_remote_frame=True, is_extended_id=False, dlc=1))
    return rig.run()


def test_guard_requests_are_answered_with_the_state_and_a_bit_that_alternates(listing: Path) -> None:
    with Rig(listing) as rig:
        assert [request_state(rig) for _ in range(3)] == [[(0x705, "7f")], [(0x705, "ff")], [(0x705, "7f")]]
        assert request_state(rig, 6) == []
        rig.send(0x000, "82 05")  # reset communication begins anew
        assert request_state(rig) == [(0x705, "7f")]
        rig.write(0x1017, 0, 60_000, 2)  # heartbeats take the place of guarding
        assert request_state(rig) == []


def test_a_drive_whose_dictionary_lists_no_guarding_answers_no_request() -> None:
    with Rig() as rig:
        assert request_state(rig) == []


@pytest.mark.parametrize(("time", "factor", "life_time"), [(20, 5, 100), (0, 5, None), (20, 0, None)])
def test_life_guarding_counts_from_the_first_request_and_takes_the_torque_away(
    listing: Path, time: int, factor: int, life_time: int | None
) -> None:
    with Rig(listing) as rig:
        assert rig.write(0x100C, 0, time, 2) == rig.write(0x100D, 0, factor, 1) == "ok"
        rig.enable()
        rig.send(0x205, "0f 00 64 00")
        assert rig.run(rig.now + 500 * MS) == []  # no request yet
        request_state(rig)
        begin = rig.now
        rig.run(begin + 99 * MS)
        assert rig.drive.torque == 0.1
        frames = rig.run(begin + 101 * MS)
        assert frames == ([] if life_time is None else [(0x085, "30 81 11 00 00 00 00 00")])
        assert rig.drive.torque == (0.1 if life_time is None else 0.0)


def test_life_guarding_that_is_switched_off_or_comes_back_is_no_error(listing: Path) -> None:
    with Rig(listing) as rig:
        rig.write(0x100D, 0, 5, 1)
        rig.write(0x100C, 0, 20, 2)
        request_state(rig)
        assert rig.run(rig.now + 200 * MS) == [(0x085, "30 81 11 00 00 00 00 00")]
        assert (0x085, "00 00 00 00 00 00 00 00") in request_state(rig)
        rig.write(0x100C, 0, 0, 2)
        assert rig.run(rig.now + 500 * MS) == []
