"""Counts the structure of the package: size, names, import circles, `Any`, and files that name one scene key.

    python -m tools.count_structure               a table of this tree
    python -m tools.count_structure OLD NEW       several trees, one column each (folders that hold `canhaptic/`)
    python -m tools.count_structure --json        the same as JSON, with the lists behind the counts

Only the syntax trees of the files are read, but for `loaded`. Definitions:

code             lines with a token that is not a comment, without strings that are statements (docstrings);
                 that of `canhaptic/lab/` is the laboratory's, the rest is the product
loaded           code of the modules that a run of one axis imports, in a process of its own: `canhaptic run` of
                 `configs/demo.yaml`, without `canhaptic/sim/`, so that it is about what a real axis loads
crossing         classes and functions that a module of another room imports by name; a room is a child of the package
folders          files of each folder, its `__init__.py` left out
long functions   functions of more than 40 lines, their docstring left out
names            classes and functions at the top level of a module whose own name has no leading underscore, also
                 in modules and packages whose name has one; constants (top-level assignments) are counted apart
names twice      names of top-level classes, and of files (`__init__.py` and `__main__.py` left out), found twice
module circles   groups of modules that import each other; imports in functions and under TYPE_CHECKING count
sibling circles  the same between children of one package, where a child is a module or all of a subpackage
Any              uses of the name `Any` in the code, imports left out, per 1,000 lines of code
arguments        entries of `Args:` that begin with "Of" or "That"
key places       files of the package that hold a scene key as a string literal, for every key in `configs/`
"""

import argparse
import ast
import io
import json
import os
import re
import subprocess
import sys
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

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
    is_package: bool
    text: str
    tree: ast.Module

    @property
    def room(self) -> str:
        """The first folder below the package, or the package for its own files."""
        parts = self.name.split(".")
        return parts[1] if len(parts) > 2 or (len(parts) == 2 and self.is_package) else parts[0]


def count(top: Path, package: str = "canhaptic") -> dict[str, Any]:
    """Returns the counts of the package in the folder `top`, by name; for circles and double names, the lists."""
    modules = list(modules_of(top, package))
    lines = {module.name: _code_lines(module) for module in modules}
    names = [name for module in modules for name in _public_definitions(module)]
    imports = _imports(modules)
    return {
        "files": len(modules),
        "code": sum(lines.values()),
        "code_lab": sum(lines[module.name] for module in modules if _is_lab(module)),
        "loaded": _loaded_code(top, lines),
        "crossing": _crossing(modules),
        "vague_arguments": sum(len(VAGUE_ARGUMENT.findall(module.text)) for module in modules),
        "folders": files_by_folder(top / package),
        "long_functions": long_functions(modules),
        "names": len(names),
        "constants": sum(len(_public_constants(module)) for module in modules),
        "names_by_room": dict(Counter(module.room for module in modules for _ in _public_definitions(module))),
        "class_names_twice": _twice(node.name for module in modules for node in _classes(module)),
        "file_names_twice": _twice(_file_names(modules)),
        "module_circles": _circles(imports),
        "sibling_circles": _sibling_circles(imports),
        "any_per_1000": _any_by_room(modules, lines),
        "key_places": _key_places(top, modules),
    }


def files_by_folder(top: Path) -> dict[str, int]:
    """Returns how many files each folder of a package has, without its `__init__.py`; folders from `top` on."""
    places = (path.parent.relative_to(top).as_posix() for path in top.rglob("*.py") if path.name != "__init__.py")
    return dict(sorted(Counter(places).items()))


def crossing_names(top: Path, package: str = "canhaptic") -> list[str]:
    """Returns the classes and functions of the package in the folder `top` that a module of another room imports."""
    return _crossing(list(modules_of(top, package)))


def modules_of(top: Path, package: str) -> Iterator[_Module]:
    """Reads every source file of the package in the folder `top`."""
    for path in sorted((top / package).rglob("*.py")):
        parts = path.relative_to(top).with_suffix("").parts
        is_package = parts[-1] == "__init__"
        text = path.read_text(encoding="utf-8")
        yield _Module(".".join(parts[:-1] if is_package else parts), is_package, text, ast.parse(text))


