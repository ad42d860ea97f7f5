"""Runs the tests of the compiled loops with every minor version of numba that the package declares, newest first.

    python -m tools.numba_minors [MINOR ...]

Each version gets an environment of its own, `.venv/numba-MINOR`, which is kept for the next time. The first line of
an answer is the version that was really there.
"""

import re
import subprocess
import sys
import venv
from collections.abc import Sequence
from pathlib import Path

_REPOSITORY = Path(__file__).resolve().parent.parent
_TESTS = ("tests/kernels", "tests/lab/batch")


def minors(project: str) -> list[str]:
    """The minor versions 0.n that the text of a `pyproject.toml` allows, newest first.

    Raises:
        ValueError: It has no requirement of this form, or more than one.
    """
    found = re.findall(r'"numba>=0\.(\d+),<0\.(\d+)"', project)
    if len(found) != 1:
        raise ValueError(f'pyproject.toml: got {len(found)} requirements of numba, expected one, "numba>=0.A,<0.B"')
    first, beyond = map(int, found[0])
    return [f"0.{minor}" for minor in reversed(range(first, beyond))]


def tested(minor: str) -> int:
    """The status of the tests with one version; not zero where it cannot be installed either."""
    place = _REPOSITORY / ".venv" / f"numba-{minor}"
    if not place.exists():
        venv.create(place, with_pip=True)
    python = str(place / "bin" / "python")
    commands = (
        ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-e", ".[fast,dev]", f"numba=={minor}.*"],
        ["-c", "import numba; print(numba.__version__, flush=True)"],
        ["-m", "pytest", "-q", "-n", "auto", "--dist", "worksteal", "-m", "not campaign", *_TESTS],
    )
    for words in commands:
        if status := subprocess.run([python, *words], cwd=_REPOSITORY, check=False).returncode:
            return status
    return 0


def main(words: Sequence[str]) -> int:
    """Tests the given minor versions, or all that are declared; one line each at the end."""
    chosen = list(words) or minors((_REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
    statuses = {minor: tested(minor) for minor in chosen}
    for minor, status in statuses.items():
        print(f"numba {minor}: {'passed' if status == 0 else f'failed ({status})'}")
    return int(any(statuses.values()))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
