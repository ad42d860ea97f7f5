import copy
import io
import re
from typing import Any

import pytest
from rich.console import Console

from canhaptic.axis_units import si
from canhaptic.control.verdict import add_verdicts
from canhaptic.view.energy_table import _events_table, energy_report
from canhaptic.view.run_lines import brief_report, make_console


def port(factor: float = 1.0) -> dict[str, object]:
    return {
        "in": 0.0123456 * factor,
        "out": 0.0021 * factor,
        "dissipated": 9.99996e-4,
        "stored": 0.0,
        "surplus": {"end": 0.0, "max": 3.2e-7},
        "recovered": 1e-9,
        "leaked": 5e-5,
        "deficit": 1.5e-3,
        "margin": {"value": -2.2e-3 * factor, "cycle": 123, "time": 0.123},
        "least_interaction": -3e-3 * factor,
        "certificate": "hand_force",
        "branches": {"free": 100, "exact": 1200, "sticky": 0},
        "damping_rendered": {"least": 4.0, "most": 10.0},
        "unit": "m",
    }


def result(names: list[str]) -> dict[str, Any]:
    return {
        "status": "ok",
        "config_hash": "ab12cd34ef56ab12",
        "cycles": 8000,
        "ports": {name: port(number) for number, name in enumerate(names)},
        "truth": {names[-1]: {"interaction": 0.0102, "least_interaction": 0.0, "accounted_error": 3e-17}},
        "timing": {
            "cycles_per_second": 9123.4,
            "deadlines_missed": 0,
            "compute": {"p50": 7e-6, "p99": 9e-6, "p99.9": 2e-5, "max": 1e-4},
        },
        "link": {"success_rate": 0.99987, "missing": 1},
        "method": "exact between SYNCs",
    }


def printed(content: dict[str, object], width: int = 100) -> str:
    stream = io.StringIO()
    Console(file=stream, width=width, highlight=False).print(energy_report(content))
    return stream.getvalue()


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.0123456, "J", "12.35 mJ"),
        (9.99996e-4, "J", "1.000 mJ"),
        (-3.2e-7, "J", "-320.0 nJ"),
        (0.0, "J", "0 J"),
        (-0.0, "J", "0 J"),
        (1.0, "J", "1.000 J"),
        (999.96, "N", "1.000 kN"),
        (1e-30, "J", "1.000e-30 J"),
        (1e13, "J", "1.000e+13 J"),
        (float("inf"), "J", "inf J"),
        (0.25, "1", "0.25"),
        (1.5, "rad", "1.5 rad"),
    ],
)
def test_numbers_get_the_prefix_that_leaves_one_to_three_digits(value: float, unit: str, text: str) -> None:
    assert si(value, unit) == text


def test_a_number_with_all_its_digits_before_the_point_has_no_point() -> None:
    assert si(123.0, "N", 3) == "123 N"
    assert si(1.5, "N", 3) == "1.50 N"
    assert [si(value, "kg", 3) for value in (0.0, 0.05, 2.98)] == ["0 kg", "50.0 g", "2.98 kg"]


def test_every_part_of_the_result_is_in_the_report() -> None:
    text = printed(result(["still", "handle"]))
    for words in (
        "ok   8000 cycles   99.987 % of SYNCs answered   scene checksum ab12cd34ef56",
        "12.35 mJ",
        "-2.200 mJ",
        "0.123 s",
        "4..10 N*s/m",
        "hand force",
        "cycles in contact, energy balanced exactly",
        "true net energy (plant)",
        "TPDOs received 99.987 %, TPDOs missed 1",
        "cycles per second 9123.4, deadlines missed 0",
        "p50   7.00 us",
        "exact between SYNCs",
    ):
        assert words in text
    assert "held back" not in text


def row_of(content: dict[str, object], label: str) -> str:
    """What follows a label of the table, of a result with its verdicts."""
    content = copy.deepcopy(content)
    ports: Any = content["ports"]
    for port in ports.values():
        if "least_interaction" in port:
            add_verdicts(port)
    (line,) = (line for line in printed(content).splitlines() if line.strip().startswith(f"{label} "))
    return line.strip().removeprefix(label).strip()


def test_a_port_that_gave_energy_away_is_marked() -> None:
    assert row_of(result(["still", "handle"]), "passive at the motor").split() == ["yes", "NO"]


