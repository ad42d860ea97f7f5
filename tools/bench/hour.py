"""How long does the log of one hour at 1 kHz take to inspect, and to turn into an interactive page?"""

import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

from tests.view import hour_run
from tools.bench.report import Row, publish

ROOT = Path(__file__).resolve().parents[2]

REPEATS = 2


def timed(*words: str | Path) -> float:
    """Returns the wall time [s] of `canhaptic inspect` as a process of its own, the least of the repeats."""
    least = float("inf")
    for _ in range(REPEATS):
        begin = perf_counter()
        program = [sys.executable, "tools/inspect_energy.py", *map(str, words), "--json"]
        subprocess.run(program, check=True, capture_output=True, cwd=ROOT)
        least = min(least, perf_counter() - begin)
    return least


def main() -> None:
    """Writes the hour, inspects it, and publishes the times."""
    with tempfile.TemporaryDirectory() as folder:
        log, page = Path(folder) / "hour.h5", Path(folder) / "hour.html"
        hour_run.write_hour(log)
        summary, html = timed(log), timed(log, "--html", page, "--force")
        size = page.stat().st_size / 1e6
    rows = [
        Row("inspect one hour, one axis", summary, "s", target="< 5", met=summary < 5.0),
        Row("inspect one hour with --html", html, "s", target="< 10", met=html < 10.0),
        Row("size of the page", size, "MB", target="< 6", met=size < 6.0),
    ]
    publish("hour", rows, ["canhaptic", "h5py", "bokeh", "numpy"])


if __name__ == "__main__":
    main()
