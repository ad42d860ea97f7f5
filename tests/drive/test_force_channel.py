"""The counts of a force sensor as the master takes them, by numbers worked out by hand."""

import pytest

from canhaptic.drive.profile.motion_parameters import ForceChannel, ForceParameters


def channel(**values: object) -> ForceChannel:
    given: dict[str, object] = {"object": "0x2100", "per_count": 0.01, "range": 20.0, "error": 2.0, "slew": 100.0}
    given |= {"offset_counts": 5, "frozen_after": 3}
    parameters = ForceParameters(**given | values)
    return ForceChannel(parameters, 1e-3)


def test_counts_are_a_force_and_one_that_stays_or_is_beyond_the_range_is_wrong() -> None:
    force = channel()
    assert force.take(505) == pytest.approx(5.0)
    assert [force.take(505) and force.same for _ in range(3)] == [1, 2, 3]
    assert force.is_wrong
    force.reset()
    assert (force.force, force.same, force.is_wrong) == (0.0, 0, False)
    force.take(2006)
    assert force.is_wrong
    assert force.is_beyond_range