@pytest.mark.parametrize(
    ("label", "changed", "shown"),
    [
        (
            "smallest margin (net energy less dissipated)",
            {"margin": {"value": 0.0, "cycle": 0, "time": 0.0}},
            "0 J, never negative",
        ),
        ("smallest margin (net energy less dissipated)", {}, "-2.200 mJ at 0.123 s"),
        ("damping rendered", {"damping_rendered": {"least": 4.0, "most": 4.0}, "unit": "rad"}, "4 N*m*s/rad"),
        ("uncertainty of the account", {"energy_resolution": 0.0}, "rounding error only"),
        ("uncertainty of the account", {"read_back": "none", "energy_resolution": 0.2}, "+-200.0 mJ"),
        ("uncertainty of the account", {"energy_resolution": 2.017, "books_least": True}, "+2.02 J, -0 J"),
        ("uncertainty of the account", {"read_back": "actual", "energy_resolution": 2.5e-3}, "+-2.500 mJ"),
        ("stiffness rendered, of requested", {"rendered": {"stiffness": 0.875, "damping": None}}, "87.5 %"),
        ("mass felt", {"mass": {"requested": 3.0, "felt": 2.9607, "share": 0.9869}}, "2.96 kg, 98.7 % of requested"),
        ("cycles of contact with zero command", {"contact": {"holds": 40, "without_torque": 3}}, "3 of 40"),
        (
            "cycles of contact with zero command",
            {"contact": {"holds": 40, "without_torque": 40}},
            "all",
        ),
        ("guarantee rests on", {"certificates": []}, "no torque"),
        ("guarantee rests on", {"certificates": ["exact", "hand_force"]}, "hand force"),
        ("guarantee rests on", {"certificates": ["exact"]}, "needs no declaration"),
        ("guarantee rests on", {"certificates": ["none"]}, "no guarantee"),
        (
            "guarantee rests on",
            {"certificates": ["hand_force", "hand_speed"], "hand_force": 0.0},
            "moving mass, hand never pulls, hand speed",
        ),
        ("dissipated", {"dissipated": None}, "not known"),
        ("damping rendered", {"damping_rendered": {"least": None, "most": None}}, "not known"),
        ("passive at the handle", {"energy_resolution": 0.0, "least_at_handle": -1e-3}, "in doubt"),
        ("passive at the handle", {"energy_resolution": 0.0, "least_at_handle": 0.0}, "yes"),
        ("from elsewhere (moving surfaces, far side), net", {"supplied": 0.25}, "250.0 mJ"),
        ("uncertainty, taken off `in`", {"uncertainty": 0.25}, "250.0 mJ"),
        ("cycles limited by: singular", {"limits": {"singular": 12, "workspace": 0}}, "12"),
    ],
)
def test_each_row_says_it_in_words(label: str, changed: dict[str, object], shown: str) -> None:
    content = result(["handle"])
    content["ports"]["handle"] |= {"margin": {"value": -2.2e-3, "cycle": 123, "time": 0.123}} | changed
    assert row_of(content, label) == shown


def test_a_limit_that_never_acted_has_no_row() -> None:
    content = result(["handle"])
    content["ports"]["handle"] |= {"limits": {"workspace": 0}, "supplied": 0.0}
    assert "cycles limited" not in printed(content)
    assert "movers" not in printed(content)


def test_a_group_stands_before_its_axes() -> None:
    content = result(["x", "y", "stage"])
    for name in ("x", "y"):
        content["ports"][name] = {"group": "stage", "in": 1.0, "out": 0.0, "unit": "m"}
    heads = next(line for line in printed(content).splitlines() if "energy account" in line)
    assert heads.split()[2:] == ["stage", "x", "y"]
    assert row_of(content, "dissipated").split()[2:] == ["-", "-"]


@pytest.mark.slow
@pytest.mark.parametrize("ports", [1, 3, 4, 9])
def test_no_line_is_longer_than_a_hundred_columns_and_no_figure_is_broken(ports: int) -> None:
    names = [f"a_rather_long_axis_name_{number}" for number in range(ports)]
    text = printed(result(names))
    assert max(len(line.rstrip()) for line in text.splitlines()) <= 100
    wide = {word for word in printed(result(names), width=1000).split() if len(word) < 18}  # a head may be broken
    assert wide <= set(text.split())


def test_a_result_with_missing_parts_still_prints() -> None:
    assert "handle" in printed({"ports": {"handle": {}}})
    assert "failed" in printed({"status": "failed"})


