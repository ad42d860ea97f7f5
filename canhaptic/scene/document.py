"""YAML text as plain values with their source locations, and the list of faults found in a scene.

Scalars follow YAML 1.2, not PyYAML's 1.1: `1e-3` is a number, `017` is 17, and `1:30`, `on` and dates are plain text.
Keys stay text as written, so that `0x6076` remains the name of an object.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

import yaml

from canhaptic.axis_units import Motion
from canhaptic.errors import SceneError, escaped
from canhaptic.registry import unknown_key
from canhaptic.units import shown

_Kind = TypeVar("_Kind", "MarkedMapping", "MarkedList")


class SourceLocation(NamedTuple):
    """Source of a key or value: a line of a file, or an override on the command line."""

    source: str  # file name as given, or the override as typed
    line: int  # counted from 1; 0 when the source has no lines
    column: int  # counted from 1; 0 when the source has no lines
    path: tuple[str, ...]  # keys and list indices from the top of the scene

    @property
    def where(self) -> str:
        """Return `file:line:column`, or only the source when it has no lines."""
        return f"{self.source}:{self.line}:{self.column}" if self.line else self.source

    @property
    def folder(self) -> Path:
        """Folder from which a relative path at this location starts: that of the file, or the current one."""
        return Path(self.source).parent if self.line else Path()

    def below(self, *parts: str) -> "SourceLocation":
        """Return the location for an entry that the source does not contain: this line, with the entry's path."""
        return self._replace(path=(*self.path, *parts))


class Diagnostics:
    """List of the faults of a scene, which are shown together and each only once."""

    def __init__(self) -> None:
        self._lines: dict[str, tuple[int, int]] = {}

    def __len__(self) -> int:
        return len(self._lines)

    def add(self, mark: SourceLocation, message: str) -> None:
        """Note a fault as `file:line:column: path: message`."""
        path = f"{'.'.join(mark.path)}: " if mark.path else ""
        self._lines.setdefault(escaped(f"{mark.where}: {path}{message}"), (mark.line, mark.column))

    def mapping(self, value: object, at: SourceLocation, what: str) -> "MarkedMapping | None":
        """Return a value that must be a mapping; note a fault and return None if it is not."""
        return self._of_kind(MarkedMapping, value, at, f"a mapping of {what}")

    def section(self, owner: "MarkedMapping", key: str, what: str) -> "MarkedMapping | None":
        """Return an entry that must be a mapping, None if it is missing; note a fault if it is something else."""
        return None if owner.get(key) is None else self.mapping(owner[key], owner.value_at(key), what)

    def list(self, value: object, at: SourceLocation, what: str) -> "MarkedList | None":
        """Return a value that must be a list; note a fault and return None if it is not."""
        return self._of_kind(MarkedList, value, at, f"a list of {what}")

    def _of_kind(self, kind: type[_Kind], value: object, at: SourceLocation, what: str) -> _Kind | None:
        if isinstance(value, kind):
            return value
        self.add(at, f"got {shown(value)}, expected {what}")
        return None

    def unknown_keys(self, section: "MarkedMapping", known: Iterable[str]) -> None:
        """Note every unknown key of a section, with the nearest known name."""
        names = tuple(known)
        for key in section:
            if key not in names:
                self.add(section.keys_at[key], unknown_key(key, names))

    def error(self, kind: type[SceneError] = SceneError) -> SceneError:
        """Return an error with the faults noted so far, overrides first, then in the order of the file."""
        lines = sorted(self._lines, key=lambda line: self._lines[line])
        more = len(lines) - _MOST_SHOWN
        return kind([*lines[:_MOST_SHOWN], *([f"and {more} more faults"] if more > 0 else [])])

    def raise_if_any(self, kind: type[SceneError] = SceneError) -> None:
        """Raise the error if there is any fault."""
        if self._lines:
            raise self.error(kind)


