"""Counts the structure of the package: `python -m tools.count_structure [FOLDER]`, a folder that holds `canhaptic/`.

code             lines with a token that is not a comment, without strings that are statements (docstrings);
                 that of `canhaptic/lab/` is the laboratory's, the rest is the product
crossing         classes and functions that a module of another room imports by name; a room is a child of the package
folders          files of each folder, its `__init__.py` left out
long functions   functions of more than 40 lines, their docstring left out
arguments        entries of `Args:` that begin with "Of" or "That"
"""

import ast
import io
import json
import os
import re
import subprocess
import sys
import tokenize
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_NO_CODE = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
_LONGEST_FUNCTION = 40  # lines
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
VAGUE_ARGUMENT = re.compile(r"^\s+\*{0,2}\w+: (?:Of|That)\b", re.MULTILINE)
_RUN = """
import json, sys
from canhaptic.cli.main import main

assert main(["run", *sys.argv[1:]]) == 0
print(json.dumps([name for name in sys.modules if name.split(".")[0] == "canhaptic"]))
"""


@dataclass(frozen=True)
class _Module:
    """One source file: its dotted name, its text and its syntax tree."""

    name: str
    text: str
    tree: ast.Module


def count(top: Path) -> dict[str, Any]:
    """Returns the counts of the package in the folder `top`, by name."""
    modules = list(modules_of(top))
    lines = {module.name: _code_lines(module) for module in modules}
    return {
        "files": len(modules),
        "code": sum(lines.values()),
        "code_lab": sum(code for name, code in lines.items() if name.split(".")[1:2] == ["lab"]),
        "crossing": crossing_names(modules),
        "vague_arguments": sum(len(VAGUE_ARGUMENT.findall(module.text)) for module in modules),
        "folders": files_by_folder(top / "canhaptic"),
        "long_functions": long_functions(modules),
    }


def files_by_folder(top: Path) -> dict[str, int]:
    """Returns how many files each folder of a package has, without its `__init__.py`; folders from `top` on."""
    places = (path.parent.relative_to(top).as_posix() for path in top.rglob("*.py") if path.name != "__init__.py")
    return dict(sorted(Counter(places).items()))


def modules_of(top: Path) -> Iterator[_Module]:
    """Reads every source file of the package in the folder `top`."""
    for path in sorted((top / "canhaptic").rglob("*.py")):
        parts = path.relative_to(top).with_suffix("").parts
        is_package = parts[-1] == "__init__"
        text = path.read_text(encoding="utf-8")
        yield _Module(".".join(parts[:-1] if is_package else parts), text, ast.parse(text))


def _code_lines(module: _Module) -> int:
    found: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(module.text).readline):
        if token.type not in _NO_CODE:
            found.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            found.difference_update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(found)


def loaded_modules(top: Path, *options: str, scene: str = "configs/demo.yaml", duration: float = 0.1) -> list[str]:
    """Returns the modules of the package in the folder `top` that a run of one of its scenes imports.

    Args:
        top: Folder that holds `canhaptic/`.
        options: Of the command `run`.
        scene: Scene file.
        duration: Length of the run [s].
    """
    words = [scene, "--duration", str(duration), *options]
    environment = {**os.environ, "PYTHONPATH": str(top.resolve())}
    done = subprocess.run(
        [sys.executable, "-c", _RUN, *words], cwd=top, env=environment, capture_output=True, text=True
    )
    if done.returncode:
        raise SystemExit(f"{top}: {scene} does not run: {done.stderr}")
    loaded: list[str] = json.loads(done.stdout.splitlines()[-1])
    return loaded


def code_of(top: Path, names: Iterable[str]) -> int:
    """Returns the lines of code of modules of the package in the folder `top`."""
    lines = {module.name: _code_lines(module) for module in modules_of(top)}
    return sum(lines[name] for name in names)


def crossing_names(modules: list[_Module]) -> list[str]:
    """Returns the classes and functions that a module of another room imports."""
    defined = {f"{module.name}.{name}" for module in modules for name in _public_definitions(module)}
    found: set[str] = set()
    for module in modules:
        froms = [node for node in ast.walk(module.tree) if isinstance(node, ast.ImportFrom)]
        names = {f"{node.module}.{alias.name}" for node in froms for alias in node.names}
        found |= {name for name in names & defined if name.split(".")[:2] != module.name.split(".")[:2]}
    return sorted(found)


def long_functions(modules: Iterable[_Module]) -> list[str]:
    """Returns the functions of more than 40 lines without their docstrings."""
    found = ((module, node) for module in modules for node in ast.walk(module.tree) if isinstance(node, _FUNCTIONS))
    return [f"{module.name}.{node.name}" for module, node in found if _length(node) > _LONGEST_FUNCTION]


def _length(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Returns the lines of a function without its docstring."""
    first, length = node.body[0], (node.end_lineno or node.lineno) - node.lineno + 1
    if ast.get_docstring(node, clean=False) is None:
        return length
    return length - ((first.end_lineno or first.lineno) - first.lineno + 1)


def _public_definitions(module: _Module) -> list[str]:
    defined = [node for node in module.tree.body if isinstance(node, (ast.ClassDef, *_FUNCTIONS))]
    return [node.name for node in defined if not node.name.startswith("_")]


if __name__ == "__main__":
    print(json.dumps(count(Path(*sys.argv[1:])), indent=1))
