"""In scenes whose declarations are true, the account never claims what the simulated plant denies.

`make bench Q=truth` runs thousands of such scenes and makes one with a false claim smaller (`--only SEED`).
"""

import copy
import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from canhaptic.control.environments import ENVIRONMENTS
from canhaptic.control.passivity import ALGORITHMS
from canhaptic.control.passivity.guarded import GuardedParameters
from canhaptic.cycle import run
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import LOOP_KEYS
from canhaptic.sim.plant.effects import EFFECTS
from tools.bench.truth import (
    _sum_figures,
    false_table,
    fault_table,
    is_false,
    miss_table,
    outcome_of,
    outcome_of_sum,
    outcome_with_fault,
    outcome_with_stop,
    run_all,
    table_of,
)
from tools.truth.falsehoods import falsified, outcome_of_falsehood
from tools.truth.faults import FURTHER, with_fault
from tools.truth.judge import TOUCH, Outcome, _false_claims, account_of, judged
from tools.truth.known_ways import WAYS, is_closed, row_of
from tools.truth.scenes import TruthScene, random_scene
from tools.truth.stops import claims_after, left_after
from tools.truth.ways import differences

DEMO = Path(__file__).resolve().parents[2] / "configs" / "demo.yaml"
SCENES = 150
QUICK = 5
"""Scenes of `make test`; `make test-all` runs all of them."""
KNOWN: dict[str, str] = {}
"""Named by a scene with a false claim, and why. Each is needed: what is mended must go from here."""

_KINDS = ("effect", "environment", "algorithm")

MENDED = {
    204061: "lost positions of a group",
    205488: "the same, drives with a limit of their own",
    206597: "lost positions, torques booked at their worst",
    208872: "lost positions of a hand without a bound",
    203884: "energy_bounding with SYNCs that come late",
    700198: "a lost TPDO that showed the torque of the next hold",
}


@pytest.mark.slow_but("700198", "206597", "203884")
@pytest.mark.parametrize("seed", MENDED)
def test_what_was_mended_stays_mended(seed: int) -> None:
    _, outcome = judged(random_scene(seed, further=False))
    assert outcome.declared
    assert outcome.false_claims == ()


MENDED_FURTHER = {
    3000810: "lost RPDOs where nothing is read back",
    7002760: "energy_bounding with steps of torque as large as its torques",
    3001843: "the sum at the handle of a group whose wall a mover moves",
    9001984: "an estimate, 0.2 % too small where an unprotected medium buzzes",
    4000216: "a push against late torques, which the judge did not count: hand_push was declared too small",
    2098: "a measured torque, which is rounded, at a moment before the resolution has grown",
}


@pytest.mark.slow_but("3000810")
@pytest.mark.parametrize("seed", MENDED_FURTHER)
def test_what_was_mended_of_further_scenes_stays_mended(seed: int) -> None:
    outcome = outcome_of(seed)
    assert outcome.declared
    assert outcome.false_claims == ()


def test_where_torques_come_late_a_push_against_them_has_to_be_declared_too() -> None:
    scene = random_scene(4000216)  # 19 N towards a wall, through its drag
    raised, outcome = judged(replace(scene, duration=0.04))
    assert outcome.false_claims == ()
    assert scene.passivity["hand_push"] < 19.0 < raised.passivity["hand_push"]


def test_no_verdict_may_rest_on_a_resolution_that_is_an_estimate() -> None:
    port = {"energy_resolution": 1.0, "passive": "in doubt", "certificates": [], "resolution_is_estimated": True}
    truth = {"accounted_error": 1.05, "least_interaction": 0.0, "least_at_handle": 0.0}
    assert _false_claims("handle", port, truth, {}) == []
    [claim] = _false_claims("handle", {**port, "passive": "yes"}, truth, {})
    assert "an estimate" in claim
    [claim] = _false_claims("handle", {**port, "passive_at_handle": "yes"}, truth, {})
    assert "an estimate" in claim
    assert _false_claims("handle", port, {**truth, "accounted_error": 1.15}, {})
    assert _false_claims("handle", {**port, "resolution_is_estimated": False}, truth, {})


