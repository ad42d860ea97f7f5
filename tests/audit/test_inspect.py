import json
import math
import re
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from canhaptic.audit.inspection import Inspection, _quantiles, compare, contacts, inspect
from canhaptic.audit.user_checks import check
from canhaptic.control.balance import Branch, Certificate, EnergyBalance
from canhaptic.control.ledger import Ledger
from canhaptic.cycle import run
from canhaptic.errors import InputError
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.result import overall
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from tests.view import typed
from tests.view.synthetic_run import write_run, write_troubled_run

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
Captured = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("inspect") / "run.h5"
    write_run(path, 4000)
    return path


@pytest.fixture(scope="module")
def account(log: Path) -> Inspection:
    with EnergyLog.open(log) as opened:
        return inspect(opened)


def balances(log: EnergyLog, rows: slice) -> list[EnergyBalance]:
    port = log.ports["handle"]
    names = ["torque_command" if name == "torque" else name for name in EnergyBalance._fields]
    return [EnergyBalance(*row) for row in zip(*(port[name][rows].tolist() for name in names), strict=True)]


@pytest.mark.slow_but("None-None")
@pytest.mark.parametrize(("start", "stop"), [(None, None), (1.0, 3.0), (0.9, 1.0)])
def test_the_account_equals_that_of_the_ledger_of_the_run(log: Path, start: float | None, stop: float | None) -> None:
    with EnergyLog.open(log) as opened:
        found = inspect(opened, start, stop)["ports"]["handle"]
        first = round((start or 0.0) * 1000)
        ledger = Ledger()
        for cycle, balance in enumerate(balances(opened, slice(first, None if stop is None else round(stop * 1000)))):
            ledger.add(balance, first + cycle)
        expected = {**ledger.summary().as_json(1e-3), "open_hold": stop is None}  # the log ends while a torque acts
    for name, value in expected.items():
        if isinstance(value, float):
            assert found[name] == pytest.approx(value, rel=1e-12, abs=1e-15), name
        elif name == "margin":
            assert found[name]["value"] == pytest.approx(value["value"], rel=1e-12)
            cycle = value["cycle"] or first  # a margin that never fell below zero is least at the first cycle
            assert (found[name]["cycle"], found[name]["time"]) == (cycle, pytest.approx(cycle * 1e-3))
        else:
            assert found[name] == (pytest.approx(value, rel=1e-12) if name == "surplus" else value), name


@pytest.mark.slow
def test_the_hold_in_which_the_hand_leaves_does_not_count_as_damping_that_was_not_rendered(account, tmp_path):
    path = tmp_path / "run.h5"
    write_run(path, 4000)
    before = account["ports"]["handle"]["damping_rendered"]
    with h5py.File(path, "r+") as file:
        branch = file["ports/handle/branch"][:]
        [left, *_] = np.flatnonzero((branch[:-1] != Branch.FREE) & (branch[1:] == Branch.FREE)) + 1
        branch[left] = Branch.EXIT
        file["ports/handle/branch"][:] = branch
    with EnergyLog.open(path) as opened:
        after = inspect(opened)["ports"]["handle"]
    assert after["branches"]["exit"] == 1
    assert after["damping_rendered"] == before
    assert (before["least"] or 0.0) > 0.0


def test_a_hold_held_on_neither_begins_nor_ends_a_contact() -> None:
    free, start, exact, held = (Branch[name].value for name in ("FREE", "START", "EXACT", "HELD"))
    branch = [held, free, held, held, start, held, exact, free, held, start, held, held]
    assert contacts(np.array(branch)) == [(4, 6), (9, 11)]
    assert contacts(np.array([held, held])) == contacts(np.array([], int)) == []


def test_contacts_are_found_with_depth_peak_and_energy(log: Path, account: Inspection) -> None:
    found = account["contacts"]["handle"]
    with EnergyLog.open(log) as opened:
        port = opened.ports["handle"]
        assert len(found) == 3
        rows = slice(round(found[0]["start"] * 1000), round((found[0]["start"] + found[0]["duration"]) * 1000))
        assert (port["branch"][rows] == 2).all()
        assert port["branch"][rows.stop] == 0
        assert found[0]["energy"] == pytest.approx(math.fsum(port["h_i"][rows]), rel=1e-9)
        assert found[0]["peak_torque"] == np.abs(port["torque_applied"][rows]).max()
        assert found[0]["depth"] == np.abs(port["state"][rows]).max()


