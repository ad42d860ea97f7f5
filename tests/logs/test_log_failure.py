import errno
import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from canhaptic.cli.main import main
from canhaptic.logs.bus_reader import read_bus_log
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.ring import cause_of

DEMO = str(Path(__file__).parents[2] / "configs" / "demo.yaml")


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["stop", pytest.param("continue", marks=pytest.mark.slow)])
def test_a_run_stops_or_goes_on_when_its_disk_is_full_with_one_message(mode, tmp_path, limit_files, capsys):
    limit_files(1_700_000)
    seconds = 16 if mode == "continue" else 60  # the writer may lag behind a fast cycle by a ring of rows
    words = ["run", DEMO, "--duration", str(seconds), "--pace", "free", "--set", f"log.on_failure={mode}", "--json"]
    assert main([*words, "--bus-log", str(tmp_path / "run.log")]) == 3
    captured = capsys.readouterr()
    assert captured.err.count("log stopped") == 1
    assert str(tmp_path / "run.log") in captured.err
    result = json.loads(captured.out)
    assert (result["status"], result["error"]) == ("error", "LogStoppedError")
    cycles = result["result"]["cycles"]
    assert cycles == 16_000 if mode == "continue" else 8_500 < cycles < 60_000
    frames = list(read_bus_log_up_to_the_cut(tmp_path / "run.log"))
    assert 1_600_000 < (tmp_path / "run.log").stat().st_size <= 1_700_000
    assert len(frames) > 34_000


@pytest.mark.parametrize(
    ("error", "cause"),
    [
        (OSError(errno.ENOSPC, "x"), "no space"),
        (RuntimeError("Can't write (file write failed: errno = 122, error message = 'x')"), "no space"),
        (OSError(errno.EROFS, "x"), "Read-only file system"),
        (ValueError("neither"), "neither"),
    ],
)
def test_the_cause_of_a_log_that_ended_is_named_in_few_words(error: Exception, cause: str) -> None:
    assert cause_of(error) == cause


def read_bus_log_up_to_the_cut(path: Path) -> Iterator[object]:
    whole = path.with_suffix(".whole.log")
    whole.write_text(path.read_text().rpartition("\n")[0] + "\n")
    return read_bus_log(whole)


@pytest.mark.slow
def test_a_scene_names_its_logs_and_bounds_their_size(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs = f"log={{energy: {tmp_path / 'run.h5'}, bus: {tmp_path / 'run.log'}, file_size: 30000, files: 3}}"
    assert main(["run", DEMO, "--duration", "1", "--set", logs, "--json"]) == 0
    kept = sorted(path.name for path in tmp_path.glob("run*.log"))
    assert len(kept) == 3
    assert "run.log" in kept
    assert all(path.stat().st_size < 400_000 for path in tmp_path.glob("run*.log"))
    with EnergyLog.open(tmp_path / "run.h5") as log:
        assert log.rows == 1000
    capsys.readouterr()


def test_a_series_of_files_and_the_last_seconds_exclude_each_other(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", DEMO, "--set", "log={bus: a.log, last: 1, file_size: 1000}"]) == 2
    assert "exclude each other" in capsys.readouterr().err