def _code_lines(module: _Module) -> int:
    found: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(module.text).readline):
        if token.type not in _NO_CODE:
            found.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            found.difference_update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(found)


def _is_lab(module: _Module) -> bool:
    return module.name.split(".")[1:2] == ["lab"]


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
    lines = {module.name: _code_lines(module) for module in modules_of(top, "canhaptic")}
    return sum(lines[name] for name in names)


def _loaded_code(top: Path, lines: Mapping[str, int]) -> int | None:
    """Returns the code that a run loads without `sim`; None for a tree without a demo."""
    if not (top / "configs/demo.yaml").exists():
        return None
    return sum(lines[name] for name in loaded_modules(top) if name.split(".")[1:2] != ["sim"])


def _crossing(modules: list[_Module]) -> list[str]:
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


def _classes(module: _Module) -> list[ast.ClassDef]:
    return [node for node in module.tree.body if isinstance(node, ast.ClassDef)]


def _public_definitions(module: _Module) -> list[str]:
    defined = [node for node in module.tree.body if isinstance(node, (ast.ClassDef, *_FUNCTIONS))]
    return [node.name for node in defined if not node.name.startswith("_")]


def _public_constants(module: _Module) -> list[str]:
    targets: list[ast.expr] = []
    for node in module.tree.body:
        if isinstance(node, ast.Assign):
            targets += node.targets
        elif isinstance(node, ast.AnnAssign):
            targets.append(node.target)
    stored = [name for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)]
    return [name.id for name in stored if isinstance(name.ctx, ast.Store) and not name.id.startswith("_")]


def _file_names(modules: Iterable[_Module]) -> Iterator[str]:
    for module in modules:
        name = module.name.rsplit(".", 1)[-1]
        if not module.is_package and name != "__main__":
            yield name + ".py"


def _twice(names: Iterable[str]) -> list[str]:
    return sorted(name for name, times in Counter(names).items() if times > 1)