NOTED: Final = object()
"""Replaces a value whose fault has already been noted."""
_MOST_SHOWN: Final = 200  # faults of one scene
_MAX_NODES: Final = 20_000  # a scene has a few hundred; more is an alias bomb
_TAG: Final = "tag:yaml.org,2002:"
_MERGE: Final = _TAG + "merge"
_SCALARS: Final = (
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("bool", r"true|True|TRUE|false|False|FALSE", list("tTfF")),
    ("int", r"[-+]?[0-9][0-9_]*|0x[0-9a-fA-F]+|0o[0-7]+", list("-+0123456789")),
    ("float", r"[-+]?(?:\.[0-9]+|[0-9][0-9_]*(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?", list("-+.0123456789")),
    ("float", r"[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)", list("-+.")),
    ("merge", r"<<", ["<"]),
)


class MarkedMapping(dict[str, Any]):
    """A mapping of the scene with its source locations.

    Attributes:
        mark: Source location of the mapping.
        keys_at: Source locations of its keys.
        values_at: Source locations of its values.
        elsewhere: Valid keys that are removed here because another part reads them.
        motion: Unit of position ("m" or "rad") that decides the units of its values; None: inherited.
        bus_kind: Kind of the bus that it describes, or that its axis is on.
        was: Value of its key `type` before an override replaced it, "" without that key; None: not replaced.
    """

    def __init__(self, mark: SourceLocation, motion: Motion | None = None) -> None:
        super().__init__()
        self.mark = mark
        self.keys_at: dict[str, SourceLocation] = {}
        self.values_at: dict[str, SourceLocation] = {}
        self.elsewhere: tuple[str, ...] = ()
        self.motion = motion
        self.was: str | None = None
        self.bus_kind = "can"

    def put(self, key: str, value: Any, key_at: SourceLocation, value_at: SourceLocation) -> None:
        """Set one entry with its source locations."""
        self[key] = value
        self.keys_at[key] = key_at
        self.values_at[key] = value_at

    def set(self, key: str, value: Any) -> None:
        """Set an entry that the document does not contain; it has the location of the value, else of the mapping."""
        at = value.mark if isinstance(value, MarkedMapping | MarkedList) else self.mark
        self.put(key, value, at, at)

    def value_at(self, key: str) -> SourceLocation:
        """Return the location of an entry; for a missing one that of the mapping, with the key in its path."""
        return self.values_at.get(key) or self.mark.below(key)

    def copy(self) -> "MarkedMapping":
        """Return a copy of the entries and their locations; nested values are shared."""
        twin = MarkedMapping(self.mark, self.motion)
        twin.elsewhere, twin.was, twin.bus_kind = self.elsewhere, self.was, self.bus_kind
        twin.update(self)
        twin.keys_at.update(self.keys_at)
        twin.values_at.update(self.values_at)
        return twin

    def without(self, *names: str) -> "MarkedMapping":
        """Return a copy without some entries, which another part reads."""
        twin = self.copy()
        twin.elsewhere += names
        for name in names:
            twin.pop(name, None)
        return twin

    def only(self, names: Iterable[str]) -> "MarkedMapping":
        """Return a copy with only these entries."""
        twin = self.copy()
        for key in self.keys() - set(names):
            del twin[key]
        return twin

    def over(self, lower: "MarkedMapping") -> "MarkedMapping":
        """Return the entries of both mappings; this one's entry and location win."""
        twin = self.copy()
        for key, value in lower.items():
            if key not in self:
                twin.put(key, value, lower.keys_at[key], lower.values_at[key])
        return twin


class MarkedList(list[Any]):
    """A list of the scene; `mark` is its own location, `values_at` has the locations of its entries."""

    def __init__(self, mark: SourceLocation) -> None:
        super().__init__()
        self.mark = mark
        self.values_at: list[SourceLocation] = []

    def put(self, value: Any, value_at: SourceLocation) -> None:
        """Append one entry with its location."""
        self.append(value)
        self.values_at.append(value_at)

    def items_at(self) -> Iterator[tuple[Any, SourceLocation]]:
        """Yield every entry with its location."""
        return zip(self, self.values_at, strict=True)


