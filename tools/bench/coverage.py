"""How much of the package do the fast tests run? Lines by room, child processes included.

Under coverage the tests take about twice the processor time, so that `make test` does not measure: it ends with the
figure that is recorded here, and with its commit. Kernels count where Python runs them; machine code has no lines.
"""

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from typing import Any

from canhaptic.errors import InputError
from canhaptic.extras import install_hint
from tools.bench.report import Row, publish

ROOT = Path(__file__).resolve().parents[2]
_SETTINGS = """[run]
source = {root}/canhaptic
data_file = {folder}/data
parallel = true
patch = subprocess
sigterm = true
[report]
exclude_also =
    if TYPE_CHECKING:
    raise NotImplementedError
    \\.\\.\\.
"""


def measured(words: list[str], folder: Path) -> tuple[dict[str, Any], int]:
    """Returns the report of coverage as JSON, and the exit status of the tests.

    Args:
        words: Of pytest.
        folder: For its files.

    Raises:
        InputError: coverage is not installed.
    """
    if importlib.util.find_spec("coverage") is None:
        raise InputError(f"the figure needs coverage; install it with: {install_hint('release')}")
    settings = folder / "coverage.ini"
    settings.write_text(_SETTINGS.format(root=ROOT, folder=folder), encoding="utf-8")
    coverage = [sys.executable, "-m", "coverage"]
    given = f"--rcfile={settings}"
    status = subprocess.call([*coverage, "run", given, "-m", "pytest", *words], cwd=ROOT)
    out = folder / "coverage.json"
    for step in (["combine", given, "--quiet"], ["json", given, "--quiet", "-o", str(out)]):
        subprocess.run([*coverage, *step], cwd=ROOT, check=True)
    return json.loads(out.read_text(encoding="utf-8")), status


def rows_of(report: dict[str, Any]) -> list[Row]:
    """Returns the share of lines that ran, of the whole package and of each room."""
    run, lines = defaultdict[str, int](int), defaultdict[str, int](int)
    for name, found in report["files"].items():
        parts = Path(name).parts
        inside = parts[parts.index("canhaptic") + 1 :]
        for room in ("whole package", inside[0] if len(inside) > 1 else "modules of no room"):
            run[room] += found["summary"]["covered_lines"]
            lines[room] += found["summary"]["num_statements"]
    return [
        Row(f"{room}, {lines[room]} statements", 100.0 * run[room] / max(1, lines[room]), "%")
        for room in sorted(lines, key=lambda room: (room != "whole package", room))
    ]


def main() -> int:
    """Measures and publishes; returns the exit status of the tests."""
    tests = ["-q", "-n", str(os.cpu_count() or 1), "--dist", "worksteal", "-m", "not slow", *sys.argv[1:]]
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=False
    ).stdout.strip()
    with tempfile.TemporaryDirectory() as folder:
        report, status = measured(tests, Path(folder))
    publish("coverage", rows_of(report), ["coverage", "pytest"], {"commit": commit})
    return status


if __name__ == "__main__":
    sys.exit(main())
