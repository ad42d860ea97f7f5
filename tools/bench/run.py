"""Runs one benchmark, or every one: `python tools/bench/run.py [QUESTION]`. Each is a script of this folder."""

import subprocess
import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
NOT_QUESTIONS = {"__init__", "demo", "paced", "peers", "report", "run"}


def questions() -> list[str]:
    """Returns the names of all benchmarks."""
    return sorted(path.stem for path in FOLDER.glob("*.py") if path.stem not in NOT_QUESTIONS)


def main(arguments: list[str]) -> int:
    """Runs the named questions, or all; returns the number that failed to run."""
    known = questions()
    for name in arguments:
        if name not in known:
            print(f"unknown question {name!r}, expected one of: {', '.join(known)}", file=sys.stderr)
            return 2
    failed = 0
    for name in arguments or known:
        failed += subprocess.call([sys.executable, "-m", f"tools.bench.{name}"], cwd=FOLDER.parents[1]) != 0
    return failed


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
