"""Logs as a power cut leaves them: open for writing, with pages that were never written, or without their end."""

import random
import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from canhaptic.errors import LogFormatError
from canhaptic.logs import repair as repair_module
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.repair import in_own_process, repair
from canhaptic.logs.writer_process import EnergyLogWriter
from tests.logs.log_rows import PORTS, SAMPLE_TIME_NS, append, balance
from tests.logs.patience import wait_for

ROWS = 2000
PAGE, LAST = 4096, 65_536


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[bytes]:
    """Content of a log of which every row is in the file, and which its writer still has open."""
    path = tmp_path_factory.mktemp("power") / "run.h5"
    writer = EnergyLogWriter(path, PORTS[:1], {}, sample_time_ns=SAMPLE_TIME_NS, with_truth=True)
    for k in range(ROWS):
        append(writer, k)

    def rows() -> int:
        with EnergyLog.open(path) as log:
            return log.rows

    wait_for(lambda: rows() == ROWS)
    yield path.read_bytes()
    writer.close()


def pages_lost(content: bytes, chance: random.Random) -> bytes:
    left = bytearray(content)
    for _ in range(chance.choice([1, 2, 4])):
        page = (len(left) - chance.randrange(1, min(LAST, len(left)))) // PAGE * PAGE
        left[page : page + PAGE] = bytes(min(PAGE, len(left) - page))
    return bytes(left)


def tail_lost(content: bytes, chance: random.Random) -> bytes:
    return content[: chance.randrange(len(content) // 2, len(content))]


def read_all(path: Path) -> None:
    with EnergyLog.open(path) as log:
        for quantities in log.tables.values():
            list(quantities.values())


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *(pytest.param(n, marks=pytest.mark.slow) for n in range(1, 20))])
@pytest.mark.parametrize("cut", [pages_lost, tail_lost])
def test_what_a_power_cut_leaves_is_read_refused_or_saved_up_to_the_damage(running, tmp_path, cut, seed):
    path, saved = tmp_path / "run.h5", tmp_path / "saved.h5"
    path.write_bytes(cut(running, random.Random(seed)))
    with pytest.raises(LogFormatError, match=r"damaged \("):
        in_own_process(path, partial(read_all, path))
    kept, lost = repair(path, saved)
    assert (kept + lost, kept > 0) == (ROWS, True)
    with EnergyLog.open(saved) as log:
        assert (log.rows, log.status) == (kept, "repaired (was: running)")
        assert np.array_equal(log.ports["handle"]["h_i"], [balance(k).h_i for k in range(kept)])
        assert log.changed_rows() == []


@pytest.mark.slow
def test_a_library_that_sleeps_for_ever_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.h5"
    path.write_bytes(b"a log")
    monkeypatch.setattr(repair_module, "_PATIENCE", 0.02)
    with pytest.raises(LogFormatError, match="does not finish reading it within"):
        in_own_process(path, partial(threading.Event().wait, 3600.0))
