"""`canhaptic check-eds` and `canhaptic new`: verdicts, exit statuses, and configurations that run."""

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from canhaptic.cli.main import main
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import TO_SET

REPOSITORY = Path(__file__).resolve().parents[2]
OURS = REPOSITORY / "eds" / "cia402_servo.eds"
TRAITS = REPOSITORY / "tests" / "sim_drive" / "eds"
UNFIT = {
    "elmo_simpliq.dcf": ["0x6502 supported drive modes: got 0x006d, expected bit 9"],
    "maxon_epos2.eds": ["0x6071 target torque: missing", "map: drive:"],
    "schunk_prl.dcf": ["0x6071 target torque: missing", "0x6502 supported drive modes: got 0x0043", "map: drive:"],
}

Captured = pytest.CaptureFixture[str]


def test_check_refuses_what_a_run_refuses(tmp_path: Path, capsys: Captured) -> None:
    """A simulated drive without a rated torque anywhere."""
    text = (REPOSITORY / "configs" / "demo.yaml").read_text()
    scene = yaml.safe_load(text)
    scene["axes"][0]["eds"] = str(OURS)
    scene["axes"][0].pop("rated_torque", None)
    scene["simulation"].pop("drive", None)
    path = tmp_path / "scene.yaml"
    path.write_text(yaml.safe_dump(scene))
    texts = []
    for command in (["check", str(path)], ["run", str(path), "--duration", "0.01"]):
        assert main(command) == 2
        texts.append(capsys.readouterr().err)
    assert texts[0] == texts[1]
    assert "rated_torque: got none" in texts[0]


def checked(path: Path, capsys: Captured) -> tuple[int, dict[str, Any]]:
    status = main(["check-eds", str(path), "--json"])
    answer: dict[str, Any] = json.loads(capsys.readouterr().out)
    return status, answer


def test_our_dictionary_is_fit_but_for_what_the_rig_alone_knows(capsys: Captured) -> None:
    status, answer = checked(OURS, capsys)
    assert (status, answer["verdict"], answer["reasons"]) == (0, "usable with conditions", [])
    assert [line.split(":")[0] for line in answer["conditions"]] == ["0x6076 motor rated torque"]
    assert answer["map"]["rpdo"] == {
        "name": "RPDO1",
        "cob_id": "0x201",
        "written": True,
        "bytes": 4,
        "entries": ["0x6040:00/16", "0x6071:00/16"],
    }
    assert answer["map"]["read_back"] == "demand"


def test_a_product_that_begins_with_its_vendor_names_it_once(tmp_path: Path, capsys: Captured) -> None:
    lines = OURS.read_text().splitlines()
    names = {"vendorname": "VendorName=Acme", "productname": "ProductName=Acme RGM"}
    path = tmp_path / "acme.eds"
    path.write_text("\n".join(names.get(line.partition("=")[0].lower(), line) for line in lines))
    assert main(["check-eds", str(path)]) == 0
    assert capsys.readouterr().out.replace("\n", "").startswith(f"{path}: Acme RGM")


def test_the_loads_are_those_of_the_arithmetic_by_hand(capsys: Captured) -> None:
    """SYNC 55 + TPDO 135 + RPDO 95 bits; besides one blocking frame, two heartbeats, one EMCY and 20 us of host."""
    _, answer = checked(OURS, capsys)
    assert answer["bus"]["bitrate"] == 1_000_000
    loads = {row["rate"]: row for row in answer["bus"]["rates"]}
    assert loads[1000.0]["periodic_load"] == pytest.approx(0.285)
    assert loads[1000.0]["worst_cycle"] == pytest.approx((55 + 135 + 95 + 135 + 2 * 65 + 135) * 1e-6 + 20e-6)
    assert [row["fits"] for row in answer["bus"]["rates"]] == [True, True, True, True, False, False]
    assert (loads[1000.0]["axes"], loads[100.0]["axes"]) == (2, 16)


@pytest.mark.parametrize("name", UNFIT)
def test_vendor_drives_without_cyclic_torque_cannot(name: str, vendor_eds: Path, capsys: Captured) -> None:
    status, answer = checked(vendor_eds / name, capsys)
    assert (status, answer["verdict"]) == (1, "not usable")
    assert len(answer["reasons"]) == len(UNFIT[name])
    for reason, expected in zip(answer["reasons"], UNFIT[name], strict=True):
        assert reason.startswith(expected)


