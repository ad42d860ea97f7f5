"""Does the memory of a sweep grow with its scenes? The same kind of sweep with 10^4, 10^5 and 10^6 scenes.

Each one is the command as a user types it, summary included, in a process of its own, whose peak the kernel counts. The
chunks are of one size, so that nothing differs but how many there are.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

from tools.bench.report import Row, publish

REPOSITORY = Path(__file__).resolve().parents[2]
SIZES = {10_000: (100, 100), 100_000: (1000, 100), 1_000_000: (1000, 1000)}
"""Scenes -> values of stiffness and damping."""
CYCLES = 100
FLAT = 1.1
COMMAND = (
    "from canhaptic.cli.main import main; import sys; sys.exit(main(sys.argv[1:]))",
    "sweep", str(REPOSITORY / "configs" / "demo.yaml"), "--set", "environment.position=0.05 m",
    "--controllers", "unprotected", "--cycles", str(CYCLES), "--chunk", "5000", "--engine", "numba", "--json",
)  # fmt: skip


def run(stiffnesses: int, dampings: int, out: Path) -> tuple[float, float]:
    """Returns (seconds, peak of the resident memory [MB]) of one sweep."""
    varied = [
        "--vary",
        f"environment.stiffness=1e2:1e5:log:{stiffnesses}",
        "--vary",
        f"environment.damping=0:10:{dampings}",
    ]
    begin = perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-c", *COMMAND, *varied, "--out", str(out)], cwd=REPOSITORY, stdout=subprocess.DEVNULL
    )
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"the sweep ended with {process.returncode}")
    return perf_counter() - begin, usage.ru_maxrss * 1024 / 1e6


def main() -> None:
    """Runs each size once and publishes time and peak."""
    load = os.getloadavg()[0]
    note = "" if load < 0.5 else f"times are rough: not an idle machine, load {load:.1f} before the first sweep"
    rows, peaks = [], {}
    for scenes, (stiffnesses, dampings) in SIZES.items():
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "sweep"
            seconds, peaks[scenes] = run(stiffnesses, dampings, out)
            size = sum(path.stat().st_size for path in out.iterdir()) / 1e6
        name = f"{scenes} scenes x {CYCLES} cycles, unprotected, numba, one process"
        rows += [Row(f"{name}: time", seconds, "s", note=note), Row(f"{name}: peak memory", peaks[scenes], "MB"),
                 Row(f"{name}: folder", size, "MB")]  # fmt: skip
        print(f"{name}: {seconds:.0f} s, {peaks[scenes]:.0f} MB", flush=True)
    ratio = peaks[max(SIZES)] / peaks[min(SIZES)]
    rows.append(Row("peak of 10^6 scenes over that of 10^4", ratio, "", target=f"<= {FLAT:g}", met=ratio <= FLAT))
    publish("sweep_size", rows, ["canhaptic", "numpy"])


if __name__ == "__main__":
    main()
