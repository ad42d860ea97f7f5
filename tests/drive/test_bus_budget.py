"""The bus budget against the figures of the literature and sums done by hand."""

import pytest

from canhaptic.drive.axis_parameters import CanBusParameters
from canhaptic.drive.can.bus_budget import _worst_case_bits, bus_budget, require_budget
from canhaptic.drive.can.pdo_map import AxisMap, choose_map
from canhaptic.errors import BusBudgetError
from tests.drive.drive_bench import OUR_EDS, axis, dictionary


def maps(count: int, read_back: str = "auto") -> list[AxisMap]:
    axes = [axis(node_id, eds=OUR_EDS, read_back=read_back) for node_id in range(1, count + 1)]
    return [choose_map(dictionary(a), a) for a in axes]


def stuffed_length(bits: str) -> int:
    """Length of a bit string after the stuffing rule of ISO 11898: one bit after five equal ones."""
    out: list[str] = []
    for bit in bits:
        out.append(bit)
        if len(out) >= 5 and len(set(out[-5:])) == 1:
            out.append("1" if bit == "0" else "0")
    return len(out)


@pytest.mark.parametrize(("length", "bits"), [(0, 55), (1, 65), (2, 75), (4, 95), (6, 115), (8, 135)])
def test_worst_case_bits_are_those_of_the_literature(length: int, bits: int) -> None:
    assert _worst_case_bits(length) == bits


@pytest.mark.parametrize("length", range(9))
def test_the_worst_bit_pattern_takes_exactly_the_worst_case(length: int) -> None:
    """11111 0000 1111 0000 ... is the pattern that needs most stuff bits; 13 bits are never stuffed."""
    stuffable = 34 + 8 * length
    pattern = "11111" + "".join("0000" if k % 2 == 0 else "1111" for k in range(stuffable))
    assert stuffed_length(pattern[:stuffable]) + 13 == _worst_case_bits(length)


@pytest.mark.parametrize(("axes", "periodic"), [(1, 285), (2, 515), (3, 745), (4, 975)])
def test_the_periodic_frames_are_summed(axes: int, periodic: int) -> None:
    budget = bus_budget(CanBusParameters(rate=1000.0), maps(axes))
    assert budget.periodic_load == pytest.approx(periodic / 1000.0)


def test_the_worst_cycle_of_three_axes_is_1275_bits_and_the_host() -> None:
    budget = bus_budget(CanBusParameters(rate=500.0), maps(3))
    assert sum(row.bits for row in budget.rows) == 1275
    assert budget.worst_cycle == pytest.approx(1295e-6)
    assert budget.fits


def test_what_does_not_fit_is_refused_with_arithmetic_and_ways_out() -> None:
    with pytest.raises(BusBudgetError) as caught:
        require_budget(CanBusParameters(rate=1000.0), maps(3))
    message = str(caught.value)
    first, then = "1 SYNC x 55 + 3 TPDO x 135 + 3 RPDO x 95", "4 heartbeat x 65 + 1 EMCY x 135"
    assert f"{first} + 1 frame already on the bus x 135 + {then}" in message
    assert "1295 us of 1000 us" in message
    assert "rate: 500 (at most 772 Hz)" in message
    assert "two buses" in message
    with pytest.raises(BusBudgetError, match=r"2180 us of 1000 us.*rate: 400"):
        require_budget(CanBusParameters(rate=1000.0), maps(6))


def test_a_map_without_read_back_is_offered_when_it_alone_fits() -> None:
    bus = CanBusParameters(rate=1000.0, compute_latency=60e-6)
    without = bus_budget(bus, maps(2, read_back="none")).worst_cycle
    with pytest.raises(BusBudgetError, match=rf"read_back: none on every axis \({1e6 * without:.0f} us;"):
        require_budget(bus, maps(2))
    require_budget(bus, maps(2, read_back="none"))


def test_what_is_not_read_back_is_not_offered_to_be_left_out() -> None:
    bus = CanBusParameters(rate=1000.0, compute_latency=60e-6)
    least = bus_budget(bus, maps(2, read_back="none")).worst_cycle
    with pytest.raises(BusBudgetError) as refused:
        require_budget(bus.model_copy(update={"rate": 1.0 / (least - 1e-6)}), maps(2, read_back="none"))
    assert "read_back" not in str(refused.value)


@pytest.mark.parametrize("bitrate", [125_000, 250_000, 500_000, 800_000, 1_000_000])
@pytest.mark.parametrize("axes", [1, 2, 3, 6])
def test_the_offered_rate_fits(bitrate: int, axes: int) -> None:
    bus = CanBusParameters(rate=20_000.0, bitrate=bitrate)
    with pytest.raises(BusBudgetError) as caught:
        require_budget(bus, maps(axes))
    rate = float(str(caught.value).partition("rate: ")[2].partition(" ")[0])
    require_budget(bus.model_copy(update={"rate": rate}), maps(axes))


def test_the_longest_frames_come_first_in_the_arithmetic() -> None:
    budget = bus_budget(CanBusParameters(rate=500.0), [*maps(1), *maps(2, "none")[1:]])
    assert [(row.kind, row.frames, row.bits_each) for row in budget.rows[1:4]] == [
        ("TPDO", 1, 135),
        ("TPDO", 1, 115),
        ("RPDO", 2, 95),
    ]
