"""Energy log -> files that other programs read: CSV always; Parquet, MAT-file and MCAP with the `export` extra."""

import csv
import importlib
import json
import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from canhaptic.errors import InputError
from canhaptic.extras import install_hint
from canhaptic.files import replacing
from canhaptic.logs.energy_reader import EnergyLog, Quantities
from canhaptic.quantities import ACCOUNT
from canhaptic.registry import function_of, installed

_BLOCK: Final = 65_536  # rows held in memory at a time


def export(log: EnergyLog, path: str | Path) -> None:
    """Write a log as a table; the suffix gives the format: .csv, .parquet, .mat or .mcap, or that of a plug-in.

    Floats in CSV are the shortest text that reads back to the same bits. With .mcap comes a layout for Foxglove: a plot
    for each unit, of the quantities that have a colour.

    Raises:
        InputError: The suffix is another one, the library is not installed, or the file cannot be written.
    """
    path = Path(path)
    writers: dict[str, Callable[[EnergyLog, Path], object]] = {
        ".csv": _write_csv, ".parquet": _write_parquet, ".mat": _write_mat, ".mcap": _write_mcap
    }  # fmt: skip
    plug_ins = [f".{name}" for name in installed("exporter")]
    if path.suffix not in writers and path.suffix in plug_ins:
        writers[path.suffix] = function_of("exporter", path.suffix[1:])
    if path.suffix not in writers:
        known = ", ".join((*writers, *plug_ins))
        raise InputError(f"{path}: cannot export to {path.suffix!r}, expected one of: {known}")
    require_library(path)
    try:
        with replacing(path) as file:
            writers[path.suffix](log, file)
        if path.suffix == ".mcap":
            with replacing(path.with_suffix(".foxglove.json")) as file:
                file.write_text(json.dumps(_layout(_topics(log)), indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: the table cannot be written ({error}); name another file") from error


def require_library(path: Path) -> None:
    """Import the library that writes tables with this suffix.

    Raises:
        InputError: The library is not installed.
    """
    library = {".parquet": "pyarrow", ".mat": "scipy", ".mcap": "mcap"}.get(path.suffix)
    try:
        if library is not None:
            importlib.import_module(library)
    except ImportError as error:
        raise InputError(f"{path}: needs {library}; install it with: {install_hint('export')}") from error


def _columns(log: EnergyLog) -> Iterator[tuple[str, str, Quantities, str]]:
    """Yield (title, unit, group, name) of every quantity, the timing first."""
    for path, quantities in log.tables.items():
        kind, _, port = path.partition("/")
        prefix = {"timing": "", "ports": f"{port}.", "truth": f"true.{port}."}[kind]
        for name in quantities.every_name():
            yield f"{prefix}{name}", quantities.unit(name), quantities, name


def _write_csv(log: EnergyLog, path: Path) -> None:
    described = list(_columns(log))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        titles = (f"{title} [{unit}]" if unit != "1" else title for title, unit, _, _ in described)
        writer.writerow(["time [s]", *titles])
        for start in range(0, log.rows, _BLOCK):
            block = [(log.deadlines(start, min(start + _BLOCK, log.rows)) * log.sample_time).tolist()]
            block += [group.read(name, start, start + _BLOCK).tolist() for _, _, group, name in described]
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

    content: dict[str, object] = {"timing": dict(log.timing), "sample_time": log.sample_time}
    content["ports"] = {name: {key: port[key] for key in port.every_name()} for name, port in log.ports.items()}
    if log.truth:
        content["truth"] = {name: dict(truth) for name, truth in log.truth.items()}
    content["attributes"] = {name.replace(".", "_"): value for name, value in log.attributes.items()}
    savemat(path, content, long_field_names=True, do_compression=True, oned_as="column")


def _write_mcap(log: EnergyLog, path: Path) -> None:
    """Write one JSON message per port and SYNC, with its schema, as Foxglove opens it.

    Topics: /PORT, /true/PORT (the simulated plant), /timing, /events. Time: of the SYNC since the first, from 0.
    """
    writer_module: Any = importlib.import_module("mcap.writer")
    tables = _topics(log)
    with path.open("wb") as file:
        writer = writer_module.Writer(file)
        writer.start(library="canhaptic")
        writer.add_metadata("canhaptic", {name: str(value) for name, value in log.attributes.items()})
        channels = {topic: _mcap_channel(writer, topic, _described(of)) for topic, of in tables.items()}
        for start in range(0, log.rows, _MESSAGES):
            stop = min(start + _MESSAGES, log.rows)
            times = log.deadlines(start, stop) * log.sample_time_ns
            blocks = {topic: [of.read(name, start, stop).tolist() for name in of] for topic, of in tables.items()}
            for row, time in enumerate(times.tolist()):
                for topic, quantities in tables.items():
                    values = {name: column[row] for name, column in zip(quantities, blocks[topic], strict=True)}
                    _add_message(writer, channels[topic], int(time), values)
        _write_events(writer, log)
        writer.finish()


def _topics(log: EnergyLog) -> Mapping[str, Quantities]:
    return {f"/{path.removeprefix('ports/').replace('truth/', 'true/')}": of for path, of in log.tables.items()}


def _layout(tables: Mapping[str, Quantities]) -> dict[str, object]:
    """Return a layout for Foxglove: plots below each other, above a table of the events."""
    plots = dict[str, list[dict[str, object]]]()
    for topic, quantities in tables.items():
        for name in quantities:
            if name in ACCOUNT and (colour := ACCOUNT[name].colour):
                line: dict[str, object] = {
                    "value": f"{topic}.{name}",
                    "label": f"{topic[1:]}: {ACCOUNT[name].title}",
                    "color": colour,
                }
                line |= {"enabled": True, "timestampMethod": "receiveTime"}
                plots.setdefault(quantities.unit(name), []).append(line)
    panels: dict[str, object] = {
        f"Plot!{number}": {"title": unit, "paths": lines, "isSynced": True, "xAxisVal": "timestamp", "showLegend": True}
        for number, (unit, lines) in enumerate(plots.items(), 1)
    }
    panels["Table!events"] = {"topicPath": "/events"}
    *above, layout = panels
    below: object = layout
    for count, name in enumerate(reversed(above), 2):
        below = {"direction": "column", "first": name, "second": below, "splitPercentage": 100.0 / count}
    rest = {"globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1.0}}
    return {"configById": panels, **rest, "layout": below}


_MESSAGES: Final = 4096  # SYNCs held in memory at a time


def _described(quantities: Quantities) -> dict[str, dict[str, str]]:
    titles = {name: f"{ACCOUNT[name].title} " if name in ACCOUNT else "" for name in quantities}
    return {name: {"type": "number", "description": f"{of}[{quantities.unit(name)}]"} for name, of in titles.items()}


def _mcap_channel(writer: Any, topic: str, properties: Mapping[str, Mapping[str, str]]) -> int:
    schema = json.dumps({"type": "object", "properties": properties}).encode()
    schema_id = writer.register_schema(f"canhaptic{topic.replace('/', '.')}", "jsonschema", schema)
    return int(writer.register_channel(topic, "json", schema_id))


def _write_events(writer: Any, log: EnergyLog) -> None:
    text = {"type": "string"}
    channel = _mcap_channel(writer, "/events", {"kind": text, "port": text, "text": text})
    for event in log.events:
        time = max(0, round(log.time_of(event.sync_index) * 1e9))
        _add_message(writer, channel, time, {"kind": event.kind, "port": event.port, "text": event.text})


def _add_message(writer: Any, channel: int, time: int, values: Mapping[str, float | str]) -> None:
    """Add one message; numbers that JSON lacks (inf, nan) are left out."""
    finite = {name: value for name, value in values.items() if not isinstance(value, float) or math.isfinite(value)}
    writer.add_message(channel, time, json.dumps(finite, separators=(",", ":")).encode(), time)