@pytest.mark.parametrize(
    ("name", "conditions"),
    [
        ("elmo_gold.dcf", ["0x6502", "0x6076"]),
        ("kollmorgen_rgm.eds", ["0x6502", "torque", "0x6072", "0x6076", "0x6007"]),
        ("zeroerr_erob.eds", ["0x6072", "0x6076", "0x6007"]),
        ("maxon_epos4.dcf", ["torque", "0x6072"]),
    ],
)
def test_conditions_are_what_the_dictionary_leaves_open(name: str, conditions: list[str], vendor_eds: Path, capsys):
    status, answer = checked(vendor_eds / name, capsys)
    assert (status, answer["verdict"], answer["reasons"]) == (0, "usable with conditions", [])
    assert [line.split(" ")[0] for line in answer["conditions"]] == conditions


@pytest.mark.parametrize(
    ("name", "status"),
    [
        ("fixed_maps.eds", 0),
        ("array_maps.eds", 0),
        ("empty_entries.eds", 0),
        ("no_cyclic_torque.eds", 1),
        ("no_target_torque.eds", 1),
    ],
)
def test_trait_dictionaries_are_judged_without_vendor_files(name: str, status: int, capsys: Captured) -> None:
    seen, answer = checked(TRAITS / name, capsys)
    assert (seen, answer["verdict"] == "not usable") == (status, status == 1)


def test_a_drive_without_watchdog_is_a_condition_with_its_key(tmp_path: Path, capsys: Captured) -> None:
    text = OURS.read_text()
    path = tmp_path / "no_watchdog.eds"
    path.write_text(text.replace("[1016", "[2016").replace("[1400sub5", "[2400sub5"))
    status, answer = checked(path, capsys)
    assert status == 0
    assert any(line.startswith("0x1016:01") for line in answer["conditions"])
    assert "watchdog: false" in answer["configure"]


@pytest.mark.slow_but("name2")
@pytest.mark.parametrize("name", [OURS, TRAITS / "fixed_maps.eds", TRAITS / "no_target_torque.eds"])
def test_the_verdict_and_its_reasons_come_first_and_the_tables_on_demand(name: Path, capsys: Captured) -> None:
    main(["check-eds", str(name)])
    brief = capsys.readouterr().out.splitlines()
    assert len(brief) <= 50
    assert brief[1] == ("not usable" if "no_target" in name.name else "usable with conditions")
    main(["check-eds", str(name), "--full"])
    out = capsys.readouterr().out
    for words in ("what the dictionary states", "0x6071 target torque", "watchdog", "PDO"):
        assert words in out
    verdict = "not usable" if "no_target" in name.name else "usable with conditions"
    assert f"\n{verdict}\n" in out


@pytest.mark.parametrize("words", [["check-eds"], ["new"]])
def test_a_file_that_is_no_dictionary_is_bad_input(words: list[str], tmp_path: Path, capsys: Captured) -> None:
    path = tmp_path / "x.eds"
    path.write_text("hello")
    assert main([*words, str(path)]) == 2
    assert "lists no object" in capsys.readouterr().err
    assert main([*words, str(tmp_path / "none.eds")]) == 2


# --- new ----------------------------------------------------------------------------------------------------------


def started(path: Path, folder: Path, capsys: Captured, *options: str) -> Path:
    capsys.readouterr()
    assert main(["new", str(path), *options]) == 0
    scene = folder / "rig.yaml"
    scene.write_text(capsys.readouterr().out, encoding="utf-8")
    return scene


def test_every_guess_is_marked(tmp_path: Path, capsys: Captured) -> None:
    lines = started(TRAITS / "fixed_maps.eds", tmp_path, capsys).read_text().splitlines()
    marked = [line.split(":")[0].strip() for line in lines if f"# {TO_SET}" in line]
    assert {"interface", "channel", "node_id", "counts_per_unit", "rated_torque", "torque_limit"} <= set(marked)
    assert {"moving_mass", "demand_reported"} <= set(marked)


@pytest.mark.slow_but("socketcan*")
@pytest.mark.parametrize(
    ("interface", "expected"), [("gs_usb", (200.0, 0.7)), ("slcan", (25.0, 0.7)), ("socketcan", (1000.0, 0.5))]
)
def test_rate_and_window_are_those_that_an_adapter_keeps(interface, expected, tmp_path, capsys) -> None:
    bus = load_scene(started(OURS, tmp_path, capsys, "--interface", interface)).bus
    assert (bus.rate, bus.tpdo_timeout) == expected
    twin = tmp_path / "twin"
    twin.mkdir()
    usb = f"simulation.bus={{jitter: {0.3 * bus.tpdo_timeout * 1e3 / bus.rate:g} ms}}"
    scene = started(OURS, twin, capsys, "--simulate", "--interface", interface)
    assert main(["run", str(scene), "--duration", f"{40 / bus.rate:g}", "--json", "--set", usb]) == 0
    assert json.loads(capsys.readouterr().out)["link"]["late"] == 0
    assert main(["new", str(OURS), "--interface", interface[:-1]]) == 2
    assert f"did you mean {interface!r}?" in capsys.readouterr().err


