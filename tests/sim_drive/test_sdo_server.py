"""The SDO server against literal frames of CiA 301."""

import pytest

from tests.sim_drive.drive_on_bus import Rig


@pytest.mark.parametrize(
    ("request_frame", "answer"),
    [
        ("40 00 10 00 00 00 00 00", "43 00 10 00 92 01 02 00"),  # 4 bytes
        ("40 17 10 00 00 00 00 00", "4b 17 10 00 00 00 00 00"),  # 2 bytes
        ("40 01 10 00 00 00 00 00", "4f 01 10 00 00 00 00 00"),  # 1 byte
        ("40 14 10 00 00 00 00 00", "43 14 10 00 85 00 00 00"),  # relative to the node ID
        ("40 c2 60 02 00 00 00 00", "4f c2 60 02 fd 00 00 00"),  # -3
    ],
)
def test_expedited_uploads_tell_their_length(rig: Rig, request_frame: str, answer: str) -> None:
    assert rig.sdo(request_frame) == answer


def test_uploads_without_length_when_the_drive_is_of_that_kind() -> None:
    with Rig(sdo_size_indicated=False) as rig:
        assert rig.sdo("40 17 10 00 00 00 00 00") == "42 17 10 00 00 00 00 00"


def test_segmented_upload_toggles_and_marks_the_last_segment(rig: Rig) -> None:
    name = b"canhaptic generic CiA 402 servo"
    assert rig.sdo("40 08 10 00 00 00 00 00") == "41 08 10 00 1f 00 00 00"
    received = b""
    for k in range(5):
        answer = bytes.fromhex(rig.sdo(("60", "70")[k % 2] + "00" * 7))
        assert answer[0] & 0x10 == 0x10 * (k % 2)
        assert answer[0] & 0x01 == (k == 4)
        received += answer[1 : 8 - (answer[0] >> 1 & 7)]
    assert received == name
    assert rig.sdo("70 00 00 00 00 00 00 00") == "80 00 00 00 01 00 04 05"


@pytest.mark.parametrize(
    ("request_frame", "answer"),
    [
        ("2b 17 10 00 64 00 00 00", "60 17 10 00 00 00 00 00"),
        ("2f 60 60 00 0a 00 00 00", "60 60 60 00 00 00 00 00"),
        ("22 17 10 00 64 00 ff ff", "60 17 10 00 00 00 00 00"),  # length not given: the object's own counts
        ("2b 72 60 00 f4 01 00 00", "60 72 60 00 00 00 00 00"),
    ],
)
def test_expedited_downloads_are_confirmed(rig: Rig, request_frame: str, answer: str) -> None:
    assert rig.sdo(request_frame) == answer


def test_value_written_is_the_value_read(rig: Rig) -> None:
    rig.sdo("2b 72 60 00 f4 01 00 00")
    assert rig.sdo("40 72 60 00 00 00 00 00") == "4b 72 60 00 f4 01 00 00"


def test_segmented_download_of_a_number_is_stored_once_complete(rig: Rig) -> None:
    assert rig.sdo("21 06 10 00 04 00 00 00") == "60 06 10 00 00 00 00 00"
    assert rig.sdo("06 e8 03 00 00 00 00 00") == "20 00 00 00 00 00 00 00"  # 4 bytes, and not marked as the last
    assert rig.sdo("1f 00 00 00 00 00 00 00") == "30 00 00 00 00 00 00 00"  # 0 bytes, last
    assert rig.read(0x1006) == "e8 03 00 00"


def test_segmented_download_in_one_segment(rig: Rig) -> None:
    rig.sdo("21 06 10 00 04 00 00 00")
    assert rig.sdo("07 d0 07 00 00 00 00 00") == "20 00 00 00 00 00 00 00"
    assert rig.read(0x1006) == "d0 07 00 00"


def test_segmented_download_that_is_never_ended_changes_nothing(rig: Rig) -> None:
    rig.sdo("21 06 10 00 04 00 00 00")
    assert rig.sdo("06 d0 07 00 00 00 00 00") == "20 00 00 00 00 00 00 00"
    assert rig.sdo("40 06 10 00 00 00 00 00") == "43 06 10 00 00 00 00 00"


def test_toggle_bit_of_a_download_must_alternate(rig: Rig) -> None:
    rig.sdo("21 06 10 00 04 00 00 00")
    rig.sdo("0c d0 00 00 00 00 00 00")
    assert rig.sdo("0d 07 00 00 00 00 00 00") == "80 06 10 00 00 00 03 05"


