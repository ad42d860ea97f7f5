"""Every table of every command on a terminal of 80 columns: no cell is cropped, no line is wider."""

import io
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from canhaptic.cli.main import main
from canhaptic.commission.session import Report, StepFinding, StepVerdict
from canhaptic.view.run_lines import make_console

ROOT = Path(__file__).parents[2]
CONFIGS = ROOT / "configs"
LONG = "the_handle_with_a_name_of_forty_letters_"
PRINT = Console.print
SHORT = 14
"""Words of so many letters are not broken over lines; longer ones may be, in columns that fold."""


@pytest.fixture(autouse=True)
def _wide(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")


@pytest.fixture
def printed(monkeypatch: pytest.MonkeyPatch) -> list[tuple[tuple[Any, ...], dict[str, Any]]]:
    """What any console prints from now on."""
    calls: list[tuple[tuple[Any, ...], dict[str, Any]]] = []

    def kept(console: Console, *objects: Any, **options: Any) -> None:
        calls.append((objects, options))
        PRINT(console, *objects, **options)

    monkeypatch.setattr(Console, "print", kept)
    return calls


def rendered(call: tuple[tuple[Any, ...], dict[str, Any]], width: int) -> str:
    console = Console(file=io.StringIO(), width=width, highlight=False)
    PRINT(console, *call[0], **call[1])
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def assert_whole(calls: list[Any]) -> None:
    """At 80 columns every call shows the words that it shows where there is room for everything."""
    assert calls
    for call in list(calls):
        narrow, wide = rendered(call, 80), rendered(call, 1000)
        assert "\N{HORIZONTAL ELLIPSIS}" not in narrow
        if not call[1].get("soft_wrap"):
            assert max(map(len, narrow.splitlines()), default=0) <= 80
        missing = {word for word in wide.split() if len(word) <= SHORT} - set(narrow.split())
        assert not missing, narrow


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("logs")
    words = ["--log", str(folder / "run.h5"), "--bus-log", str(folder / "run.log"), "--duration", "0.6"]
    assert main(["run", str(CONFIGS / "demo.yaml"), "--set", f"axes.0.name={LONG}", *words, "--json"]) == 0
    return folder / "run.h5"


COMMANDS = {
    "run": ["run", "xy_box.yaml", "--duration", "0.3"],
    "run long name": ["run", "demo.yaml", "--duration", "1.5", "--set", f"axes.0.name={LONG}"],
    "compare": ["compare", "paper_fig5_100hz.yaml", "--duration", "1.5"],
    "compare long name": ["compare", "paper_fig5_100hz.yaml", "--duration", "0.1", "--set", f"axes.0.name={LONG}"],
    "sweep": ["sweep", "paper_fig5_100hz.yaml", "--vary", "environment.stiffness=1e2,1e4", "--duration", "1",
              "--controllers", "guarded,unprotected", "--engine", "python", "--set", f"axes.0.name={LONG}"],
    "accuracy": ["accuracy", "paper_fig5_100hz.yaml", "--duration", "0.05", "--budget", "0"],
    "design": ["design", "paper_fig5_100hz.yaml", "--engine", "python", "--set", "axes.0.torque_limit=4"],
    "check": ["check", "two_handles.yaml"],
    "check long name": ["check", "demo.yaml", "--set", f"axes.0.name={LONG}"],
    "check a marked scene": ["check", "interfaces/pcan.yaml"],
    "check-eds": ["check-eds", str(ROOT / "eds" / "cia402_servo.eds")],
    "configs": ["configs"],
    "preflight": ["check", "--host", "socketcan_example.yaml"],
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_no_table_of_a_command_loses_anything(name: str, printed: list[Any]) -> None:
    command, *words = COMMANDS[name]
    if words and words[0].endswith(".yaml"):
        words[0] = str(CONFIGS / words[0])
    assert main([command, *words]) in {0, 1, 2, 3, 4}
    assert_whole(printed)


@pytest.mark.slow
def test_no_table_of_an_inspected_log_loses_anything(log: Path, printed: list[Any]) -> None:
    other = log.with_name("other.h5")
    assert main(["run", str(CONFIGS / "demo.yaml"), "--log", str(other), "--duration", "2", "--json",
                 "--set", f"axes.0.name={LONG}", "--set", "environment.stiffness=700"]) == 0  # fmt: skip
    assert main(["inspect", str(log), "--compare", str(other), "--check", "margin >= -1 uJ", "--recompute"]) == 1
    assert_whole(printed)


@pytest.mark.slow
def test_a_replay_is_shown_whole(log: Path, printed: list[Any]) -> None:
    scene = ["--config", str(CONFIGS / "demo.yaml"), "--set", f"axes.0.name={LONG}"]
    main(["replay", "--quick", str(log.with_suffix(".log")), *scene])
    assert_whole(printed)


def test_the_findings_of_commissioning_are_shown_whole() -> None:
    report = Report()
    text = "no friction could be seen in the noise; move the handle further, or give a larger step of the torque"
    for verdict in StepVerdict:
        report.findings.append(
            StepFinding(LONG, "counts of the encoder", "131072 count/rev", "131071.6 count/rev", verdict, text)
        )
    assert_whole([((report.table(),), {})])


@pytest.mark.parametrize(("columns", "width"), [("80", 80), ("132", 132), ("", 100), ("wide", 100)])
def test_piped_output_is_as_wide_as_columns_says(columns: str, width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    assert make_console(file=io.StringIO()).width == width