@pytest.mark.slow
def test_in_the_wall_of_user_code_in_its_own_process_the_depth_is_measured_and_of_a_program_not_known(
    log: Path, account: Inspection, tmp_path: Path
) -> None:
    states = [contact["depth"] for contact in account["contacts"]["handle"]]
    path = tmp_path / "requested.h5"
    path.write_bytes(log.read_bytes())
    with h5py.File(path, "r+") as file:
        file.attrs["handle.guard"] = "certificates"
        file["ports/handle/state"][:] = 0.0
    with EnergyLog.open(path) as opened:
        found = inspect(opened)
        deepest = -0.02 - opened.ports["handle"]["position"].min()
    depths = [contact["depth"] for contact in found["contacts"]["handle"]]
    assert depths == pytest.approx(states, abs=1e-12)
    assert max(depth or 0.0 for depth in depths) == deepest
    assert (found["ports"]["handle"]["dissipated"], check(found, "in > 0 J")[0]["holds"]) == (None, True)
    with h5py.File(path, "r+") as file:
        del file.attrs["handle.wall_position"]
    with EnergyLog.open(path) as opened:
        assert {contact["depth"] for contact in inspect(opened)["contacts"]["handle"]} == {None}


@pytest.mark.slow
def test_syncs_that_were_skipped_in_a_contact_are_part_of_its_time(log: Path, account: Inspection, tmp_path) -> None:
    before = account["contacts"]["handle"]
    path = tmp_path / "late.h5"
    path.write_bytes(log.read_bytes())
    within = round(1000 * (before[0]["start"] + 0.5 * before[0]["duration"]))
    with h5py.File(path, "r+") as file:
        file["timing/deadline_index"][within:] += 5
    with EnergyLog.open(path) as opened:
        found = inspect(opened)["contacts"]["handle"]
    assert found[0]["duration"] == pytest.approx(before[0]["duration"] + 0.005)
    assert found[1]["start"] == pytest.approx(before[1]["start"] + 0.005)
    assert found[1]["duration"] == pytest.approx(before[1]["duration"])


def test_quantiles_are_values_that_occurred() -> None:
    assert _quantiles(np.arange(1, 1001) * 1000) == pytest.approx(
        {"p50": 501e-6, "p99": 991e-6, "p99.9": 1000e-6, "max": 1000e-6}, rel=1e-9
    )


@pytest.mark.slow
def test_a_part_says_where_it_begins_and_ends(log: Path, account: Inspection) -> None:
    with EnergyLog.open(log) as opened:
        whole, part = account, inspect(opened, 1.0, 3.0)
    assert (whole["from"], whole["to"], whole["cycles"]) == pytest.approx((0.0, 3.999, 4000))
    assert (part["from"], part["to"], part["cycles"]) == pytest.approx((1.0, 2.999, 2000))


def test_no_check_passes_on_a_log_that_holds_no_cycle(tmp_path: Path) -> None:
    write_run(tmp_path / "run.h5", 0)
    with EnergyLog.open(tmp_path / "run.h5") as opened:
        result = inspect(opened)
    for expression in ("passive", "margin >= -1 uJ"):
        with pytest.raises(InputError, match="the run has no cycle"):
            check(result, expression)


def test_a_part_without_a_cycle_is_refused(log: Path) -> None:
    with EnergyLog.open(log) as opened, pytest.raises(InputError, match=r"the log ends at 3\.999 s"):
        inspect(opened, 5.0, None)


