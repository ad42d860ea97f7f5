"""The code blocks of the documentation, and a folder in which they run as a reader would run them."""

import re
import shlex
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
_BLOCK = re.compile(r"^```(\w+)[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)
_INDENTED = re.compile(r"\n\n {4,}(?:\$ )?(?:canhaptic|candump) ")
_IN_A_SENTENCE = re.compile(r"(?<!`)`canhaptic ([^`]+)`(?!`)")
_FILE = re.compile(r"# ([\w/]+\.(?:py|yaml))\n")


class Block(NamedTuple):
    """One fenced block."""

    page: str
    line: int
    language: str
    text: str

    @property
    def file(self) -> str:
        """The name of the file that the block is, from its first line; "" when it is none."""
        found = _FILE.match(self.text)
        return found[1] if found else ""

    @property
    def commands(self) -> list[list[str]]:
        """The commands of a shell block, split into words, without comments; `&&` parts two on a line."""
        found: list[list[str]] = []
        for line in self.text.replace("\\\n", " ").splitlines():
            parts: list[list[str]] = [[]]
            for word in shlex.split(line, comments=True):
                if word == "&&":
                    parts.append([])
                else:
                    parts[-1].append(word)
            found += [part for part in parts if part]
        return found


def sentences_commands(page: Path) -> list[tuple[int, str]]:
    """The commands in code spans of a page, without `canhaptic`, and the line of each."""
    text = _BLOCK.sub(lambda found: "\n" * found[0].count("\n"), page.read_text(encoding="utf-8"))
    return [(text.count("\n", 0, m.start()) + 1, " ".join(m[1].split())) for m in _IN_A_SENTENCE.finditer(text)]


def has_indented_command(page: Path) -> bool:
    """Whether a page has a command in an indented block, which `blocks` does not find."""
    return bool(_INDENTED.search(_BLOCK.sub("", page.read_text(encoding="utf-8"))))


def pages() -> list[Path]:
    """README, CONTRIBUTING and every page of the documentation."""
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def blocks(page: Path) -> list[Block]:
    """The fenced blocks of a page in order."""
    text = page.read_text(encoding="utf-8")
    name = page.relative_to(ROOT).as_posix()
    return [Block(name, text.count("\n", 0, m.start()) + 1, m[1], m[2]) for m in _BLOCK.finditer(text)]
