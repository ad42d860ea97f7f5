"""SDO during the running cycle: literal frames, from any thread, never in the way of a PDO, never after the stop."""

import threading
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import replace
from typing import Any

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canhaptic.drive.axis_parameters import CanBusParameters
from canhaptic.drive.can import sdo as sdo_transfer
from canhaptic.drive.can.bus_budget import bus_budget, has_room_for_sdo
from canhaptic.drive.can.sdo import ProtocolError
from canhaptic.errors import InputError, SdoError
from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.drive.drive_bench import Bench, MakeBench, axis

SOON = 10.0  # [s] until a thread of this process has handed a result over; never a pass mark
NAME = b"canhaptic generic CiA 402 servo"  # 0x1008 of our EDS


def started(b: Bench) -> Bench:
    b.rig.start()
    b.run(3, torque=1.0)
    return b


# --- the protocol, against literal frames -------------------------------------------------------------------------


def converse(transfer: sdo_transfer.Transfer, *exchange: tuple[str, str]) -> bytes:
    """Walks a transfer through (request, answer) in hexadecimal and returns its value."""
    request = next(transfer)
    for place, (expected, answer) in enumerate(exchange):
        assert request.hex(" ") == expected
        try:
            request = transfer.send(bytes.fromhex(answer))
        except StopIteration as end:
            assert place == len(exchange) - 1
            return bytes(end.value)
    raise AssertionError("the transfer goes on")


@pytest.mark.parametrize(
    ("answer", "value"),
    [
        ("4f 41 60 00 37 00 00 00", "37"),
        ("4b 41 60 00 37 12 00 00", "37 12"),
        ("43 41 60 00 01 02 03 04", "01 02 03 04"),
        ("42 41 60 00 01 02 03 04", "01 02 03 04"),  # size not indicated, as Elmo does
    ],
)
def test_an_expedited_upload(answer: str, value: str) -> None:
    assert converse(sdo_transfer.upload(0x6041, 0), ("40 41 60 00 00 00 00 00", answer)) == bytes.fromhex(value)


def test_a_segmented_upload_and_download_as_cia_301_has_them() -> None:
    text = b"canhaptic servo"  # 15 bytes: 7 + 7 + 1
    value = converse(
        sdo_transfer.upload(0x1008, 0),
        ("40 08 10 00 00 00 00 00", "41 08 10 00 0f 00 00 00"),
        ("60 00 00 00 00 00 00 00", "00 63 61 6e 68 61 70 74"),
        ("70 00 00 00 00 00 00 00", "10 69 63 20 73 65 72 76"),
        ("60 00 00 00 00 00 00 00", "0d 6f 00 00 00 00 00 00"),
    )
    assert value == text
    converse(
        sdo_transfer.download(0x2000, 1, text),
        ("21 00 20 01 0f 00 00 00", "60 00 20 01 00 00 00 00"),
        ("00 63 61 6e 68 61 70 74", "20 00 00 00 00 00 00 00"),
        ("10 69 63 20 73 65 72 76", "30 00 00 00 00 00 00 00"),
        ("0d 6f 00 00 00 00 00 00", "20 00 00 00 00 00 00 00"),
    )
    converse(sdo_transfer.download(0x6098, 0, b"\x11"), ("2f 98 60 00 11 00 00 00", "60 98 60 00 00 00 00 00"))


@pytest.mark.parametrize("data", [b"\x11", b"more than four bytes"])
def test_an_answer_of_another_kind_to_the_begin_of_a_write_ends_it(data: bytes) -> None:
    transfer = sdo_transfer.download(0x2000, 1, data)
    next(transfer)
    with pytest.raises(ProtocolError):
        transfer.send(bytes.fromhex("4b 00 20 01 00 00 00 00"))  # that of a read


def answer_all(transfer: sdo_transfer.Transfer, answers: list[bytes]) -> None:
    """Hands in one answer after the other; each request must be a whole frame."""
    for answer in answers:
        assert len(transfer.send(answer)) == 8


