"""Every column of an energy log, damaged in every way: one error that names it, or a finding; nothing passes."""

import contextlib
import ctypes
import os
import re
import resource
import struct
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from canhaptic.cli.main import main
from canhaptic.cycle import run
from canhaptic.errors import LogFormatError
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.hdf5 import Hdf5File
from canhaptic.logs.repair import repair
from canhaptic.quantities import OLD_COLUMNS
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from canhaptic.view.series import LiveLog
from tests.view import typed

DEMO = Path(__file__).parents[2] / "configs" / "demo.yaml"
ROWS = 40


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("damaged") / "whole.h5"
    with build(load_scene(DEMO, ["simulation.plant.initial_position=-0.021"]), energy_log=path) as experiment:
        run(experiment.cycle, ROWS)
        experiment.close("completed")
    with h5py.File(path, "r+") as file:
        for dataset in file["events"].values():
            dataset.resize((2,))
    assert typed.inspect(path, "--recompute", "--check", "in >= 0") == 0
    return path


def columns(path: Path) -> list[str]:
    found: list[str] = []
    with h5py.File(path) as file:
        file.visititems(lambda name, item: found.append(name) if isinstance(item, h5py.Dataset) else None)
    assert len(found) == 43  # each once, by one of its names
    names = (name.rpartition("/") for name in found)
    return [
        f"{at}{slash}{OLD_COLUMNS.get(name, name) if at.startswith('ports/') else name}" for at, slash, name in names
    ]


def missing(file: Any, name: str) -> None:
    del file[name]


def of_another_type(file: Any, name: str) -> None:
    length = len(file[name])
    del file[name]
    file[name] = np.zeros(length, "c8")


def two_wide(file: Any, name: str) -> None:
    dtype, length = file[name].dtype, len(file[name])
    del file[name]
    file[name] = np.zeros((length, 2), dtype)


def one_value(file: Any, name: str) -> None:
    dtype = file[name].dtype
    del file[name]
    file[name] = np.zeros((), dtype)


def a_folder(file: Any, name: str) -> None:
    del file[name]
    file.create_group(name)


