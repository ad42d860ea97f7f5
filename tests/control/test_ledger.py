"""The ledger: compensated sums, the least margin and where it was, and the names of `run --json`."""

import json
import math
import random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canhaptic.control.balance import AT_REST, Branch, Certificate
from canhaptic.control.ledger import Ledger, without_dust
from canhaptic.control.verdict import (
    account_verdict,
    add_verdicts,
    contradict,
    handle_verdict,
    headline,
    passive_verdict,
    plant_verdict,
)


def hold(h_i=0.0, h_r=0.0, **more):
    return AT_REST._replace(h_i=h_i, h_m=h_i, h_r=h_r, branch=Branch.EXACT.value, **more)


def test_sums_equal_the_exact_sum_over_values_of_every_size():
    generator = random.Random(3)
    terms = [generator.gauss(0.0, 1.0) * 10.0 ** generator.randint(-12, 3) for _ in range(20_000)]
    ledger = Ledger()
    for cycle, term in enumerate(terms):
        ledger.add(hold(h_i=term, h_r=abs(term) * 0.1), cycle)
    summary = ledger.summary()
    assert summary.energy_in == pytest.approx(math.fsum(term for term in terms if term > 0.0), rel=1e-15)
    assert summary.energy_in - summary.energy_out == pytest.approx(math.fsum(terms), abs=1e-10)
    assert summary.dissipated == pytest.approx(math.fsum(abs(term) * 0.1 for term in terms), rel=1e-15)


def test_the_least_margin_comes_with_its_cycle():
    ledger = Ledger()
    for cycle, (h_i, h_r) in enumerate([(1.0, 0.2), (-0.5, 0.5), (-0.4, 0.1), (0.3, 0.0)]):
        ledger.add(hold(h_i, h_r), cycle)
    summary = ledger.summary()
    assert summary.margin_value == pytest.approx(-0.7)
    assert summary.margin_cycle == 2
    assert summary.least_interaction == 0.0
    assert summary.energy_out == pytest.approx(0.9)


def test_a_run_that_never_loses_has_its_least_margin_before_it_began():
    ledger = Ledger()
    for cycle in range(5):
        ledger.add(hold(0.1, 0.1), cycle)
    assert (ledger.summary().margin_value, ledger.summary().margin_cycle) == (0.0, 0)


def test_what_is_given_to_a_far_side_counts_at_rest_and_while_the_hand_brings_in_less():
    ledger = Ledger()
    ledger.add(hold(h_i=0.5), 0)
    ledger.add(hold(h_i=-0.4, supplied=-0.4), 1)  # at rest
    ledger.add(hold(h_i=0.1 - 0.3, supplied=-0.3), 2)  # 0.1 comes in, and 0.3 goes
    ledger.add(hold(h_i=0.0, supplied=-0.2), 3)  # 0.2 comes in and goes
    ledger.add(hold(h_i=0.7, supplied=0.7), 4)
    summary = ledger.summary()
    assert summary.energy_in == pytest.approx(0.5 + 0.1 + 0.2)
    assert (summary.energy_out, summary.supplied) == pytest.approx((0.0, -0.4 - 0.3 - 0.2 + 0.7))
    assert (summary.least_interaction, summary.margin_cycle, summary.first_below) == (pytest.approx(-0.1), 2, 2)
    assert "supplied" not in Ledger().summary().as_json(1e-3)


def test_the_weakest_certificate_and_the_range_of_damping_in_contact_are_kept():
    ledger = Ledger()
    ledger.add(hold(torque=1.0, damping_rendered=3.0, certificate=Certificate.DEVICE_DAMPING.value), 0)
    ledger.add(hold(torque=1.0, damping_rendered=7.0, certificate=Certificate.HAND_SPEED.value), 1)
    ledger.add(AT_REST._replace(certificate=Certificate.NONE.value), 1)  # without a torque nothing is certified
    ledger.add(AT_REST, 2)
    summary = ledger.summary()
    assert (summary.damping_least, summary.damping_most) == (3.0, 7.0)
    assert summary.certificate is Certificate.HAND_SPEED
    assert summary.branches == {
        branch.name.lower(): {"free": 2, "exact": 2}.get(branch.name.lower(), 0) for branch in Branch
    }


