"""Results of a sweep: a store whose chunks are NumPy archives of consecutive scenes, and the summary of all scenes.

KEY                    values of each scene: numbers in SI, or texts
AXIS/METRIC            figures; NaN where a metric does not apply
status, engine         indices in `STATUS` and `ENGINES` of `chunk`
remark                 0 for none, else 1 + index in texts
texts                  remarks of the chunk
"""

import io
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any, Final
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray
from rich.console import Group, RenderableType
from rich.text import Text

from canhaptic.axis_units import si
from canhaptic.control.verdict import PASSIVE_TOLERANCE
from canhaptic.errors import LogFormatError
from canhaptic.lab.figures.figures import outcomes
from canhaptic.lab.loop.axis_loop import Array
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.store import Store, create_store
from canhaptic.lab.studies.sweep.chunk import COMPLETED, ENGINES, RADIUS, STATUS, UNRENDERED, UNTOUCHED, ChunkResult
from canhaptic.lab.studies.sweep.vary import CONTROLLER, Column, Points, Varied
from canhaptic.view.table import Table

_KIND: Final = "sweep"
_BYTES: Final = 8  # of one figure


class SweepTable(Store):
    """The folder of a sweep: its scenes, and the figures computed so far.

    Args:
        path: Folder made by `create`.
        writable: Whether chunks will be written; only one process can write.

    Attributes:
        points: Scenes of the sweep.
        identity: Facts that a resumed sweep must match.
        chunk: Scenes per chunk.
        keys: Keys that vary, in the order given.
        axes: Names of the axes, in the order of the scene.
        metrics: Names of the figures, the same for every axis.

    Raises:
        LogFormatError: The folder holds no sweep, or one of a newer version.
        LogWriteError: Another process writes it.
    """

    def __init__(self, path: Path, *, writable: bool = False) -> None:
        super().__init__(path, _KIND, writable=writable)
        self.identity: Row = self.document["identity"]
        self.chunk = int(self.document["chunk"])
        self.points = _points(self.identity)
        self.keys = [one.key for one in self.points.varied]
        self.axes: list[str] = self.identity["axes"]
        self.metrics: list[str] = self.identity["metrics"]

    def __len__(self) -> int:
        return len(self.points)

    def note(self, name: str) -> str:
        """Return a note on the sweep by name; "" if there is none."""
        return str(self.document["notes"].get(name, ""))

    def done(self) -> NDArray[np.bool_]:
        """Return which chunks exist, shape (n_chunks,)."""
        flags = np.zeros(-(-len(self) // self.chunk), dtype=bool)
        flags[[int(name.partition(".")[0]) for name in self.chunks]] = True
        return flags

    def span(self, chunk: int) -> tuple[int, int]:
        """Return the indices [start, stop) of the scenes of a chunk."""
        return chunk * self.chunk, min(len(self), (chunk + 1) * self.chunk)

    def finished(self) -> int:
        """Return the number of scenes in chunks that exist."""
        return sum(stop - start for start, stop in map(self.span, np.flatnonzero(self.done()).tolist()))

    def values(self, key: str) -> Column:
        """Return the values of a key: numbers in SI of shape (n,), or a list of texts."""
        return self.points.columns(0, len(self))[key]

    def figure(self, axis: str, metric: str) -> Array:
        """Return a figure of every scene, shape (n,); NaN where it does not apply or is not computed yet."""
        return self._column(f"{axis}/{metric}", np.full(len(self), np.nan))

    def status(self, axis: str = "") -> NDArray[np.uint8]:
        """Return the status of every scene, for one axis or for all, as indices in `STATUS`, shape (n,)."""
        found = self._column("status", np.zeros(len(self), dtype=np.uint8))
        axes = [axis] if axis else self.axes
        return self._with_outcomes(found, axes, lambda path: self._column(path, np.full(len(self), np.nan)))

    def _with_outcomes(
        self, status: NDArray[np.uint8], axes: Sequence[str], column: Callable[[str], Array]
    ) -> NDArray[np.uint8]:
        """Mark the completed scenes in which no axis was touched and rendered: they say nothing about passivity."""

        def outcome(axis: str) -> Any:
            return outcomes(lambda metric: column(f"{axis}/{metric}") if metric in self.metrics else np.nan)

        found = np.stack([outcome(axis) for axis in axes])
        marks = np.where((found == 0).any(axis=0), 0, found.max(axis=0))
        return np.where(status == COMPLETED, np.array([COMPLETED, UNTOUCHED, UNRENDERED], np.uint8)[marks], status)

    def engine(self) -> NDArray[np.uint8]:
        """Return the engine of every scene as indices in `ENGINES`, shape (n,)."""
        return self._column("engine", np.zeros(len(self), dtype=np.uint8))

    def remark(self, scene: int) -> str:
        """Return the remark on a scene: why it was refused or ran alone, or which properties came from the plant."""
        texts, numbers = self._read(scene // self.chunk, "texts", "remark")
        number = int(numbers[scene % self.chunk])
        return str(texts[number - 1]) if number else ""

    def remarks(self) -> Iterator[tuple[str, str, str, int]]:
        """Yield (status, engine, remark, number of scenes), chunk by chunk, with equal scenes counted together."""
        for chunk in np.flatnonzero(self.done()).tolist():
            texts, *rows = self._read(chunk, "texts", "status", "engine", "remark")
            rows[0] = self._with_outcomes(rows[0], self.axes, partial(self._figure_in, chunk))
            kinds, counts = np.unique(np.stack(rows), axis=1, return_counts=True)
            for (status, engine, number), count in zip(kinds.T.tolist(), counts.tolist(), strict=True):
                yield STATUS[status], ENGINES[engine], str(texts[number - 1]) if number else "", count

    def store(self, chunk: int, result: ChunkResult) -> None:
        """Store a chunk; it is on the disk on return.

        Raises:
            LogWriteError: The chunk cannot be written; finished chunks are kept.
        """
        columns: dict[str, Any] = {**self.points.columns(*self.span(chunk)), **result.figures}
        columns |= {"status": result.status, "engine": result.engine, "remark": result.remark}
        content = io.BytesIO()
        np.savez(content, **columns, texts=np.array(result.texts, dtype=np.str_))
        self.write(_name(chunk), content.getvalue())

    def _column(self, name: str, found: NDArray[Any]) -> NDArray[Any]:
        """Fill a column with the rows of the finished chunks, and return it."""
        for chunk in np.flatnonzero(self.done()).tolist():
            (found[slice(*self.span(chunk))],) = self._read(chunk, name)
        return found

    def _figure_in(self, chunk: int, path: str) -> Array:
        return self._read(chunk, path)[0]

    def _read(self, chunk: int, *names: str) -> list[NDArray[Any]]:
        """Return arrays of a chunk.

        Raises:
            LogFormatError: The chunk is damaged or missing.
        """
        path = self.folder / _name(chunk)
        try:
            with np.load(path, allow_pickle=False) as found:
                return [np.asarray(found[name]) for name in names]
        except (OSError, ValueError, KeyError, BadZipFile) as error:
            raise LogFormatError(f"{path}: cannot be read ({error}); remove it and --resume") from error


def create(path: Path, chunk: int, identity: Row, notes: dict[str, str], *, replace: bool) -> None:
    """Create the folder of a sweep, without results; it appears completely or not at all.

    Args:
        path: Folder.
        chunk: Scenes per chunk.
        identity: Facts that a resumed sweep must match.
        notes: Texts about the sweep.
        replace: Whether to replace an existing sweep.

    Raises:
        InputError: The folder exists already.
        LogWriteError: The folder is missing or read-only, the disk is too small for all results, or another process
            writes it.
    """
    columns = len(identity["axes"]) * len(identity["metrics"]) + len(identity["varied"])
    room = len(_points(identity)) * (_BYTES * columns + 3)
    document = {"identity": identity, "chunk": chunk, "notes": notes}
    create_store(path, _KIND, document, room=room, replace=replace)


def _points(identity: Row) -> Points:
    keys = [field.name for field in fields(Varied)]
    varied = ({key: one[key] for key in keys} | {"values": tuple(one["values"])} for one in identity["varied"])
    return Points(tuple(Varied(**one) for one in varied), identity["samples"], identity["seed"])


def _name(chunk: int) -> str:
    return f"{chunk:08d}.npz"


_MOST_REMARKS: Final = 20


def summary(table: SweepTable) -> Row:
    """Return the summary of a sweep as plain values, as `canhaptic sweep --json` prints it."""
    remarks, status, engines = Counter[tuple[str, str, str]](), Counter[str](), Counter[str]()
    for ended, engine, remark, number in table.remarks():
        remarks[ended, engine, remark] += number
        status[ended] += number
        engines[engine] += number
    return {
        "file": str(table.folder),
        "scene": table.note("source"),
        "varied": [varied["given"] for varied in table.identity["varied"]],
        "samples": table.identity["samples"],
        "scenes": len(table),
        "finished": table.finished(),
        "status": dict(status),
        "engines": dict(engines),
        "remarks": [
            {**dict(zip(("status", "engine", "remark"), kind, strict=True)), "scenes": number}
            for kind, number in remarks.most_common()
            if kind[2]
        ][:_MOST_REMARKS],
        "figures": {axis: _figures(table, axis) for axis in table.axes},
    }


def _figures(table: SweepTable, axis: str) -> Row:
    """Return shares and medians over the completed scenes, by algorithm."""
    status = table.status(axis)
    if CONTROLLER not in table.keys:
        return {"of the scene": _shares(table, axis, status)}
    numbers = table.points.numbers(CONTROLLER)
    names = next(one.values for one in table.points.varied if one.key == CONTROLLER)
    return {str(name): _shares(table, axis, np.where(numbers == i, status, 0)) for i, name in enumerate(names)}


def _shares(table: SweepTable, axis: str, status: NDArray[np.uint8]) -> Row:
    """Return shares, least values and medians of some scenes that were touched; None where there are none."""
    rows = status == COMPLETED
    found: Row = {"scenes": int(rows.sum())}
    for key, number in _PROVE_NOTHING.items():
        if count := int((status == number).sum()):
            found[key] = count
    for name, (_, metric, figure) in _SHARES.items():
        if metric in table.metrics:
            values = table.figure(axis, metric)[rows]
            found[name] = figure(values) if len(values) else None
    return found


def _kept(values: Array) -> float:
    return float((values >= -PASSIVE_TOLERANCE).mean())


def _finite(figure: Callable[[Array], Any]) -> Callable[[Array], float | None]:
    """Return a function that applies `figure` to the finite values only; None if there are none."""

    def of(values: Array) -> float | None:
        finite = values[np.isfinite(values)]
        return float(figure(finite)) if len(finite) else None

    return of


_SHARES: Final[Mapping[str, tuple[str, str, Callable[[Array], float | None]]]] = {
    "passive": ("passive, by the plant", "least_interaction", _kept),
    "margin_kept": ("margin kept", "margin", _kept),
    "least_margin": ("smallest margin", "margin", _finite(np.min)),
    "diverged": ("diverged", "diverged", lambda values: float((values == 1.0).mean())),
    "stable": ("linear loop stable", RADIUS, _finite(lambda values: (values < 1.0).mean())),
    "stiffness_rendered": ("stiffness, median", "stiffness_rendered.share", _finite(np.median)),
    "mass_felt": ("mass felt, median", "mass_felt.share", _finite(np.median)),
    "guard_acts": ("guard acts, median", "guard_acts", _finite(np.median)),
}
"""Name -> heading, metric, and the function from its values to one number."""
_PROVE_NOTHING: Final = {"no_contact": UNTOUCHED, "nothing_rendered": UNRENDERED}
"""Name -> status of scenes that count neither as passive nor as active."""


def summary_report(found: Row) -> RenderableType:
    """Return the tables of a summary for a terminal."""
    heading = Text.assemble(" ", (found["scene"], "bold"), f"   {found['finished']} of {found['scenes']} scenes   ",
                            "  ".join(found["varied"]))  # fmt: skip
    engines = {_ENGINES[name]: number for name, number in found["engines"].items()}
    lines = [Text(f" computed: {_listed(engines)}"), Text(f" status:   {_listed(found['status'])}")]
    style = {"refused": "yellow", "failed": "red"}
    lines += [
        Text(f" {of['scenes']} {of['status']} ({_ENGINES[of['engine']]}): {of['remark']}", style.get(of["status"], ""))
        for of in found["remarks"]
        if of["engine"] != "scalar" or not of["remark"].startswith("only ")
    ]
    return Group(heading, *lines, _shares_table(found))


def _listed(counts: dict[str, int]) -> str:
    return ", ".join(f"{number} {name}" for name, number in counts.items()) or "nothing yet"


_ENGINES: Final = {"none": "not run", "scalar": "one at a time", "python": "in batches", "numba": "in compiled batches",
                   "closed form": "in closed form"}  # fmt: skip


def _shares_table(found: Row) -> Table:
    entries = {(axis, name): entry for axis, of in found["figures"].items() for name, entry in of.items()}
    heads = {key: STATUS[number] for key, number in _PROVE_NOTHING.items()}
    heads |= {key: head for key, (head, _, _) in _SHARES.items()}
    shown = [key for key in heads if any(key in entry for entry in entries.values())]
    rows = [
        [f"{axis}, {name}", str(entry["scenes"]), *(_cell(key, entry.get(key)) for key in shown)]
        for (axis, name), entry in entries.items()
    ]
    return Table("", ["axis, algorithm", "scenes", *(heads[key] for key in shown)], rows, keys=1)


def _cell(key: str, value: float | None) -> str:
    if value is None:
        return "-"
    if key in _PROVE_NOTHING:
        return str(value)
    return si(value, "J", 3) if key == "least_margin" else f"{100.0 * value:.3g} %"
