"""Every code block of README and documentation is run, in order, page by page, as a reader would."""

import argparse
import contextlib
import io
import json
import shlex
import shutil
import sys
from pathlib import Path

import pytest
import yaml

from canhaptic.cli.main import COMMANDS, in_mode, main
from canhaptic.cli.options import add_arguments, table
from canhaptic.control.environments import ENVIRONMENTS
from canhaptic.control.passivity import ALGORITHMS
from canhaptic.sim.plant.effects import EFFECTS
from tests.docs.documents import ROOT, Block, blocks, has_indented_command, pages, sentences_commands

NOT_RUN = {
    "make": "the tests themselves are run by it",
    "sudo": "changes the host",
    "ip": "changes the host",
    "apt-get": "changes the host",
    "pip": "tests/project/test_wheel.py installs",
    "git": "of the reader's own tree",
    "candump": "reads a CAN interface",
    "curl": "of the reader's own tree",
}
"""First word of a command that no test runs, and why."""
FOR_A_REAL_RIG = ("run", "commission", "preflight", "check", "drive")
"""Subcommands that end with status 1, 2 or 3 on a scene for real hardware, which is not here."""
QUICK = {
    "arena": ["--duration", "0.1", "--workers", "1"],
    "compare": ["--duration", "0.2"],
    "commission": ["--duration", "0.1", "--yes"],
    "evidence": ["--yes"],
    "accuracy": ["--duration", "0.1", "--budget", "2"],
    "scope": None,  # lives until it is stopped; tests/view start it
    "touch": None,  # tests/lab/touch start it
    "drive": ["--duration", "0.2"],
}
"""Arguments that make a command short; None for one that other tests run."""
IN_NO_HURRY = {"real": "free"}
"""Paces: at the rate of the clock a run may end with SYNCS_SKIPPED on a busy computer; tests/cli has such runs."""

SHELLS = ("sh", "bash")
OWN_TEST = ("gallery.md",)
"""Pages whose commands tests/docs/test_scene_gallery.py runs, as they are; here they take minutes."""
STARTS_WITH = {page: {"rig.yaml": "configs/demo.yaml"} for page in ("replay_in_ci.md", "safety.md")}
"""What the reader of a page has, and what is here in its place."""
REFUSED = {"safety.md": ("check <(...)",)}
"""Commands of which the page says that they do not work."""

QUICK_PAGES = ("README.md",)
WITH_BLOCKS = [
    pytest.param(page, id=page.relative_to(ROOT).as_posix(), marks=() if page.name in QUICK_PAGES else pytest.mark.slow)
    for page in pages()
    if page.name not in OWN_TEST and any(block.language in (*SHELLS, "python", "yaml") for block in blocks(page))
]


@pytest.fixture
def reader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the shipped scenes, in which modules of the page can be imported."""
    for folder in ("configs", "eds"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    shutil.copy(ROOT / "eds" / "cia402_servo.eds", tmp_path / "my_drive.eds")  # is the reader's own
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


@pytest.mark.slow
@pytest.mark.timeout(600)  # a design compiles for a minute
@pytest.mark.parametrize("page", WITH_BLOCKS)
def test_every_block_of_a_page_runs(page: Path, reader: Path) -> None:
    tables = [(table, dict(table)) for table in (ENVIRONMENTS, ALGORITHMS, EFFECTS)]
    modules = set(sys.modules)
    for name, shipped in STARTS_WITH.get(page.name, {}).items():
        shutil.copy(ROOT / shipped, reader / name)
        (reader / "recordings").mkdir()
    try:
        for block in blocks(page):
            run_block(block, reader)
    finally:
        for table, before in tables:
            table.clear()
            table.update(before)
        for name in set(sys.modules) - modules:
            if getattr(sys.modules[name], "__file__", None) and str(reader) in str(sys.modules[name].__file__):
                del sys.modules[name]


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.relative_to(ROOT).as_posix())
def test_a_command_in_a_sentence_is_one_that_the_parser_takes(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert not has_indented_command(page), "a command belongs into a fenced block, where it is run"
    for line, text in sentences_commands(page):
        name, *rest = shlex.split(text.replace("...", ""))
        if name not in ("COMMAND", *COMMANDS) or text in REFUSED.get(page.name, ()):
            assert text in REFUSED.get(page.name, ()), f"{page.name}:{line}: no command {name}"
            continue
        if modes := [word for word in rest if word in table().get(name, {}).get("modes", {})]:
            (_, *rest), name = in_mode([name, *rest], name)
            rest = [] if rest == modes else rest  # named alone
        if rest and name != "COMMAND":
            is_parsed = parses(name, ["5" if word == "NODE" else word for word in rest])
            assert is_parsed, f"{page.name}:{line}: canhaptic {text}: {capsys.readouterr().err}"


def parses(name: str, words: list[str]) -> bool:
    """Whether a subcommand takes these arguments."""
    parser = argparse.ArgumentParser()
    add_arguments(name, parser)
    try:
        parser.parse_args(words)
    except SystemExit as end:
        return end.code == 0
    return True


def run_block(block: Block, folder: Path) -> None:
    """Writes the file that a block is, or runs it; the error names the place in the page."""
    where = f"{block.page}:{block.line}"
    try:
        if block.file:
            (folder / block.file).write_text(block.text)
        if block.language == "python" and not block.file:
            exec(compile(block.text, where, "exec"), {"__name__": "__main__"})
        elif block.language == "yaml":
            assert yaml.safe_load(block.text) is not None
        elif block.language == "json":
            json.loads(block.text)
        elif block.language in SHELLS:
            for words in block.commands:
                run_command(words, folder)
    except BaseException as error:
        raise AssertionError(f"{where}: {type(error).__name__}: {error}") from error


def run_command(words: list[str], folder: Path) -> None:
    """Runs one command line that begins with `canhaptic`; anything else must be among those that no test runs."""
    if words[0] != "canhaptic":
        assert words[0] in NOT_RUN or words[:2] == ["python", "-m"] or words[0].startswith(("python", ".venv")), words
        return
    if "wire.pcap" in words and words[1] == "inspect":  # of an interface that is not here
        return
    words, target = redirected(words[1:])
    words = [IN_NO_HURRY.get(word, word) for word in words]
    extra = QUICK.get(words[0], [])
    if extra is None:
        return
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        status = main([*words, *(extra if "--help" not in words else [])])
    real = words[0] in FOR_A_REAL_RIG and any(is_real(word) or word.startswith("bus.interface=") for word in words)
    assert status in ((1, 2, 3) if real else (0,)), f"{words}: status {status}"
    if target:
        (folder / target).write_text(out.getvalue())


def redirected(words: list[str]) -> tuple[list[str], str]:
    """A command line without its `> FILE`, and the file."""
    if ">" in words:
        at = words.index(">")
        return words[:at], words[at + 1]
    return words, ""


def is_real(word: str) -> bool:
    """Whether a word is the scene of real hardware, or one that its commissioning was to write."""
    if not word.endswith(".yaml"):
        return False
    return not Path(word).is_file() or "interface: virtual" not in Path(word).read_text()