def test_the_certificate_none_is_the_weakest_of_all():
    every = Certificate.of((1 << len(Certificate)) - 1)
    assert set(every) == set(Certificate)
    assert every[-1] is Certificate.NONE


def test_the_json_of_a_port_has_the_shared_names_and_no_number_that_json_lacks():
    ledger = Ledger()
    port = ledger.summary().as_json(sample_time=1e-3)
    assert {"in", "out", "stored", "dissipated", "surplus", "recovered", "leaked", "deficit", "margin"} <= set(port)
    assert {"least_interaction", "certificate", "branches", "damping_rendered"} <= set(port)
    assert set(port["margin"]) == {"value", "cycle", "time"}
    json.dumps(port, allow_nan=False)


@pytest.mark.campaign
def test_ten_million_holds_of_noise_drift_less_than_a_nanojoule():
    generator = random.Random(11)
    ledger, block = Ledger(), [generator.gauss(0.0, 1.0) for _ in range(1000)]
    holds = [hold(h_i) for h_i in block]
    for cycle in range(10_000_000):
        ledger.add(holds[cycle % 1000], cycle)
    summary = ledger.summary()
    assert summary.energy_in - summary.energy_out == pytest.approx(1e4 * math.fsum(block), abs=1e-9)


@pytest.mark.parametrize(
    ("least", "resolution", "expected"),
    [
        (-1e-3, 1e-2, "in doubt"),
        (-1e-2, 1e-3, "no"),
        (0.0, 1e-9, "yes"),
        (0.0, 1e-7, "in doubt"),
        (-1e-3, 0.0, "no"),
        (0.0, 1.0, "in doubt"),
    ],
)
def test_a_sum_is_below_zero_for_certain_only_beyond_its_resolution(
    least: float, resolution: float, expected: str
) -> None:
    assert passive_verdict(least, resolution, energy_in=1.0)[0] == expected


@pytest.mark.parametrize(("least", "expected"), [(None, None), (0.0, "yes"), (-1.0, "in doubt")])
def test_at_the_handle_a_sum_below_zero_is_a_doubt(least: float | None, expected: str | None) -> None:
    account = {"in": 1.0, "least_at_handle": least, "energy_resolution": 1e-9, "certificate": "none"}
    found = handle_verdict(account)  # type: ignore[arg-type]
    assert (found and found[0]) == expected


def test_a_hold_without_torque_has_no_certificate_but_none_for_energy_that_nothing_bounded() -> None:
    without = dict.fromkeys(Certificate, ()) | {Certificate.NONE: (Certificate.NONE,)}
    for certificate, expected in without.items():
        ledger = Ledger()
        ledger.add(AT_REST._replace(h_i=1.0, certificate=certificate.value), 0)
        assert ledger.summary().certificates == expected


@pytest.mark.parametrize("branch", Branch)
def test_a_run_ends_with_an_open_hold_where_the_last_was_held_on(branch: Branch) -> None:
    ledger = Ledger()
    ledger.add(AT_REST._replace(branch=branch.value), 0)
    assert ledger.summary().has_open_hold is (branch is Branch.HELD)


