"""Before or after the update: found out from what a drive reports, judged by how the simulated drive was made."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canhaptic.drive.readback_timing import detect_read_back, measure_read_back, probe_torques
from canhaptic.errors import ParameterError
from tests.drive.drive_bench import MakeBench, axis


@pytest.mark.parametrize("configured", ["before", "after"])
@pytest.mark.parametrize(("twin", "expected"), [("before_update", "before"), ("after_update", "after")])
@pytest.mark.parametrize("read_back", ["demand", "actual"])
def test_the_timing_is_found_whatever_the_configuration_says(
    bench: MakeBench, twin: str, expected: str, read_back: str, configured: str
) -> None:
    made = bench([axis(read_back=read_back, demand_reported=configured)], drive_values={"torque_read_back": twin})
    with made.rig:
        [found] = measure_read_back(made.rig, amplitude=0.5)
    assert found.reported == expected
    right, wrong = found.before_error, found.after_error
    if expected == "after":
        right, wrong = wrong, right
    assert right == 0.0
    assert wrong == pytest.approx(1.0)
    assert found.changes > 30


@pytest.mark.parametrize("twin", ["before_update", "after_update"])
def test_with_an_event_driven_rpdo_the_hold_that_ended_is_reported_either_way(bench: MakeBench, twin: str) -> None:
    made = bench([axis()], {"rpdo": "event"}, drive_values={"torque_read_back": twin})
    with made.rig:
        [found] = measure_read_back(made.rig, amplitude=0.5)
    assert (found.reported, found.after_error) == ("before", 0.0)
    assert "the same" in found.text


@pytest.mark.parametrize(
    ("lag", "expected"),
    [(0.05e-3, "before"), (0.3e-3, "before"), (2e-3, None)],
)
def test_a_filtered_torque_is_recognised_as_long_as_it_follows_within_a_hold(
    bench: MakeBench, lag: float, expected: str | None
) -> None:
    """A first-order filter of time constant t misses exp(-T / t) of each change: 4 % at 0.3 ms, 61 % at 2 ms."""
    made = bench([axis(read_back="actual")], drive_values={"torque_lag": lag})
    with made.rig:
        [found] = measure_read_back(made.rig, amplitude=2.0, cycles=120)
    assert found.reported == expected
    if expected is None:
        assert "filtered, noisy or not followed" in found.text


def test_every_axis_is_told_on_its_own(bench: MakeBench) -> None:
    made = bench([axis(5), axis(6)], {"rate": 500.0})
    made.drives[1]._process_data._shows_next_torque = True
    with made.rig:
        assert [found.reported for found in measure_read_back(made.rig, amplitude=0.5)] == ["before", "after"]


def test_the_axis_hardly_moves_and_the_limit_holds(bench: MakeBench) -> None:
    made = bench([axis(torque_limit=0.4)])
    with made.rig:
        start = made.drives[0].servo.motor.position
        [found] = measure_read_back(made.rig, amplitude=5.0, cycles=200)
        assert abs(made.drives[0].servo.motor.position - start) < 1e-4
        assert max(abs(torque) for torque in made.torques_sent()) == 40
    assert found.reported == "before"


def test_lost_tpdos_are_left_out(bench: MakeBench) -> None:
    made = bench([axis()], {"stop_cycles": 50})
    count = 0

    def drop(message: Any) -> Any:
        nonlocal count
        count += message.arbitration_id == 0x185
        return None if message.arbitration_id == 0x185 and count % 5 == 0 else message

    made.rig.start()
    made.tampered.on_receive = drop
    [found] = measure_read_back(made.rig, amplitude=0.5, cycles=100)
    made.rig.stop()
    assert (found.reported, found.before_error) == ("before", pytest.approx(0.0, abs=0.2))


def test_a_probe_that_cannot_tell_is_refused(bench: MakeBench) -> None:
    made = bench([axis()])
    with made.rig, pytest.raises(ParameterError, match=r"amplitude: got 0.01, expected at least 0.03"):
        measure_read_back(made.rig, amplitude=0.01)
    made = bench([axis(read_back="none")])
    with made.rig, pytest.raises(ParameterError, match="read_back is none"):
        measure_read_back(made.rig, amplitude=1.0)


def test_too_few_changes_decide_nothing() -> None:
    found = detect_read_back([0, 5, 5, 5, 5, 5, 5, 5, 5, 5], [0] * 10, "synchronous")
    assert (found.reported, found.changes) == (None, 1)
    assert "expected at least 8" in found.text


def test_a_drive_that_does_not_follow_at_all_decides_nothing() -> None:
    commanded = [100 if k % 3 else -100 for k in range(60)]
    assert detect_read_back(commanded, [0] * 60, "synchronous").reported is None
    late = [0, 0, 0, *commanded[:-3]]
    assert detect_read_back(commanded, late, "event").reported is None


torques = st.lists(st.integers(-1000, 1000), min_size=40, max_size=80)


@given(torques, st.sampled_from(["before", "after"]))
def test_any_changing_torque_tells_the_timing_and_noise_of_a_count_does_not_hide_it(
    commanded: list[int], timing: str
) -> None:
    commanded = [value + 2000 * (k % 2) for k, value in enumerate(commanded)]
    delay = 2 if timing == "before" else 1
    reported = [0] * delay + [value + k % 3 - 1 for k, value in enumerate(commanded[:-delay])]
    assert detect_read_back(commanded, reported, "synchronous").reported == timing


@given(st.integers(2, 126))
def test_the_probe_pushes_nowhere_and_uses_its_whole_amplitude(cycles: int) -> None:
    probe = probe_torques(0.7, cycles)
    assert len(probe) == cycles
    sums = [sum(probe[:k]) for k in range(cycles + 1)]
    assert max(map(abs, sums)) <= 0.7 + 1e-9
    assert set(map(abs, probe)) == {0.7}


def test_the_probe_does_not_repeat_within_its_period() -> None:
    signs = [torque > 0 for torque in probe_torques(1.0, 252)[::2]]
    assert signs[:63] == signs[63:]
    assert all(signs[:63] != signs[k : 63 + k] for k in range(1, 63))