@pytest.mark.slow
def test_a_wall_that_moves_by_itself_counts_at_the_handle_too():
    _, outcome = judged(random_scene(3001843))
    assert outcome.at_handle == "in doubt"  # without a certificate, and -2 mJ at the motors
    assert outcome.lost < 0.02  # of the motors alone 22 mJ


@pytest.mark.slow
def test_where_friction_alone_is_declared_late_torques_leave_energy_open():
    outcome = outcome_of(1000771)
    assert outcome.error > 1e-5
    assert outcome.certificates == ("device_friction",)
    assert outcome.false_claims == ()


@pytest.mark.slow_but("event")
@pytest.mark.parametrize("rpdo", ["event", "synchronous"])
def test_where_friction_alone_is_declared_lost_positions_leave_energy_open(rpdo):
    overrides = [
        "simulation.effects=[{type: coulomb_friction, static: 1.0, kinetic: 1.0}]",
        "simulation.bus={drop: 0.05, direction: to_master, ids: [0x181]}",
        "passivity={algorithm: guarded, hand_force: null, device_friction: 1.0, max_consecutive_losses: 3}",
        f"bus.rpdo={rpdo}",
        "environment.side=above",
    ]
    with build(load_scene(DEMO, overrides)) as experiment:
        run(experiment.cycle, cycles=800)
        resolution = experiment.cycle.meters.ports[0].measured().energy_resolution
        assert experiment.cycle.judge.believed_error[0] < resolution < 0.1
        assert experiment.cycle.judge.believed_error[0] > 1e-7


@pytest.mark.slow
def test_a_hold_ended_by_a_late_sync_dissipates_for_its_own_length():
    assert judged(with_fault(random_scene(400828, further=False)))[1].false_claims == ()


@pytest.mark.parametrize("seed", [684, pytest.param(1245, marks=pytest.mark.slow)])
def test_a_winding_at_its_supply_leaves_no_false_claim(seed):
    """Both claimed joules that were not there before the account knew of the supply."""
    scene = random_scene(seed)
    assert "effect:voltage_limit" in scene.tags
    assert judged(scene)[1].false_claims == ()


def _outcomes(scenes: int) -> list[Outcome]:
    return [outcome_of(seed) for seed in range(scenes)]


class TestNoFalseClaim:
    @pytest.mark.timeout(400)  # 12 s of an idle processor for all
    @pytest.mark.parametrize(
        "scenes", [QUICK, pytest.param(50, marks=pytest.mark.slow), pytest.param(SCENES, marks=pytest.mark.campaign)]
    )
    def test_only_where_it_is_known(self, scenes):
        outcomes = _outcomes(scenes)
        wrong = [outcome for outcome in outcomes if is_false(outcome)]
        unknown = {o.seed: o.false_claims for o in wrong if not KNOWN.keys() & set(o.tags)}
        assert unknown == {}
        alone = [KNOWN.keys() & set(outcome.tags) for outcome in wrong]
        needless = [tag for tag in KNOWN if {tag} not in alone]
        assert needless == [], "mended: take it out of KNOWN"
        counted = [outcome for outcome in outcomes if outcome.counts]
        assert len(counted) > 0.75 * scenes  # a run without torque proves nothing and is not counted
        assert table_of(outcomes)[0]["runs"] == len(counted)


CHANGES = {"pose": 1, "changes:grasp": 3, "changes:winding": 3, "changes:wall": 1}
"""What changes in a run, or where it starts; and how many scenes of each `make test` runs."""


def _changing(kind: str, count: int) -> list[TruthScene]:
    scenes = (random_scene(seed, changes=1.0) for seed in range(4000))
    return list(itertools.islice((s for s in scenes if any(tag.startswith(kind) for tag in s.tags)), count))


@pytest.mark.slow_but("changes:wall-1")
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "times", [1, pytest.param(5, marks=pytest.mark.slow), pytest.param(20, marks=pytest.mark.campaign)]
)
@pytest.mark.parametrize("kind", CHANGES)
def test_what_changes_in_a_run_leaves_no_false_claim(kind: str, times: int) -> None:
    outcomes = [judged(scene)[1] for scene in _changing(kind, times * CHANGES[kind])]
    assert {o.seed: o.false_claims for o in outcomes if is_false(o)} == {}
    assert any(outcome.peak > 0.0 for outcome in outcomes) or times == 1


