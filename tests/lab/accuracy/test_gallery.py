"""The five scenes: the committed gallery is what is measured, and its advice is right.

Counts of evaluations and events are golden, errors to a part of themselves; times are no business of a test.
"""

import json
from functools import cache

import pytest

from canhaptic.audit.recompute import RELEASES, earlier_hash
from canhaptic.lab.judge.reference_model import difference
from canhaptic.lab.judge.solvers import located
from canhaptic.lab.reference import textbook_model
from canhaptic.lab.studies.accuracy.accuracy_table import advice, line, markdown, meets
from canhaptic.lab.studies.accuracy.loop_sensitivity import holds_of
from canhaptic.lab.studies.accuracy.plant_solvers import FLOOR, OURS, PlantSide, ladder
from canhaptic.lab.studies.accuracy.study import choose
from canhaptic.scene.far_side import build_plant
from canhaptic.scene.load import load_scene
from canhaptic.scene.method import simulation_of, torque_history
from canhaptic.sim.plant import AccuracyParameters
from canhaptic.sim.plant.direct_rig import observed
from tests.lab.accuracy.accuracy_scenes import FOLDER, REPOSITORY, SCENES
from tools.accuracy_gallery import redraw

DEAR = 6.0  # evaluations a period: such rungs are measured anew by the slow tests only
TOLERANCES = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)


@cache
def committed(name):
    return json.loads((REPOSITORY / "docs" / "accuracy" / f"{name}.json").read_text(encoding="utf-8"))


def ours_of(result):
    return [row for row in result["plant"] if row["method"] == OURS]


@cache
def measured(name, everything=False):
    """Returns the ladder of a scene measured anew; only our own cheap rungs unless everything is asked for."""
    scene = load_scene(FOLDER / f"{name}.yaml")
    side = PlantSide(scene.axes[0], scene, holds_of(scene), lambda: False)
    if not everything:
        price = {(row["method"], row["setting"]): row["evaluations_per_period"] for row in ours_of(committed(name))}
        side.candidates = [c for c in side.candidates if price.get((c.method, c.setting), DEAR) < DEAR]
    for _ in side.measure():
        pass
    return side


def check_rows(rows, golden, floor):
    by_name = {(row["method"], row["setting"]): row for row in golden}
    for row in rows:
        before = by_name[row["method"], row["setting"]]
        assert row["status"] == before["status"]
        if row["status"] != "ok":
            continue
        # Where a force is found by trial or a step chosen by an error, the last bits of a machine may cost a trial.
        assert row["evaluations"] == pytest.approx(before["evaluations"], rel=0.02)
        assert row["events"] == before["events"]
        for error in ("position_error", "force_error", "energy_error"):
            least = floor if error == "position_error" else 1e-8
            assert row[error] == pytest.approx(before[error], rel=0.3, abs=max(least, 1e-12)), (row["setting"], error)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_the_committed_gallery_is_what_our_plant_does(name):
    side, golden = measured(name), committed(name)
    scene = load_scene(FOLDER / f"{name}.yaml")
    assert golden["config_hash"] in [scene.config_hash(), *(earlier_hash(scene, of) for of in RELEASES)]
    assert golden["status"] == "completed"
    assert len(side.rows) >= 1
    check_rows(side.rows, ours_of(golden), 10.0 * FLOOR * side.travel)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_the_committed_gallery_is_what_every_method_does(name):
    side = measured(name, everything=True)
    assert len(side.rows) == len(committed(name)["plant"])
    check_rows(side.rows, committed(name)["plant"], 10.0 * FLOOR * side.travel)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_no_setting_of_the_ladder_is_cheaper_than_the_advised_one_and_keeps_the_tolerance(name):
    everything, anew = committed(name)["plant"], {row["setting"]: row for row in measured(name).rows}
    rows = [anew.get(row["setting"], row) for row in ours_of(committed(name))]
    met = 0
    for tolerance in (*TOLERANCES, committed(name)["tolerance"]):
        good = [row for row in rows if row["status"] == "ok" and row["position_error"] <= tolerance]
        sure = advice(rows, [], tolerance)["chosen"]
        if sure is not None:
            met += 1
            assert sure in good
            finer = [row for row in rows if all(row["accuracy"][k] >= v for k, v in sure["accuracy"].items())]
            assert all(row in good for row in finer)
            for row in good:  # what is cheaper yet has a finer setting that fails
                if row["evaluations"] < sure["evaluations"]:
                    own = row["accuracy"].items()
                    assert any(r not in good for r in rows if all(r["accuracy"][k] >= v for k, v in own))
        whole = advice(everything, [], tolerance)
        elsewhere = {(row["method"], row["setting"]) for row in whole["cheaper_elsewhere"]}
        for row in everything:
            is_cheaper = whole["chosen"] is not None and row["method"] != OURS and meets(row, tolerance)
            is_cheaper = is_cheaper and row["evaluations"] < whole["chosen"]["evaluations"]
            assert ((row["method"], row["setting"]) in elsewhere) == is_cheaper
    assert met >= 2  # the ladder reaches at least two of the tolerances, or nothing was tested


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_the_advised_line_keeps_the_tolerance_when_it_is_pasted_into_the_scene(name):
    golden = committed(name)
    text = golden["advice"]["line"]
    scene = load_scene(FOLDER / f"{name}.yaml", [text.replace(": ", "=", 1)])
    simulation = simulation_of(scene.axes[0])
    assert line(simulation.accuracy.model_dump(include={"event_bits", "substeps"})) == text
    count, period = min(holds_of(scene), 150), scene.bus.sample_time_ns
    torques = torque_history(scene.axes[0], scene, count)
    witness = located(textbook_model(simulation), torques, period, "LSODA", 1e-9, 1e-12)
    found = difference(observed(build_plant(simulation, period), torques), witness, 1.0, period * 1e-9)
    assert found.position <= golden["tolerance"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["paper_wall", "delayed_bus", "stick_slip"])
