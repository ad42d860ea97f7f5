"""A kill or a full disk can come between two columns."""

from pathlib import Path

import numpy as np
import pytest

from canhaptic.logs import energy_sink
from canhaptic.logs.energy_sink import _whole_lengths, repack, trim
from canhaptic.logs.hdf5 import Hdf5File

LENGTHS = {"timing/sync_index": 9, "ports/handle/h_i": 7, "events/sync_index": 3, "events/text": 2}


@pytest.fixture
def torn(tmp_path: Path) -> Path:
    """A file whose columns are not of one length."""
    path = tmp_path / "torn.h5"
    with Hdf5File(path, "w") as file:
        file.set_attributes({"status": "running"})
        for name, length in LENGTHS.items():
            dataset = file.create(name, "i8", 4, {"unit": "1"})
            dataset.append(np.arange(length))
    return path


def columns_of(path: Path) -> dict[str, list[int]]:
    with Hdf5File(path, "live") as file:
        return {name: dataset.read().tolist() for name, dataset in file.datasets()}


def test_rows_and_events_are_whole_where_every_column_of_theirs_has_them(torn: Path) -> None:
    with Hdf5File(torn, "live") as file:
        assert _whole_lengths(file) == (7, 2)


def test_what_is_longer_is_cut(torn: Path, tmp_path: Path) -> None:
    with Hdf5File(torn, "live") as old, Hdf5File(tmp_path / "copy.h5", "w") as file:
        old.copy_to(file)
        assert trim(file) == (7, 2)
    assert {name: len(values) for name, values in columns_of(tmp_path / "copy.h5").items()} == {
        "timing/sync_index": 7,
        "ports/handle/h_i": 7,
        "events/sync_index": 2,
        "events/text": 2,
    }


@pytest.mark.parametrize("block", [3, 100])
def test_a_packed_copy_holds_whole_rows_in_their_order(torn: Path, tmp_path, block: int, monkeypatch) -> None:
    monkeypatch.setattr(energy_sink, "_BLOCK", block)
    repack(torn, tmp_path / "packed.h5", {"status": "packed"})
    assert columns_of(tmp_path / "packed.h5") == {
        name: list(range(2 if name.startswith("events/") else 7)) for name in LENGTHS
    }
    with Hdf5File(tmp_path / "packed.h5", "live") as file:
        assert file.attributes == {"status": "packed"}
        assert {name: dataset.attributes for name, dataset in file.datasets()} == {n: {"unit": "1"} for n in LENGTHS}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["packed.h5", "torn.h5"]


def test_a_packed_copy_holds_as_many_rows_and_events_as_asked_for(torn: Path) -> None:
    repack(torn, torn, {}, (4, 1))
    assert {name: len(values) for name, values in columns_of(torn).items()} == {
        "timing/sync_index": 4,
        "ports/handle/h_i": 4,
        "events/sync_index": 1,
        "events/text": 1,
    }
