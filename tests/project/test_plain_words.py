"""Texts without the tics of this project's early English: pages, comments, docstrings, messages, help texts.

Each has a plain word of the field: see the glossary (docs/words.md) and the neighbours of the text.
"""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

from tools.count_structure import VAGUE_ARGUMENT

ROOT = Path(__file__).resolve().parents[2]
TICS = {
    "beside": r"\bbeside\b(?!')",
    "told": r"\btold\b",
    "stands": r"\b(?:stands?|stood)\b(?! (?:still|at the machine|alone))",
    "whatever": r"\bwhatever\b",
    "whoever": r"\bwhoever\b",
    "nobody": r"\bnobody\b",
    "is there already": r"\b(?:is|are) there already\b",
    "lay over": r"\b(?:lay|laid|lays|lie|lies) over\b",
    "Of the ...": r"^(?:Of|By which|In what|In which|With which|From which|To which) ",
}
"""Name -> pattern. The last one is for the beginning of a text: a sentence has a subject."""
PATTERNS = {name: re.compile(pattern, re.IGNORECASE if name != "Of the ..." else 0) for name, pattern in TICS.items()}
_PARTS = {"stands": "st", "is there already": "already", "lay over": "over"}
_ANYWHERE = [
    (_PARTS.get(name, name), re.compile(pattern.replace(" ", r"[\s#\"'f]+"), re.IGNORECASE))
    for name, pattern in TICS.items()
    if name != "Of ..."
]
_BEGINNING = re.compile(r"(?:^|[\"'#])\s*(?:Of|(?:By|In|With|From|To)[\s#]+wh(?:ich|at))\b", re.MULTILINE)
"""A file without any of these has no tic: it need not be parsed, which takes a hundred times as long."""
ALLOWED = {
    "got beside {}, expected": "the name of a parameter",
    "got neither or both of beside and": "the name of a parameter",
    "got beside with a structure": "the name of a parameter",
    "viscous: 8, beside:": "the name of a parameter",
}


def strings(path: Path) -> Iterator[tuple[int, str]]:
    """Every string of a module: docstrings, messages, help texts; of an f-string its constant parts as one."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    inside = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in ast.walk(node)}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            parts = [str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values]
            yield node.lineno, "".join(parts)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in inside:
            text = node.value if " " in node.value else ""  # no key and no name
            yield node.lineno, text


def comments(path: Path) -> Iterator[tuple[int, str]]:
    """Every block of comments of a module as one text; a comment behind code is a text of its own."""
    begun, texts = 0, list[str]()
    for token in tokenize.generate_tokens(io.StringIO(path.read_text(encoding="utf-8")).readline):
        is_alone = token.type == tokenize.COMMENT and not token.line[: token.start[1]].strip()
        if is_alone and texts and token.start[0] == begun + len(texts):
            texts.append(token.string[1:].strip())
            continue
        if token.type == tokenize.COMMENT:
            if texts:
                yield begun, " ".join(texts)
            begun, texts = token.start[0], [token.string[1:].strip()]
    if texts:
        yield begun, " ".join(texts)


def prose(path: Path) -> Iterator[tuple[int, str]]:
    """Every line of a page outside of blocks of code; of a scene its comments."""
    is_code = False
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if path.suffix == ".yaml":
            if "#" in line:
                yield number, line.split("#", 1)[1].strip()
            continue
        is_code ^= line.lstrip().startswith("```")
        if not is_code:
            yield number, re.sub(r"`[^`]*`", "", line)


def files() -> list[Path]:
    pages = [ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")]
    pages += [*(ROOT / "docs").rglob("*.md")]
    scenes = [*(ROOT / "configs").rglob("*.yaml"), *(ROOT / "examples").rglob("*.yaml")]
    code = [path for folder in ("canhaptic", "tools", "examples", "tests") for path in (ROOT / folder).rglob("*.py")]
    return sorted({*pages, *scenes, *code} - {Path(__file__).resolve()})


def found(path: Path) -> list[str]:
    """Every tic of a file, with its place."""
    whole = path.read_text(encoding="utf-8")
    lower = whole.lower()
    if (
        not any(part in lower and pattern.search(whole) for part, pattern in _ANYWHERE)
        and _BEGINNING.search(whole) is None
    ):
        return []
    texts = [*strings(path), *comments(path)] if path.suffix == ".py" else prose(path)
    hits = [
        (number, name, text[max(0, hit.start() - 40) : hit.end() + 40])
        for number, text in texts
        if not any(allowed in text for allowed in ALLOWED)
        for name, pattern in PATTERNS.items()
        for hit in pattern.finditer(text)
    ]
    return [f"{path.relative_to(ROOT)}:{number}: {name}: {' '.join(place.split())}" for number, name, place in hits]


def vague_arguments(folder: Path) -> list[str]:
    """Every entry of `Args:` or `Attributes:` that says what the argument belongs to, and not what it is."""
    return [
        f"{path.relative_to(folder)}: {entry.strip()}"
        for path in sorted(folder.rglob("*.py"))
        for entry in VAGUE_ARGUMENT.findall(path.read_text(encoding="utf-8"))
    ]


def test_every_argument_says_what_it_is():
    assert vague_arguments(ROOT / "canhaptic") == []


@pytest.mark.parametrize("entry", ["settings: Of the run.", "environment: That is rendered."])
def test_an_argument_that_says_what_it_belongs_to_is_found(tmp_path, entry):
    (tmp_path / "module.py").write_text(f'def f(x):\n    """Do.\n\n    Args:\n        {entry}\n    """\n')
    assert vague_arguments(tmp_path) == [f"module.py: {' '.join(entry.split()[:2])}"]


@pytest.mark.slow
def test_no_text_has_a_tic():
    hits = [hit for path in files() for hit in found(path)]
    assert hits == []


@pytest.mark.parametrize(
    "text", ["What stands beside it.", "Of the spring.", "it is told so", "whatever comes", "nobody holds it"]
)
def test_a_tic_is_found(tmp_path, monkeypatch, text):
    monkeypatch.setattr(f"{__name__}.ROOT", tmp_path)
    for name, content in (
        ("page.md", text),
        ("module.py", f'"""{text}"""'),
        ("code.py", f"# {text}"),
        ("scene.yaml", f"a: 1  # {text}"),
    ):
        (tmp_path / name).write_text(content)
        assert found(tmp_path / name)
