"""A designed wall is rendered as promised, judged by a run of its own; what cannot be designed is said."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
import yaml

from canhaptic.errors import CheckFailedError, InputError
from canhaptic.lab.batch.scalar import run_scalar
from canhaptic.lab.commands.design import _replaced, snippet
from canhaptic.lab.studies.compare import compare
from canhaptic.lab.studies.design import search
from canhaptic.lab.studies.design.contact_quality import felt_of
from canhaptic.lab.studies.design.search import _rounded, design
from canhaptic.lab.studies.design.trial import Trial
from canhaptic.scene.load import load_scene

DEMO = str(Path(__file__).resolve().parents[3] / "configs" / "demo.yaml")
RIG = [
    "bus.rate=100",
    "simulation.plant.damping=1",
    "passivity={algorithm: guarded, moving_mass: 0.2, device_damping: 0.9, device_damping_bound: 0.9}",
]


@pytest.fixture(scope="module", params=["python", pytest.param("numba", marks=pytest.mark.slow)])
def engine(request):
    """Trials: Python tries fewer walls, numba compiles for 20 s of a processor."""
    if request.param == "numba":
        pytest.importorskip("numba")
    return request.param


@pytest.fixture(scope="module")
def progress():
    """(walls tried, most there can be), as a progress bar shows them."""
    return []


@pytest.fixture(scope="module")
def designed(engine, progress):
    progress.clear()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(search, "_ONE_BY_ONE", search._Places((8, 5), (4, 3), 3))  # a third of them
        return design(load_scene(DEMO, RIG), engine=engine, progress=lambda *seen: progress.append(seen))


@pytest.mark.slow
def test_a_progress_bar_rises_and_never_passes_its_end(designed, progress):
    tried, most = zip(*progress, strict=True)
    assert list(tried) == sorted(set(tried))
    assert tried[0] == 0  # shown before the first batch, which takes seconds
    assert len(set(most)) == 1
    assert 0.5 * most[0] < designed["walls"] <= most[0]


@pytest.mark.slow
def test_the_wall_and_one_that_is_larger_by_the_margin_are_rendered_within_the_tolerance(designed):
    assert designed["stiffness"] > 100.0
    pasted = yaml.safe_load(snippet(designed))
    for factor in (1.0, 1.2):
        stiffness, damping = factor * designed["stiffness"], factor * designed["damping"]
        scene = load_scene(
            DEMO,
            [
                *RIG,
                f"environment={{type: spring_damper_wall, stiffness: {stiffness!r}, damping: {damping!r}}}",
                "simulation.user={damping: 5, push: -5}",
                "simulation.plant.initial_position=0.002",
            ],
        )
        [run] = compare(scene, ["guarded"], duration=4.0, repeats=0).result["rows"]
        assert run["stiffness_at_rest.share"] == pytest.approx(1.0, abs=0.05)
        assert run["status"] == "completed"
    assert pasted["environment"]["stiffness"] == f"{designed['stiffness']:g} N/m"
    assert pasted["passivity"]["algorithm"] == "guarded"


@pytest.mark.slow
def test_a_wall_well_beyond_the_margin_is_not_rendered(designed, engine):
    trial = Trial(load_scene(DEMO, RIG), 0.05, engine)
    verdict = trial.verdict(
        np.array([designed["stiffness"], 1.3 * designed["stiffness"], 20.0 * designed["stiffness"]]), np.zeros(3)
    )
    assert verdict.passed.tolist()[0]
    assert (verdict.least_judged >= verdict.least_interaction).all()  # declared damping covers what the port gave out
    assert verdict.least_judged[0] >= -1e-6
    assert not verdict.passed.tolist()[2]


@pytest.mark.parametrize("engine", [pytest.param("numba", marks=pytest.mark.slow)], indirect=True, scope="module")
def test_the_search_ends_where_a_fine_grid_of_walls_does(designed):
    trial = Trial(load_scene(DEMO, RIG), 0.05, "numba")
    places = np.linspace(0.8, 1.2, 201) * designed["stiffness"]
    verdict = trial.verdict(1.2 * places, np.zeros(len(places)))
    first = int(np.argmin(verdict.nearly))
    assert first > 0
    assert designed["stiffness"] == pytest.approx(places[:first][verdict.passed[:first]].max(), rel=0.006)
    assert designed["trade"][-1]["damping"] > 0.0
    for stiffness, damping in (row.values() for row in designed["trade"]):
        dampings = np.linspace(0.0, 1.3, 131) * damping if damping else np.geomspace(1e-3, 1.0, 131)
        below = 1.2 * stiffness * np.array([0.2, 0.4, 0.6, 0.8, 1.0])
        grid = trial.verdict(*(wall.ravel() for wall in np.broadcast_arrays(below, 1.2 * dampings[:, None])))
        passed, nearly = (found.reshape(131, 5).all(axis=1) for found in (grid.passed, grid.nearly))
        first = int(np.argmin(nearly))
        assert damping == pytest.approx(dampings[:first][passed[:first]].max(initial=0.0), rel=0.03)


@pytest.mark.slow
def test_both_hands_in_one_batch_are_each_hand_in_a_scene_of_its_own(engine):
    trial = Trial(load_scene(DEMO, RIG), 0.05, engine)
    verdict = trial.verdict(np.array([300.0, 600.0]), np.array([2.0, 0.0]))
    motion = "{type: sinusoid, amplitude: 0.16666666666666666, frequency: 1, phase: 1.5707963267948966}"
    for row, (stiffness, damping) in enumerate([(300.0, 2.0), (600.0, 0.0)]):
        shares, least = [], []
        hands = {
            "stiffness_at_end.share": "{damping: 5, push: -5}",
            "stiffness_rendered.share": f"{{stiffness: 60, damping: 5, motion: {motion}}}",
        }
        for share, user in hands.items():
            wall = f"environment={{type: spring_damper_wall, stiffness: {stiffness}, damping: {damping}}}"
            start = "simulation.plant.initial_position=0.002"
            scene = load_scene(DEMO, [*RIG, wall, start, f"simulation.user={user}"])
            found = run_scalar(scene, 300, [share, "least_covered"])
            shares.append(found[share])
            least.append(found["least_covered"])
        assert verdict.stiffness_share[row] == pytest.approx(max(shares, key=lambda share: abs(share - 1.0)), rel=1e-9)
        assert verdict.least_judged[row] == pytest.approx(min(least), abs=1e-12)


@pytest.mark.slow
def test_a_wall_on_a_plant_with_friction_is_tried_in_the_loop_of_a_batch_and_in_fewer_places_interpreted():
    scene = load_scene(DEMO, [*RIG, "simulation.effects=[{type: coulomb_friction, kinetic: 0.1 N, static: 0.1 N}]"])
    if importlib.util.find_spec("numba"):
        assert Trial(scene, 0.05, "numba").is_quick
    trial = Trial(scene, 0.05, "python")
    assert not trial.is_quick
    verdict = trial.verdict(np.array([200.0]), np.zeros(1))
    assert trial.engine == "python"
    assert 0.5 < verdict.stiffness_share[0] < 1.0
    assert search._ONE_BY_ONE.most < 300


@pytest.mark.slow
def test_the_lines_can_be_pasted_into_the_scene(designed):
    pasted = yaml.safe_load(snippet(designed))
    lines = [
        f"{key}={yaml.safe_dump(value, default_flow_style=True, width=1000).strip()}" for key, value in pasted.items()
    ]
    scene = load_scene(DEMO, ["bus.rate=100", *lines])
    assert scene.axes[0].environment.parameters.stiffness == designed["stiffness"]  # type: ignore[attr-defined]


def test_a_wall_that_stands_in_place_of_detents_is_said_to():
    assert "replaces environment.type: detents of the scene" in str(_replaced({"replaces": "detents"})[0])
    assert _replaced({"replaces": "spring_damper_wall"}) == _replaced({}) == []


def test_what_cannot_be_designed_is_said():
    with pytest.raises(InputError, match="expected 0 <= margin"):
        design(load_scene(DEMO), margin=-1.0)
    bare = load_scene(DEMO, ["simulation=null", "bus.channel=x", "passivity={algorithm: unprotected}"])
    with pytest.raises(InputError, match="moving_mass"):
        design(bare)


@pytest.mark.slow
def test_a_rig_that_renders_no_wall_is_told_what_to_change():
    with pytest.raises(CheckFailedError, match=r"not even 60 N/m is rendered .* raise bus\.rate"):
        design(load_scene(DEMO, ["bus.rate=5", "passivity.moving_mass=0.01"]), engine="python")


def test_numbers_are_rounded_down():
    assert [_rounded(value) for value in (1569.9, 0.012349, 0.0, 149.0, 1e8)] == [1560.0, 0.0123, 0.0, 149.0, 1e8]


PULLED = ["bus.rate=100", "passivity.hand_force=5 N", "simulation.plant.damping=1", "passivity.device_damping_bound=1"]


@pytest.fixture(scope="module")
def felt():
    trial = Trial(load_scene(DEMO, PULLED), 0.05, "python")
    return felt_of(trial.scene, "guarded", trial.hand, 0.05, 100.0)


@pytest.mark.slow
def test_a_wall_said_to_be_felt_is_held_in_a_scene_and_one_beyond_the_certificate_is_not(felt):
    [_, wall, _] = felt["walls"]
    assert wall["push"] == 5.0
    assert 0.3 * wall["certified"] < wall["held"] < 1.05 * wall["certified"]
    for stiffness, is_held in ((0.95 * wall["held"], True), (1.3 * wall["certified"], False)):
        scene = load_scene(
            DEMO,
            [
                *PULLED,
                f"environment={{type: spring_damper_wall, stiffness: {stiffness!r}}}",
                "simulation.user={damping: 5, push: -5}",
                "simulation.plant.initial_position=0.02",
            ],
        )
        [run] = compare(scene, ["guarded"], duration=4.0, repeats=0).result["rows"]
        assert (run["stiffness_at_rest.share"] > 0.95) == is_held


@pytest.mark.slow
def test_a_contact_is_felt_above_the_speed_that_the_hand_can_take_away(felt):
    """(1 + delay) F_h T / m, one sample late; the hand that is tried pushes as well, which takes time."""
    slowest = 2.0 * 5.0 * 0.01 / 0.2
    assert slowest < felt["start_speed"] < 1.5 * slowest
    assert felt["drag"] == 0.0


@pytest.mark.slow
def test_a_drag_earns_the_energy_of_a_start_over_the_way_that_is_said(felt):
    without, drag = felt["drags"]
    assert (without["drag"], without["way"], without["start_speed"]) == (0.0, None, None)
    each, wall = 3.0 * 0.01**2 / 0.2, 100.0  # h of start_energy
    assert drag["energy"] == pytest.approx((each * 5.0) ** 2 / 4.0 / (0.5 / wall - each), rel=0.1)
    assert drag["way"] == pytest.approx(drag["energy"] / 0.1)
    assert drag["start_speed"] < felt["start_speed"]
