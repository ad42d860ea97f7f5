"""Seventeen commands in four groups; what had names of its own is a mode of one of them."""

from pathlib import Path

import pytest

from canhaptic.cli.main import COMMANDS, main
from canhaptic.cli.options import table

RECORDED = Path(__file__).resolve().parents[1] / "recordings" / "emergency.log"
MODES = {flag: (name, section) for name, of in table().items() for flag, section in of.get("modes", {}).items()}


def test_help_lists_seventeen_commands_in_four_groups(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    shown = capsys.readouterr().out
    assert len(COMMANDS) == 17
    assert all(f"\n  {name} " in shown and of["example"] in shown for name, of in table().items() if name in COMMANDS)
    assert [line for line in shown.splitlines() if line in ("try:", "build a rig:", "look:", "study:")] == [
        "try:", "build a rig:", "look:", "study:",
    ]  # fmt: skip
    assert not any(f"\n  {name} " in shown for name in table().keys() - COMMANDS.keys())


@pytest.mark.parametrize("flag", MODES)
def test_an_old_name_works_as_its_mode_and_says_so_in_one_line(flag: str, capsys: pytest.CaptureFixture[str]) -> None:
    command, old = MODES[flag]
    shown = []
    for words in ([command, flag, "--help"], [old, "--help"]):
        with pytest.raises(SystemExit) as ended:
            main(words)
        assert ended.value.code == 0
        shown.append(capsys.readouterr())
    assert shown[0].out == shown[1].out
    assert f"usage: canhaptic {command} {flag} " in shown[0].out
    assert shown[0].err == ""
    assert shown[1].err.splitlines() == [
        f"canhaptic: {old} is now: canhaptic {command} {flag}; the old name works in this release"
    ]


def test_every_command_shows_an_example_and_its_exit_statuses(capsys: pytest.CaptureFixture[str]) -> None:
    for name in COMMANDS:
        with pytest.raises(SystemExit):
            main([name, "--help"])
        shown = " ".join(capsys.readouterr().out.split())
        assert f"Example: {table()[name]['example']}"[:40] in shown
        assert "2 bad input" in shown


NO_RESULT = {"new", "scope", "touch", "drive", "evidence"}
"""Commands that print a scene or an address, or write their JSON into a folder."""
NO_LENGTH = {"check", "touch", "design", "inspect", "replay"}
"""Commands with a scene that run nothing, or as long as a person, a search or a recording takes."""


def test_an_option_is_where_a_person_expects_it() -> None:
    """--json, --png, --html, --set and --duration, of a command and of its modes together."""
    for name in COMMANDS:
        sections = [name, *table()[name].get("modes", {}).values()]
        has = {option for section in sections for option in table()[section].get("arguments", {})}
        assert ("--png" in has) == ("--html" in has), name
        assert ("--json" in has) == (name not in NO_RESULT), name
        if "config" in has:
            assert "--set" in has, name
            assert ("--duration" in has) == (name not in NO_LENGTH), name


@pytest.mark.slow
def test_a_run_and_a_comparison_write_their_page(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    assert main(["run", "demo", "--duration", "0.05", "--html", str(page)]) == 0
    assert "energy account" in page.read_text(encoding="utf-8")
    words = ["compare", "demo", "--duration", "0.05", "--algorithms", "unprotected", "--html", str(page)]
    assert main(words) == 0
    assert "passive, by the plant" in page.read_text(encoding="utf-8")


def test_an_abbreviated_mode_is_refused_and_not_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["check", "demo", "--hos"], ["commission", "demo", "--hom"], ["commission", "demo", "--node", "5"]):
        with pytest.raises(SystemExit):
            main(words)
        assert "write the option in full" in capsys.readouterr().err


def test_a_bus_log_without_a_scene_is_shown_frame_by_frame(capsys: pytest.CaptureFixture[str]) -> None:
    shown = []
    for words in (["inspect", str(RECORDED)], ["inspect", "--frames", str(RECORDED)], ["decode", str(RECORDED)]):
        assert main([*words, "--to", "0.02"]) == 0
        shown.append(capsys.readouterr().out)
    assert "NMT" in shown[0]
    assert shown[0] == shown[1] == shown[2]
    assert main(["inspect", str(RECORDED), "--check", "passive"]) == 2
    assert "name the scene of the run with --config" in capsys.readouterr().err


@pytest.mark.slow
def test_the_schema_and_the_host_check_are_modes(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["configs", "--schema"]) == 0
    assert '"title": "canhaptic scene"' in capsys.readouterr().out
    assert main(["check", "demo", "--host"]) == 0
    assert "nothing to check" in capsys.readouterr().out
    assert main(["commission", "demo", "--node-id", "0"]) == 2
    assert "got 0, expected 1 to 127" in capsys.readouterr().err