@pytest.mark.slow
def test_a_winding_that_gets_hot_gives_less_torque_within_its_run() -> None:
    lost = 0
    for scene in _changing("changes:winding", 20):
        cold = copy.deepcopy(scene)
        effects = cold.values["simulation"]["effects"]
        effects[:] = [effect for effect in effects if effect["type"] != "thermal_derating"]
        lost += judged(cold)[1].least != judged(scene)[1].least
    assert lost >= 2


@pytest.mark.slow
def test_five_bars_start_in_every_pose_and_near_singular_ones() -> None:
    scenes = _changing("pose", 25)
    linkages = [scene.values["simulation"]["mechanisms"][0] for scene in scenes]
    angles = np.array([linkage["initial_angles"] for linkage in linkages])
    assert {tuple(signs) for signs in np.sign(np.sin(angles)).astype(int)} == {(1, 1), (1, -1), (-1, 1), (-1, -1)}
    assert sum("pose:near_singular" in scene.tags for scene in scenes) >= 4


@pytest.mark.slow
def test_scenes_name_every_effect_environment_limit_algorithm_and_declaration():
    named, keys = set(), set()
    for seed in range(1200):
        scene = random_scene(seed)
        named |= scene.tags
        keys |= scene.passivity.keys() if scene.promises else set()
        keys |= scene.values["axes"][0].keys()
    of = {kind: {tag.partition(":")[2] for tag in named if tag.startswith(f"{kind}:")} for kind in _KINDS}
    assert of["effect"] == set(EFFECTS)
    assert of["environment"] == set(ENVIRONMENTS) - {"free_space"}  # nothing is touched there
    assert of["algorithm"] == {*ALGORITHMS, "step_scaling"}
    assert {tag for tag in named if tag.startswith("sum:")} == {"sum:2", "sum:3", "sum:4", "sum:networks"}
    from_the_scene = {"sync_jitter", "torque_window", "current_lag", "delay", "sample_time"}
    assert keys >= GuardedParameters.model_fields.keys() | set(LOOP_KEYS) - from_the_scene
    assert keys >= {"torque_limit", "torque_rate_limit", "power_limit", "read_back", "demand_reported", "direction"}


@pytest.mark.slow
@pytest.mark.parametrize("scenes", [40, pytest.param(150, marks=pytest.mark.campaign)])
def test_an_account_of_a_sum_claims_nothing_that_the_plant_denies(scenes: int) -> None:
    outcomes = [outcome_of_sum(seed) for seed in range(scenes)]
    assert {o.seed: o.false_claims for o in outcomes if is_false(o)} == {}
    sums = [outcome for outcome in outcomes if any(tag.startswith("sum:") for tag in outcome.tags)]
    assert len(sums) > 0.6 * scenes
    assert sum(outcome.peak > TOUCH for outcome in sums) > 0.4 * len(sums)


def test_faults_of_bus_drive_and_host_leave_no_false_claim_either():
    outcomes = [outcome_with_fault(seed) for seed in range(7)]
    assert {o.seed: o.false_claims for o in outcomes if is_false(o)} == {}
    assert not any(outcome.went_on for outcome in outcomes)
    rows = fault_table(outcomes)
    assert sum(row["runs"] for row in rows) == len(outcomes)
    assert sum(outcome.status == "stopped" for outcome in outcomes) > 1


@pytest.mark.slow
def test_losses_that_a_bus_makes_are_declared_and_a_yes_is_due_then():
    scenes = [with_fault(random_scene(seed, further=False)) for seed in (5863, 5718)]  # any frame lost; RPDOs lost
    outcomes = [judged(scene)[1] for scene in scenes]
    assert all(0 < outcome.losses == outcome.declared_losses for outcome in outcomes)
    assert all(outcome.is_due and outcome.says_yes for outcome in outcomes)
    coarse = judged(with_fault(random_scene(5342, further=False)))[1]  # the resolution is three times what came in
    assert coarse.open_share > 2.0
    assert (coarse.verdict, coarse.is_due) == ("in doubt", False)
    beyond = Outcome(**{**outcomes[0].as_json(), "declared_losses": outcomes[0].losses - 1})
    assert not beyond.is_due


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("way", WAYS, ids=lambda way: f"{way.name}: {way.what}")
def test_a_known_way_out_is_closed_where_it_is_declared_or_follows_from_the_scene(way):
    row = row_of(way, 10)
    assert is_closed(row)
    assert row["yes"] == row["of"]


