import os
import signal
import struct
from pathlib import Path

import h5py
import numpy as np
import pytest

from canhaptic.control.balance import EnergyBalance
from canhaptic.errors import InputError, LogFormatError, LogWriteError
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.repair import repair
from canhaptic.logs.ring import RingShape, SharedArea, allocate, size_of
from canhaptic.logs.writer_process import EnergyLogWriter
from canhaptic.quantities import NEW_COLUMNS
from tests.logs.log_rows import PORTS, SAMPLE_TIME_NS, append, balance, sample, timing, truth
from tests.logs.patience import wait_for

ROWS = 4200


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "run.h5"
    writer = EnergyLogWriter(
        path,
        PORTS,
        {"config": "bus: {}\n", "config_hash": "abc", "bitrate": 1_000_000, "credit": 1e-3},
        sample_time_ns=SAMPLE_TIME_NS,
        with_truth=True,
        pace="free",
        ring_rows=512,  # smaller than the run: at free pace the producer waits
    )
    for k in range(ROWS):
        append(writer, k, ports=2)
    writer.event(17, "emcy", "handle", "0x7500 communication \u00e4")
    writer.event(18, "stop", "", "x" * 1000)
    writer.event(19, "note", "", "x" * 207 + "\u00e4")  # two bytes, one of which has no room
    writer.close("complete")
    return path


@pytest.mark.slow
def test_every_quantity_of_every_row_is_read_back_as_it_was_written(finished: Path) -> None:
    with EnergyLog.open(finished) as log:
        assert log.rows == ROWS
        for number, name in enumerate(("handle", "knob")):
            port = log.ports[name]
            for k in (0, 1, 511, 512, 513, 4095, 4096, ROWS - 1):
                s, b, t = sample(k, number), balance(k, number), truth(k, number)
                assert port["position"][k] == s.position
                assert port["torque_applied"][k] == s.torque_applied
                assert port["statusword"][k] == s.statusword
                assert port["fresh"][k] == s.fresh
                assert port["torque_command"][k] == b.torque
                for field in EnergyBalance._fields[1:]:
                    assert port[field][k] == getattr(b, field), field
                assert log.truth[name]["position"][k] == t.position
                assert log.truth[name]["stored"][k] == t.energy.stored
                assert log.timing["send"][k] == timing(k).send
            assert np.array_equal(port["h_i"], [balance(k, number).h_i for k in range(ROWS)])
        assert np.array_equal(log.timing["sync_index"], np.arange(ROWS))
        assert log.time[-1] == pytest.approx(ROWS * 1e-3 - 1e-3, abs=1e-12)


@pytest.mark.slow
def test_a_log_has_each_renamed_column_under_both_names_and_an_older_one_is_read_by_either(finished: Path, tmp_path):
    older, repaired = tmp_path / "older.h5", tmp_path / "repaired.h5"
    older.write_bytes(finished.read_bytes())
    with h5py.File(older, "r+") as file:
        port, size = file["ports/handle"], finished.stat().st_size
        assert all(port[new] == port[old] for old, new in NEW_COLUMNS.items())  # one column
        for new in NEW_COLUMNS.values():
            del port[new]
    for path in (finished, older):
        with EnergyLog.open(path) as log:
            names = set(log.ports["handle"])
            assert set(NEW_COLUMNS.values()) <= names
            assert not names & set(NEW_COLUMNS)
            assert "velocity_command" not in log.ports["handle"]
            assert np.array_equal(log.ports["handle"]["surplus"], [balance(k).h_dis for k in range(ROWS)])
            assert log.ports["handle"]["h_dis"] is log.ports["handle"]["surplus"]
            assert log.changed_rows() == []
    assert repair(finished, repaired) == (ROWS, 0)
    with h5py.File(repaired) as file:
        assert file["ports/knob/surplus"] == file["ports/knob/h_dis"]
    assert repaired.stat().st_size < 1.1 * size


