"""Reads an energy log: quantities as NumPy arrays, each loaded on first use.

with EnergyLog("run.h5") as log:
    handle = log.ports["handle"]
    power = handle["interaction"] / log.sample_time  # [W]
    print(handle.unit("interaction"), log.status, log.attributes["config_hash"])

A log is opened only if all its columns are present, of the right type, and of equal length.
"""

import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple, Self, TypeVar

import numpy as np

from canhaptic.errors import InputError, LogFormatError
from canhaptic.logs import columns as log_format
from canhaptic.logs import log_file
from canhaptic.logs.hdf5 import Array, Attribute, Dataset, Hdf5File, failure_of, row_digests
from canhaptic.quantities import NEW_COLUMNS, OLD_COLUMNS

RUNNING: Final = "running"
"""Status of a log that its writer has not closed; after a kill the columns may differ in length by one chunk."""

DAMAGE: Final = (OSError, RuntimeError, LookupError, ValueError, TypeError, OverflowError)
"""Exceptions of h5py and NumPy for damaged files."""
_SAVES: Final = "; `inspect --repair` saves the rest"
Columns = Mapping[str, Dataset]


@contextmanager
def read_safely(path: str | Path, what: str, more: str = "") -> Iterator[None]:
    """Turn exceptions of h5py and NumPy for damaged files into a LogFormatError.

    Args:
        path: Path of the log.
        what: Damaged part, for the message.
        more: End of the message, after the library's words.
    """
    try:
        yield
    except InputError:
        raise
    except DAMAGE as error:
        raise LogFormatError(f"{path}: {what} ({error}){more}") from error


def checked_rows(path: Path, file: Hdf5File, ports: Sequence[str], status: str) -> int:
    """Return the number of rows that all columns have.

    Args:
        path: Path of the log, for messages.
        file: The same file, open.
        ports: Names of its ports.
        status: Status of the log: while it is `RUNNING`, columns may differ by a chunk.

    Raises:
        LogFormatError: A column is missing, of another type, or shorter than the others; names it, with the rows found
            and expected.
    """
    rows, events = found_columns(path, file, ports)
    for columns in (rows, events):
        lengths, expected = {name: len(dataset) for name, dataset in columns.items()}, usual_length(columns)
        odd = [name for name, length in lengths.items() if length != expected]
        if status == RUNNING:  # it may also have grown from one column to the next
            least = expected - max(dataset.chunk for dataset in columns.values())
            odd = [name for name in odd if lengths[name] < least and columns[name].refreshed_length() < least]
        if odd:
            more = f" ({len(odd)} columns are of another length)" if len(odd) > 1 else ""
            raise LogFormatError(
                f"{path}: {odd[0]} has {lengths[odd[0]]} rows, expected {expected} like the other columns{more}; "
                "the file is damaged; `inspect --repair` saves the rows that every column has"
            )
    return min(len(dataset) for dataset in rows.values())


def found_columns(path: Path, file: Hdf5File, ports: Sequence[str]) -> tuple[Columns, Columns]:
    """Return the columns of the rows and of the events, by path; older formats have fewer.

    Raises:
        LogFormatError: A column is missing or of another type.
    """
    version = int(file.attributes.get("format_version", log_format.FORMAT_VERSION))
    described = tuple(log_format.PortDescription(name, "m") for name in ports)
    has_phase, has_far = log_format.PHASE in file.names("timing"), "far" in file.names("/")
    schema = log_format.LogSchema(described, 1, bool(file.names("truth")), 1, False, {}, version, has_phase, has_far)
    rows = {column.path: _column(path, file, column.path, column.dtype) for column in schema.stored()}
    return rows, {name: _column(path, file, name, dtype) for name, dtype in log_format.EVENT_COLUMNS.items()}