def test_a_late_sync_that_is_declared_falsely_gives_energy_out_and_is_noticed():
    [way] = [way for way in WAYS if "0.49 T late" in way.what]
    row = row_of(way, 2)
    assert is_closed(row)
    assert not is_closed({**row, "declared [J]": -1e-8})
    assert not is_closed({**row, "false claims": 1})
    assert row["noticed"] == row["gave out"]


def test_the_table_of_false_declarations_counts_what_a_run_notices():
    one = replace(outcome_of(0), tags=("false:moving_mass",), status="completed", peak=1.0, least=-1e-3, at_handle="")
    unseen = replace(one, verdict="yes", certificates=("hand_force",), false_claims=("passive yes",))
    seen, stopped = replace(one, verdict="no"), replace(unseen, status="stopped")
    harmless, refused = replace(unseen, least=0.0, false_claims=()), replace(unseen, status="refused")
    [row] = false_table([unseen, seen, stopped, harmless, refused])
    assert list(row.values()) == ["moving_mass", 4, 1, 2, 3, 2]


def test_a_campaign_of_sums_counts_the_runs_of_a_sum_that_had_a_torque():
    one = Outcome(1, ("sum:2",), "completed", "yes", "", (), 0.0, 0.0, 0.0, 1.0, 1.0, True, (), "")
    others = [replace(one, peak=0.0), replace(one, tags=()), replace(one, false_claims=("x",)), replace(one, asked=0.0)]
    assert [row.value for row in _sum_figures([one, *others])] == [4, 3, 1, 0]


@pytest.mark.slow
def test_a_campaign_goes_on_where_it_was_stopped(tmp_path):
    first, second = replace(outcome_of(0), seed=1), replace(outcome_of(0), seed=2)
    lines = [json.dumps((one.seed, one.as_json())) for one in (first, second)]
    kept = tmp_path / "truth_runs.jsonl"
    kept.write_text(f"{lines[0]}\n{lines[1][:50]}{lines[1]}\n{lines[1]}\n", encoding="utf-8")
    assert run_all([1, 2], kept, 1) == [first, second]


@pytest.mark.slow_but("syncs_late=1-declared1-*", "acts_at_once*")
@pytest.mark.parametrize(
    ("drive", "declared", "is_booked"),
    [
        ("syncs_late=1", ["axes.0.quirks=[acts_a_sync_late]"], True),
        ("syncs_late=1", ["axes.0.quirks=[acts_a_sync_late]", "axes.0.read_back=none"], True),
        ("syncs_late=1", ["axes.0.read_back=none"], False),
        ("acts_at_once=true", ["axes.0.demand_reported=after"], False),
    ],
)
def test_a_torque_in_another_hold_is_booked_right_where_it_is_declared_and_wrong_where_not(
    drive: str, declared: list[str], *, is_booked: bool
) -> None:
    wall = ["environment.stiffness=20 kN/m", "environment.damping=0", "simulation.user.motion.frequency=1.5"]
    with build(load_scene(DEMO, [*wall, f"simulation.drive.{drive}", *declared])) as experiment:
        run(experiment.cycle, 600)
        judge = experiment.cycle.judge
    assert judge is not None
    error = judge.believed_error[0]
    assert error < 5e-5 if is_booked else error > 1e-2


@pytest.mark.slow_for("30039")
@pytest.mark.parametrize("seed", [30039, 30243])  # detents, and a slot whose hand pushes harder than was guessed
def test_where_an_environment_turns_a_hand_keeps_its_words_by_where_the_handle_is(seed):
    drawn = random_scene(seed)
    scene, outcome = judged(drawn)
    assert outcome.declared
    assert outcome.false_claims == ()
    assert outcome.says_yes
    assert outcome.peak > 3.0
    assert scene.passivity["hand_push"] > (1.2 if seed == 30243 else 0.99) * drawn.passivity["hand_push"]


