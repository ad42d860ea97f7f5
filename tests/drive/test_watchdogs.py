"""By what a drive notices a dead master: its heartbeat, guard requests or RPDOs; and what other masters left armed."""

import re
from itertools import pairwise
from pathlib import Path

import can
import pytest

from canhaptic.canopen.eds import read_dictionary
from canhaptic.drive.axis_parameters import AxisParameters, CanBusParameters
from canhaptic.drive.can.bus_budget import bus_budget
from canhaptic.drive.can.pdo_map import check_dictionary, choose_map
from canhaptic.drive.profile.fitness import Verdict
from canhaptic.errors import DictionaryError
from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.drive.drive_bench import OUR_EDS, Bench, MakeBench, axis, started

MILLISECOND = 1_000_000
SILENCE = 100 * MILLISECOND  # of the master that the drives of these tests tolerate
GUARDING = """
[100C]
ParameterName=Guard time
ObjectType=0x7
DataType=0x0006
AccessType=rw
DefaultValue=0
PDOMapping=0

[100D]
ParameterName=Life time factor
ObjectType=0x7
DataType=0x0005
AccessType=rw
DefaultValue=0
PDOMapping=0
"""


def lacking(folder: Path, *sections: str, guarding: bool = False) -> Path:
    """Our dictionary with objects that are read-only, and with the objects of life guarding if asked."""
    text = OUR_EDS.read_text(encoding="utf-8")
    for section in sections:
        text, count = re.subn(rf"(\[{section}\][^\[]*?AccessType=)rw", r"\1ro", text)
        assert count == 1, section
    if guarding:
        text = re.sub(
            r"(\[OptionalObjects\]\nSupportedObjects=)(\d+)",
            lambda found: f"{found[1]}{int(found[2]) + 2}\n{int(found[2]) + 1}=0x100C\n{int(found[2]) + 2}=0x100D",
            text,
        )
        text += GUARDING
    path = folder / "odd.eds"
    path.write_text(text, encoding="utf-8")
    return path


def of(folder: Path, means: str) -> AxisParameters:
    eds = {
        "heartbeat": lambda: lacking(folder, guarding=True),
        "life_guarding": lambda: lacking(folder, "1016sub1", guarding=True),
        "rpdo_timer": lambda: lacking(folder, "1016sub1"),
    }[means]()
    return axis(eds=eds)