def test_real_drives_do_not_run_on_guesses(tmp_path: Path, capsys: Captured) -> None:
    scene = started(OURS, tmp_path, capsys)
    assert main(["run", str(scene)]) == 2
    lines = scene.read_text().splitlines()
    marked = [(n, line.split(":")[0].strip()) for n, line in enumerate(lines, 1) if f" # {TO_SET}" in line]
    assert f"lines {', '.join(f'{n} ({key})' for n, key in marked)}: marked TO SET" in capsys.readouterr().err
    scene.write_text("\n".join(line.split(f"# {TO_SET}")[0] for line in lines))
    main(["run", str(scene), "--set", "bus.channel=not_attached"])  # refused at once: the interface does not exist
    said = capsys.readouterr().err
    assert "not_attached" in said
    assert "marked TO SET" not in said


@pytest.mark.slow
def test_check_says_what_is_still_to_be_set(tmp_path: Path, capsys: Captured) -> None:
    scene = started(OURS, tmp_path, capsys)
    lines = scene.read_text().splitlines()
    marked = [number for number, line in enumerate(lines, 1) if f" # {TO_SET}" in line]
    assert main(["check", str(scene), "--full"]) == 1
    out = " ".join(capsys.readouterr().out.split())
    assert f"Simulation: no section `simulation`. Hardware: {len(marked)} values to set; " in out
    assert "the largest torque that may ever reach the hand" in out
    assert main(["check", str(scene), "--json"]) == 1
    rows = json.loads(capsys.readouterr().out)["to_set"]
    assert [row["line"] for row in rows] == marked
    channel = next(row for row in rows if row["key"] == "channel")
    assert (channel["value"], channel["note"]) == ("can0", "")
    node = next(row for row in rows if row["key"] == "node_id")
    assert (node["value"], node["note"]) == ("1", "as set in the drive")


def test_what_a_dictionary_states_is_taken_over(tmp_path: Path, capsys: Captured) -> None:
    path = tmp_path / "known.eds"
    text = OURS.read_text().replace(
        "ParameterName=Encoder increments\nObjectType=0x7\nDataType=0x0007\nAccessType=rw\n",
        "ParameterName=Encoder increments\nObjectType=0x7\nDataType=0x0007\nAccessType=rw\nDefaultValue=2000\n",
    )
    assert text != OURS.read_text()
    path.write_text(text.replace("BaudRate_1000=1", "BaudRate_1000=0").replace("BaudRate_800=1", "BaudRate_800="))
    scene = load_scene(started(path, tmp_path, capsys))
    assert scene.axes[0].parameters.counts_per_unit == pytest.approx(2000 / 6.283185307, rel=1e-7)
    # 705 us of the cycle at 1 Mbit/s are 1390 us at 500 kbit/s: at most 719 Hz
    assert (scene.bus.bitrate, scene.bus.rate) == (500_000, 500.0)


@pytest.mark.slow
def test_a_path_with_every_awkward_letter_survives(tmp_path: Path, capsys: Captured) -> None:
    folder = tmp_path / 'a "b"  # c: [red] Gerät'
    folder.mkdir()
    path = folder / "x.eds"
    path.write_bytes(OURS.read_bytes())
    scene = started(path, tmp_path, capsys)
    assert yaml.safe_load(scene.read_text(encoding="utf-8"))["axes"][0]["eds"] == str(path)
    assert main(["check", str(scene)]) == 1  # its values are still marked
    assert "[red]" in "".join(capsys.readouterr().out.split())


