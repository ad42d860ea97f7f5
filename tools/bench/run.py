"""Runs one benchmark, or every one: `python tools/bench/run.py [QUESTION]`. Each is a script of this folder.

Results go to `bench_output/`, or where `--out` says. `--record` is a step of its own: it replaces the results of
`docs/results` and the pictures of `docs/images`, from which the pages are filled in; run `python -m tools.make_missed`
(names missed rows without a reason), `python -m tools.fill_numbers` and `python -m tools.make_paper_page` after it.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
ROOT = FOLDER.parents[1]
sys.path.insert(0, str(ROOT))

from tools.bench.report import DEFAULT_OUT, OUT_VARIABLE, RESULTS  # noqa: E402 - found from any folder

NOT_QUESTIONS = {
    "__init__",
    "commission_line",
    "demo",
    "feel_best",
    "feel_picture",
    "paced",
    "peers",
    "report",
    "run",
    "slow_worlds",
    "standard_cases",
    "sweep_events",
    "user_laws",
}


def questions() -> list[str]:
    """Returns the names of all benchmarks."""
    return sorted(path.stem for path in FOLDER.glob("*.py") if path.stem not in NOT_QUESTIONS)


def main(words: list[str]) -> int:
    """Runs the named questions, or all; returns the number that failed to run."""
    known = questions()
    parser = argparse.ArgumentParser(description="Runs benchmarks; prints their tables and writes their results.")
    parser.add_argument("questions", nargs="*", metavar="QUESTION", help=f"of {', '.join(known)}; by default all")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--out", metavar="FOLDER", type=Path, default=DEFAULT_OUT, help="for results and pictures")
    where.add_argument("--record", action="store_true", help="replace the results that the pages are made from")
    arguments = parser.parse_args(words)
    for name in arguments.questions:
        if name not in known:
            print(f"unknown question {name!r}, expected one of: {', '.join(known)}", file=sys.stderr)
            return 2
    out = RESULTS if arguments.record else arguments.out.absolute()
    environment = {**os.environ, OUT_VARIABLE: str(out)}
    failed = 0
    for name in arguments.questions or known:
        words = [sys.executable, "-m", f"tools.bench.{name}"]
        failed += subprocess.call(words, cwd=ROOT, env=environment) != 0
    return failed


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
