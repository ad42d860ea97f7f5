"""Energy log -> tables that other programs read: CSV always, Parquet and MAT-file with the `export` extra."""

import csv
import importlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from canhaptic.errors import InputError
from canhaptic.extras import install_hint
from canhaptic.host.output_file import replacing
from canhaptic.logs.energy_reader import EnergyLog, Quantities

_BLOCK: Final = 65_536  # rows held in memory at a time


def export(log: EnergyLog, path: str | Path) -> None:
    """Writes a log as a table; the suffix says which kind: .csv, .parquet or .mat.

    Floats in CSV are the shortest text that reads back to the same bits.

    Raises:
        InputError: Another suffix, a library that is not installed, or a file that cannot be written.
    """
    path = Path(path)
    writers = {".csv": _write_csv, ".parquet": _write_parquet, ".mat": _write_mat}
    if path.suffix not in writers:
        raise InputError(f"{path}: cannot export to {path.suffix!r}, expected one of: {', '.join(writers)}")
    require_library(path)
    try:
        with replacing(path) as file:
            writers[path.suffix](log, file)
    except OSError as error:
        raise InputError(f"{path}: the table cannot be written ({error}); name another file") from error


def require_library(path: Path) -> None:
    """Imports what a table of this suffix is written with.

    Raises:
        InputError: It is not installed.
    """
    library = {".parquet": "pyarrow", ".mat": "scipy"}.get(path.suffix)
    try:
        if library is not None:
            importlib.import_module(library)
    except ImportError as error:
        raise InputError(f"{path}: needs {library}; install it with: {install_hint('export')}") from error


def _columns(log: EnergyLog) -> Iterator[tuple[str, str, Quantities, str]]:
    """Yields (title, unit, group, name) of every quantity, the timing first."""
    for name in log.timing:
        yield name, log.timing.unit(name), log.timing, name
    for prefix, groups in (("", log.ports), ("true.", log.truth)):
        for port, quantities in groups.items():
            for name in quantities:
                yield f"{prefix}{port}.{name}", quantities.unit(name), quantities, name


def _write_csv(log: EnergyLog, path: Path) -> None:
    described = list(_columns(log))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(f"{title} [{unit}]" if unit != "1" else title for title, unit, _, _ in described)
        for start in range(0, log.rows, _BLOCK):
            block = [group.read(name, start, start + _BLOCK).tolist() for _, _, group, name in described]
            writer.writerows(zip(*block, strict=True))


def _write_parquet(log: EnergyLog, path: Path) -> None:
    pa: Any = importlib.import_module("pyarrow")
    parquet: Any = importlib.import_module("pyarrow.parquet")

    described = list(_columns(log))
    fields = [
        pa.field(title, pa.from_numpy_dtype(group.read(name, 0, 0).dtype), metadata={"unit": unit})
        for title, unit, group, name in described
    ]
    with parquet.ParquetWriter(path, pa.schema(fields)) as writer:
        for start in range(0, log.rows, _BLOCK):
            block = [pa.array(group.read(name, start, start + _BLOCK)) for _, _, group, name in described]
            writer.write_table(pa.table(block, schema=pa.schema(fields)))


def _write_mat(log: EnergyLog, path: Path) -> None:
    from scipy.io import savemat

    content: dict[str, Any] = {"timing": dict(log.timing), "sample_time": log.sample_time}
    content["ports"] = {name: dict(port) for name, port in log.ports.items()}
    if log.truth:
        content["truth"] = {name: dict(truth) for name, truth in log.truth.items()}
    content["attributes"] = {name.replace(".", "_"): value for name, value in log.attributes.items()}
    savemat(path, content, long_field_names=True, do_compression=True, oned_as="column")