class _Loader(yaml.SafeLoader):
    """Composes nodes with the scalars of YAML 1.2."""

    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012  (PyYAML's own name; emptied of the YAML 1.1 rules)


for _kind, _pattern, _first in _SCALARS:
    _Loader.add_implicit_resolver(_TAG + _kind, re.compile(f"^(?:{_pattern})$"), _first)

_C_DIFFERS: Final = re.compile(r"[\t\ufeff!?]|^%|[|>].*#|^ {99}", re.MULTILINE)
"""Text that libyaml may accept where PyYAML's own parser does not, or read otherwise."""
_C_NESTS: Final = re.compile(r"[\[{]|- +(?=-)")
_C_NESTED: Final = 200  # matches of _C_NESTS in a text; libyaml's composer calls itself without a limit


def _c_loader() -> Any:
    """Return the loader that composes by libyaml, in a tenth of the time; None where PyYAML was built without it."""
    if not yaml.__with_libyaml__:
        return None

    class CLoader(yaml.CSafeLoader):
        yaml_implicit_resolvers = _Loader.yaml_implicit_resolvers

        def resolve(self, kind: Any, value: Any, implicit: Any) -> Any:
            if value == "" and implicit[0]:
                raise yaml.YAMLError("libyaml has another place for a value that is missing")
            return super().resolve(kind, value, implicit)  # type: ignore[no-untyped-call]

    return CLoader


_C_LOADER: Final = _c_loader()


def parse_yaml(text: str, source: str, faults: Diagnostics, path: tuple[str, ...] = (), lined: bool = True) -> Any:
    """Return the value of a YAML document, its mappings and lists marked.

    Args:
        text: The document.
        source: Name of the document in every fault.
        faults: Receives syntax errors, duplicate keys and anything else that is not plain data.
        path: Path of the value in the scene.
        lined: Whether locations have line numbers; False for an override.
    """
    top = SourceLocation(source, int(lined), int(lined), path)
    try:
        node = compose(text)
    except RecursionError:
        faults.add(top, "nested too deeply")
        return None
    except yaml.MarkedYAMLError as error:
        place = error.problem_mark
        at = top._replace(line=place.line + 1, column=place.column + 1) if place is not None and lined else top
        context = f" {error.context}" if error.context else ""
        faults.add(at, f"not valid YAML: {error.problem}{context}")
        return None
    except (yaml.YAMLError, ValueError) as error:
        faults.add(top, f"not valid YAML: {' '.join(str(error).split())}")
        return None
    return None if node is None else _Builder(source, lined, faults).value(node, path)


@lru_cache(maxsize=32)  # a sweep reads one file for each of its scenes: reading it is most of what loading costs
def compose(text: str) -> yaml.Node | None:
    """Return the YAML nodes of a document, with their lines and columns.

    Raises:
        yaml.YAMLError: It is not valid.
        RecursionError: It is nested too deeply.
        ValueError: It has characters that YAML does not know.
    """
    if _C_LOADER is not None and not _C_DIFFERS.search(text) and len(_C_NESTS.findall(text)) <= _C_NESTED:
        with suppress(yaml.YAMLError, ValueError):  # whose text and place are those of PyYAML's own parser
            return yaml.compose(text, _C_LOADER)
    return yaml.compose(text, _Loader)


class _Builder:
    """Conversion of YAML nodes to marked values; faults are noted, and reading continues."""

    def __init__(self, source: str, lined: bool, faults: Diagnostics) -> None:
        self._source = source
        self._lined = lined
        self._faults = faults
        self._open: list[yaml.Node] = []
        self._nodes = 0

    def _mark(self, node: yaml.Node, path: tuple[str, ...]) -> SourceLocation:
        place = node.start_mark
        if not self._lined or place is None:
            return SourceLocation(self._source, 0, 0, path)
        return SourceLocation(self._source, place.line + 1, place.column + 1, path)

    def value(self, node: yaml.Node, path: tuple[str, ...]) -> Any:
        """Return the value of a node; note a fault and return None if it is not plain data."""
        self._nodes += 1
        mark = self._mark(node, path)
        if any(node is outer for outer in self._open):
            self._faults.add(mark, "an alias that contains itself")
        elif self._nodes == _MAX_NODES:
            self._faults.add(mark, f"more than {_MAX_NODES} values after resolving aliases")
        elif self._nodes > _MAX_NODES:
            pass
        elif isinstance(node, yaml.ScalarNode):
            return self._scalar(node, mark)
        elif node.tag not in {_TAG + "map", _TAG + "seq"}:
            self._faults.add(mark, f"tag {node.tag!r} is not supported; write plain values")
        else:
            self._open.append(node)
            result = self._mapping(node, mark) if isinstance(node, yaml.MappingNode) else self._list(node, mark)
            self._open.pop()
            return result
        return None

    def _scalar(self, node: yaml.ScalarNode, mark: SourceLocation) -> Any:
        try:
            return _read_scalar(node.tag.removeprefix(_TAG), str(node.value))
        except (KeyError, ValueError):
            shown = str(node.value)[:40]
            self._faults.add(mark, f"got {shown!r}, which is not a plain value of tag {node.tag!r}")
            return None

    def _list(self, node: yaml.Node, mark: SourceLocation) -> MarkedList:
        result = MarkedList(mark)
        for index, item in enumerate(node.value):
            path = (*mark.path, str(index))
            result.put(self.value(item, path), self._mark(item, path))
        return result

    def _mapping(self, node: yaml.MappingNode, mark: SourceLocation) -> MarkedMapping:
        result = MarkedMapping(mark)
        merged: list[MarkedMapping] = []
        for key_node, value_node in node.value:
            if key_node.tag == _MERGE:
                merged += self._merged(value_node, mark)
            elif not isinstance(key_node, yaml.ScalarNode):
                self._faults.add(self._mark(key_node, mark.path), "a key must be a plain word or number")
            else:
                self._entry(result, str(key_node.value), key_node, value_node)
        for other in merged:  # entries written out win over merged ones, earlier ones over later
            result = result.over(other)
        return result

    def _entry(self, result: MarkedMapping, key: str, key_node: yaml.Node, value_node: yaml.Node) -> None:
        path = (*result.mark.path, key)
        key_at = self._mark(key_node, path)
        if key in result:
            first = result.keys_at[key]
            self._faults.add(key_at, f"key {key!r} is given twice, first in line {first.line}; keep one")
            return
        result.put(key, self.value(value_node, path), key_at, self._mark(value_node, path))

    def _merged(self, node: yaml.Node, mark: SourceLocation) -> list[MarkedMapping]:
        sources = node.value if isinstance(node, yaml.SequenceNode) else [node]
        found = [self.value(source, mark.path) for source in sources]
        if not all(isinstance(value, MarkedMapping) for value in found):
            self._faults.add(self._mark(node, mark.path), "'<<' merges mappings only")
        return [value for value in found if isinstance(value, MarkedMapping)]


def _read_scalar(kind: str, text: str) -> Any:
    plain = text.replace("_", "").lower()
    if kind == "int":
        return int(plain, {"0x": 16, "0o": 8}.get(plain[:2], 10))
    if kind == "float":
        return float(re.sub(r"\.(?=inf|nan)", "", plain))
    if kind == "bool":
        return {"true": True, "false": False}[text.lower()]
    return {"str": text, "merge": text, "null": None}[kind]


def mark_plain(value: Any, source: str, path: tuple[str, ...] = ()) -> Any:
    """Return Python mappings and sequences as marked ones, for a scene without a file."""
    mark = SourceLocation(source, 0, 0, path)
    if isinstance(value, Mapping):
        result = MarkedMapping(mark)
        for key, entry in value.items():
            name = f"{key:#x}" if isinstance(key, int) and not isinstance(key, bool) else str(key)  # of an object
            below = mark.below(name)
            result.put(name, mark_plain(entry, source, below.path), below, below)
        return result
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        items = MarkedList(mark)
        for index, entry in enumerate(value):
            below = mark.below(str(index))
            items.put(mark_plain(entry, source, below.path), below)
        return items
    return value if value is None or isinstance(value, str | bytes | int | float) else _given(value, source, path)


def _given(value: object, source: str, path: tuple[str, ...]) -> object:
    """Return an object that a Python program gives in place of plain values; what it does not know unchanged."""
    from canhaptic.scene.given import plain

    with suppress(TypeError):
        return mark_plain(plain(value, path), source, path)
    return value