ABORTS = [
    ("unknown object", "40 00 20 00 00 00 00 00", "80 00 20 00 00 00 02 06"),
    ("unknown subindex", "40 18 10 09 00 00 00 00", "80 18 10 09 11 00 09 06"),
    ("subindex of a variable", "40 00 10 01 00 00 00 00", "80 00 10 01 11 00 09 06"),
    ("write to ro", "23 00 10 00 00 00 00 00", "80 00 10 00 02 00 01 06"),
    ("write to const", "2f 16 10 00 00 00 00 00", "80 16 10 00 02 00 01 06"),
    ("write to unknown object", "23 00 20 00 00 00 00 00", "80 00 20 00 00 00 02 06"),
    ("too long", "23 17 10 00 00 00 00 00", "80 17 10 00 12 00 07 06"),
    ("too short", "2f 17 10 00 00 00 00 00", "80 17 10 00 13 00 07 06"),
    ("above the range", "2b 07 60 00 04 00 00 00", "80 07 60 00 31 00 09 06"),
    ("below the range", "2b 07 60 00 ff ff 00 00", "80 07 60 00 32 00 09 06"),
    ("mode not supported", "2f 60 60 00 08 00 00 00", "80 60 60 00 30 00 09 06"),
    ("object without value", "40 75 60 00 00 00 00 00", "80 75 60 00 24 00 00 08"),
    ("error field without error", "40 03 10 01 00 00 00 00", "80 03 10 01 24 00 00 08"),
    ("history set to other than 0", "2f 03 10 00 01 00 00 00", "80 03 10 00 30 00 09 06"),
    ("sync generator", "23 05 10 00 80 00 00 40", "80 05 10 00 30 00 09 06"),
    ("block upload", "a4 08 10 00 7f 00 00 00", "80 08 10 00 01 00 04 05"),
    ("block download", "c6 08 10 00 04 00 00 00", "80 08 10 00 01 00 04 05"),
    ("unknown specifier", "e0 08 10 00 00 00 00 00", "80 08 10 00 01 00 04 05"),
    ("segment without transfer", "60 00 00 00 00 00 00 00", "80 00 00 00 01 00 04 05"),
    ("download segment without transfer", "00 00 00 00 00 00 00 00", "80 00 00 00 01 00 04 05"),
    ("segmented write to ro", "21 08 10 00 10 00 00 00", "80 08 10 00 02 00 01 06"),
    ("segmented, far too long", "21 06 10 00 00 00 00 7f", "80 06 10 00 05 00 04 05"),
]


@pytest.mark.parametrize(("request_frame", "answer"), [a[1:] for a in ABORTS], ids=[a[0] for a in ABORTS])
def test_aborts_carry_object_and_code(rig: Rig, request_frame: str, answer: str) -> None:
    assert rig.sdo(request_frame) == answer


def test_segmented_downloads_of_a_wrong_length_are_aborted(rig: Rig) -> None:
    rig.sdo("21 06 10 00 04 00 00 00")
    assert rig.sdo("01 01 02 03 04 05 06 07") == "80 06 10 00 12 00 07 06"
    rig.sdo("21 06 10 00 04 00 00 00")
    assert rig.sdo("0b 01 02 00 00 00 00 00") == "80 06 10 00 13 00 07 06"
    rig.sdo("20 06 10 00 00 00 00 00")  # length not announced
    assert rig.sdo("0b 01 02 00 00 00 00 00") == "80 06 10 00 13 00 07 06"
    assert rig.read(0x1006) == "00 00 00 00"


def test_wrong_toggle_of_an_upload_is_aborted(rig: Rig) -> None:
    rig.sdo("40 08 10 00 00 00 00 00")
    assert rig.sdo("70 00 00 00 00 00 00 00") == "80 08 10 00 00 00 03 05"


def test_abort_by_the_client_ends_the_transfer_without_answer(rig: Rig) -> None:
    rig.sdo("40 08 10 00 00 00 00 00")
    assert rig.send(0x605, "80 08 10 00 00 00 04 05") == []
    assert rig.sdo("60 00 00 00 00 00 00 00")[:2] == "80"


def test_stunted_requests_and_those_to_other_nodes_get_no_answer(rig: Rig) -> None:
    assert rig.send(0x605, "40 00 10 00") == []
    assert rig.send(0x604, "40 00 10 00 00 00 00 00") == []


def test_a_new_request_replaces_the_transfer_under_way(rig: Rig) -> None:
    rig.sdo("40 08 10 00 00 00 00 00")
    assert rig.read(0x1000) == "92 01 02 00"


def test_objects_are_answered_from_the_parameters_where_the_dictionary_has_no_value() -> None:
    with Rig(objects={0x6075: 5000, "0x608F.1": 4096, "1018sub4": 77, 0x1008: "mine"}) as rig:
        assert rig.read(0x6075) == "88 13 00 00"
        assert rig.read(0x608F, 1) == "00 10 00 00"
        assert rig.read(0x1018, 4) == "4d 00 00 00"
        assert rig.read(0x1008) == "6d 69 6e 65"
        assert rig.read(0x608F, 2) == "08000024"
