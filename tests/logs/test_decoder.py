from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canhaptic.canopen.code_texts import emcy_text, sdo_abort_text
from canhaptic.canopen.eds import read_dictionary
from canhaptic.canopen.objects import SdoAbort
from canhaptic.logs.decoder import Access, BusDecoder, NodeDescription, PdoMaps
from tests.drawn import examples

EDS = Path(__file__).parents[2] / "eds" / "cia402_servo.eds"


def words(decoder: BusDecoder, can_id: int, data: str) -> tuple[str, ...]:
    return tuple(decoder.decode(can_id, bytes.fromhex(data)))


@pytest.fixture
def decoder() -> BusDecoder:
    dictionary = read_dictionary(EDS, 5)
    return BusDecoder([NodeDescription(5, "handle", dictionary, counts_per_unit=1e6, unit="m", full_torque=20.0)])


@pytest.mark.parametrize(
    ("can_id", "data", "expected"),
    [
        (0x000, "0105", ("NMT", "handle", "start (operational)")),
        (0x000, "8000", ("NMT", "all", "enter pre-operational")),
        (0x000, "01", ("NMT", "", "malformed: 1 bytes instead of 2")),
        (0x080, "", ("SYNC", "", "")),
        (0x705, "00", ("heartbeat", "handle", "boot-up")),
        (0x705, "05", ("heartbeat", "handle", "operational")),
        (0x705, "85", ("heartbeat", "handle", "operational")),  # bit 7 toggles where nodes are guarded
        (0x705, "0500", ("heartbeat", "handle", "malformed: 2 bytes instead of 1")),
        (0x085, "1186", ("EMCY", "handle", "malformed: 2 bytes instead of 8")),
        (0x100, "00112233", ("TIME", "", "00 11 22 33")),
        (0x70A, "7F", ("heartbeat", "node 10", "pre-operational")),
        (
            0x085,
            "3081110102030405",
            ("EMCY", "handle", "0x8130 life guard or heartbeat error, error register 0x11, vendor 01 02 03 04 05"),
        ),
        (0x085, "118601", ("EMCY", "handle", "0x8611 following error, error register 0x01, vendor - (short: 3 bytes)")),
        (0x605, "4041600000000000", ("SDO", "handle", "read 0x6041 Statusword")),
        (0x585, "4B41600037020000", ("SDO", "handle", "0x6041 Statusword = 0x0237 (OPERATION ENABLED)")),
        (0x605, "2F6060000A000000", ("SDO", "handle", "write 0x6060 Modes of operation = 0x0A")),
        (
            0x585,
            "8071600030000906",
            ("SDO", "handle", "abort by server of 0x6071 Target torque: 0x06090030 invalid value for parameter"),
        ),
        (0x585, "4372600000000000", ("SDO", "handle", "0x6072 Max torque = 0x00000000 (0 N)")),
        (0x605, "226060000A000000", ("SDO", "handle", "write 0x6060 Modes of operation = 0x0000000A")),  # no size
        (0x585, "426160000A000000", ("SDO", "handle", "0x6061 Modes of operation display = 0x0000000A")),
        (0x605, "2108100008000000", ("SDO", "handle", "write 0x1008 Manufacturer device name in segments, 8 bytes")),
        (0x585, "4108100008000000", ("SDO", "handle", "0x1008 Manufacturer device name follows in segments, 8 bytes")),
        (0x585, "4008100000000000", ("SDO", "handle", "0x1008 Manufacturer device name follows in segments")),
        (0x605, "A608100000000000", ("SDO", "handle", "block upload: a6 08 10 00 00 00 00 00")),
        (0x605, "C608100000000000", ("SDO", "handle", "block download: c6 08 10 00 00 00 00 00")),
        (0x605, "E008100000000000", ("SDO", "handle", "unknown command 0xe0")),
        (0x585, "A108100000000000", ("SDO", "handle", "block transfer: a1 08 10 00 00 00 00 00")),
        (
            0x605,
            "8008100001000405",
            (
                "SDO",
                "handle",
                "abort by client of 0x1008 Manufacturer device name: "
                "0x05040001 client/server command specifier not valid or unknown",
            ),
        ),
        (0x585, "4B", ("SDO", "handle", "malformed: 1 bytes instead of 8")),
        (0x18FF1234, "01", ("unknown", "", "01")),
    ],
)
def test_literal_frames_are_named(decoder: BusDecoder, can_id: int, data: str, expected: tuple[str, str, str]) -> None:
    kind, node, text = words(decoder, can_id, data)
    assert (kind, node, text.lower()) == (expected[0], expected[1], expected[2].lower())


MAP_TPDO1 = [
    ("2300180185010080", "6000180100000000"),  # COB-ID with bit 31: off
    ("2F001A0000000000", "60001A0000000000"),
    ("23001A0110004160", "60001A0100000000"),
    ("23001A0220006460", "60001A0200000000"),
    ("23001A0310007460", "60001A0300000000"),
    ("2F001A0003000000", "60001A0000000000"),
    ("2300180185010000", "6000180100000000"),
]


def test_pdo_fields_are_learnt_from_the_bring_up_and_get_units(decoder: BusDecoder) -> None:
    for request, response in MAP_TPDO1:
        words(decoder, 0x605, request)
        words(decoder, 0x585, response)
    assert words(decoder, 0x185, "3712 60790100 F6FF") == (
        "TPDO1",
        "handle",
        "statusword 0x1237 OPERATION ENABLED, position actual 96608 (0.096608 m), torque demand -10 (-0.2 N)",
    )
    assert words(decoder, 0x185, "3712")[2] == "malformed: 2 bytes, the map has 64 bits"