def test_auto_chooses_what_the_study_advises(name):
    golden = committed(name)
    scene = load_scene(FOLDER / f"{name}.yaml")
    choice = choose(scene.axes[0], scene, golden["tolerance"])
    assert line(choice["accuracy"]) == golden["advice"]["line"]
    assert choice["evaluations"] == pytest.approx(golden["advice"]["chosen"]["evaluations"], rel=0.02)


@pytest.mark.parametrize("name", SCENES)
def test_the_committed_gallery_shows_everything_that_was_asked(name):
    golden = committed(name)
    methods = {row["method"] for row in golden["plant"]}
    assert {OURS, "semi-implicit Euler", "implicit midpoint", "RK4", "LSODA, located"} <= methods
    groups = {row["group"] for row in golden["loop"]}
    assert {"as it is", "sample rate", "RPDO", "algorithm", "torque step", "encoder count"} <= groups
    effects = {effect.name for effect in simulation_of(load_scene(FOLDER / f"{name}.yaml").axes[0]).effects}
    assert {row["effect"] for row in golden["advice"]["effects"]} == effects
    assert golden["reference"]["witness"]["apart"] < 1e-8
    stable = [row for row in golden["plant"] if row["status"] == "ok"]
    assert all(row["us_per_period"] > 0.0 and row["ratio"] > 0.0 for row in stable)
    assert (REPOSITORY / "docs" / "accuracy" / f"{name}.png").stat().st_size > 2000


def test_the_ladder_of_auto_and_of_the_study_are_one():
    scene = load_scene(FOLDER / "stiff_stop.yaml")
    rungs = {row["accuracy"]["event_bits"] for row in committed("stiff_stop")["plant"] if row["method"] == OURS}
    of_auto = ladder(simulation_of(scene.axes[0]), scene.bus.sample_time_ns)
    assert rungs == {setting.event_bits for setting in of_auto} == {4, 8, 12, 16, 20, 24}
    assert AccuracyParameters().event_bits in rungs
    assert holds_of(scene) == committed("stiff_stop")["holds"]


def of_an_earlier_release(name):
    """Returns a study that does not tell which engine ran its loops, as those before 0.2."""
    loop = [{key: value for key, value in row.items() if key != "engine"} for row in committed(name)["loop"]]
    return committed(name) | {"loop": loop}


@pytest.mark.parametrize("name", SCENES)
def test_tables_of_an_earlier_release_leave_out_what_it_does_not_tell(name):
    text = markdown(of_an_earlier_release(name))
    assert committed(name)["advice"]["line"] in text
    assert "the loops ran in" not in text


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_a_study_of_an_earlier_release_is_drawn_again_from_what_it_measured(name, tmp_path):
    (tmp_path / f"{name}.json").write_text(json.dumps(of_an_earlier_release(name)), encoding="utf-8")
    redraw(name, tmp_path)
    again = json.loads((tmp_path / f"{name}.json").read_text(encoding="utf-8"))
    assert again["advice"]["line"] == committed(name)["advice"]["line"]
    assert (tmp_path / f"{name}.png").stat().st_size > 2000
