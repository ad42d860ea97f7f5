"""`canhaptic new --simulate`: the scene of every dictionary that it takes runs, also where values are missing."""

import re
from pathlib import Path

import pytest

from canhaptic.cli.main import main

REPOSITORY = Path(__file__).resolve().parents[2]
OURS = (REPOSITORY / "eds" / "cia402_servo.eds").read_text()
TRAITS = REPOSITORY / "tests" / "sim_drive" / "eds"
SECTIONS = re.findall(r"(?m)^\[([0-9A-F]{4}(?:sub[0-9A-F]+)?)\]", OURS)


def section_of(text: str, name: str) -> str:
    found = re.search(rf"(?ms)^\[{name}\]\n.*?(?=^\[|\Z)", text)
    assert found is not None
    return found[0]


def with_entry(text: str, section: str, key: str, value: str | None) -> str:
    """The dictionary with one entry of a section set, or taken away."""
    old = section_of(text, section)
    lines = [line for line in old.strip().splitlines() if not line.startswith(f"{key}=")]
    return text.replace(old, "\n".join([*lines, *([] if value is None else [f"{key}={value}"])]) + "\n\n")


def without_object(text: str, index: str) -> str:
    return re.sub(rf"(?ms)^\[{index}(sub[0-9A-F]+)?\]\n.*?(?=^\[|\Z)", "", text)


WITH_DEFAULTS = [name for name in SECTIONS if "DefaultValue" in section_of(OURS, name)]
GENERATED = {
    "vendor ID in DeviceInfo alone": with_entry(
        with_entry(OURS, "1018sub1", "DefaultValue", None), "DeviceInfo", "VendorNumber", "0xFB"
    ),
    "vendor ID in DeviceInfo, no 0x1018": with_entry(without_object(OURS, "1018"), "DeviceInfo", "VendorNumber", "7"),
    "0x6072 from 200 on": with_entry(OURS, "6072", "LowLimit", "200"),
    "0x6072 up to 20": with_entry(with_entry(OURS, "6072", "DefaultValue", "10"), "6072", "HighLimit", "20"),
    "no 0x6502": without_object(OURS, "6502"),
    "0x1006 = 1 us": with_entry(OURS, "1006", "DefaultValue", "1"),
    "0x1006 = 1 us, read-only": with_entry(with_entry(OURS, "1006", "DefaultValue", "1"), "1006", "AccessType", "ro"),
    "SYNC with another COB-ID": with_entry(OURS, "1005", "DefaultValue", "0x81"),
    "RPDO deadline of 1 ms": with_entry(OURS, "1400sub5", "DefaultValue", "1"),
    "0x1400 an array, no deadline": with_entry(without_object(OURS, "1400sub5"), "1400", "ObjectType", "0x8"),
    "0x1016:01 read-only": with_entry(OURS, "1016sub1", "AccessType", "ro"),
}


def runs(eds: Path, folder: Path) -> None:
    scene = folder / "rig.yaml"
    assert main(["new", str(eds), "--simulate", "--out", str(scene)]) == 0
    assert main(["check", str(scene), "--json"]) == 0
    assert main(["run", str(scene), "--duration", "0.05", "--json"]) == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", GENERATED)
def test_a_scene_runs_for_what_dictionaries_of_the_field_state(name: str, tmp_path: Path) -> None:
    eds = tmp_path / "drive.eds"
    eds.write_text(GENERATED[name])
    assert GENERATED[name] != OURS
    runs(eds, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("part", sorted({name[:2] for name in WITH_DEFAULTS}))
def test_a_scene_runs_without_the_values_of_any_part_of_the_dictionary(part: str, tmp_path: Path) -> None:
    """All values of one part missing at once; parts are 0x10xx, 0x14xx and so on."""
    text = OURS
    for section in [name for name in WITH_DEFAULTS if name.startswith(part)]:
        text = with_entry(text, section, "DefaultValue", None)
    eds = tmp_path / "drive.eds"
    eds.write_text(text)
    runs(eds, tmp_path)


@pytest.mark.slow
def test_a_scene_runs_for_a_dictionary_with_empty_entries(tmp_path: Path) -> None:
    runs(TRAITS / "empty_entries.eds", tmp_path)


def test_the_remedy_of_a_torque_limit_that_is_too_low_does_not_say_lower(tmp_path, capsys) -> None:
    eds = tmp_path / "drive.eds"
    eds.write_text(GENERATED["0x6072 from 200 on"])
    scene = tmp_path / "rig.yaml"
    assert main(["new", str(eds), "--simulate", "--out", str(scene)]) == 0
    assert main(["run", str(scene), "--duration", "0.05", "--set", "axes.0.torque_limit=0.05"]) == 3
    err = capsys.readouterr().err
    assert "written too low" in err
    assert "raise torque_limit" in err
    assert "lower torque_limit" not in err


def test_a_scene_of_guesses_says_what_it_does_not_render_and_what_helps(tmp_path, capsys) -> None:
    eds = REPOSITORY / "eds" / "cia402_servo.eds"
    for words, is_said in (([], True), (["--simulate"], False)):
        assert main(["new", str(eds), *words, "--out", str(tmp_path / f"{len(words)}.yaml")]) == 0
        said = capsys.readouterr().err
        assert ("% of the wall is rendered at most; canhaptic commission measures" in said) == is_said


@pytest.mark.slow
@pytest.mark.parametrize("name", ["Analog input", "Force, mean since SYNC"])
def test_a_sensor_that_shows_means_is_declared_so(name: str, tmp_path: Path) -> None:
    text = (REPOSITORY / "eds" / "cia402_admittance.eds").read_text()
    (tmp_path / "drive.eds").write_text(with_entry(text, "2205sub1", "ParameterName", name))
    for words, is_mean in (([], "mean" in name), (["--simulate"], True)):
        scene = tmp_path / f"{len(words)}.yaml"
        assert main(["new", str(tmp_path / "drive.eds"), "--display", "velocity", *words, "--out", str(scene)]) == 0
        assert re.search(r"sampling: (\w+)", scene.read_text())[1] == ("mean" if is_mean else "point")
