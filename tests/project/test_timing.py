import math

from hypothesis import given
from hypothesis import strategies as st

from canhaptic.drive.clock import DurationHistogram


@given(
    st.lists(st.integers(min_value=-5_000, max_value=60_000_000), min_size=1, max_size=200),
    st.sampled_from([0.5, 0.99, 0.999]),
)
def test_a_quantile_is_the_sorted_one_rounded_up_to_a_bin(durations: list[int], fraction: float) -> None:
    histogram = DurationHistogram()
    for duration in durations:
        histogram.add(duration)
    exact = max(0, sorted(durations)[math.ceil(fraction * len(durations)) - 1])
    found = histogram.quantile(fraction) * 1e9
    if exact < 20_000_000:
        assert exact - 1e-3 <= found <= exact + 1_000 + 1e-3
    else:
        assert math.isclose(found, max(durations), rel_tol=1e-12)
    assert histogram.maximum == max(0, *durations)


def test_an_empty_histogram_reports_zeros() -> None:
    assert set(DurationHistogram().summary().values()) == {0.0}
