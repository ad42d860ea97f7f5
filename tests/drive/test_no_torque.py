"""A drive of a dry run: every RPDO carries a target torque of 0, literal bytes."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canhaptic.drive.safety.limiter import DryRunLimiter, TorqueLimiter
from canhaptic.drive.safety.power_states import PowerState, drive_state, is_enabled
from canhaptic.errors import ControlError
from tests.drive.drive_bench import MakeBench, axis, started

LIMITS = (5.0, 1e-3, 1000.0, 2.0)


@given(st.lists(st.tuples(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0)), min_size=1, max_size=20))
def test_nothing_passes_and_the_largest_that_would_have_passed_is_kept(asked: list[tuple[float, float]]) -> None:
    limiter, largest = DryRunLimiter(*LIMITS), 0.0
    for torque, velocity in asked:
        largest = max(largest, abs(TorqueLimiter(*LIMITS).limit(torque, velocity)))  # from rest each time
        assert limiter.limit(torque, velocity) == limiter.last == limiter.low == limiter.high == 0.0
        assert limiter.withheld == largest
    limiter.reset()
    assert limiter.withheld == 0.0


def test_a_torque_that_is_no_number_ends_a_dry_run_as_it_ends_a_run() -> None:
    with pytest.raises(ControlError, match="expected a finite number"):
        DryRunLimiter(*LIMITS).limit(math.nan, 0.0)


def test_operation_enabled_is_one_state_of_all_statuswords() -> None:
    words = [high | low for high in (0x0000, 0x1600) for low in range(256)]
    assert [is_enabled(word) for word in words] == [drive_state(word) is PowerState.OPERATION_ENABLED for word in words]
    assert sum(map(is_enabled, words)) == 2 * 4  # bits 4 and 7 are free


@pytest.mark.parametrize("values", [{}, {"rpdo": "event"}])
def test_every_rpdo_of_a_dry_run_carries_zero_and_the_drive_is_enabled(bench: MakeBench, values: dict[str, str]):
    b = started(bench, bus=values, dry_run=True)
    samples = b.run(50, 5.0)
    assert b.drives[0].servo.torque == 0.0
    b.rig.stop()
    frames = b.sent(0x205)
    assert frames.count(bytes.fromhex("0F000000")) >= 50  # operation enabled, target torque 0
    assert {frame[2:] for frame in frames} == {b"\0\0"}
    assert [sample.torque_applied for sample in samples] == [0.0] * 50  # 0x6074 as read back
    assert b.rig.drives[0].withheld == 5.0
    assert b.rig.dry_run


def test_the_same_torque_is_on_the_wire_in_a_run(bench: MakeBench) -> None:
    b = started(bench)
    b.run(50, 5.0)
    assert bytes.fromhex("0F00F401") in b.sent(0x205)  # 500 per mille of 10 N
    assert not b.rig.dry_run


def test_no_torque_gets_past_the_limiter_of_a_dry_run_either(bench: MakeBench) -> None:
    b = started(bench, dry_run=True)
    b.rig.drives[0].limiter = TorqueLimiter(8.0, 1e-3)
    b.run(5, 5.0)
    b.rig.drives[0].write(777)
    assert {frame[2:] for frame in b.sent(0x205)} == {b"\0\0"}


def test_every_axis_of_a_dry_run_is_without_torque(bench: MakeBench) -> None:
    b = started(bench, [axis(5), axis(6)], dry_run=True)
    b.run(20, -8.0)
    assert set(b.torques_sent(0x205)) == set(b.torques_sent(0x206)) == {0}
