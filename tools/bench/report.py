"""What every benchmark shares: rows side by side, interleaved repeats, the machine, one table, one JSON file."""

import json
import os
import platform
from argparse import ArgumentParser
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from importlib import metadata
from pathlib import Path
from time import perf_counter
from typing import Any, TypeVar

from rich.console import Console
from rich.table import Table

Name = TypeVar("Name")
Found = TypeVar("Found")

RESULTS = Path(__file__).resolve().parents[2] / "docs" / "results"
IMAGES = RESULTS.with_name("images")
OUT_VARIABLE = "CANHAPTIC_BENCH_OUT"
"""Names the folder of a benchmark's files; `tools/bench/run.py` sets it."""
DEFAULT_OUT = RESULTS.parents[1] / "bench_output"


def out_folder() -> Path:
    """Returns the folder for the results of this run: `docs/results` only where recording was asked for."""
    return Path(os.environ.get(OUT_VARIABLE) or DEFAULT_OUT)


def kept_folder() -> Path:
    """Returns the folder for runs that a later call goes on from; they are no result, and never recorded."""
    return DEFAULT_OUT if out_folder() == RESULTS else out_folder()


def picture_place(name: str) -> Path:
    """Returns where a picture of this run goes: into `docs/images` where results are recorded."""
    folder = IMAGES if out_folder() == RESULTS else out_folder()
    folder.mkdir(parents=True, exist_ok=True)
    return folder / name


@dataclass(frozen=True, slots=True)
class Row:
    """One figure of a benchmark and its peer; `met` is None where there is no target."""

    row: str
    value: float
    unit: str
    peer: str = ""
    peer_value: float | None = None
    ratio: float | None = None
    target: str = ""
    met: bool | None = None
    note: str = ""  # why a target is missed, or what the peer does against ours


def machine() -> dict[str, str]:
    """Returns what the figures were measured on."""
    return {
        "system": f"{platform.system()} {platform.release()}",
        "processor": _processor(),
        "cores": str(os.cpu_count()),
        "python": platform.python_version(),
    }


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def versions(packages: Sequence[str]) -> dict[str, str]:
    """Returns the installed version of each package; "absent" where it is not installed."""
    found = {}
    for package in packages:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "absent"
    return found


def in_turn(candidates: Mapping[Name, Callable[[], Found]], repeats: int) -> dict[Name, list[Found]]:
    """Returns what each candidate gives, run in turn A B C A B C, so that a drifting machine hits all alike."""
    found: dict[Name, list[Found]] = {name: [] for name in candidates}
    for _ in range(repeats):
        for name, candidate in candidates.items():
            found[name].append(candidate())
    return found


def interleave(candidates: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, list[float]]:
    """Returns wall times [s] of each candidate, run in turn."""
    return in_turn({name: partial(_seconds, candidate) for name, candidate in candidates.items()}, repeats)


def _seconds(candidate: Callable[[], object]) -> float:
    start = perf_counter()
    candidate()
    return perf_counter() - start


def rows_of_kinds(
    question: str, kinds: Mapping[str, Callable[[], Iterable[Row]]], parser: ArgumentParser, only: Sequence[str]
) -> list[Row]:
    """Returns rows of some kinds, or of all, and the recorded rows of those that were not measured.

    Args:
        question: Name of the result.
        kinds: Kind -> what measures its rows, all of whose names begin alike up to a colon.
        parser: Ends the process for an unknown kind.
        only: Kinds; none: all.
    """
    if unknown := [kind for kind in only if kind not in kinds]:
        parser.error(f"--only: got {', '.join(unknown)}, expected some of: {', '.join(kinds)}")
    rows = [row for kind in only or kinds for row in kinds[kind]()]
    path = out_folder() / f"{question}.json"
    path = path if path.is_file() else RESULTS / path.name
    known = [Row(**of) for of in json.loads(path.read_text(encoding="utf-8"))["rows"]] if path.is_file() else []
    measured = {_kind(row) for row in rows}
    return [*(row for row in known if _kind(row) not in measured), *rows]


def _kind(row: Row) -> str:
    return row.row.partition(":")[0]


def publish(question: str, rows: Sequence[Row], packages: Sequence[str], more: Mapping[str, Any] | None = None) -> None:
    """Prints the table and writes <question>.json, with more besides, into the folder for results."""
    table = Table(title=question)
    for heading in ("figure", "value", "unit", "peer", "peer value", "ratio", "target", "met"):
        table.add_column(heading)
    for row in rows:
        met = "" if row.met is None else "yes" if row.met else "MISSED"
        table.add_row(
            row.row, _short(row.value), row.unit, row.peer, _short(row.peer_value), _short(row.ratio), row.target, met
        )
    console = Console(width=150)
    console.print(table)
    for row in rows:
        if row.note:
            console.print(f"{row.row}, {row.peer}: {row.note}")
    console.print("  ".join(f"{key}: {value}" for key, value in {**machine(), **versions(packages)}.items()))
    path = out_folder() / f"{question}.json"
    write_result(path, packages, {"rows": [asdict(row) for row in rows], **(more or {})})
    console.print(f"written: {path}", soft_wrap=True)


def write_result(path: Path, packages: Sequence[str], found: Mapping[str, Any]) -> None:
    """Writes what was found, under the machine and the versions of some packages unless it names its own."""
    document = {"machine": machine(), "versions": versions(packages), **found}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def _short(value: float | None) -> str:
    return "" if value is None else f"{value:.4g}"