@pytest.mark.parametrize(
    "answers",
    [
        ["60 08 10 00 00 00 00 00"],  # of a download
        ["41 08 10 00 02 00 00 00", "10 61 62 00 00 00 00 00"],  # wrong toggle
        ["41 08 10 00 02 00 00 00", "20 61 62 00 00 00 00 00"],  # of a download
        ["41 08 10 00 09 00 00 00", "01 61 62 63 64 65 66 67"],  # ends before what was announced
    ],
)
def test_an_answer_that_is_none_ends_the_transfer(answers: list[str]) -> None:
    transfer = sdo_transfer.upload(0x1008, 0)
    next(transfer)
    with pytest.raises(ProtocolError):
        answer_all(transfer, [bytes.fromhex(answer) for answer in answers])


def test_an_upload_without_end_is_given_up() -> None:
    transfer = sdo_transfer.upload(0x1008, 0)
    next(transfer)
    transfer.send(bytes.fromhex("40 08 10 00 00 00 00 00"))
    with pytest.raises(ProtocolError, match="more than 65536 bytes"):
        answer_all(transfer, [bytes([0x10 * (number % 2)]) + bytes(7) for number in range(20_000)])


@given(st.lists(st.binary(min_size=8, max_size=8), min_size=1, max_size=20), st.booleans(), st.binary(max_size=30))
def test_any_answers_end_a_transfer_or_are_part_of_it(answers: list[bytes], reads: bool, data: bytes) -> None:
    transfer = sdo_transfer.upload(0x1008, 0) if reads else sdo_transfer.download(0x1008, 0, data)
    assert len(next(transfer)) == 8
    with suppress(ProtocolError, StopIteration):
        answer_all(transfer, answers)


# --- during a cycle -----------------------------------------------------------------------------------------------


def test_an_upload_and_a_download_beside_the_cycle(bench: MakeBench) -> None:
    b = started(bench())
    sdo = b.rig.sdo("axis5")
    futures: list[Any] = [
        sdo.read(0x6502),
        sdo.upload(0x1008),
        sdo.write(0x605A, 0, 3),
        sdo.read(0x605A),
        sdo.read(0x60FF),
    ]
    b.run(60, torque=1.0)
    assert futures[0].result(SOON) == 0x3FF
    assert futures[1].result(SOON) == NAME
    assert futures[2].result(SOON) is None
    assert futures[3].result(SOON) == 3
    with pytest.raises(SdoError, match=r"axis5: read 0x60ff:00.*aborted with 0x06020000") as caught:
        futures[4].result(SOON)
    assert caught.value.code == 0x06020000
    assert b.rig.is_running


def test_at_most_one_sdo_frame_goes_out_per_cycle_and_always_behind_the_rpdos(bench: MakeBench) -> None:
    b = started(bench([axis(5), axis(6)]))
    begin = len(b.frames)
    futures = [b.rig.sdo(number % 2).upload(0x1008) for number in range(6)]
    b.run(80, torque=1.0)
    assert {future.result(SOON) for future in futures} == {NAME}
    cycles: list[list[int]] = []
    for _, can_id, _, is_rx in b.frames[begin:]:
        if can_id == 0x080:
            cycles.append([])
        elif not is_rx and cycles and can_id not in (0x77E,):
            cycles[-1].append(can_id)
    assert all(cycle[:2] == [0x205, 0x206] for cycle in cycles)
    assert all(len(cycle) <= 3 for cycle in cycles)
    assert sum(len(cycle) == 3 for cycle in cycles) == 6 * 6  # initiate and five segments each


def test_the_account_is_to_the_bit_the_same_with_and_without(bench: MakeBench) -> None:
    def run(asks: bool) -> tuple[list[object], list[int]]:
        b = started(bench())
        samples: list[object] = []
        for cycle in range(100):
            if asks and cycle % 10 == 0:
                b.rig.sdo(0).upload(0x1008)
                b.rig.sdo(0).write(0x605A, 0, cycle % 4)
            samples += b.run(1, torque=4.0 - 0.08 * cycle)
        return samples, b.torques_sent()

    assert run(asks=True) == run(asks=False)


