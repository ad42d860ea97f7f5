"""What a start wrote is put back once a drive is disabled; what is not, is named."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from canhaptic.canopen.eds import read_dictionary
from canhaptic.cli.main import main
from canhaptic.drive.axis_parameters import AxisParameters
from canhaptic.logs.energy_reader import EnergyLog
from tests.drive.drive_bench import OUR_EDS, REPOSITORY, Bench, MakeBench, axis, started
from tests.drive.odd_slave import OddSlave
from tests.drive.test_odd_habits import odd_bench
from tests.drive.test_start import VENDOR_FILES

COMMANDS = (0x6040, 0x6071, 0x607A, 0x60FF)
LIMITS = (0x6072, 0x607F, 0x6080)
TRAITS = Path(__file__).parents[1] / "sim_drive" / "eds"
OUR_DICTIONARIES = [TRAITS / f"{name}.eds" for name in ("fixed_maps", "array_maps", "empty_entries")]
DISPLAY = str(REPOSITORY / "configs" / "admittance" / "virtual_mass.yaml")
WITH_RAMPS = REPOSITORY / "eds" / "cia402_admittance.eds"


def values(bench: Bench) -> dict[tuple[int, int], Any]:
    """Every object of the simulated drive that keeps what is written to it."""
    entries = bench.drives[0].store._entries  # what no master sees: the test must not ask by SDO
    return {place: entry.value for place, entry in entries.items() if entry.writable and place[0] not in COMMANDS}


def written(bench: Bench) -> set[tuple[int, int]]:
    """Objects that SDO has written."""
    requests = [data for data in bench.sent(0x605) if data[0] & 0xE0 == 0x20]
    return {(int.from_bytes(data[1:3], "little"), data[3]) for data in requests} - {(0x6040, 0)}


def run_and_compare(bench: Bench) -> tuple[set[tuple[int, int]], set[tuple[int, int]], list[str]]:
    """Returns the objects that differ after a run, all that were written, and what the drive says of them."""
    bench.clock.wait_until(1)  # power on
    before = values(bench)
    bench.rig.start()
    bench.run(5, 1.0)
    assert {place for place, value in values(bench).items() if value != before[place]}
    bench.rig.stop()
    after = values(bench)
    differing = {place for place in before if before[place] != after[place]}
    return differing, written(bench), bench.rig.drives[0].unrestored


def test_all_that_a_start_wrote_is_put_back_but_the_limit_which_is_named(bench: MakeBench) -> None:
    b = bench(objects={"0x1A00.1": 0x60640020, "0x1A00.0": 1, "0x6072": 700, "0x6060": 1, "0x6007": 0})
    differing, all_written, named = run_and_compare(b)
    assert {(0x1A00, 0), (0x1A00, 1), (0x1800, 2), (0x1017, 0), (0x1016, 1), (0x6060, 0)} <= all_written
    assert differing == {(0x6072, 0)}
    assert len(named) == 1
    assert named[0].endswith(
        "is 800, was 700 before the run; the run leaves its limits in the drive, unless restore_limits is true"
    )


def test_limits_are_put_back_where_the_scene_says_so(bench: MakeBench) -> None:
    b = bench([axis(restore_limits=True)], objects={"0x6072": 700})
    differing, all_written, named = run_and_compare(b)
    assert (0x6072, 0) in all_written
    assert differing == set()
    assert named == []


@pytest.mark.parametrize("eds", [OUR_EDS, *OUR_DICTIONARIES], ids=lambda path: path.stem)
def test_no_object_of_a_dictionary_differs_after_a_run_that_is_not_named(bench: MakeBench, eds: Path) -> None:
    compare_all(bench, eds)


@pytest.mark.parametrize("name", VENDOR_FILES)
def test_no_object_of_a_vendors_dictionary_differs_after_a_run(bench: MakeBench, vendor_eds: Path, name: str) -> None:
    compare_all(bench, vendor_eds / name)


def compare_all(bench: MakeBench, eds: Path) -> None:
    listed = read_dictionary(eds, 5)
    b = bench([axis(eds=eds)], objects={0x6502: 0x3FF} if 0x6502 in listed else {})
    differing, all_written, named = run_and_compare(b)
    assert len(all_written) > 5
    reasons = {(int(text[2:6], 16), int(text[7:9], 16)): text for text in named}
    assert differing <= set(reasons)
    for place in differing - {(0x1A19, 0)}:  # of one drive: two entries of 0, which no drive takes for a map
        assert place[0] in LIMITS or reasons[place].endswith("unknown before"), reasons[place]


def test_what_was_written_last_is_put_back_first(bench: MakeBench) -> None:
    b = bench(objects={"0x1A00.1": 0x60640020, "0x1A00.0": 1})
    run_and_compare(b)
    requests = [data for data in b.sent(0x605) if data[0] & 0xE0 == 0x20 and data[1:3] in (b"\x00\x18", b"\x00\x1a")]
    places = [(data[2], data[3]) for data in requests]
    half = len(places) // 2
    undone = [place for place in places[half:] if place in places[:half]]
    assert places[0] == (0x18, 1)  # switched off first, by the start and by the stop
    assert undone[-1] == (0x18, 1)
    assert places[half:].index((0x1A, 0)) < places[half:].index((0x1A, 1))


def stop_after(act: Callable[[OddSlave], None]) -> tuple[OddSlave, list[str], dict[tuple[int, int], bytes]]:
    with odd_bench("torque") as b:
        before = dict(b.slave.objects)
        b.slave.script = {20: act}
        b.run()
        return b.slave, b.rig.drives[0].unrestored, before


def test_a_drive_in_fault_is_left_as_it_is_and_each_object_is_named() -> None:
    slave, named, _ = stop_after(lambda slave: slave.fault(0x7120))
    assert slave.objects[0x1017, 0] == b"\x14\x00"  # of the start
    assert any(text.startswith("0x1017:00") and "shows FAULT" in text for text in named)


def test_a_silent_drive_is_not_asked_again_and_again() -> None:
    def fall_silent(slave: OddSlave) -> None:
        slave.has_heartbeat, slave.is_deaf_to_sdo = False, True
        slave.hears = lambda message: False

    slave, named, _ = stop_after(fall_silent)
    assert slave.objects[0x1017, 0] == b"\x14\x00"
    assert any(text.startswith("0x1017:00") and "no answer" in text for text in named)


def test_a_drive_that_takes_no_value_back_is_named_and_the_rest_is_put_back() -> None:
    def refuse(slave: OddSlave) -> None:
        slave.aborts[0x6007, 0] = bytes.fromhex("30 00 09 06")

    slave, named, before = stop_after(refuse)
    assert [text[:9] for text in named] == ["0x6072:00", "0x6007:00"]
    assert "is 1, was 0 before" in named[1]
    kept = {(0x6072, 0), (0x6007, 0), (0x6040, 0), (0x6071, 0), (0x6061, 0)}
    assert {place for place in before if before[place] != slave.objects[place]} <= kept


def test_a_refused_start_puts_back_what_it_wrote() -> None:
    with odd_bench("torque") as b:
        before = dict(b.slave.objects)
        b.slave.refuses_mode = True
        assert b.run() is not None
        differing = {place for place in before if before[place] != b.slave.objects[place]}
        assert differing <= {(0x6072, 0), (0x6040, 0), (0x6071, 0)}


def test_objects_that_the_scene_sets_are_written_and_put_back(bench: MakeBench) -> None:
    b = started(bench, [axis(eds=WITH_RAMPS, drive_objects={0x6085: 5000})], objects={"0x6085": 70})
    assert b.drives[0].store.find(0x6085).number == 5000
    b.rig.stop()
    assert b.drives[0].store.find(0x6085).number == 70


@pytest.mark.slow
def test_a_display_leaves_no_steepest_ramp_behind(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """0x6083 to 0x6085, 0x60C5 and 0x60C6 are as before; the log of the run names the limit that is kept."""
    log, bus_log = tmp_path / "run.h5", tmp_path / "run.log"
    words = ["--duration", "0.05", "--log", str(log), "--bus-log", str(bus_log), "--json"]
    assert main(["run", DISPLAY, *words]) == 0
    assert list(json.loads(capsys.readouterr().out)["unrestored"]["handle"]) == [
        "0x6072:00 Max torque is 2000, was 1000 before the run; the run leaves its limits in the drive, "
        "unless restore_limits is true"
    ]
    with EnergyLog.open(log) as opened:
        assert [(event.kind, event.port) for event in opened.events] == [("stopping", ""), ("unrestored", "handle")]
    ends: dict[str, str] = {}
    for line in bus_log.read_text().splitlines():
        head, _, data = line.split()[2].partition("#")
        if head == "601" and data[:2] == "23":
            ends[data[4:6] + data[2:4]] = data[8:]
    assert {index: ends[index] for index in ("6083", "6084", "6085")} == dict.fromkeys(
        ("6083", "6084", "6085"), "10270000"
    )


def test_check_and_commission_read_what_the_drive_keeps_and_name_limits_that_are_too_narrow(capsys, tmp_path) -> None:
    eds = tmp_path / "display.eds"
    text = Path(WITH_RAMPS).read_text(encoding="utf-8")
    for sub, value in ((1, -200), (2, 200)):
        text += f"\n[607Dsub{sub}]\nParameterName=Limit {sub}\nObjectType=0x7\nDataType=0x0004\nAccessType=rw\n"
        text += f"DefaultValue={value}\nPDOMapping=0\n"
    eds.write_text(text + "\n[607D]\nParameterName=Position limit\nObjectType=0x8\nSubNumber=3\n", encoding="utf-8")
    given = [f"axes.0.eds={eds}", "axes.0.admittance.position_high=0.1", "axes.0.drive_objects={0x6085: 9}"]
    words = [word for override in given for word in ("--set", override)]
    main(["check", DISPLAY, "--bus", "--json", *words])
    rows = {row["item"][:9]: row for row in json.loads(capsys.readouterr().out)["objects"]["handle"]}
    assert rows["0x6085:00"]["text"].startswith("10000, the start writes 9: quick stop deceleration")
    assert "position_low or position_high is at" in rows["0x607d:02"]["text"]
    assert rows["0x607d:02"]["verdict"] == "unknown"


@pytest.mark.parametrize("key", [0x6071, "0x607D", "0x607D.3", "0x6072", "window"])
def test_no_other_object_can_be_set_by_a_scene(key: object) -> None:
    with pytest.raises(ValueError, match=r"expected one of: 0x6065, 0x6066, 0x607D\.1"):
        AxisParameters(name="a", node_id=1, eds=OUR_EDS, counts_per_unit=1.0, torque_limit=1.0, drive_objects={key: 1})