def until_torque_is_gone(b: Bench) -> int:
    """Time from the last frame of a master that is killed to zero torque [ns]."""
    drive, last = b.drives[0], b.frames[-1][0]
    assert drive.torque != 0.0
    while drive.torque != 0.0 and b.clock.now() - last < 10 * SILENCE:
        b.links[0].pump(b.clock.now() + MILLISECOND // 2)
    return b.clock.now() - last


@pytest.mark.parametrize(
    ("means", "code"), [("heartbeat", "30 81"), ("life_guarding", "30 81"), ("rpdo_timer", "50 82")]
)
def test_a_dead_master_leaves_no_torque_by_any_standard_means(bench: MakeBench, tmp_path, means: str, code: str):
    b = started(bench, [of(tmp_path, means)])
    b.run(300, torque=2.0)  # the master is well: nothing fires
    assert b.drives[0].torque == pytest.approx(2.0)
    assert until_torque_is_gone(b) <= SILENCE + 3 * MILLISECOND
    assert b.drives[0].state is DriveState.FAULT_REACTION_ACTIVE
    assert b.received(0x085)[-1][:2] == bytes.fromhex(code)


@pytest.mark.parametrize("means", ["heartbeat", "life_guarding", "rpdo_timer"])
def test_the_watchdog_ends_with_the_run_and_leaves_the_drive_as_it_was(bench: MakeBench, tmp_path, means: str) -> None:
    b = bench([of(tmp_path, means)])
    before = {place: b.drives[0].store.read(*place) for place in ((0x1016, 1), (0x1017, 0), (0x1400, 5))}
    for _ in range(2):
        b.rig.start()
        b.run(50, torque=0.5)
        b.rig.stop()
        b.links[0].pump(b.clock.now() + 5 * SILENCE)
        assert b.drives[0].state is DriveState.SWITCH_ON_DISABLED
        assert not b.received(0x085)
    assert {place: b.drives[0].store.read(*place) for place in before} == before


def test_a_guarded_drive_answers_each_request_with_another_bit(bench: MakeBench, tmp_path: Path) -> None:
    b = started(bench, [of(tmp_path, "life_guarding")])
    begin = len(b.received(0x705))
    b.run(200)
    answers = [data[0] for data in b.received(0x705)[begin:]]
    assert set(answers) == {0x05, 0x85}
    assert all(one != next_ for one, next_ in pairwise(answers))
    assert [data[4:6].hex() for data in b.sent(0x605) if data[:4].hex() == "2b0c1000"] == ["1400"]  # 20 ms
    assert [data[4] for data in b.sent(0x605) if data[:4].hex() == "2f0d1000"] == [5]
    assert len(answers) + 1 >= 200 // 20


def test_answers_whose_bit_does_not_change_are_no_sign_of_life(bench: MakeBench, tmp_path: Path) -> None:
    b = started(bench, [of(tmp_path, "life_guarding")])
    b.run(50)

    def stuck(message: can.Message) -> can.Message:
        if message.arbitration_id == 0x705:
            message.data[0] = 0x05
        return message

    b.tampered.on_receive = stuck
    with pytest.raises(Exception, match="heartbeat stopped"):
        b.run(200)
    assert b.drives[0].torque == 0.0


@pytest.mark.parametrize("late_step", ["configuration", "zero torque"])
def test_no_watchdog_waits_in_vain_while_another_drive_is_slow(bench: MakeBench, late_step: str) -> None:
    """Answers of the second drive are lost until the request is repeated 0.3 s later."""
    b = bench([axis(5), axis(6)])
    index = {"configuration": "7260", "zero torque": "7160"}[late_step]
    lost: list[bytes] = []

    def lose(message: can.Message) -> can.Message | None:
        is_meant = message.arbitration_id == 0x586 and message.data[:3].hex() in (f"4b{index}", f"60{index}")
        if is_meant and len(lost) < 2:
            lost.append(bytes(message.data))
            return None
        return message

    b.tampered.on_receive = lose
    b.rig.start()
    assert lost
    armed = next(time for time, can_id, data, _ in b.frames if can_id == 0x605 and data[:4].hex() == "23161001")
    beats = [armed, *(time for time, can_id, _, is_rx in b.frames if can_id == 0x77E and not is_rx and time >= armed)]
    assert max(later - sooner for sooner, later in pairwise(beats)) < SILENCE // 2


def test_guarding_that_another_master_left_is_cleared_where_it_is_not_needed_and_put_back(bench: MakeBench, tmp_path):
    b = bench([of(tmp_path, "heartbeat")], objects={0x100C: 100, 0x100D: 3})
    store = b.drives[0].store
    b.rig.start()
    assert store.read(0x100C, 0) == b"\0\0"
    assert "0x100C was 100 ms and 0x100D 3 at the start, and this start cleared them" in b.rig.drives[0].guarding
    b.rig.stop()
    assert (store.read(0x100C, 0), store.read(0x100D, 0)) == (b"\x64\0", b"\x03")


def test_timers_of_the_process_data_are_cleared_and_put_back(bench: MakeBench) -> None:
    b = bench(objects={"0x1800.3": 300, "0x1800.5": 7, "0x1400.5": 9})
    store, places = b.drives[0].store, ((0x1800, 3), (0x1800, 5), (0x1400, 5))
    before = [store.read(*place) for place in places]
    b.rig.start()
    b.run(20)
    assert [store.read(*place) for place in places] == [b"\0\0"] * 3
    b.rig.stop()
    assert [store.read(*place) for place in places] == before


# --- before anything is sent --------------------------------------------------------------------------------------


def judged(parameters: AxisParameters) -> tuple[Verdict, str]:
    found = check_dictionary(read_dictionary(parameters.eds, 5), parameters, CanBusParameters(rate=1000.0))
    return next((one.verdict, one.text) for one in found if one.item.startswith("0x1016"))


@pytest.mark.parametrize(
    ("means", "words"),
    [("heartbeat", "(0x1016)"), ("life_guarding", "guard requests (0x100C, 0x100D)"), ("rpdo_timer", "its RPDO")],
)
def test_the_dictionary_says_which_watchdog_is_armed(tmp_path: Path, means: str, words: str) -> None:
    parameters = of(tmp_path, means)
    verdict, text = judged(parameters)
    assert verdict is Verdict.FIT
    assert words in text
    assert choose_map(read_dictionary(parameters.eds, 5), parameters).watchdog == means


def test_a_drive_without_any_is_refused_and_all_three_are_named(bench: MakeBench, tmp_path: Path) -> None:
    eds = lacking(tmp_path, "1016sub1", "1400sub5")
    with pytest.raises(DictionaryError, match=r"0x1016:01 .*0x100c:00 .*0x100d:00 .*0x1400:05 .*watchdog: false"):
        bench([axis(eds=eds)])
    assert judged(axis(eds=eds, watchdog=False))[0] is Verdict.UNKNOWN


def test_a_means_that_the_drive_lacks_names_one_that_it_has(bench: MakeBench) -> None:
    with pytest.raises(DictionaryError, match=r"0x100c:00 is missing.*set watchdog: heartbeat"):
        bench([axis(watchdog="life_guarding")])


def test_guard_requests_are_part_of_the_budget(tmp_path: Path) -> None:
    bus = CanBusParameters(rate=1000.0)
    maps = [choose_map(read_dictionary(p.eds, 5), p) for p in (axis(), of(tmp_path, "life_guarding"))]
    beaten, guarded = (bus_budget(bus, [one]) for one in maps)
    assert guarded.worst_cycle - beaten.worst_cycle == pytest.approx(55e-6)  # a frame without data at 1 Mbit/s
    assert "1 guard request x 55" in guarded.arithmetic()