@pytest.mark.parametrize(
    ("certificate", "given", "expected"),
    [
        ("hand_force", {}, ("yes", "by certificate")),
        ("none", {}, ("in doubt", "without a certificate, and as low as -0.05 J within its resolution")),
        ("hand_force", {"energy_resolution": 0.11}, ("in doubt", "the contact acts as if 18 counts deep, 20 needed")),
        ("hand_force", {"energy_resolution": 0.11, "energy_allowance": 0.11, "least_certain": -0.2},
         ("yes", "by certificate")),
        ("hand_force", {"energy_resolution": 1e-5, "in": 1e-6}, ("yes", "by certificate")),
        ("hand_force", {"energy_resolution": 1.1e-5, "in": 1e-6},
         ("in doubt", "the contact acts as if 0.18 counts deep, 20 needed")),
        ("hand_force", {"energy_resolution": 5.0, "books_least": True, "least_interaction": 0.0}, ("yes", "measured")),
        ("none", {"energy_resolution": 0.266, "in": 2e-3, "books_least": True},
         ("in doubt", "0.002 J is certain to have come in, and up to 0.27 J is not")),
        ("none", {"least_certain": -1e-9}, ("yes", "measured")),
        ("none", {"least_certain": -1e-9, "resolution_is_estimated": True},
         ("in doubt", "the resolution of its energy is an estimate")),
        ("none", {"least_certain": 0.0, "open_hold": True}, ("in doubt", "the run ended in holds without a position")),
        ("hand_force", {"open_hold": True}, ("yes", "by certificate")),
        ("hand_force", {"uncommanded_cycles": 1}, ("in doubt", "torques were held that were not commanded")),
        ("hand_force", {"least_certain": -1.0, "active_since": 0.5}, ("no", "")),
        ("hand_force", {"hold": "checked at commissioning"}, ("yes", "by certificate")),
        ("hand_force", {"hold": "not checked"},
         ("in doubt", "the hold of its torques was not checked: run canhaptic commission, or set check_hold")),
        ("hand_force", {"hold": "not checked", "least_certain": 0.0},
         ("in doubt", "the hold of its torques was not checked: run canhaptic commission, or set check_hold")),
        ("hand_force", {"hold": "undecided", "least_certain": 0.0},
         ("in doubt", "the hold of its torques was undecided: render for longer, or harder")),
        ("hand_force", {"hold": "by construction", "least_certain": 0.0}, ("yes", "measured")),
    ],
)  # fmt: skip
def test_a_yes_is_measured_at_every_time_or_certified_with_a_fine_resolution(
    certificate: str, given: Any, expected: Any
) -> None:
    account: Any = {"in": 1.0, "least_interaction": 0.0, "energy_resolution": 0.05, "certificates": [certificate]}
    account |= {"certificate": certificate, "least_certain": -0.05} | given
    assert account_verdict(account) == expected
    add_verdicts(account)
    assert account.get("why", "") == expected[1]


def test_what_is_taken_out_beyond_the_store_and_when_the_margin_was_least_are_in_the_summary() -> None:
    ledger = Ledger()
    assert (ledger.summary().damping_least, ledger.summary().damping_most) == (0.0, 0.0)
    ledger.add(AT_REST._replace(deficit=0.25), 0)
    ledger.add(AT_REST._replace(h_i=-1.0, deficit=0.5), 1, 7)
    assert ledger.summary().deficit == 0.75
    assert ledger.summary().margin_deadline == 7
    ledger.add(AT_REST._replace(h_i=-1.0), 2)
    assert ledger.summary().margin_deadline == 2  # no SYNC was skipped
    ledger = Ledger()
    ledger.add(AT_REST._replace(deficit=0.25), 0)
    ledger.add(AT_REST._replace(h_i=-1.0, deficit=0.5), 1, 7)
    assert ledger.summary().as_json(0.5)["margin"] == {"value": -1.0, "cycle": 1, "time": 3.5}


def test_a_verdict_changes_beyond_a_bound_and_not_on_it() -> None:
    assert passive_verdict(-1e-9)[0] == "yes"
    assert passive_verdict(-1.1e-9)[0] == "no"
    assert passive_verdict(0.0, 0.2, energy_in=2.0, is_promised=True)[0] == "yes"
    assert passive_verdict(0.0, 0.21, energy_in=2.0, is_promised=True)[0] == "in doubt"
    assert passive_verdict(0.0, 1e-9)[0] == "yes"
    assert passive_verdict(0.0, 1.1e-9)[0] == "in doubt"
    assert passive_verdict(0.0, 0.0, has_open_hold=True)[0] == "in doubt"


