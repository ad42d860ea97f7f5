"""What bus and axis parameters accept, refuse and derive."""

from typing import Any

import pytest

from canhaptic.drive.axis_parameters import CanBusParameters
from canhaptic.drive.profile.quirks import Quirks, quirks_of
from canhaptic.errors import ParameterError
from tests.drive.drive_bench import axis


@pytest.mark.parametrize(
    ("rate", "sample_time_ns"), [(1000.0, 1_000_000), ("40 Hz", 25_000_000), ("3 kHz", 333_333), (10_000, 100_000)]
)
def test_the_sample_time_is_a_whole_number_of_nanoseconds(rate: Any, sample_time_ns: int) -> None:
    bus = CanBusParameters(rate=rate)
    assert bus.sample_time_ns == sample_time_ns
    assert bus.sample_time == sample_time_ns * 1e-9


@pytest.mark.parametrize(
    ("rate", "cycles", "silence_ms"), [(1000.0, 20, 100), (100.0, 2, 100), (40.0, 1, 100), (5.0, 1, 600)]
)
def test_the_heartbeat_is_counted_in_syncs_and_three_are_always_granted(rate: float, cycles: int, silence_ms: int):
    bus = CanBusParameters(rate=rate)
    assert (bus.heartbeat_cycles, bus.master_silence_ns) == (cycles, silence_ms * 1_000_000)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"rate": 0.0}, "rate"),
        ({"rate": "100 N"}, "rate"),
        ({"rate": 100, "bitrate": 2_000_000}, "bitrate"),
        ({"rate": 100, "hold_cycles": 5, "stop_cycles": 5}, "expected more than hold_cycles"),
        ({"rate": 100, "stop_ramp": "60 ms"}, "stop_ramp"),
        ({"rate": 100, "speed": 3}, "speed"),
    ],
)
def test_bad_bus_parameters_are_refused_by_name(values: dict[str, Any], text: str) -> None:
    with pytest.raises(ParameterError, match=text):
        CanBusParameters(**values)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"node_id": 0}, "node_id"),
        ({"node_id": 128}, "node_id"),
        ({"counts_per_unit": 0.0}, "counts_per_unit"),
        ({"torque_limit": -1.0}, "torque_limit"),
        ({"torque_limit": float("nan")}, "torque_limit"),
        ({"direction": 2}, "direction"),
        ({"pdo_cob_ids": {0x1A00: 0x185}}, "0x1a00 is no PDO communication object"),
        ({"pdo_cob_ids": {0x1804: 0x700}}, "expected a free COB-ID"),
        ({"pdo_cob_ids": {0x1804: 0x585}}, "expected a free COB-ID"),
    ],
)
def test_bad_axis_parameters_are_refused_by_name(values: dict[str, Any], text: str) -> None:
    with pytest.raises(ParameterError, match=text):
        axis(**values)


def test_quirks_add_up_and_those_that_are_unknown_or_contradict_are_refused() -> None:
    assert quirks_of(()) == Quirks()
    both = quirks_of(("rated_torque_micro", "max_torque_absent"))
    assert (both.rated_torque_resolution, both.writes_max_torque, both.maps_demand) == (1e-6, False, True)
    with pytest.raises(ParameterError, match=r"expected any of: abort_disable_voltage, .*did you mean 'slow_enable'"):
        quirks_of(("slow_enabel",))
    with pytest.raises(ParameterError, match="'torque_per_cent' and 'torque_per_ten_thousand' contradict each other"):
        quirks_of(("torque_per_cent", "torque_per_ten_thousand"))
    with pytest.raises(ParameterError, match="quirks: got 'nothing'"):
        axis(quirks=("nothing",))


def test_what_is_not_given_has_the_value_of_the_manual() -> None:
    bus, of = CanBusParameters(rate=1000.0), axis()
    assert (bus.hold_cycles, bus.stop_cycles, bus.rpdo) == (2, 20, "synchronous")
    assert (of.sdo_timeout, of.step_timeout, of.demand_reported, of.watchdog) == (0.3, 1.0, "before", True)