@pytest.mark.slow_but("20001955")
@pytest.mark.parametrize("seed", [20001955, 20003446])
def test_a_program_whose_torque_turns_is_held_by_the_push_of_the_hand_both_ways(seed):
    """With the force along the torque alone these gave out 11 and 2 mJ under a certificate."""
    assert outcome_of(seed).false_claims == ()


def test_damping_of_the_device_alone_bounds_no_motion_inside_a_hold():
    """The sum at the motor was wrong by 0.30 uJ where 0.24 uJ were stated, after 4 holds of a torque that turned."""
    outcome = outcome_of(41061106)
    assert outcome.peak > 0.0
    assert outcome.false_claims == ()


@pytest.mark.parametrize("seed", [114, 7, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(500, 530))])
def test_stopped_at_any_instant_the_account_is_true_to_the_very_end(seed: int) -> None:
    outcome = outcome_with_stop(seed)
    assert not outcome.declared or outcome.false_claims == ()


@pytest.mark.parametrize("seed", [26, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (20, 57, 76, 160))])
def test_a_second_sender_and_a_torque_that_was_not_commanded_leave_no_false_claim(seed: int) -> None:
    outcome = outcome_with_fault(seed)
    assert any(f"fault:{name}" in outcome.tags for name in FURTHER)
    assert outcome.status == "stopped"
    assert outcome.false_claims == ()
    assert outcome.given_after < 1.0


def test_what_a_motor_gives_after_the_account_of_an_operators_stop_is_a_claim() -> None:
    """A control: a display and an axis, each with energy that no account holds."""
    for name in ("demo", "admittance/virtual_mass"):
        with build(load_scene(DEMO.parent / f"{name}.yaml"), "free") as experiment:
            run(experiment.cycle, 30)
            account = account_of(experiment.cycle, "stopped")
            left = left_after(experiment, account)
            assert claims_after(experiment, account, left) == []
            given = {axis: energy - 100.0 for axis, energy in left.items()}
            assert len(claims_after(experiment, account, given)) == 1


class TestFalseDeclarations:
    @pytest.mark.slow
    def test_a_yes_that_the_plant_denies_is_a_miss_and_a_doubt_or_a_stop_is_found(self):
        empty = outcome_of_falsehood(8)  # a display
        assert empty.tags == ("admittance", "algorithm:guarded", "false:commands")
        denied = replace(empty, tags=("false:hold",), status="completed", verdict="yes", certificates=("exact",))
        denied = replace(denied, false_claims=("handle: error",))
        doubted, stopped = replace(denied, verdict="in doubt"), replace(denied, status="stopped")
        fine = replace(denied, false_claims=(), least=0.0)
        [row] = miss_table([denied, doubted, stopped, fine])
        assert (row["runs"], row["mattered"], row["found"], row["missed"]) == (4, 3, 2, 1)
        assert row["share"] == 0.333

    @pytest.mark.slow
    def test_command_line_simulate_and_cycle_say_the_same_of_a_false_hold(self):
        scene = falsified(4)
        _, outcome = judged(scene)
        assert "false:hold" in outcome.tags
        assert differences(scene, outcome) == []
        assert len(differences(scene, replace(outcome, verdict="another"))) == 2

    @pytest.mark.slow
    def test_a_program_in_open_rig_has_the_account_of_the_cycle_to_the_last_bit(self):
        scene, outcome = judged(random_scene(258))
        assert any(tag.startswith("program:") for tag in outcome.tags)
        assert outcome.status == "completed"
        assert differences(scene, outcome) == []
        assert len(differences(scene, replace(outcome, least=outcome.least - 1e-15))) == 1

    @pytest.mark.slow
    def test_no_false_hold_is_missed(self):
        outcomes = [judged(scene)[1] for scene in map(falsified, range(40)) if "false:hold" in scene.tags]
        [row] = miss_table(outcomes)
        assert row["missed"] == 0
        assert row["mattered"] >= 2