def test_the_worst_of_a_run_is_in_its_account(log: Path, account: Inspection, tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    path.write_bytes(log.read_bytes())
    with h5py.File(path, "r+") as file:
        port = file["ports/handle"]
        port["statusword"][20:25] |= 0x0800  # internal limit active
        port["torque_applied"][7] = -99.0
        certified = int(np.flatnonzero(port["torque_command"][:])[0])  # holds without a torque have no certificate
        port["certificate"][certified] = Certificate.HAND_SPEED
    before = account["ports"]["handle"]
    with EnergyLog.open(path) as opened:
        after = inspect(opened)["ports"]["handle"]
    assert (before["limited_cycles"], after["limited_cycles"]) == (0, 5)
    assert (before["peak_torque"] < 99.0, after["peak_torque"]) == (True, 99.0)
    assert (before["certificate"], after["certificate"]) == ("exact", "hand_speed")


@pytest.mark.slow
def test_late_cycles_and_lost_frames_are_counted(tmp_path: Path) -> None:
    write_troubled_run(tmp_path / "run.h5")
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        file["timing/dropped_before"][60] = 4
        file.attrs["rows_lost"] = 7
    with EnergyLog.open(tmp_path / "run.h5") as opened:
        result, part = inspect(opened), inspect(opened, 0.045)
    assert result["timing"]["deadlines_missed"] == 1
    assert result["timing"]["cycle_time"]["p50"] == pytest.approx(55e-6)
    assert result["timing"]["wakeup_lateness"] == pytest.approx(
        {"p50": 900e-6, "p99": 950e-6, "p99.9": 950e-6, "max": 950e-6}
    )
    assert result["link"] == {
        "success_rate": 0.97, "missing": 3, "cycles_without_row": 2, "dropped_by_log": 4, "lost_by_damage": 7,
        "skipped_syncs": 0,
    }  # fmt: skip
    assert part["timing"]["deadlines_missed"] == 0
    assert (part["link"]["missing"], part["link"]["cycles_without_row"]) == (1, 0)


@pytest.mark.slow_but("cycles?<?4000*", "margin?>=*", "surplus*")
@pytest.mark.parametrize(
    ("expression", "holds"),
    [
        ("margin>=-1e-6", False),
        ("margin >= -1 mJ", True),
        ("handle.margin.value >= -1 mJ", True),
        ("ports.handle.deficit == 0", True),
        ("surplus < 1uJ", False),
        ("compute.p99.9 <= 7 us", True),
        ("success_rate >= 1", True),
        ("cycles == 4000", True),
        ("cycles != 4000", False),
        ("cycles < 4000", False),
        ("cycles > 4000", False),
        ("cycles <= 4000", True),
        ("cycles >= 4000", True),
        ("cycles != 3999", True),
        ("in > 90 mJ", True),
        ("peak.torque < 1 kN", True),
        ("margin_value >= -1 mJ", True),
    ],
)
def test_checks_read_like_sentences(account: Inspection, expression: str, holds: bool) -> None:
    (outcome,) = check(account, expression)
    assert outcome["holds"] is holds


@pytest.mark.parametrize(
    ("expression", "message"),
    [
        ("margin", "NAME >="),
        ("margn>0", "did you mean margin"),
        ("foo>0", "no figure 'foo'; inspect --json lists"),
        ("in>1 xJ", "unknown unit"),
        ("in>1.2.3", "NAME >="),
    ],
)
def test_checks_that_cannot_be_read_are_refused(account: Inspection, expression: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        check(account, expression)


@pytest.mark.slow_but("cycles*", "margin*", "knob*")
@pytest.mark.parametrize(
    ("expression", "message"),
    [
        ("margin >= -1 m", "got m for ports.handle.margin.value, expected J, or the same with a prefix"),
        ("handle.margin.time < 1 J", "expected s, or the same"),
        ("peak_torque < 1 kg", "expected N, or the same"),
        ("damping_rendered.most < 1 N/m", "expected N*s/m, or the same"),
        ("branches.free > 3 s", "expected no unit: it is a pure number"),
        ("contact.holds > 3 J", "expected no unit"),
        ("max_consecutive_losses < 1 J", "expected no unit"),
        ("cycles == 4000 Hz", "expected no unit"),
        ("rate > 1 s", "expected Hz, or the same"),
        ("wakeup_lateness.max < 1 m", "expected s, or the same"),
        ("knob.passive", "the run has no account of that name"),
    ],
)
def test_a_check_with_the_unit_of_something_else_is_refused(account: Inspection, expression: str, message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        check(account, expression)


def test_every_figure_of_an_account_has_a_unit_that_a_check_takes(account: Inspection) -> None:
    result = account
    for name in ("in", "surplus.max", "margin", "least_interaction", "deficit", "leaked"):
        assert check(result, f"handle.{name} > -1 kJ")[0]["holds"], name
    assert check(result, "rate == 1 kHz")[0]["holds"]
    assert check(result, "handle.peak_torque < 1 kN")[0]["holds"]
    assert check(result, "wakeup_lateness.max < 1 s")[0]["holds"]


def test_the_verdict_is_one_word_for_machines(log: Path, account: Inspection, tmp_path, capsys) -> None:
    result = account
    assert (result["passive"], result["ports"]["handle"]["passive"]) == ("yes", "yes")
    assert [c["holds"] for c in check(result, "passive")] == [c["holds"] for c in check(result, "handle.passive")]
    active = tmp_path / "active.h5"
    active.write_bytes(log.read_bytes())
    with h5py.File(active, "r+") as file:
        file["ports/handle/h_i"][0] = -1.0
    assert typed.inspect(active, "--check", "passive") == 1
    assert "FAILS" in capsys.readouterr().out
    assert typed.inspect(active, "--json") == 1  # its digest is of the value that was written
    found = json.loads(capsys.readouterr().out)
    assert (found["passive"], found["ports"]["handle"]["passive"]) == ("no", "no")


def test_the_verdict_of_a_run_is_its_worst() -> None:
    doubtful = overall({"a": {"passive": "yes"}, "b": {"passive": "in doubt"}, "c": {"group": "b"}})
    assert doubtful == {"verdict": "in doubt", "passive": "in doubt"}
    assert overall({"a": {"passive": "no"}, "b": {"passive": "in doubt"}})["passive"] == "no"
    assert overall({}) == {"verdict": "in doubt", "passive": "in doubt"}
    by_plant: Any = {"a": {"passive": "yes", "verdict": "yes"}, "b": {"passive": "in doubt", "plant_passive": "no"}}
    assert overall(by_plant)["plant_passive"] == "no"
    words = ("no contact", "dry run", "yes", "in doubt", "nothing rendered", "no")
    for worst, better in zip(words[1:], words, strict=False):
        ports: Any = {"a": {"passive": "yes", "verdict": worst}, "b": {"passive": "yes", "verdict": better}}
        assert overall(ports)["verdict"] == worst


@pytest.mark.slow
def test_a_run_without_a_contact_fails_the_check_of_its_verdict(tmp_path: Path, capsys: Captured) -> None:
    scene = load_scene(CONFIGS / "demo.yaml", ["environment.position=-1"])
    with build(scene, energy_log=tmp_path / "run.h5") as experiment:
        run(experiment.cycle, 300)
    assert typed.inspect(tmp_path / "run.h5", "--check", "passive", "--json") == 1
    (outcome,) = json.loads(capsys.readouterr().out)["checks"]
    assert (outcome["value"], outcome["holds"]) == ("no contact", False)
    assert typed.inspect(tmp_path / "run.h5", "--check", "handle.passive") == 1
    shown = capsys.readouterr().out
    assert "no contact, so nothing was tested" in shown
    assert "the wall begins at -1" in shown


@pytest.mark.slow
def test_every_log_is_checked_and_a_failing_one_is_named(log: Path, tmp_path: Path, capsys: Captured) -> None:
    write_run(short := tmp_path / "short.h5", 3000)
    assert typed.inspect(log, short, "--check", "cycles >= 4000", "--json") == 1
    checks = json.loads(capsys.readouterr().out)["checks"]
    assert [(each["log"], each["holds"]) for each in checks] == [(str(log), True), (str(short), False)]
    assert typed.inspect(log, "--overlay", short, "--check", "cycles >= 3000") == 0
    shown = capsys.readouterr().out
    assert re.search(r"run\.h5 +cycles >= 3000 .*holds\s+short\.h5 +cycles >= 3000 .*holds", shown)
    with pytest.raises(InputError, match=r"short\.h5: check 'foo>0'|run\.h5: check 'foo>0'"):
        typed.inspect(log, short, "--check", "foo>0")


@pytest.mark.slow
def test_a_damaged_further_log_fails_and_is_named(log: Path, tmp_path: Path, capsys: Captured) -> None:
    assert typed.inspect(log, changed(log, tmp_path / "changed.h5")) == 1
    assert re.search(r"changed\.h5 .*: 1 row is not as the run wrote it", capsys.readouterr().out)


@pytest.mark.parametrize("option", ["--recompute", "--compare", "--bus-log", "--repair", "--csv", "--mat"])
def test_an_option_for_one_log_refuses_several(log: Path, tmp_path: Path, option: str) -> None:
    words = (option,) if option == "--recompute" else (option, tmp_path / f"out.{option[2:]}")
    with pytest.raises(InputError, match=rf"{option}: got .*run\.h5, .*expected one log"):
        typed.inspect(log, log, *words)


def test_a_bus_log_is_inspected_alone(log: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a bus log, expected alone"):
        typed.inspect(tmp_path / "frames.log", log)


def test_a_value_that_is_not_a_number_fails_every_check() -> None:
    assert not check({"ports": {"a": {"in": math.nan}}}, "in >= 0")[0]["holds"]


def changed(log: Path, path: Path) -> Path:
    path.write_bytes(log.read_bytes())
    with h5py.File(path, "r+") as file:
        file["ports/handle/h_r"][1234] += 1e-18
    return path


@pytest.mark.slow_but("0.0--0.0-True", "nan-nan-False")
@pytest.mark.parametrize(
    ("first", "second", "differ"),
    [(0.0, -0.0, True), (math.nan, math.nan, False), (math.nan, 1.0, True), (1.0, math.nextafter(1.0, 2.0), True)],
)
def test_comparison_is_of_bits(log: Path, tmp_path: Path, first: float, second: float, differ: bool) -> None:
    paths = tmp_path / "a.h5", tmp_path / "b.h5"
    for path, value in zip(paths, (first, second), strict=True):
        path.write_bytes(log.read_bytes())
        with h5py.File(path, "r+") as file:
            file["ports/handle/leak"][5] = value
    with EnergyLog.open(paths[0]) as left, EnergyLog.open(paths[1]) as right:
        found = compare(left, right)
    assert [entry["cycle"] for entry in found["differences"]] == ([5] if differ else [])
    assert found["identical"] is not differ


@pytest.mark.slow
def test_comparison_names_ports_and_rows_that_only_one_log_has(log: Path, tmp_path: Path) -> None:
    write_run(tmp_path / "two.h5", 3000, ("handle", "knob"))
    write_run(tmp_path / "short.h5", 3000)
    with EnergyLog.open(log) as whole, EnergyLog.open(tmp_path / "two.h5") as two:
        assert compare(whole, two)["missing"] == compare(two, whole)["missing"] == ["ports/knob"]
    with EnergyLog.open(log) as whole, EnergyLog.open(tmp_path / "short.h5") as short:
        found = compare(whole, short)
    assert (found["rows"], found["differences"], found["missing"], found["identical"]) == ([4000, 3000], [], [], False)


def test_comparison_finds_one_changed_bit_and_its_cycle(log: Path, tmp_path: Path) -> None:
    with EnergyLog.open(log) as first, EnergyLog.open(changed(log, tmp_path / "b.h5")) as second:
        assert compare(first, first)["identical"]
        found = compare(first, second)
    assert not found["identical"]
    (difference,) = found["differences"]
    assert (difference["name"], difference["cycle"], difference["unit"]) == ("ports/handle/dissipated", 1234, "J")
    assert difference["largest"] == pytest.approx(1e-18, rel=0.1)


def break_chunk(path: Path, name: str, number: int) -> None:
    """Writes zeros over one chunk of a column."""
    with h5py.File(path) as file:
        place = file[name].id.get_chunk_info(number)
    content = bytearray(path.read_bytes())
    content[place.byte_offset : place.byte_offset + place.size] = bytes(place.size)
    path.write_bytes(content)


@pytest.mark.slow
def test_repair_saves_every_row_of_a_log_whose_events_are_damaged(log: Path, tmp_path: Path) -> None:
    damaged, saved = tmp_path / "damaged.h5", tmp_path / "saved.h5"
    damaged.write_bytes(log.read_bytes())
    break_chunk(damaged, "events/text", 0)
    assert typed.inspect(damaged, "--repair", saved, "--json") == 0
    with EnergyLog.open(saved) as repaired:
        assert (repaired.rows, repaired.events) == (4000, [])


@pytest.mark.slow
def test_a_repaired_copy_that_cannot_be_written_is_one_clear_error(log: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no/saved\.h5: the repaired copy cannot be written"):
        typed.inspect(log, "--repair", tmp_path / "no" / "saved.h5")


@pytest.mark.slow
def test_what_json_lacks_is_null(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "nan.h5"
    path.write_bytes(log.read_bytes())
    with h5py.File(path, "r+") as file:
        file["ports/handle/h_m"][7] = math.nan
        file["ports/handle/leak"][7] = math.inf
    assert typed.inspect(path, "--json") == 1
    result = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert result["findings"] == [
        {"dataset": "ports/handle/h_m", "what": "not finite", "rows": 1, "cycle": 7},
        {"dataset": "ports/handle/leaked", "what": "not finite", "rows": 1, "cycle": 7},
        {"dataset": "digest", "what": "not as the run wrote it", "rows": 1, "cycle": 7},
    ]
    assert result["ports"]["handle"]["leaked"] is None
