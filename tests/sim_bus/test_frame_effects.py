"""What happens to single frames: how often, to which, and to nothing else."""

import itertools
import math
from typing import Any

import pytest

from tests.sim_bus.bus_bench import MS, US, Bench, frame, numbered, numbers

COUNT = 1500


def sent_through(count: int = COUNT, seed: int = 0, **effects: Any) -> list[tuple[int, int, bytes]]:
    with Bench(seed=seed, **effects) as bench:
        bench.sync()
        return bench.send_all(numbered(count))


@pytest.mark.parametrize("drop", [0.02, 0.5])
def test_the_share_of_lost_frames_is_the_one_asked_for(drop: float) -> None:
    lost = COUNT - len(sent_through(drop=drop))
    assert lost == pytest.approx(COUNT * drop, abs=4.0 * math.sqrt(COUNT * drop * (1.0 - drop)))


@pytest.mark.slow
@pytest.mark.parametrize("burst", [1.0, 3.0, 10.0])
def test_bursts_of_losses_have_the_mean_length_and_share_asked_for(burst: float) -> None:
    count, drop = 12_000, 0.2
    heard = set(numbers(sent_through(count, drop=drop, drop_burst=burst)))
    runs = [len(list(run)) for is_heard, run in itertools.groupby(range(count), heard.__contains__) if not is_heard]
    assert sum(runs) / len(runs) == pytest.approx(burst, rel=0.15)
    assert sum(runs) / count == pytest.approx(drop, rel=0.25)
    if burst == 1.0:
        assert set(runs) == {1}


def test_the_same_seed_strikes_the_same_frames_and_another_seed_others() -> None:
    runs = [numbers(sent_through(500, seed=seed, drop=0.2)) for seed in (3, 3, 4)]
    assert runs[0] == runs[1] != runs[2]


def test_an_effect_more_leaves_what_the_others_do_as_it_was() -> None:
    alone = numbers(sent_through(500, drop=0.2))
    together = sent_through(500, drop=0.2, jitter=300e-6, duplicate=0.3, reorder=0.1, foreign_rate=100.0)
    assert sorted(set(numbers(entry for entry in together if entry[1] == 0x201))) == alone


def test_a_frame_arrives_twice_as_often_as_asked_for() -> None:
    heard = numbers(sent_through(duplicate=0.1))
    copies = len(heard) - COUNT
    assert copies == pytest.approx(0.1 * COUNT, abs=50)
    assert heard == sorted(heard)
    assert len(set(heard)) == COUNT


def test_a_corrupt_frame_differs_in_one_bit() -> None:
    turned = []
    for n, (_, _, data) in enumerate(sent_through(corrupt=0.1)):
        assert len(data) == 4
        turned.append((n ^ int.from_bytes(data, "little")).bit_count())
    assert set(turned) == {0, 1}
    assert sum(turned) == pytest.approx(0.1 * COUNT, abs=50)


def test_a_truncated_frame_is_the_beginning_of_what_was_sent() -> None:
    lengths = []
    for n, (_, _, data) in enumerate(sent_through(truncate=0.1)):
        assert n.to_bytes(4, "little").startswith(data)
        lengths.append(len(data))
    assert set(lengths) == {0, 1, 2, 3, 4}
    assert sum(length < 4 for length in lengths) == pytest.approx(0.1 * COUNT, abs=50)


def test_frames_without_data_can_be_neither_truncated_nor_corrupted() -> None:
    with Bench(truncate=1.0, corrupt=1.0) as bench:
        bench.sync()
        assert [data for _, _, data in bench.send_all([frame(0x080)] * 5)] == [b""] * 5
        assert not bench.master.counts


def test_a_delayed_frame_arrives_at_its_own_virtual_instant() -> None:
    with Bench(delay=1.7e-3) as bench:
        bench.sync()
        begin = bench.clock.now()
        heard = bench.send_all(numbered(3))
        assert [time - begin for time, _, _ in heard] == [1700 * US, 2700 * US, 3700 * US]


def test_jitter_stays_within_its_range_and_keeps_the_order() -> None:
    with Bench(delay=200e-6, jitter=3e-3) as bench:
        bench.sync()
        begin = bench.clock.now()
        heard = bench.send_all(numbered(2000))
        assert numbers(heard) == list(range(2000))
        lateness = [time - begin - n * MS for n, (time, _, _) in enumerate(heard)]
        assert min(lateness) >= 200 * US
        assert max(lateness) <= 3200 * US
        assert min(lateness) < 400 * US < 3000 * US < max(lateness)


def test_a_reordered_frame_is_overtaken_by_those_behind_it_and_by_no_more() -> None:
    heard = numbers(sent_through(reorder=0.1, reorder_delay=2.5e-3))
    assert sorted(heard) == list(range(COUNT))
    late = [n for n, after in itertools.pairwise(heard) if after < n]
    assert len(late) > 0.05 * COUNT
    places = {n: place for place, n in enumerate(heard)}
    assert max(places[n] - n for n in range(COUNT)) == 2  # at most the two that follow within 2.5 ms
    assert min(places[n] - n for n in range(COUNT)) >= -3


@pytest.mark.parametrize(("direction", "out", "back"), [("to_drive", 0, 50), ("to_master", 50, 0), ("both", 0, 0)])
def test_effects_can_be_kept_to_one_direction(direction: str, out: int, back: int) -> None:
    with Bench(drop=1.0, direction=direction, bring_up=True) as bench:
        for n in range(50):
            bench.ear.bus.send(frame(0x181, bytes([n])))
        assert len(bench.until(bench.clock.now() + MS)) == back
        assert len(bench.send_all(numbered(50))) == out


def test_effects_can_be_kept_to_some_cob_ids() -> None:
    with Bench(drop=1.0, ids=(0x201, 0x77E)) as bench:
        bench.sync()
        heard = bench.send_all(frame(can_id) for can_id in (0x201, 0x202, 0x77E, 0x601))
        assert [can_id for _, can_id, _ in heard] == [0x202, 0x601]
        assert dict(bench.master.counts) == {("drop", "to_drive", 0x201): 1, ("drop", "to_drive", 0x77E): 1}


def test_effects_can_be_kept_to_some_times() -> None:
    with Bench(drop=1.0, during=[{"begin": 0.103, "duration": 2e-3, "every": 5e-3}]) as bench:
        bench.sync()  # 100 ms
        heard = numbers(bench.send_all(numbered(12)))
        assert heard == [0, 1, 2, 5, 6, 7, 10, 11]


def test_nothing_happens_before_the_first_sync_unless_asked_for() -> None:
    for bring_up in (False, True):
        with Bench(drop=1.0, bring_up=bring_up) as bench:
            assert len(bench.send_all(numbered(3))) == (0 if bring_up else 3)
            bench.master.send(frame(0x080))
            bench.ear.heard.clear()
            assert bench.send_all(numbered(3)) == []


def test_a_frame_that_is_changed_or_kept_waiting_is_a_copy() -> None:
    with Bench(corrupt=1.0, delay=1e-3) as bench:
        bench.sync()
        message = frame(0x201, b"\1\2\3\4")
        bench.master.send(message)
        assert bytes(message.data) == b"\1\2\3\4"
        message.data = bytearray(b"\xff\xff\xff\xff")  # the master uses one message again and again
        bench.until(bench.clock.now() + 10 * MS)
        [(_, _, data)] = bench.ear.heard
        assert sum((a ^ b).bit_count() for a, b in zip(data, b"\1\2\3\4", strict=True)) == 1