def test_units_follow_the_motion_of_the_axis(finished: Path) -> None:
    with EnergyLog.open(finished) as log:
        names = ("position", "torque_applied", "torque_command", "damping_rendered", "h_i", "branch", "state")
        assert [log.ports["handle"].unit(n) for n in names] == ["m", "N", "N", "N*s/m", "J", "1", "m"]
        assert [log.ports["knob"].unit(n) for n in names] == ["rad", "N*m", "N*m", "N*m*s/rad", "J", "1", "rad"]
        assert log.timing.unit("send") == "ns"


def test_attributes_events_and_status_are_kept_and_long_texts_are_cut(finished: Path) -> None:
    with EnergyLog.open(finished) as log:
        assert log.attributes == {"config": "bus: {}\n", "config_hash": "abc", "bitrate": 1_000_000, "credit": 1e-3}
        assert {type(value) for value in log.attributes.values()} == {str, int, float}  # none of NumPy's
        assert log.status == "complete"
        assert log.sample_time_ns == SAMPLE_TIME_NS
        first, second, third = log.events
        assert first == (17, "emcy", "handle", "0x7500 communication \u00e4")
        assert second.text == "x" * 208
        assert third.text == "x" * 207


def test_a_finished_log_opens_in_plain_h5py_with_the_documented_names(finished: Path) -> None:
    with h5py.File(finished, "r") as file:
        assert set(file) == {"ports", "truth", "timing", "events", "digest"}
        dataset = file["ports/handle/h_r"]
        assert dataset.shape == (ROWS,)
        assert dataset.dtype == np.float64
        assert dataset.attrs["unit"] == "J"
        assert "fallback" in file["ports/handle/branch"].attrs["meaning"]


def test_a_finished_log_is_at_most_a_fifth_larger_than_its_raw_data(finished: Path) -> None:
    with EnergyLog.open(finished) as log:
        columns = [q[name] for q in (*log.ports.values(), *log.truth.values(), log.timing) for name in q]
        raw = sum(column.nbytes for column in columns)
    assert finished.stat().st_size <= 1.2 * raw


@pytest.mark.slow
def test_noise_that_cannot_be_compressed_still_stays_within_the_size_limit(tmp_path: Path) -> None:
    path = tmp_path / "noise.h5"
    noise = np.random.default_rng(1).standard_normal((3000, 13)).tolist()
    writer = EnergyLogWriter(path, PORTS[:1], {}, sample_time_ns=SAMPLE_TIME_NS, pace="real")
    for k, row in enumerate(noise):
        writer.append(k, [sample(k)], [EnergyBalance(*row[:11], 1, row[11], 0, row[12])], timing(k))  # type: ignore[call-arg]
    assert writer.dropped == 0
    writer.close()
    assert path.stat().st_size <= 1.2 * 3000 * (15 * 8 + 5 + 4 + 5 * 8)


@pytest.mark.slow
def test_a_full_ring_at_real_pace_drops_counts_and_flags_without_waiting(tmp_path: Path) -> None:
    path = tmp_path / "full.h5"
    writer = EnergyLogWriter(path, PORTS[:1], {}, sample_time_ns=SAMPLE_TIME_NS, with_truth=True, ring_rows=64)
    os.kill(writer.pid, signal.SIGSTOP)  # the disk stalls
    for k in range(100):
        append(writer, k)
    assert writer.dropped == 36
    os.kill(writer.pid, signal.SIGCONT)
    k = 100
    before = writer.dropped
    while True:  # until there is room again; every try is a cycle
        append(writer, k)
        if writer.dropped == before:
            break
        before = writer.dropped
        k += 1
    writer.close()
    with EnergyLog.open(path) as log:
        flags = log.timing["dropped_before"]
        assert log.rows == 65
        assert not flags[:64].any()
        assert flags[64] == k - 64
        assert log.timing["sync_index"][64] == k
        assert log.dropped == writer.dropped