def cut_in_half(file: Any, name: str) -> None:
    file[name].resize((len(file[name]) // 2,))


DAMAGES = (missing, of_another_type, two_wide, one_value, a_folder, cut_in_half)


def damaged(whole: Path, damage: Callable[[Any, str], None], name: str) -> Path:
    path = whole.with_name("damaged.h5")
    path.write_bytes(whole.read_bytes())
    with h5py.File(path, "r+") as file:
        damage(file, name)
    return path


USES: tuple[Callable[[Path, Path], object], ...] = (
    lambda path, _whole: typed.inspect(path),
    lambda path, _whole: typed.inspect(path, "--check", "deficit >= 0"),
    lambda path, _whole: typed.inspect(path, "--recompute"),
    lambda path, whole: typed.inspect(path, "--compare", whole),
    lambda path, whole: typed.inspect(whole, "--compare", path),
    lambda path, _whole: typed.inspect(path, "--csv", path.with_suffix(".csv")),
)


EVERY_THIRTEENTH_OR_ALL = [13, pytest.param(1, marks=pytest.mark.campaign)]  # all of them take 15 s of a processor


@pytest.mark.slow
@pytest.mark.parametrize("step", EVERY_THIRTEENTH_OR_ALL)
@pytest.mark.parametrize("damage", DAMAGES, ids=lambda damage: damage.__name__)
def test_a_damaged_column_is_one_error_that_names_it(whole: Path, damage: Callable[[Any, str], None], step: int):
    for number, name in list(enumerate(columns(whole)))[DAMAGES.index(damage) % step :: step]:
        path, expected = damaged(whole, damage, name), ROWS if not name.startswith("events/") else 2
        with pytest.raises(LogFormatError) as refused:
            USES[number % len(USES)](path, whole)
        message = str(refused.value)
        assert f"damaged.h5: {name} " in message
        if damage is cut_in_half:
            assert f"has {expected // 2} rows, expected {expected} like the other columns" in message
        live = LiveLog(path)
        assert live.look() is None
        assert live.trouble == message


@pytest.mark.slow
@pytest.mark.parametrize("step", EVERY_THIRTEENTH_OR_ALL)
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_value_that_is_no_finite_number_is_a_finding_and_no_check_passes(whole: Path, value: float, step: int):
    for number, name in list(enumerate(columns(whole)))[::step]:
        with h5py.File(whole) as file:
            if file[name].dtype.kind != "f":
                continue

        def put(file: Any, name: str) -> None:
            file[name][ROWS // 2] = value

        path = damaged(whole, put, name)
        use = USES[number % 4]
        assert use(path, whole) == 1, name
        LiveLog(path).look()


@pytest.mark.slow_but("*longest_hold")
@pytest.mark.parametrize(
    "name",
    ["timing/sync_index", *(f"ports/handle/{name}" for name in ("statusword", "longest_hold", "energy_resolution"))],
)
def test_one_changed_cell_that_no_account_contains_is_found_by_the_digest_of_its_row(whole: Path, name: str, capsys):
    def put(file: Any, name: str) -> None:
        file[name][ROWS // 2] = file[name][ROWS // 2] + 1

    assert typed.inspect(damaged(whole, put, name), "--check", "in >= 0", "--recompute") == 1
    assert "digest: 1 row is not as the run wrote it" in capsys.readouterr().out


@pytest.mark.slow
def test_a_log_of_a_release_without_digests_is_inspected_as_before(whole: Path) -> None:
    def put(file: Any, name: str) -> None:
        del file[name]
        file.attrs["format_version"] = 3

    assert typed.inspect(damaged(whole, put, "digest"), "--check", "in >= 0", "--recompute") == 0


def test_a_changed_byte_of_an_event_is_an_error_before_the_log_is_packed_too(tmp_path: Path) -> None:
    path = tmp_path / "live.h5"
    with Hdf5File(path, "x live") as file:
        file.create("events/text", "S8", 1, {}, compressed=False).append(np.array([b"a fault"], "S8"))
    content = bytearray(path.read_bytes())
    content[content.index(b"a fault")] ^= 1
    path.write_bytes(content)
    with Hdf5File(path, "live") as file, pytest.raises(OSError, match="filter returned failure"):
        file["events/text"].read()


def too_long(file: Any, name: str) -> None:
    file[name].resize((1 << 50,))


@pytest.mark.slow
def test_a_column_that_claims_any_length_is_named_and_repaired_at_once(whole: Path) -> None:
    for name in ("ports/handle/h_i", "timing/sync_index"):
        path = damaged(whole, too_long, name)
        with pytest.raises(LogFormatError, match=rf"{name} has {1 << 50} rows, expected {ROWS} like the other"):
            EnergyLog.open(path)
        assert repair(path, whole.with_name("saved.h5")) == (ROWS, 0)


@pytest.mark.slow
def test_repair_keeps_the_rows_that_every_column_has_and_refuses_what_it_cannot_save(whole: Path) -> None:
    saved = whole.with_name("saved.h5")
    for name in columns(whole)[::6]:
        is_event = name.startswith("events/")
        assert repair(damaged(whole, cut_in_half, name), saved) == ((ROWS, 0) if is_event else (ROWS // 2, ROWS // 2))
        with EnergyLog.open(saved) as log:
            assert (log.rows, len(log.events)) == (ROWS if is_event else ROWS // 2, 1 if is_event else 2)
            assert log.status == "repaired (was: completed)"
    for damage in (missing, of_another_type, one_value):
        with pytest.raises(LogFormatError, match=r"damaged\.h5: ports/handle/h_i "):
            repair(damaged(whole, damage, "ports/handle/h_i"), saved)


@pytest.mark.slow_but("<lambda>0")
@pytest.mark.skipif(sys.platform == "win32", reason="a process has no copies on Windows")
@pytest.mark.parametrize("crash", [lambda *_, **__: ctypes.string_at(0), lambda *_, **__: os.abort()])
def test_a_crash_of_the_library_is_one_error_and_leaves_nothing(whole, monkeypatch, capsys, crash: Callable[..., Any]):
    folder = Path(tempfile.mkdtemp(dir=whole.parent))
    monkeypatch.setattr("canhaptic.logs.energy_sink.Hdf5File.create", crash)
    assert main(["inspect", str(whole), "--repair", str(folder / "repaired.h5")]) == 2
    assert re.fullmatch(
        rf"canhaptic: error: {whole}: too damaged: the HDF5 library crashes on it \(exit status SIG\w+\)\n",
        capsys.readouterr().err,
    )
    assert list(folder.iterdir()) == []
    monkeypatch.setattr("canhaptic.logs.hdf5.Dataset.attributes", property(crash))
    assert main(["inspect", str(whole)]) == 2
    assert "the HDF5 library crashes on it" in capsys.readouterr().err


def test_a_log_that_is_being_written_may_be_a_chunk_short_in_some_columns_and_no_more(whole: Path) -> None:
    def running(rows: int, chunk: int) -> Callable[[Any, str], None]:
        def cut(file: Any, name: str) -> None:
            file.attrs["status"] = "running"
            for path in columns(whole):
                values = file[path][:]
                dtype = file[path].dtype
                del file[path]
                file.create_dataset(path, data=values.astype(dtype), chunks=(chunk,), maxshape=(None,))
            file[name].resize((rows,))

        return cut

    with EnergyLog.open(damaged(whole, running(ROWS - 10, 10), "ports/handle/h_i")) as log:
        assert log.rows == ROWS - 10
    with pytest.raises(LogFormatError, match=rf"ports/handle/h_i has {ROWS // 2} rows, expected {ROWS}"):
        EnergyLog.open(damaged(whole, running(ROWS // 2, 10), "ports/handle/h_i"))


@pytest.mark.slow
def test_a_text_that_is_no_utf8_is_read_and_saved(whole: Path) -> None:
    def put(file: Any, name: str) -> None:
        file.attrs[name] = b"\xff.yaml"

    path, saved = damaged(whole, put, "config_source"), whole.with_name("saved.h5")
    assert typed.inspect(path) == 0
    assert repair(path, saved) == (ROWS, 0)
    with EnergyLog.open(saved) as log:
        assert log.attributes["config_source"] == "\ufffd.yaml"


@pytest.mark.slow_but("branch")
@pytest.mark.parametrize("name", ["branch", "certificate"])
def test_a_code_that_does_not_exist_is_one_error(whole: Path, name: str) -> None:
    def put(file: Any, name: str) -> None:
        file[name][5] = 200

    with pytest.raises(LogFormatError, match=rf"damaged\.h5: {name} holds 200 in row 5, expected 0 to "):
        typed.inspect(damaged(whole, put, f"ports/handle/{name}"))


@pytest.mark.slow_but("ports-")
@pytest.mark.parametrize(
    ("attribute", "value"),
    [
        ("ports", "handle m\nghost m"),
        ("ports", ""),
        ("sample_time_ns", 0),
        ("sample_time_ns", "soon"),
        ("rows_lost", "many"),
        ("format_version", "x"),
        ("handle.group_axes", "{"),
        ("handle.group_axes", '["ghost"]'),
        ("ghost.group_axes", '["handle"]'),
    ],
)
def test_a_damaged_attribute_is_one_error(whole: Path, attribute: str, value: object) -> None:
    def put(file: Any, name: str) -> None:
        file.attrs[name] = value

    path = damaged(whole, put, attribute)
    with pytest.raises(LogFormatError, match=r"damaged\.h5: "):
        typed.inspect(path)
    assert LiveLog(path).look() is None


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="memory is bounded through /proc")
def test_a_text_that_claims_gigabytes_is_refused_at_once(whole: Path) -> None:
    content = whole.read_bytes()
    heap = struct.pack("<Q", content.index(b"GCOL"))
    places = [match.start() - 4 for match in re.finditer(re.escape(heap), content)]  # length, heap, number in the heap
    assert len(places) > 10
    before = resource.getrlimit(resource.RLIMIT_AS)
    used, began, refused = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time(), 0
    for place in places[::8]:
        path = whole.with_name("damaged.h5")
        path.write_bytes(content[:place] + b"\xff\xff\xff\xef" + content[place + 4 :])
        try:
            typed.inspect(path)
        except LogFormatError:
            refused += 1
    assert refused >= 2
    assert time.process_time() - began < 10.0  # of this process: a busy machine changes nothing
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - used < 150 << 10  # kB
    assert resource.getrlimit(resource.RLIMIT_AS) == before


@pytest.mark.slow
@pytest.mark.parametrize("step", [12, pytest.param(1, marks=pytest.mark.slow)])
def test_a_damaged_table_of_names_is_repaired_or_one_error(whole: Path, step: int) -> None:
    content = whole.read_bytes()
    for name in (b"SNOD", b"HEAP", b"TREE"):
        for match in list(re.finditer(name, content))[::step]:
            path = whole.with_name("damaged.h5")
            path.write_bytes(content[: match.start()] + b"XXXX" + content[match.end() :])
            with contextlib.suppress(LogFormatError):
                repair(path, whole.with_name("saved.h5"))


@pytest.mark.slow
@pytest.mark.parametrize("column", ["digest", "timing/compute", "ports/handle/branch"])
def test_a_chunk_that_cannot_be_unpacked_is_one_error(column: str, whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "damaged.h5"
    path.write_bytes(whole.read_bytes())
    with h5py.File(path) as file:
        chunk = file[column].id.get_chunk_info(0)
    with path.open("r+b") as file:
        file.seek(chunk.byte_offset)
        file.write(b"\xff" * chunk.size)
    with pytest.raises(LogFormatError, match="the data is damaged"):
        typed.inspect(path, "--check", "in >= 0")


@pytest.mark.slow
def test_a_running_count_that_falls_is_found(whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "damaged.h5"
    path.write_bytes(whole.read_bytes())
    with h5py.File(path, "r+") as file:
        file["ports/handle/uncommanded"][7:9] = (900, 3)
    assert typed.inspect(path, "--recompute", "--check", "in >= 0") == 1
    assert "uncommanded: 2 rows are a decreasing count, first in cycle 8" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("config_overrides", '["a"', "config_overrides cannot be read"),
        ("config_overrides", "{}", "config_overrides holds dict, expected list"),
        ("config_resolved", "[1]", "config_resolved holds list, expected dict"),
        ("config_resolved", "[" * 30_000, "config_resolved cannot be read"),  # nested too deeply
    ],
)
def test_a_damaged_description_is_one_error(name: str, text: str, said: str, whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "damaged.h5"
    path.write_bytes(whole.read_bytes())
    with h5py.File(path, "r+") as file:
        file.attrs[name] = text
    with pytest.raises(LogFormatError, match=said):
        typed.inspect(path, "--recompute")