def test_several_threads_ask_at_once(bench: MakeBench) -> None:
    b = started(bench([axis(5), axis(6)]))
    found: list[tuple[int, object]] = []

    def ask(number: int) -> None:
        sdo = b.rig.sdo(number % 2)
        for _ in range(5):
            found.append((number, sdo.read(0x6502).result(SOON)))
            found.append((number, sdo.upload(0x1008).result(SOON)))

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        b.run(1, torque=1.0)
    for number in range(4):
        assert [value for who, value in found if who == number] == [0x3FF, NAME] * 5


def test_what_is_hung_on_a_future_does_not_run_in_the_cycle(bench: MakeBench) -> None:
    b = started(bench())
    where: list[str] = []
    ran = threading.Event()
    future = b.rig.sdo(0).read(0x6502)
    future.add_done_callback(lambda _: (where.append(threading.current_thread().name), ran.set()))  # type: ignore[func-returns-value]
    b.run(10, torque=1.0)
    assert ran.wait(SOON)
    assert where == ["SDO results"]


def test_an_unanswered_request_is_repeated_and_then_fails_while_the_run_goes_on(bench: MakeBench) -> None:
    b = started(bench([axis(5, sdo_timeout=0.01)]))
    b.tampered.drop(0x585)
    future = b.rig.sdo(0).read(0x6502)
    b.run(50, torque=1.0)
    with pytest.raises(SdoError, match=r"node 5: no answer \(3 requests, 0.01 s each\)"):
        future.result(SOON)
    assert [data.hex() for data in b.sent(0x605)[-4:]] == ["4002650000000000"] * 3 + ["8002650000000405"]
    assert b.rig.is_running


def test_the_repeated_request_is_enough_when_the_first_is_lost(bench: MakeBench) -> None:
    b = started(bench([axis(5, sdo_timeout=0.01)]))
    b.tampered.drop(0x585)
    future = b.rig.sdo(0).read(0x6502)
    b.run(5, torque=1.0)
    b.tampered.drop()
    b.run(20, torque=1.0)
    assert future.result(SOON) == 0x3FF


def test_answers_to_nobody_are_put_aside(bench: MakeBench) -> None:
    b = started(bench())
    future = b.rig.sdo(0).read(0x6502)
    b.run(1, torque=1.0)
    late = b.links[0].statistics.late
    for data in ("4b 41 60 00 00 00 00 00", "80 41 60 00 00 00 02 06", "00 00 00 00 00 00 00 00", "01"):
        frame = bytes.fromhex(data)
        b.rig.drives[0].link._handlers[0x585](bytearray(frame))
    b.run(10, torque=1.0)
    assert future.result(SOON) == 0x3FF
    assert b.links[0].statistics.late == late + 3
    assert b.links[0].statistics.short == 1


def test_a_stop_fails_what_waits_and_leaves_the_sdo_channel_of_the_rig_as_it_was(bench: MakeBench) -> None:
    b = started(bench())
    futures = [b.rig.sdo(0).upload(0x1008) for _ in range(3)]
    b.run(4, torque=1.0)
    b.rig.stop()
    for future in futures:
        with pytest.raises(SdoError, match="the rig has stopped before"):
            future.result(SOON)
    assert b.drives[0].state is DriveState.SWITCH_ON_DISABLED
    assert b.rig.drives[0].sdo.read(0x6502) == 0x3FF
    b.rig.start()  # and once more
    again = b.rig.sdo(0).read(0x6502)
    b.run(10)
    assert again.result(SOON) == 0x3FF


def test_a_request_that_was_cancelled_is_never_sent(bench: MakeBench) -> None:
    b = started(bench())
    sent = len(b.sent(0x605))
    future = b.rig.sdo(0).read(0x6502)
    assert future.cancel()
    b.run(5, torque=1.0)
    assert len(b.sent(0x605)) == sent
    with pytest.raises(CancelledError):
        future.result(SOON)


# --- refused ------------------------------------------------------------------------------------------------------


def test_it_is_refused_while_the_rig_does_not_run(bench: MakeBench) -> None:
    b = bench()
    with pytest.raises(SdoError, match="the rig is not running"):
        b.rig.sdo(0).read(0x6502)
    started(b)
    b.rig.stop()
    with pytest.raises(SdoError, match="the rig is not running"):
        b.rig.sdo(0).read(0x6502)


