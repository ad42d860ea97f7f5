"""Finished cases of an arena on disk, one a line: an arena that was stopped goes on where it was.

The store of a sweep does not fit: its columns are the figures of one scene, fixed before it begins. A case is known
again by its scene, rate, delay, algorithm and duration, and by the code that made it: all of the package that computes,
and the file of an own algorithm. A line that was cut off by a kill is left out.
"""

import hashlib
import json
import os
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any, Final

from canhaptic.errors import InputError
from canhaptic.input_file import read_regular
from canhaptic.lab.studies.arena.arena_cases import CaseFigures, CaseGroup, is_own, label_of

_LARGEST: Final = 100_000_000  # [B], of the store, and of the files that a case is made of
_COMPUTES: Final = ("control", "kernels", "scene", "sim", "study")
"""Folders of the package whose code decides what a case gives."""


class ArenaStore:
    """The file of finished cases.

    Args:
        path: Path of the file; created with its folder if need be.
        force: Whether to begin anew.

    Raises:
        InputError: It cannot be read or made.
    """

    def __init__(self, path: Path, *, force: bool = False) -> None:
        self._path = path
        self._known: dict[str, CaseFigures] = {}
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if force:
                path.unlink(missing_ok=True)
            text = read_regular(path, _LARGEST).decode("utf-8") if path.exists() else ""
            if text and not text.endswith("\n"):
                self._write("\n")  # what follows is not to be added to a line that a kill cut off
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"{path}: cannot be used as the store of an arena ({error}); name another") from error
        for line in text.splitlines():
            self._take(line)

    def _take(self, line: str) -> None:
        try:
            kept = json.loads(line)
            self._known[kept["key"]] = kept["case"]
        except (ValueError, KeyError, TypeError):
            return  # cut off by a kill: the case runs again

    def finished(self, group: CaseGroup) -> list[CaseFigures]:
        """Return what is known of the cases of a group."""
        keys = (_key(group, delay, name) for delay in group.delays for name in group.algorithms)
        return [self._known[key] for key in keys if key in self._known]

    def add(self, group: CaseGroup, found: Iterable[CaseFigures]) -> None:
        """Keep the figures of cases of a group, all of them on disk once this returns.

        Raises:
            InputError: The file cannot be written.
        """
        lines, references = "", {label_of(name): name for name in group.algorithms}
        for case in found:
            key = _key(group, case["delay"], references[case["algorithm"]])
            self._known[key] = case
            lines += json.dumps({"key": key, "case": case}) + "\n"
        try:
            self._write(lines)
        except OSError as error:
            raise InputError(f"{self._path}: cannot be written ({error}); make room, or name another --out") from error

    def _write(self, lines: str) -> None:
        with self._path.open("a", encoding="utf-8") as file:
            file.write(lines)
            file.flush()
            os.fsync(file.fileno())


def _key(group: CaseGroup, delay: int, algorithm: str) -> str:
    own = _hash_of(Path(algorithm.rpartition(":")[0])) if is_own(algorithm) else ""
    parts: list[Any] = [_hash_of(group.path), group.rate, delay, algorithm, own, group.longest, code_hash()]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:32]


def _hash_of(path: Path) -> str:
    return hashlib.sha256(read_regular(path, _LARGEST)).hexdigest()


@cache
def code_hash() -> str:
    """Return the hash of the code that computes."""
    package, digest = Path(__file__).resolve().parents[3], hashlib.sha256()
    for path in sorted(path for folder in _COMPUTES for path in (package / folder).rglob("*.py")):
        digest.update(path.relative_to(package).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()