@pytest.mark.parametrize(("cycles", "least", "expected"), [(0, 0.0, "yes"), (1, 0.0, "in doubt"), (1, -1.0, "no")])
def test_a_torque_that_was_not_commanded_is_a_doubt_and_no_excuse(cycles: int, least: float, expected: str) -> None:
    account = {"in": 1.0, "certificate": "none", "least_interaction": least, "uncommanded_cycles": cycles}
    assert account_verdict(account)[0] == expected  # type: ignore[arg-type]


def test_every_flow_is_summed_under_its_name_and_the_surplus_at_its_largest() -> None:
    draw, ledger = random.Random(1), Ledger()
    rows = []
    for cycle in range(20):
        h_r, h_pas, gen, deficit, leak, paid = (draw.choice([0.0, draw.random()]) for _ in range(6))
        h_i, surplus = draw.uniform(-1.0, 1.0), draw.random() if cycle < 9 else 0.1
        row = AT_REST._replace(h_i=h_i, h_r=h_r, h_pas=h_pas, gen=gen, deficit=deficit, leak=leak, h_dis=surplus)
        rows.append(row._replace(paid=paid if leak else 0.0))
        ledger.add(rows[-1], cycle)
    found = ledger.summary()
    named = {"h_r": "dissipated", "h_pas": "recovered", "gen": "generated", "leak": "leaked"}
    for name in ("h_r", "h_pas", "gen", "deficit", "leak", "paid"):
        assert getattr(found, named.get(name, name)) == pytest.approx(sum(getattr(row, name) for row in rows)), name
    assert found.energy_in == pytest.approx(sum(max(0.0, row.h_i) for row in rows))
    assert found.energy_out == pytest.approx(sum(max(0.0, -row.h_i) for row in rows))
    assert (found.surplus_max, found.surplus_end) == (max(row.h_dis for row in rows), 0.1)


def test_a_log_without_a_resolution_is_judged_by_counts_and_at_the_motor_no_damping_promises() -> None:
    account = {"in": 1.0, "certificate": "hand_force", "certificates": ["none"], "uncertainty": 0.0}
    assert account_verdict({**account, "least_interaction": -5e-7})[0] == "yes"
    assert account_verdict({**account, "least_interaction": -1e-5})[0] == "no"
    del account["uncertainty"]
    assert account_verdict({**account, "least_interaction": 0.0})[0] == "yes"
    assert account_verdict({**account, "least_interaction": -1e-5})[0] == "no"
    promised = {**account, "certificates": ["hand_force"], "least_interaction": -1e-3, "energy_resolution": 1.0}
    assert account_verdict({**promised})[0] == "in doubt"
    assert account_verdict({**promised, "least_at_handle": 0.0})[0] == "in doubt"
    assert account_verdict({**promised, "energy_allowance": 1.0})[0] == "yes"


def test_a_hold_held_on_is_no_contact_without_damping() -> None:
    ledger = Ledger()
    ledger.add(AT_REST._replace(branch=Branch.EXACT.value, damping_rendered=5.0), 0)
    ledger.add(AT_REST._replace(branch=Branch.HELD.value), 1)
    assert (ledger.summary().damping_least, ledger.summary().damping_most) == (5.0, 5.0)


def test_what_went_out_within_the_allowance_is_passive() -> None:
    assert passive_verdict(-1e-4, allowance=1e-4)[0] == "yes"
    assert passive_verdict(-1.1e-4, allowance=1e-4)[0] == "no"
    assert passive_verdict(-1.1e-4, 2e-5, allowance=1e-4)[0] == "in doubt"
    assert passive_verdict(0.0, 1e-4, energy_in=1e-4, allowance=1e-4)[0] == "yes"
    assert (plant_verdict(-1e-4, 1e-4), plant_verdict(-1.1e-4, 1e-4)) == ("yes", "no")


def test_an_estimate_refutes_nothing() -> None:
    assert passive_verdict(-1.0, 1e-3, is_estimated=True)[0] == "in doubt"