def _imports(modules: list[_Module]) -> dict[str, set[str]]:
    known = {module.name for module in modules}
    found: dict[str, set[str]] = {}
    for module in modules:
        targets: set[str] = set()
        for node in ast.walk(module.tree):
            if isinstance(node, ast.Import):
                targets.update(alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                inside = {f"{node.module}.{alias.name}" for alias in node.names}
                targets.update((inside & known) or {node.module})
        found[module.name] = (targets & known) - {module.name}
    return found


def _circles(graph: Mapping[str, set[str]]) -> list[list[str]]:
    """Returns the strongly connected groups of more than one node: those that reach each other."""
    reach = {node: _reached(graph, node) for node in graph}
    groups = {tuple(sorted(other for other in reach[node] if node in reach[other])) for node in graph}
    return [list(group) for group in sorted(groups) if len(group) > 1]


def _reached(graph: Mapping[str, set[str]], start: str) -> set[str]:
    found, ahead = {start}, [start]
    while ahead:
        new = graph[ahead.pop()] - found
        found |= new
        ahead += new
    return found


def _sibling_circles(imports: Mapping[str, set[str]]) -> list[list[str]]:
    found: list[list[str]] = []
    for package in sorted({name.rsplit(".", 1)[0] for name in imports if "." in name}):
        children: dict[str, set[str]] = defaultdict(set)
        for name, targets in imports.items():
            if (child := _child(package, name)) is not None:
                children[child].update(other for target in targets if (other := _child(package, target)))
        found += _circles({child: others - {child} for child, others in children.items()})
    return found


def _child(package: str, name: str) -> str | None:
    if not name.startswith(package + "."):
        return None
    return package + "." + name[len(package) + 1 :].split(".", 1)[0]


def _any_by_room(modules: list[_Module], lines: Mapping[str, int]) -> dict[str, float]:
    uses, sizes = Counter[str](), Counter[str]()
    for module in modules:
        uses[module.room] += sum(isinstance(n, ast.Name) and n.id == "Any" for n in ast.walk(module.tree))
        sizes[module.room] += lines[module.name]
    by_room = {room: round(1000 * uses[room] / sizes[room], 1) for room in sorted(sizes) if sizes[room]}
    return {"all": round(1000 * uses.total() / max(sizes.total(), 1), 1)} | by_room


def _key_places(top: Path, modules: list[_Module]) -> dict[str, int]:
    keys = {key for path in sorted((top / "configs").rglob("*.yaml")) for key in _keys(_yaml(path))}
    places = Counter[str]()
    for module in modules:
        literals = {
            node.value
            for node in ast.walk(module.tree)
            if isinstance(node, ast.Constant) and isinstance(node.value, str)
        }
        places.update(keys & literals)
    return {key: places[key] for key in sorted(keys, key=lambda key: (-places[key], key))}


def _yaml(path: Path) -> object:
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def _keys(value: object) -> Iterator[str]:
    if isinstance(value, list):
        for item in value:
            yield from _keys(item)
    elif isinstance(value, dict):
        for key, item in value.items():
            if isinstance(key, str):
                yield key
            yield from _keys(item)


def _rows(counts: Mapping[str, Any]) -> dict[str, str]:
    places = sorted(counts["key_places"].values()) or [0]
    return {
        "files": f"{counts['files']:,}",
        "lines of code": f"{counts['code']:,}",
        "lines of code of the product": f"{counts['code'] - counts['code_lab']:,}",
        "lines of code of the laboratory": f"{counts['code_lab']:,}",
        "lines of code that a run of one axis loads, without `sim`": f"{counts['loaded'] or 0:,}",
        "names that cross a room": str(len(counts["crossing"])),
        "arguments that begin with Of or That": str(counts["vague_arguments"]),
        "files of a folder, most": str(max(counts["folders"].values(), default=0)),
        "functions over 40 lines": str(len(counts["long_functions"])),
        "public classes and functions": f"{counts['names']:,}",
        "public constants": f"{counts['constants']:,}",
        "class names used twice": str(len(counts["class_names_twice"])),
        "file names used twice": str(len(counts["file_names_twice"])),
        "circles of modules": str(len(counts["module_circles"])),
        "circles of siblings": str(len(counts["sibling_circles"])),
        "`Any` per 1,000 lines": f"{counts['any_per_1000']['all']:.1f}",
        "files that name one scene key, mean": f"{sum(places) / len(places):.1f}",
        "files that name one scene key, most": str(places[-1]),
    }


def _table(trees: Mapping[str, Mapping[str, Any]]) -> str:
    columns = {name: _rows(counts) for name, counts in trees.items()}
    first = next(iter(columns.values()))
    head = ["| | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]
    body = [f"| {row} | " + " | ".join(column[row] for column in columns.values()) + " |" for row in first]
    rooms = sorted({room for counts in trees.values() for room in counts["any_per_1000"]})
    by_room = ["", "| room | " + " | ".join(f"{name}: names, Any" for name in trees) + " |", head[1]]
    for room in rooms:
        cells = [f"{c['names_by_room'].get(room, '')}, {c['any_per_1000'].get(room, '')}" for c in trees.values()]
        by_room.append(f"| {room} | " + " | ".join("" if cell == ", " else cell for cell in cells) + " |")
    return "\n".join(head + body + by_room)


def main(arguments: list[str] | None = None) -> int:
    """Prints the table or the JSON of one tree or several."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "tops", nargs="*", type=Path, default=[Path()], help="folders that hold canhaptic/ and configs/"
    )
    parser.add_argument("--json", action="store_true", help="print JSON, with the lists behind the counts")
    given = parser.parse_args(arguments)
    trees = {top.resolve().name: count(top) for top in given.tops}
    print(json.dumps(trees, indent=2) if given.json else _table(trees))
    return 0


if __name__ == "__main__":
    sys.exit(main())