def test_a_scene_finds_its_dictionary_from_its_own_folder_and_moves_with_it(tmp_path, monkeypatch) -> None:
    for folder in ("rig/drives", "rig/scenes", "elsewhere"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "rig" / "drives" / "x.eds").write_bytes(OURS.read_bytes())
    (tmp_path / "link").symlink_to(tmp_path / "rig" / "scenes")
    monkeypatch.chdir(tmp_path)
    assert main(["new", "rig/drives/x.eds", "--out", "rig/scenes/a.yaml"]) == 0
    assert main(["new", "rig/drives/x.eds", "--out", "link/b.yaml"]) == 0
    (tmp_path / "rig").rename(tmp_path / "moved")
    monkeypatch.chdir(tmp_path / "elsewhere")
    for name in ("a.yaml", "b.yaml"):
        scene = load_scene(Path("..") / "moved" / "scenes" / name)
        assert scene.axes[0].parameters.eds.read_bytes() == OURS.read_bytes()
        assert yaml.safe_load(scene.text)["axes"][0]["eds"] == "../drives/x.eds"


def test_a_printed_scene_finds_its_dictionary_from_any_folder(tmp_path, capsys, monkeypatch) -> None:
    (tmp_path / "own.eds").write_bytes(OURS.read_bytes())
    (tmp_path / "scenes").mkdir()
    monkeypatch.chdir(tmp_path)
    scene = started(Path("own.eds"), tmp_path / "scenes", capsys)
    assert load_scene(scene).axes[0].parameters.eds == tmp_path / "own.eds"


def test_no_scene_is_overwritten(tmp_path: Path, capsys: Captured) -> None:
    out = tmp_path / "rig.yaml"
    out.write_text("mine")
    assert main(["new", str(OURS), "--out", str(out)]) == 2
    assert "rig.yaml already exists" in capsys.readouterr().err
    assert out.read_text() == "mine"
    assert main(["new", str(OURS), "--out", str(tmp_path / "none" / "rig.yaml")]) == 2
    assert "no such folder" in capsys.readouterr().err


def test_a_drive_that_cannot_serve_gets_no_configuration(capsys: Captured) -> None:
    assert main(["new", str(TRAITS / "no_cyclic_torque.eds")]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "is not fit for cyclic torque: 0x6502 supported drive modes: got" in captured.err


def displayed(path: Path, capsys: Captured, *options: str) -> tuple[int, dict[str, Any]]:
    status = main(["check-eds", str(path), "--display", *options, "--json"])
    answer: dict[str, Any] = json.loads(capsys.readouterr().out)
    return status, answer


@pytest.mark.parametrize(
    ("name", "analog"),
    [
        ("elmo_gold.dcf", "0x2205:01/16"),
        ("maxon_epos4.dcf", "0x3160:01/16"),
        ("maxon_epos2.eds", "0x207c:01/16"),
        ("zeroerr_erob.eds", "0x2205:00/16"),
    ],
)
def test_the_analog_input_of_a_make_shows_the_force_of_an_admittance_display(name, analog, vendor_eds, capsys) -> None:
    for mode, target in (("velocity", "0x60ff:00/32"), ("position", "0x607a:00/32")):
        status, answer = displayed(vendor_eds / name, capsys, mode)
        assert (status, answer["verdict"]) == (0, "usable with conditions")
        assert answer["map"]["rpdo"]["entries"] == ["0x6040:00/16", target]
        assert answer["map"]["tpdos"][0]["entries"] == ["0x6041:00/16", "0x6064:00/32", analog]
        assert "admittance.force.frozen_after" in answer["configure"]
        has_limit = not any(text.startswith("0x6072") for text in answer["conditions"])
        assert has_limit == (name == "elmo_gold.dcf")


def test_a_drive_without_the_mode_or_with_another_force_cannot_be_a_display(vendor_eds: Path, capsys: Captured) -> None:
    status, answer = displayed(vendor_eds / "elmo_simpliq.dcf", capsys, "velocity")
    assert (status, answer["reasons"][0][:70]) == (
        1,
        "0x6502 supported drive modes: got 0x006d, expected bit 8 (cyclic synch",
    )
    status, answer = displayed(vendor_eds / "elmo_gold.dcf", capsys, "velocity", "--force-object", "0x6041")
    assert status == 1
    assert "UNSIGNED16" in answer["reasons"][0]
    status, answer = displayed(vendor_eds / "kollmorgen_rgm.eds", capsys, "velocity")
    assert any(text.startswith("force sensor: no analog input is known") for text in answer["conditions"])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--force-object", "0x2205.1"], "add --display"),
        (["--display", "velocity", "--force-object", "2205"], "expected an object such as"),
    ],
)
def test_a_force_object_that_cannot_be_is_refused_in_one_line(options: list[str], words: str, capsys: Captured) -> None:
    assert main(["check-eds", str(OURS), *options]) == 2
    assert words in capsys.readouterr().err