@pytest.mark.slow
def test_a_log_can_be_read_while_it_is_written(tmp_path: Path) -> None:
    writer = EnergyLogWriter(tmp_path / "live.h5", PORTS[:1], {}, sample_time_ns=SAMPLE_TIME_NS, with_truth=True)
    for k in range(1000):
        append(writer, k)
    seen = [0]

    def is_whole() -> bool:
        with EnergyLog.open(writer.path) as log:
            assert log.status == "running"
            assert log.rows >= seen[-1]
            seen.append(log.rows)
            assert not log.rows or log.ports["handle"]["h_i"][log.rows - 1] == balance(log.rows - 1).h_i
        return log.rows == 1000

    wait_for(is_whole)
    writer.close()


@pytest.mark.slow
def test_closing_twice_is_harmless_and_an_empty_log_is_a_log(tmp_path: Path) -> None:
    writer = EnergyLogWriter(tmp_path / "empty.h5", PORTS[:1], {}, sample_time_ns=SAMPLE_TIME_NS)
    writer.close("drive absent")
    writer.close()
    with EnergyLog.open(writer.path) as log:
        assert (log.rows, log.status, log.events, log.dropped) == (0, "drive absent", [], 0)


def test_a_missing_folder_is_one_error_before_the_cycle(tmp_path: Path) -> None:
    with pytest.raises(LogWriteError, match="choose a folder that exists"):
        EnergyLogWriter(tmp_path / "no" / "run.h5", PORTS, {}, sample_time_ns=SAMPLE_TIME_NS)


@pytest.mark.parametrize("content", [b"", b"hello", b"\x89HDF\r\n\x1a\n" + bytes(200)])
def test_what_is_no_energy_log_is_one_clear_error(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.h5"
    path.write_bytes(content)
    with pytest.raises(LogFormatError, match=r"x\.h5"):
        EnergyLog.open(path)


def test_foreign_and_newer_files_are_named_as_such(tmp_path: Path, finished: Path) -> None:
    foreign = tmp_path / "foreign.h5"
    with h5py.File(foreign, "w") as file:
        file["x"] = [1.0]
    with pytest.raises(LogFormatError, match="not an energy log"):
        EnergyLog.open(foreign)
    newer = tmp_path / "newer.h5"
    newer.write_bytes(finished.read_bytes())
    with h5py.File(newer, "r+") as file:
        file.attrs["format_version"] = 6
    with pytest.raises(LogFormatError, match="version 6, this program reads up to 5"):
        EnergyLog.open(newer)
    lacking = tmp_path / "lacking.h5"
    lacking.write_bytes(finished.read_bytes())
    with h5py.File(lacking, "r+") as file:
        del file.attrs["sample_time_ns"]
    with pytest.raises(LogFormatError, match="the attributes sample_time_ns are missing"):
        EnergyLog.open(lacking)


def test_the_ring_keeps_order_across_its_end_and_refuses_when_full() -> None:
    shapes = [RingShape("=qd", 8), RingShape("=4s", 2)]
    descriptor = allocate(size_of(shapes))
    producer, consumer = SharedArea(descriptor, shapes), SharedArea(descriptor, shapes)
    ring = producer.rings[0]
    for k in range(20):
        assert ring.push((k, k / 2))
        if k >= 5:
            got = struct.unpack("=qdqd", consumer.rings[0].read(k - 5, 2))
            assert got == (k - 5, (k - 5) / 2, k - 4, (k - 4) / 2)
            consumer.rings[0].release(k - 4)
    assert [ring.push((0, 0.0)) for _ in range(4)] == [True, True, True, False]
    producer.set_text("failure", "no space")
    assert consumer.text("failure") == "no space"
    assert consumer.text("status") == ""
    producer.close()
    consumer.close()
    os.close(descriptor)


def test_a_closed_log_says_so_and_not_that_it_is_damaged(finished: Path) -> None:
    with EnergyLog(finished) as log:
        quantities = next(iter(log.ports.values()))
    with pytest.raises(InputError, match="the log is closed; read its arrays before"):
        quantities.read("h_i")