def test_a_map_is_learnt_without_any_description_too_and_an_aborted_write_teaches_nothing() -> None:
    decoder = BusDecoder()
    assert words(decoder, 0x185, "3712")[2] == "37 12 (map not known)"
    for request, response in MAP_TPDO1:
        words(decoder, 0x605, request)
        words(decoder, 0x585, response)
    words(decoder, 0x605, "2F001A0001000000")
    words(decoder, 0x585, "80001A0022000008")
    assert words(decoder, 0x185, "37120A0000000000")[2].endswith("position actual 10, torque demand 0")


def test_every_bit_of_a_cob_id_that_was_written_counts() -> None:
    maps = PdoMaps(5, None)
    maps.learn(Access(0x1801, 1, (0x4000_02FF).to_bytes(4, "little")))
    assert (0x2FF, "TPDO2", 0x1A01) in list(maps.cob_ids())


def test_the_fields_of_a_frame_are_objects_with_their_subindex() -> None:
    maps = PdoMaps(5, None)
    for subindex, entry in ((0, 2), (1, 0x60C1_0220), (2, 0x6071_0010)):
        maps.learn(Access(0x1600, subindex, entry.to_bytes(4, "little")))
    fields = maps.fields(0x1600, bytes.fromhex("78563412 f6ff"))
    assert fields == [(0x60C1, 2, 32, 0x12345678), (0x6071, 0, 16, -10)]


def test_a_map_with_an_entry_of_no_bits_or_of_more_entries_than_there_are_is_not_known() -> None:
    maps = PdoMaps(5, None)
    for subindex, entry in ((0, 2), (1, 0x6071_0000), (2, 0x6040_0010)):
        maps.learn(Access(0x1600, subindex, entry.to_bytes(4, "little")))
    assert maps.fields(0x1600, bytes.fromhex("0f00")) == "0f 00 (map not known)"
    maps.learn(Access(0x1600, 0, b"\xff\xff\xff\xff"))
    assert maps.fields(0x1600, bytes.fromhex("0f00")) == "0f 00 (map not known)"


def test_segments_belong_to_the_object_whose_transfer_they_continue(decoder: BusDecoder) -> None:
    name = "0x1008 Manufacturer device name"
    words(decoder, 0x605, "4008100000000000")
    words(decoder, 0x585, "4108100009000000")
    assert words(decoder, 0x605, "6000000000000000")[2] == f"read next segment of {name}"
    assert words(decoder, 0x585, "1061626364656667")[2] == f"segment of {name}: 61 62 63 64 65 66 67"  # toggled
    assert words(decoder, 0x585, "0061626364656667")[2] == f"segment of {name}: 61 62 63 64 65 66 67"
    assert words(decoder, 0x585, "1D68000000000000")[2] == f"segment of {name}: 68, last"
    words(decoder, 0x605, "2109100002000000")
    assert words(decoder, 0x605, "0B61620000000000")[2].endswith("hardware version: 61 62, last")
    assert words(decoder, 0x585, "2000000000000000")[2].endswith("hardware version taken")


@pytest.mark.parametrize(
    ("requests", "response"),
    [
        (["2F001A0001000000"], "80001A0022000008"),
        (["2F011A0001000000"], "60001A0000000000"),  # another object
        (["2F001A0001000000", "21001A0001000000"], "60001A0000000000"),  # what came in segments is not known
        (["40001A0000000000"], "60001A0000000000"),
    ],
)
def test_only_a_confirmed_write_of_a_known_value_teaches(requests: list[str], response: str) -> None:
    decoder = BusDecoder()
    words(decoder, 0x605, "23001A0110004160")
    words(decoder, 0x585, "60001A0100000000")
    for request in requests:
        words(decoder, 0x605, request)
    words(decoder, 0x585, response)
    assert words(decoder, 0x185, "3712")[2] == "37 12 (map not known)"


def test_an_aborted_write_is_forgotten() -> None:
    decoder = BusDecoder()
    for request, response in MAP_TPDO1:
        words(decoder, 0x605, request)
        words(decoder, 0x585, response)
    words(decoder, 0x605, "2F001A0001000000")
    words(decoder, 0x585, "80001A0022000008")
    words(decoder, 0x585, "60001A0000000000")  # as if it were confirmed after all
    assert words(decoder, 0x185, "3712")[2] == "malformed: 2 bytes, the map has 64 bits"


def test_only_signed_objects_have_a_sign() -> None:
    decoder = BusDecoder()
    for entry in ("23001A0110007260", "23001A0210007160", "2F001A0002000000"):
        words(decoder, 0x605, entry)
        words(decoder, 0x585, f"60{entry[2:8]}00000000")
    assert words(decoder, 0x185, "FFFF FFFF")[2] == "max torque 65535, target torque -1"


def test_a_pdo_that_is_moved_is_followed() -> None:
    decoder = BusDecoder()
    words(decoder, 0x605, "23001801A6020000")
    words(decoder, 0x585, "6000180100000000")
    assert words(decoder, 0x2A6, "00")[:2] == ("TPDO1", "node 5")


def test_every_abort_code_that_we_send_has_words() -> None:
    assert all(not sdo_abort_text(code).startswith("unknown") for code in SdoAbort)


def test_an_emcy_code_without_words_of_its_own_gets_those_of_its_group() -> None:
    assert emcy_text(0x8613) == "positioning controller"
    assert emcy_text(0x2ABC) == "current"
    assert emcy_text(0xFF42) == "device-specific"
    assert emcy_text(0x0001) == "unknown error code"


@given(st.lists(st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8)), max_size=40))
@settings(max_examples=examples(60), deadline=None)
def test_no_sequence_of_frames_breaks_the_decoder(frames: list[tuple[int, bytes]]) -> None:
    decoder = BusDecoder()
    for can_id, data in frames:
        assert decoder.decode(can_id, data).kind