@given(least=st.floats(-1.0, 1.0), resolution=st.floats(0.0, 10.0), certificate=st.sampled_from(["hand_force", "none"]))
def test_a_port_that_was_active_is_active_whatever_comes_later(
    least: float, resolution: float, certificate: str
) -> None:
    account: Any = {"in": 1.0, "least_interaction": least, "energy_resolution": resolution}
    account |= {"certificate": certificate, "certificates": [certificate]}
    assert account_verdict({**account, "active_since": 0.5})[0] == "no"
    assert account_verdict({**account, "active_before": True})[0] == "no"
    damped: Any = {**account, "least_at_handle": least, "active_since": 0.5}
    assert handle_verdict({**damped, "active_at_handle_since": 0.6})[0] == "no"
    assert handle_verdict(damped)[0] != "no"


@pytest.mark.parametrize(
    ("known", "left"),
    [
        ({"active_since": 1.0}, ["none"]),
        ({"active_since": 1.0, "least_at_handle": -1.0}, ["exact", "hand_force"]),
        ({"active_since": 1.0, "least_at_handle": -1.0, "active_at_handle_since": 2.0}, ["none"]),
        ({}, ["exact", "hand_force"]),
    ],
)
def test_a_certificate_is_refuted_where_its_own_sum_is(known: dict[str, float], left: list[str]) -> None:
    account: Any = {"certificate": "hand_force", "certificates": ["exact", "hand_force"], **known}
    contradict(account)
    assert account["certificates"] == left
    assert account.get("contradicted", []) == ([] if len(left) == 2 else ["hand_force"])
    assert ("suspects" in account) is (left == ["none"])


AT_REST_INSIDE = {"holds": 100, "without_torque": 99, "requested": 0.0, "sent": 0.0}
TOUCHED = {"holds": 100, "without_torque": 0, "requested": 50.0, "sent": 49.0}


@pytest.mark.parametrize(
    ("account", "word"),
    [
        ({"passive": "yes"}, "yes"),
        ({"passive": "in doubt", "plant_passive": "no"}, "no"),
        ({"passive": "in doubt", "plant_passive": "yes"}, "yes"),
        ({"passive": "no", "passive_at_handle": "yes"}, "yes"),
        ({"passive": "no", "passive_at_handle": "in doubt"}, "no"),
        ({"passive": "no", "passive_at_handle": "yes", "plant_passive": "no", "plant_passive_at_handle": "no"}, "no"),
        ({"passive": "yes", "contact": {**TOUCHED, "holds": 0}}, "no contact"),
        ({"passive": "yes", "contact": {**TOUCHED, "sent": 5.0}}, "yes"),
        ({"passive": "yes", "contact": {**TOUCHED, "sent": 4.9}}, "nothing rendered"),
        ({"passive": "no", "contact": {**TOUCHED, "sent": 0.0}}, "no"),
        ({"passive": "in doubt", "contact": {"holds": 100, "without_torque": 100}}, "nothing rendered"),
        ({"passive": "in doubt", "contact": {"holds": 100, "without_torque": 99}}, "in doubt"),
        ({"passive": "yes", "contact": AT_REST_INSIDE, "rendered": {"stiffness": None, "damping": 0.1}}, "yes"),
        (
            {"passive": "yes", "contact": AT_REST_INSIDE, "rendered": {"stiffness": None, "damping": 0.0}},
            "nothing rendered",
        ),
    ],
)
def test_the_word_that_is_shown(account: Any, word: str) -> None:
    assert headline(account) == word
    assert headline({**account, "dry_run": True}) == "dry run"


def test_a_margin_of_rounding_is_none_and_a_small_one_of_little_energy_stays() -> None:
    assert without_dust(-2.9e-18, 1e-3) == 0.0
    assert without_dust(-1e-6, 1e-3) == -1e-6
    assert without_dust(-1.1e-6, 1e9) == -1.1e-6  # never more than the tolerance of the verdict
    assert without_dust(0.0, 0.0) == 0.0