def test_without_a_terminal_the_table_is_plain_text_a_hundred_columns_wide(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    assert make_console().width == 100
    make_console().print(energy_report(result(["handle"])))
    text = capsys.readouterr().out
    assert "\x1b" not in text
    assert "energy account" in text


@pytest.mark.parametrize(
    ("least", "most", "unit", "shown"),
    [
        (0.0025, 0.0025, "rad", "0.0025 N*m*s/rad "),
        (0.00180001, 0.00250004, "rad", "0.0018..0.0025 N*m*s/rad "),
        (5e-15, 9.02, "m", " 0..9.02 N*s/m "),
        (10.0, 10.0000001, "m", " 10 N*s/m "),
    ],
)
def test_a_range_of_damping_is_written_whole_and_once_where_it_is_one_number(least, most, unit, shown):
    text = printed(
        result(["axis1"])
        | {"ports": {"axis1": port() | {"unit": unit, "damping_rendered": {"least": least, "most": most}}}, "truth": {}}
    )
    assert shown in text


def test_two_logs_share_one_table_with_a_column_for_each_account() -> None:
    runs = [result(["handle"]) | {"file": f"{name}.h5", "rate": 1e3, "from": 0.0, "to": 1.0} for name in "ab"]
    runs[1]["ports"]["handle"] |= {"in": 0.5, "energy_resolution": 1e-6}
    del runs[1]["truth"]
    stream = io.StringIO()
    Console(file=stream, width=80, highlight=False).print(energy_report(*runs))
    text = stream.getvalue()
    assert max(map(len, text.splitlines())) <= 80
    assert re.search(r"^ *a\.h5 +b\.h5 *\n *energy account +handle +handle *$", text, re.MULTILINE)
    assert re.search(r"^ *energy in +0 J +500\.0 mJ", text, re.MULTILINE)
    assert re.search(r"^ *uncertainty of the +- +\+-1\.000 uJ", text, re.MULTILINE)
    assert re.search(r"^ *true net energy \(plant\) +10\.20 mJ +-", text, re.MULTILINE)
    assert text.index(" a.h5   1.00 kHz") < text.index(" b.h5   1.00 kHz") < text.index("energy account")


def test_a_quantity_that_no_port_has_is_no_row():
    assert "uncertainty of the account" not in printed(result(["handle"]))
    assert "uncertainty of the account" in printed(
        result(["a"]) | {"ports": {"a": port() | {"energy_resolution": 1e-6}}, "truth": {}}
    )


@pytest.mark.parametrize(("count", "title"), [(1, " 1 event"), (20, " 20 events"), (21, " 21 events, the first 20")])
def test_of_many_events_the_first_are_shown(count: int, title: str) -> None:
    event = {"time": 1.0, "sync_index": 1000, "kind": "fault", "port": "handle", "text": "stopped"}
    table = _events_table([event] * count)
    assert (table.title, len(table.rows)) == (title, min(count, 20))


def test_a_run_prints_a_line_a_port_and_what_is_amiss(capsys: pytest.CaptureFixture[str]) -> None:
    content = result(["still", "handle"])
    ports: Any = content["ports"]
    for port in ports.values():
        add_verdicts(port)
    make_console().print(brief_report(content))
    lines = capsys.readouterr().out.splitlines()[1:]
    assert lines[0].startswith(" handle: passive: NO")
    assert lines[1].startswith(" ok   8000 cycles")
    assert lines[2].split() == ["link", "TPDOs", "missed", "1"]
    assert "--full" in lines[3]
    content |= {"link": {"missing": 0}, "method": "cogging of order 2, estimated error 1 um"}
    make_console().print(brief_report(content))
    assert capsys.readouterr().out.splitlines()[3].strip().startswith("method   cogging of order 2")


@pytest.mark.parametrize(
    ("own_code", "row"),
    [
        ({"runs_in": "cycle"}, "user code ran in the cycle"),
        (
            {"runs_in": "process", "late_holds": 3, "longest": 2},
            "user code ran in a process of its own, 3 answers late",
        ),
        ({"runs_in": "process", "late_holds": 1, "longest": 1}, "user code ran in a process of its own, 1 answer late"),
    ],
)
def test_a_run_with_own_code_says_where_it_ran_and_how_often_it_was_late(
    own_code: Any, row: str, capsys: pytest.CaptureFixture[str]
) -> None:
    content = result(["handle"])
    add_verdicts(content["ports"]["handle"])
    make_console().print(brief_report(content))
    assert "user code" not in capsys.readouterr().out
    make_console().print(brief_report(content | {"own_code": own_code}))
    assert f" {row}" in capsys.readouterr().out.splitlines()
    assert f" {row}" in map(str.rstrip, printed(content | {"own_code": own_code}).splitlines())
