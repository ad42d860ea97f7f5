"""Diagnostics of a scene: where each one is, and the list that is raised at once."""

from pathlib import Path
from typing import NamedTuple

from canhaptic.errors import SceneError


class SourceLocation(NamedTuple):
    """The place a key or value came from: a line of a file, or an override of the command line."""

    source: str  # file name as given, or the override as typed
    line: int  # counted from 1; 0 when the source has no lines
    column: int  # counted from 1; 0 when the source has no lines
    path: tuple[str, ...]  # keys and list indices from the top of the scene

    @property
    def where(self) -> str:
        """Return `file:line:column`, or the source alone when it has no lines."""
        return f"{self.source}:{self.line}:{self.column}" if self.line else self.source

    @property
    def folder(self) -> Path:
        """Base of a relative path given here: the folder of the file, or the current one."""
        return Path(self.source).parent if self.line else Path()

    def below(self, *parts: str) -> "SourceLocation":
        """Return the same place for an entry below it that the source does not hold."""
        return self._replace(path=(*self.path, *parts))


class Diagnostics:
    """Collects every fault of a scene, so that all of them are shown at once and each only once."""

    def __init__(self) -> None:
        self._lines: dict[str, tuple[int, int]] = {}

    def __len__(self) -> int:
        return len(self._lines)

    def add(self, mark: SourceLocation, message: str) -> None:
        """Note a fault as `file:line:column: path: message`."""
        path = f"{'.'.join(mark.path)}: " if mark.path else ""
        line = "".join(
            letter if letter.isprintable() else letter.encode("unicode_escape").decode()
            for letter in f"{mark.where}: {path}{message}"
        )
        self._lines.setdefault(line, (mark.line, mark.column))

    def error(self, kind: type[SceneError] = SceneError) -> SceneError:
        """Return the error with every fault noted so far, in the order of the file; overrides come first."""
        return kind(sorted(self._lines, key=lambda line: self._lines[line]))

    def raise_if_any(self, kind: type[SceneError] = SceneError) -> None:
        """Raise the error if there is any fault."""
        if self._lines:
            raise self.error(kind)
