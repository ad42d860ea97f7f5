"""A running sum against the exact one, and the numbers and claims that accounts and logs begin with."""

import math
import random
from dataclasses import fields

from canhaptic.control.balance import AT_REST, Certificate, RunningSum, add
from canhaptic.control.certificates.certified_torque import TorqueBound
from canhaptic.control.multi_axis.group_kernel import GroupMotion
from canhaptic.control.passivity.stepped import Axis
from canhaptic.control.verdict import ACTIVE_AT_HANDLE, ACTIVE_AT_MOTOR, PortResult, add_verdicts, claim_nothing
from canhaptic.lab.rivals.scaled_group import ScaledState


def test_a_sum_of_terms_of_every_size_is_exact_to_the_last_place() -> None:
    for seed in range(20):
        draw = random.Random(seed)
        running, terms = RunningSum(), []
        for _ in range(400):
            terms.append(draw.uniform(-1.0, 1.0) * 10.0 ** draw.randint(-12, 12))
            if draw.random() < 0.3:
                terms.append(-terms[draw.randrange(len(terms))])
        found = [add(running, term) for term in terms][-1]
        exact = math.fsum(terms)
        assert found == running.value
        assert math.isclose(found, exact, rel_tol=1e-12, abs_tol=1e-15)


def test_a_new_sum_is_zero_and_the_balance_at_rest_holds_nothing() -> None:
    assert (RunningSum().total, RunningSum().error, RunningSum().value) == (0.0, 0.0, 0.0)
    assert tuple(AT_REST) == (0.0,) * 16


def test_the_numbers_of_certificates_and_of_active_ports_in_old_logs_keep_their_meaning() -> None:
    assert {one.name: one.value for one in Certificate} == {
        "EXACT": 0,
        "DEVICE_DAMPING": 1,
        "HAND_FORCE": 2,
        "HAND_SPEED": 3,
        "NONE": 4,
        "VELOCITY_LOOP": 5,
        "LARGEST_HAND_FORCE": 6,
        "DEVICE_FRICTION": 7,
        "DECLARED_HAND": 8,
    }
    assert (ACTIVE_AT_MOTOR, ACTIVE_AT_HANDLE) == (1, 2)


def test_a_dry_run_claims_neither_torque_nor_mass_and_needs_neither_in_its_account() -> None:
    full: PortResult = {
        "mass": {"felt": 1.0},
        "contact": {"holds": 3, "without_torque": 0, "sent": 2.0},
    }
    claim_nothing(full)
    assert "mass" not in full
    assert full["contact"] == {"holds": 3, "without_torque": 3, "sent": 0.0}
    bare: PortResult = {"contact": {"holds": 3, "without_torque": 0}}
    claim_nothing(bare)
    assert bare["contact"] == {"holds": 3, "without_torque": 3}


def test_a_plant_may_give_out_no_energy_where_no_allowance_is_declared() -> None:
    account: PortResult = {"certificate": "none", "least_interaction": 0.0, "energy_resolution": 0.0, "in": 1.0}
    add_verdicts(account, (-1e-3, 0.0))
    assert account["plant_passive"] == "no"
    assert "plant_passive_at_handle" not in account
    account = {**account, "least_at_handle": 0.0}
    add_verdicts(account, (0.0, -1e-3))
    assert (account["plant_passive"], account["plant_passive_at_handle"]) == ("yes", "no")


def test_a_state_before_its_first_hold_has_lost_no_sample_and_holds_no_energy() -> None:
    for kind, names in (
        (TorqueBound, ("dissipated",)),
        (Axis, ("missed",)),
        (GroupMotion, ("elapsed",)),
        (ScaledState, ("h_s", "blind")),
    ):
        defaults = {field.name: field.default for field in fields(kind)}
        assert [defaults[name] for name in names] == [0] * len(names)