def _column(path: Path, file: Hdf5File, name: str, dtype: str) -> Dataset:
    with read_safely(path, f"{name} is missing or cannot be read", "; the file is damaged"):
        dataset = file[name]
    if len(dataset.shape) != 1 or dataset.dtype != np.dtype(dtype):
        raise LogFormatError(
            f"{path}: {name} holds {dataset.dtype} of shape {dataset.shape}, expected a column of {np.dtype(dtype)}; "
            "the file is damaged, or was not written by canhaptic"
        )
    return dataset


def usual_length(columns: Columns) -> int:
    """Return the length of most columns; of two equally common lengths the longer."""
    counts = Counter(len(dataset) for dataset in columns.values())
    return max(counts, key=lambda length: (counts[length], length))


_Json = TypeVar("_Json", list[str], dict[str, float], dict[str, dict[str, Any]])

_LONGEST_NS: Final = 10_000_000_000
_BLOCK: Final = 65_536  # rows held in memory at a time
_OURS = ("format", "format_version", "sample_time_ns", "ports", "status", "rows_lost")


class Quantities(Mapping[str, Array]):
    """The columns of one group, as arrays of shape (n_rows,); names of earlier releases are understood too."""

    def __init__(self, file: Hdf5File, path: str, rows: int) -> None:
        self._file = file
        self._path = path
        self._rows = rows
        found = set(file.names(path))
        known = OLD_COLUMNS if path.startswith("ports/") else {}
        self._stored = {  # name -> that of the dataset; a velocity has its name where the log says that it is one
            new: old for new, old in known.items() if old in found and (old in NEW_COLUMNS or new in found)
        }
        self._names = sorted((found - {*self._stored.values()}).union(self._stored))
        self._loaded: dict[str, Array] = {}

    def __getitem__(self, name: str) -> Array:
        name = self._stored.get(name, name)
        if name not in self._loaded:
            if name not in self._names and name not in self._stored.values():
                raise KeyError(name)
            self._loaded[name] = self.read(name)
        return self._loaded[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def every_name(self) -> list[str]:
        """Return the names, and those that some had before 0.4."""
        return [*self._names, *self._stored.values()]

    def read(self, name: str, start: int = 0, stop: int | None = None) -> Array:
        """Return rows `start` to `stop` of one quantity without keeping them in memory."""
        path = f"{self._path}/{self._stored.get(name, name)}"
        if self._file.is_closed:
            raise InputError(f"{path}: the log is closed; read its arrays before `close`, or within its `with` block")
        with read_safely(path, "the data is damaged", _SAVES):
            return self._file[path].read(start, self._rows if stop is None else min(stop, self._rows))

    def unit(self, name: str) -> str:
        """Return the unit of a quantity; "1" for a pure number."""
        path = f"{self._path}/{self._stored.get(name, name)}"
        with read_safely(path, "the unit is damaged"):
            return str(_plain(self._file[path].attributes.get("unit", "1")))


class EnergyLog:
    """An energy log opened for reading: finished, still being written, or left by a killed run.

    Args:
        path: The file.

    Raises:
        LogFormatError: The file is missing, empty, truncated, no energy log or of a newer format; or a column is
            missing, of another type, or shorter than the others.

    Attributes:
        path: The file.
        attributes: Attributes stored with the run (configuration, hashes, versions, ...).
        format_version: Version of the format; 1 and 2 are from earlier releases.
        ports: Name of the axis -> its quantities; `position`, `torque_command`, `torque_applied`, `surplus`, ...
        far: What passed between a port and its far side (`FarRow`); None without one.
        truth: True values of a simulation, in the same form; empty on a real rig.
        groups: Name of a group -> names of its axes, which share its account.
        timing: Times of each cycle and `sync_index`.
        rows: Number of cycles in the log.
        rows_lost: Cycles missing at the start because the file is damaged.
        status: Status of the run; "running" while it is written or after a power cut, "failed: no space" after a full
            disk.
        sample_time_ns: Sample time [ns].
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._file, description = open_file(self.path)
        try:
            with read_safely(path, "the file is damaged"):
                self._read(self._file, description)
        except BaseException:
            self.close()
            raise

    def _read(self, file: Hdf5File, description: "LogDescription") -> None:
        self.attributes = {n: _plain(value) for n, value in file.attributes.items() if n not in _OURS}
        self.format_version = int(file.attributes["format_version"])
        self.sample_time_ns = description.sample_time_ns
        self.rows_lost = description.rows_lost
        self.status = description.status
        self.rows = checked_rows(self.path, file, description.ports, str(_plain(file.attributes["status"])))
        self.ports = {name: Quantities(file, f"ports/{name}", self.rows) for name in description.ports}
        self.truth = {name: Quantities(file, f"truth/{name}", self.rows) for name in file.names("truth")}
        self.timing = Quantities(file, "timing", self.rows)
        self.far = Quantities(file, "far", self.rows) if "far" in file.names("/") else None
        self.groups = self._groups()
        self.axes = tuple(name for name in self.ports if name not in self.groups)
        joint = {axis for axes in self.groups.values() for axis in axes}
        self.accounts = tuple(name for name in self.ports if name not in joint)

    @classmethod
    def open(cls, path: str | Path) -> Self:
        """Open a log: the same as `EnergyLog(path)`."""
        return cls(path)

    def __repr__(self) -> str:
        return f"<EnergyLog {self.path}: {self.status}, {', '.join(self.ports)}>"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; arrays already loaded stay valid."""
        self._file.close()

    def number(self, name: str, default: float = 0.0) -> float:
        """Return an attribute that is a number, or the default where the log has none.

        Raises:
            LogFormatError: The attribute is no finite number.
        """
        value = self.attributes.get(name)
        if value is None:
            return default
        if isinstance(value, str) or not math.isfinite(value):
            raise LogFormatError(f"{self.path}: attribute {name} holds {value!r}, expected a number; damaged")
        return value

    def decoded(self, name: str, default: _Json) -> _Json:
        """Return an attribute that was written as JSON, or the default where the log has none.

        Raises:
            LogFormatError: The attribute is no JSON, or not of the type of the default.
        """
        if name not in self.attributes:
            return default
        with read_safely(self.path, f"attribute {name} cannot be read", "; the file is damaged"):
            value = json.loads(str(self.attributes[name]))
        if not isinstance(value, type(default)):
            seen = f"holds {type(value).__name__}, expected {type(default).__name__}"
            raise LogFormatError(f"{self.path}: attribute {name} {seen}; the file is damaged")
        return value

    def _groups(self) -> dict[str, tuple[str, ...]]:
        suffix = f".{log_format.GROUP_AXES}"
        names = [name.removesuffix(suffix) for name in self.attributes if name.endswith(suffix)]
        groups = {name: tuple(self.decoded(f"{name}{suffix}", list[str]())) for name in names}
        unknown = {*groups, *(axis for axes in groups.values() for axis in axes)} - set(self.ports)
        if unknown:
            absent = ", ".join(sorted(map(str, unknown)))
            raise LogFormatError(
                f"{self.path}: a group of axes lists {absent}, but the log has no columns for it; the file is damaged"
            )
        return groups

    @property
    def tables(self) -> dict[str, Quantities]:
        """Every group of columns by its path: timing, ports/NAME and truth/NAME."""
        return {
            "timing": self.timing,
            **{f"ports/{name}": port for name, port in self.ports.items()},
            **{f"truth/{name}": truth for name, truth in self.truth.items()},
            **({} if self.far is None else {"far": self.far}),
        }

    def axes_of(self, name: str) -> tuple[str, ...]:
        """Return the names of the axes of a port."""
        return self.groups.get(name, (name,))

    @property
    def dry_run(self) -> bool:
        """Whether no torque was sent."""
        return log_format.DRY_RUN in self.attributes

    @property
    def sample_time(self) -> float:
        """Sample time [s]."""
        return self.sample_time_ns * 1e-9

    @property
    def time(self) -> Array:
        """Time of each SYNC since the first [s], shape (n_rows,)."""
        return np.asarray(self.deadlines() * self.sample_time)

    def deadlines(self, start: int = 0, stop: int | None = None) -> Array:
        """Return the number of sample times from the first SYNC to that of each row; for an older log, SYNC indices."""
        return self.timing.read("deadline_index" if "deadline_index" in self.timing else "sync_index", start, stop)

    def time_of(self, sync_index: int) -> float:
        """Return the time of a SYNC [s], which may be after the last row."""
        if not self.rows:
            return sync_index * self.sample_time
        index = self.timing["sync_index"]
        row = min(int(np.searchsorted(index, sync_index)), self.rows - 1)
        return float((int(self.deadlines(row, row + 1)[0]) + sync_index - int(index[row])) * self.sample_time)

    @property
    def dropped(self) -> int:
        """Number of cycles that were dropped because the ring had no room."""
        return int(self.timing["dropped_before"].sum(dtype=np.int64))

    def changed_rows(self) -> list[int]:
        """Return the rows that do not match their digest; none for a log of an older format, which has no digests.

        Raises:
            LogFormatError: A column cannot be read.
        """
        if log_format.DIGEST not in self._file.names("/"):
            return []
        columns = list(found_columns(self.path, self._file, list(self.ports))[0].values())
        found: list[int] = []
        for start in range(0, self.rows, _BLOCK):
            with read_safely(self.path, "the data is damaged", _SAVES):
                *values, digests = (column.read(start, min(self.rows, start + _BLOCK)) for column in columns)
            found += (start + np.flatnonzero(row_digests(values) != digests)).tolist()
        return found

    @property
    def events(self) -> list[log_format.Event]:
        """Every event recorded during the run, in order."""
        with read_safely(self.path, "the events are damaged"):
            columns = [self._file[path].read() for path in log_format.EVENT_COLUMNS]
        return [
            log_format.Event(int(index), *(bytes(text).decode("utf-8", "replace") for text in texts))
            for index, *texts in zip(*columns, strict=False)  # a kill can come between two columns
        ]


class LogDescription(NamedTuple):
    """Attributes of a log."""

    sample_time_ns: int
    ports: tuple[str, ...]
    status: str
    rows_lost: int


def open_file(path: str | Path) -> tuple[Hdf5File, LogDescription]:
    """Open the file of a log whose columns may be damaged.

    Raises:
        LogFormatError: The file is missing, empty, truncated, no energy log or of a newer format.
    """
    path = log_file(path)
    with read_safely(path, "not a readable HDF5 file", ", expected an energy log"):
        file = Hdf5File(path, "live")
    try:
        with read_safely(path, "the file is damaged"):
            return file, _description(path, file.attributes)
    except LogFormatError:
        file.close()
        raise


def _description(path: Path, attributes: Mapping[str, Attribute]) -> LogDescription:
    if attributes.get("format") != log_format.FORMAT_NAME:
        raise LogFormatError(f"{path}: an HDF5 file, but not an energy log of canhaptic")
    version, newest = int(attributes.get("format_version", 0)), log_format.FORMAT_VERSION
    if not 1 <= version <= newest:
        raise LogFormatError(
            f"{path}: format version {version}, this program reads up to {newest}; use a newer canhaptic"
        )
    missing = [name for name in _OURS if name not in attributes]
    if missing:
        raise LogFormatError(f"{path}: the attributes {', '.join(missing)} are missing; the file is damaged")
    ports = tuple(line.rpartition(" ")[0] for line in str(_plain(attributes["ports"])).splitlines())
    sample_time_ns = int(attributes["sample_time_ns"])
    if not ports or not 0 < sample_time_ns <= _LONGEST_NS:
        raise LogFormatError(f"{path}: {len(ports)} ports at a sample time of {sample_time_ns} ns; the file is damaged")
    status = failure_of(path) or str(_plain(attributes["status"]))
    return LogDescription(sample_time_ns, ports, status, int(attributes["rows_lost"]))


def _plain(value: Attribute) -> str | int | float:
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    plain: object = value.item() if isinstance(value, np.generic) else value
    return plain if isinstance(plain, str | int | float) else str(plain)  # of an array, or of nothing