def test_it_is_refused_where_the_bus_has_no_room(bench: MakeBench) -> None:
    b = started(bench([axis(5), axis(6)], bus={"emcy_reserve": 0, "rate": 1150.0}))
    with pytest.raises(SdoError, match=r"the bus has no time left for SDO during the cycle; lower bus\.rate"):
        b.rig.sdo(0).read(0x6502)


@pytest.mark.slow_but("24640", "24689", "4118", "5120", "6656")
@pytest.mark.parametrize(
    "index",
    [
        *(0x6040, 0x6071, 0x6060, 0x6072, 0x1016, 0x1017, 0x1400, 0x1A00, 0x1005, 0x6007),
        *(0x60FE, 0x60E0, 0x60E1, 0x607E, 0x60A8, 0x6093, 0x1029, 0x100C, 0x605E),
    ],
)
def test_what_belongs_to_the_cycle_is_written_by_nobody_else(bench: MakeBench, index: int) -> None:
    b = started(bench())
    sent = len(b.sent(0x605))
    with pytest.raises(SdoError, match="it belongs to the cycle while the rig runs; stop the rig first"):
        b.rig.sdo(0).write(index, 0, 1)
    b.run(3)
    assert len(b.sent(0x605)) == sent


def test_what_does_not_exist_is_refused(bench: MakeBench) -> None:
    b = started(bench())
    for name in ("axis7", 1, -1):
        with pytest.raises(InputError, match="expected one of: axis5, or 0 to 0"):
            b.rig.sdo(name)
    with pytest.raises(SdoError, match="does not exist"):
        b.rig.sdo(0).read(0x10000)
    with pytest.raises(SdoError, match="300 does not fit 1 bytes"):
        b.rig.sdo(0).write(0x2000, 0, 300, size=1)


def test_too_many_requests_are_refused(bench: MakeBench) -> None:
    b = started(bench())
    for _ in range(1000):
        b.rig.sdo(0).read(0x6502)
    with pytest.raises(SdoError, match="1000 requests are waiting already"):
        b.rig.sdo(0).read(0x6502)


def test_the_room_is_that_of_a_request_behind_the_worst_cycle_or_in_place_of_an_emcy(bench: MakeBench) -> None:
    """One axis: SYNC 55, TPDO 135, RPDO 95, blocking 135, heartbeats 130, host 20: 570 us; a request 135."""
    plan = [bench().rig.drives[0].map]
    for rate, reserve, room in ((1754.0, 0, False), (1418.0, 0, True), (1419.0, 0, False), (1418.0, 1, True)):
        parameters = CanBusParameters(rate=rate, emcy_reserve=reserve)
        budget = bus_budget(parameters, plan)
        assert budget.fits
        assert has_room_for_sdo(budget, parameters) is room


def test_a_cycle_that_is_too_long_by_half_a_bit_has_no_room_for_a_request_either(bench: MakeBench) -> None:
    parameters = CanBusParameters(rate=1000.0, emcy_reserve=1)
    budget = bus_budget(parameters, [bench().rig.drives[0].map])
    for bits, room in ((0.0, True), (0.5, False)):
        full = replace(budget, sample_time=budget.worst_cycle - bits / budget.bitrate)
        assert has_room_for_sdo(full, parameters) is room


def test_a_part_that_is_not_answered_was_asked_for_once_whatever_came_before(bench: MakeBench) -> None:
    b = started(bench([axis(5, sdo_timeout=0.01)]))
    answers: list[bytes] = []

    def first_alone(message: can.Message) -> can.Message | None:
        if message.arbitration_id == 0x585:
            answers.append(bytes(message.data))
            return message if len(answers) == 1 else None
        return message

    b.tampered.on_receive = first_alone
    future = b.rig.sdo(0).upload(0x1008)
    b.run(50, torque=1.0)
    with pytest.raises(SdoError, match=r"no answer \(1 requests"):
        future.result(SOON)
