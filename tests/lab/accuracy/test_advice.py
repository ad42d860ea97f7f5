"""Advice is arithmetic on rows: Pareto front, cheapest setting, order, ranks; and timing is interleaved."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canhaptic.lab.studies.accuracy.accuracy_table import (
    _loop_advice,
    _loop_price,
    _method_prices,
    advice,
    cheapest,
    error_per_microsecond,
    line,
    pareto,
    rank_agreement,
)
from canhaptic.lab.studies.accuracy.plant_solvers import fitted_order
from canhaptic.lab.studies.accuracy.timing import ProcessorTime, interleaved, saving
from tests.executed_bytecodes import executed_bytecodes

errors = st.sampled_from([1e-16, 1e-12, 1e-9, 2e-9, 1e-6, 1e-3])
rows = st.lists(
    st.builds(
        lambda error, cost, stable, ours: {
            "method": "canhaptic" if ours else "RK4",
            "setting": "s",
            "status": "ok" if stable else "unstable",
            "position_error": error if stable else None,
            "evaluations": cost,
            "accuracy": {"event_bits": 24, "substeps": 1} if ours else None,
        },
        errors,
        st.integers(1, 6),
        st.booleans(),
        st.booleans(),
    ),
    max_size=12,
)


@given(rows, errors)
def test_no_row_that_keeps_the_tolerance_is_cheaper_than_the_cheapest(table, tolerance):
    chosen = cheapest(table, tolerance)
    good = [r["evaluations"] for r in table if r["status"] == "ok" and r["position_error"] <= tolerance]
    assert (chosen is None) == (not good)
    assert chosen is None or chosen["evaluations"] == min(good)


@given(rows)
def test_what_is_not_on_the_front_is_beaten_by_something_that_is(table):
    marks = pareto(table, "evaluations", 1e-13)
    front = [r for r, mark in zip(table, marks, strict=True) if mark]
    for row, mark in zip(table, marks, strict=True):
        if row["status"] != "ok":
            assert not mark
            continue
        error = max(row["position_error"], 1e-13)
        better = [
            f for f in front
            if max(f["position_error"], 1e-13) <= error and f["evaluations"] <= row["evaluations"]
        ]  # fmt: skip
        assert better
        if mark:
            assert all(
                max(f["position_error"], 1e-13) == error and f["evaluations"] == row["evaluations"] for f in better
            )


@given(rows, errors)
def test_the_advice_names_what_a_scene_cannot_name_but_would_be_cheaper(table, tolerance):
    found = advice(table, [], tolerance)
    ours = [r for r in table if r["method"] == "canhaptic"]
    cheap = cheapest(ours, tolerance)
    assert (found["chosen"] is None) or found["chosen"]["evaluations"] >= cheap["evaluations"]
    assert found["chosen"] or cheap is None or any(row["position_error"] is None or row["position_error"] > tolerance
                                                   for row in ours)  # fmt: skip
    if found["chosen"]:
        assert found["line"] == "accuracy: {event_bits: 24, substeps: 1}"
        assert all(other["evaluations"] < found["chosen"]["evaluations"] for other in found["cheaper_elsewhere"])


def test_a_setting_that_keeps_the_tolerance_by_luck_is_told_from_one_that_lasts():
    def row(bits, substeps, error, cost):
        accuracy = {"event_bits": bits, "substeps": substeps}
        return {
            "method": "canhaptic", "setting": "s", "status": "ok", "position_error": error, "evaluations": cost,
            "accuracy": accuracy,
        }  # fmt: skip

    found = advice([row(8, 8, 1e-8, 5), row(8, 16, 1e-6, 7), row(16, 8, 1e-8, 6), row(16, 16, 1e-9, 9)], [], 1e-7)
    assert found["line"] == "accuracy: {event_bits: 16, substeps: 8}"


def test_a_setting_that_was_left_out_for_its_time_does_not_speak_against_a_coarser_one():
    def row(substeps, status, method="canhaptic"):
        ran = status == "ok"
        accuracy = {"event_bits": 24, "substeps": substeps} if method == "canhaptic" else None
        return {"method": method, "setting": f"{substeps}", "status": status, "position_error": 1e-9 if ran else None,
                "evaluations": substeps if ran else None, "accuracy": accuracy}  # fmt: skip

    table = [row(1, "ok"), row(2, "ok"), row(4, "left out")]
    assert advice(table, [], 1e-7)["line"] == "accuracy: {event_bits: 24, substeps: 1}"
    assert advice([*table[:2], row(4, "unstable")], [], 1e-7)["line"] is None
    others = [row(1, "unstable", "RK4"), row(2, "failed: at 1 s", "RK4"), row(1, "left out", "LSODA")]
    assert _method_prices({"plant": others, "tolerance": 1e-7}) == ["RK4: unstable, failed", "LSODA: left out"]


def test_no_setting_is_advised_where_the_errors_do_not_fall_as_declared():
    row = {"method": "canhaptic", "setting": "s", "status": "ok", "position_error": 1e-9, "evaluations": 1,
           "accuracy": {"event_bits": 24, "substeps": 1}}  # fmt: skip
    for fitted, advised in ((-0.15, False), (0.4, False), (0.6, True), (None, True)):
        found = advice([row], [], 1e-6, [{"method": "canhaptic", "declared": 1, "fitted": fitted}])
        assert (found["chosen"] is not None) is advised
        assert ("where 1 is declared" in found["doubt"]) is not advised


def test_effects_are_sorted_by_error_per_microsecond():
    effects = [
        {"effect": "small", "error_per_microsecond": error_per_microsecond(1e-6, 2.0)},
        {"effect": "alone", "error_per_microsecond": None},
        {"effect": "free", "error_per_microsecond": error_per_microsecond(1e-6, -0.3)},
        {"effect": "large", "error_per_microsecond": error_per_microsecond(1e-3, 20.0)},
    ]
    assert [e["effect"] for e in advice([], effects, 1e-6)["effects"]] == ["large", "free", "small", "alone"]  # type: ignore[arg-type]


@given(st.floats(0.5, 4.5), st.floats(1e-9, 1e-4))
def test_an_order_that_is_there_is_found(order, scale):
    sizes = [1.0, 0.5, 0.25, 0.125]
    assert fitted_order(sizes, [scale * size**order for size in sizes], 0.1) == pytest.approx(order)


def test_errors_of_rounding_and_of_instability_tell_no_order():
    assert fitted_order([1.0, 0.5, 0.25], [3.0, 1e-15, 1e-16], 0.1) is None


@pytest.mark.slow
@given(st.lists(st.tuples(st.integers(0, 5), st.integers(0, 5)), min_size=3, max_size=12))
def test_ranks_agree_as_scipy_says(pairs):
    from scipy.stats import spearmanr  # half a second, which not every worker needs

    one, other = [float(a) for a, _ in pairs], [float(b) for _, b in pairs]
    found = rank_agreement(one, other)
    if len(set(one)) == 1 or len(set(other)) == 1:
        assert found is None
    else:
        assert found == pytest.approx(float(spearmanr(one, other).statistic))


def test_the_line_is_what_a_scene_takes():
    assert line({"event_bits": 16, "substeps": 4}) == "accuracy: {event_bits: 16, substeps: 4}"


def test_repeats_are_interleaved_and_a_stop_keeps_what_was_measured():
    order, parts = [], []
    jobs = {name: (lambda name=name: order.append(name)) for name in "abc"}
    found = interleaved(jobs, 1.0, lambda: False, parts.append)
    assert order == list("abc" * 15)
    assert parts[-1] == 1.0
    assert all(time.least >= 0.0 and time.spread >= 0.0 and time.repeats == 15 for time in found.values())
    order.clear()
    assert list(interleaved(jobs, 1e-12, lambda: False, parts.append)) == ["a"]  # the budget binds after the first
    order.clear()
    found = interleaved(jobs, 1.0, lambda: len(order) == 2, lambda _: None)
    assert (list(found), order) == (["a", "b"], ["a", "b"])


def test_bytecodes_are_the_same_in_every_run():
    def work():
        return sum(math.sqrt(i) for i in range(50))

    assert executed_bytecodes(work) == executed_bytecodes(work) > 100


@pytest.mark.parametrize(
    ("whole", "part", "repeats", "expected"),
    [(10.0, 8.0, 3, 2.0), (10.0, 9.5, 3, None), (8.0, 10.0, 3, -2.0), (10.0, 8.0, 2, None)],
)
def test_a_saving_inside_the_spread_is_none(whole: float, part: float, repeats: int, expected: float | None) -> None:
    one, other = (ProcessorTime(time, 0.05, repeats) for time in (whole, part))
    assert saving(one, other) == expected
    assert saving(None, other) is None


def test_what_sends_no_torque_or_does_nothing_is_no_advice() -> None:
    like = {
        "status": "ok", "group": "algorithm", "is_scene": False, "largest_torque": 2.0, "force_error": 1.0,
        "energy_error": 1.0, "energy_given_out": 0.0, "fineness": None, "bus_fits": True, "bus_load": 0.1,
    }  # fmt: skip
    loop = [
        {**like, "group": "as it is", "is_scene": True, "setting": "guarded", "position_error": 1e-3},
        {**like, "setting": "unprotected", "position_error": 1e-4},
        {**like, "setting": "passivity_observer", "position_error": 1e-4},  # to the last digit
        {**like, "setting": "energy_bounding", "position_error": 2e-4},
        {**like, "setting": "a_priori_dissipation", "position_error": 3e-4, "largest_torque": 0.0},
    ]
    result = {"loop": loop, "advice": {"most_exact": None}, "unit": "m", "reference": None, "now": {}}
    said = _loop_advice(result)
    assert said.endswith("closer: algorithm: energy_bounding (200 um, bus 10 %, leaves guarded and its guarantee)")
    assert _loop_price(loop[-1], result, "algorithm") == "sends no torque"
