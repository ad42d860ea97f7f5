"""A benchmark writes where the user says; what the pages are made from changes only where recording is asked for."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import recorded_coverage
from tools.bench import coverage, report
from tools.bench.run import questions

ROOT = Path(__file__).parents[2]
RUN = ROOT / "tools" / "bench" / "run.py"


def recorded() -> dict[Path, tuple[int, bytes]]:
    folders = (ROOT / "docs" / "results", ROOT / "docs" / "images")
    return {path: (path.stat().st_mtime_ns, path.read_bytes()) for folder in folders for path in folder.glob("*.*")}


@pytest.mark.slow
def test_a_benchmark_leaves_the_recorded_results_alone(tmp_path: Path) -> None:
    before = recorded()
    words = [sys.executable, str(RUN), "dictionaries", "--out", "mine"]
    environment = {**os.environ, "CANHAPTIC_VENDOR_EDS": str(tmp_path)}  # none but the package's own
    done = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "mine" / "dictionaries.json").read_text())["rows"]
    assert recorded() == before


def test_every_question_that_a_page_names_is_one() -> None:
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
    named = {name for page in pages for name in re.findall(r"Q=([a-z_]+)", page.read_text(encoding="utf-8"))}
    tables = (ROOT / "docs" / "figures.md").read_text(encoding="utf-8").split("| `make bench Q=` |")[1:]
    lines = [line for table in tables for line in table.partition("\n\n")[0].splitlines()[2:]]
    rows = [line.split("|")[1] for line in lines if line.startswith("|")]
    named |= {name for row in rows for name in re.findall(r"`([a-z_]+)`", row)}
    assert len(named) > 20
    assert named - set(questions()) == set()


@pytest.mark.parametrize(
    ("folder", "result", "picture"),
    [
        (None, ROOT / "bench_output", ROOT / "bench_output"),
        ("/tmp/elsewhere", Path("/tmp/elsewhere"), Path("/tmp/elsewhere")),
        (str(report.RESULTS), ROOT / "docs" / "results", ROOT / "docs" / "images"),
    ],
)
def test_results_and_pictures_of_one_run_go_to_one_place(folder: str | None, result: Path, picture: Path, monkeypatch):
    monkeypatch.setattr(Path, "mkdir", lambda *_, **__: None)
    monkeypatch.delenv(report.OUT_VARIABLE, raising=False)
    if folder is not None:
        monkeypatch.setenv(report.OUT_VARIABLE, folder)
    assert report.out_folder() == result
    assert report.picture_place("axes.png") == picture / "axes.png"


def test_make_records_only_where_it_is_told_to() -> None:
    def command(*words: str) -> str:
        made = subprocess.run(
            ["make", "--dry-run", "bench", *words], cwd=ROOT, capture_output=True, text=True, check=True,
            env={**os.environ, "MAKEFLAGS": ""},
        )  # fmt: skip
        return next(line for line in made.stdout.splitlines() if "bench/run.py" in line)

    assert "--record" not in command("Q=cycle")
    assert command("Q=cycle", "RECORD=1").endswith("cycle --record")
    assert command("Q=cycle", "OUT=here").endswith("cycle --out here")


def test_the_summary_of_the_tests_says_what_was_recorded_of_their_coverage(tmp_path: Path) -> None:
    place = tmp_path / "coverage.json"
    assert "not recorded (make bench Q=coverage RECORD=1)" in recorded_coverage(place)
    summary = {"covered_lines": 3, "num_statements": 4}
    files = {"canhaptic/cycle.py": summary, "canhaptic/sim/plant/user.py": {"covered_lines": 1, "num_statements": 4}}
    rows = coverage.rows_of({"files": {name: {"summary": found} for name, found in files.items()} | {
        "/there/canhaptic/sim/plant/plant.py": {"summary": summary}}})  # fmt: skip
    assert [(row.row, round(row.value, 1)) for row in rows] == [
        ("whole package, 12 statements", 58.3),
        ("modules of no room, 4 statements", 75.0),
        ("sim, 8 statements", 50.0),
    ]
    place.write_text(json.dumps({"rows": [{"row": rows[0].row, "value": rows[0].value}], "commit": "abc1234"}))
    assert recorded_coverage(place).startswith("coverage of the fast tests: 58.3 % of the whole package, 12 statements")
    assert "abc1234" in recorded_coverage(place)
