"""Every row of a sweep is the scene that a user would have written, or is refused with the reason of that scene."""

import statistics
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from canhaptic.errors import InputError, SceneError
from canhaptic.lab.batch.scalar import run_scalar
from canhaptic.lab.commands.sweep import _shares, summary
from canhaptic.lab.loop.axis_loop import with_algorithm
from canhaptic.lab.studies.store import MORE, SLOTS, SweepTable
from canhaptic.lab.studies.sweep import _pays, sweep
from canhaptic.scene.load import load_scene
from tests.lab.sweep.conftest_sweep import DEMO, VARY

EXACT = ("least_interaction", "margin", "torque_peak", "travel", "damping_rendered.mean")


def run(scene, vary, path, **options):
    sweep(scene, vary, path, **options)
    return SweepTable(path)


@pytest.mark.slow
def test_every_row_is_the_scene_written_by_hand(demo, tmp_path):
    with run(demo, VARY, tmp_path / "a", cycles=150, metrics=EXACT) as table:
        assert table.status().tolist() == [1] * 32
        for row in (0, 5, 17, 31):
            values = {key: table.values(key)[row] for key in table.keys}
            scene = load_scene(DEMO, [f"{key}={float(value)!r}" for key, value in values.items()])
            by_hand = run_scalar(scene, 150)
            for metric in EXACT:
                assert table.figure("handle", metric)[row] == pytest.approx(
                    by_hand[metric], rel=1e-9, abs=1e-15, nan_ok=True
                )


@pytest.mark.slow
def test_a_duration_is_as_many_holds_as_each_rate_makes_of_it(demo, tmp_path):
    with run(demo, ["bus.rate=100,250,1000"], tmp_path / "a", duration=0.2) as table:
        assert table.figure("handle", "cycles").tolist() == [20.0, 50.0, 200.0]


@pytest.mark.slow
def test_the_bits_do_not_depend_on_how_scenes_are_dealt_into_chunks(demo, tmp_path):
    found, vary = [], ["environment.stiffness=100,9000", *VARY[1:]]
    metrics = ["margin", "least_covered", "travel", "stiffness_rendered.share", "branches.exact", "spectral_radius"]
    for chunk in (1, 3, 8):
        with run(demo, vary, tmp_path / f"{chunk}", cycles=40, chunk=chunk, metrics=metrics) as table:
            found.append(np.array([table.figure("handle", metric) for metric in table.metrics]))
    assert found[0].tobytes() == found[1].tobytes() == found[2].tobytes()


@pytest.mark.slow
def test_what_the_bus_cannot_carry_is_refused_row_by_row_and_judged_when_asked(demo, tmp_path):
    vary = ["bus.rate=500,2000", "environment.stiffness=100:1000:3"]
    with run(demo, vary, tmp_path / "a", cycles=50) as table:
        assert table.status().tolist() == [4, 4, 4, 2, 2, 2]
        assert table.remark(3).startswith("bus.rate: the cycle does not fit the bus")
        assert np.isnan(table.figure("handle", "margin")[3:]).all()
        assert summary(table)["status"] == {"no contact": 3, "refused": 3}
    with run(demo, vary, tmp_path / "b", cycles=50, beyond_bus=True) as table:
        assert table.status().tolist() == [4] * 6


@pytest.mark.slow
def test_a_range_beyond_what_the_bus_carries_is_refused_exactly_where_the_scene_is(demo, tmp_path):
    with run(demo, ["bus.rate=1400:1440:5"], tmp_path / "a", cycles=20) as table:
        assert table.values("bus.rate").tolist() == [1400.0, 1410.0, 1420.0, 1430.0, 1440.0]
        assert table.status().tolist() == [4, 4, 2, 2, 2]


@pytest.mark.slow
def test_more_reasons_than_a_chunk_keeps_are_said_to_be_more(demo, tmp_path):
    with run(demo, ["bus.rate=1500:9000:60"], tmp_path / "a", cycles=20, chunk=60) as table:
        assert table.status().tolist() == [2] * 60
        assert table.remark(0) != table.remark(1) != MORE
        assert {table.remark(row) for row in range(SLOTS - 1, 60)} == {MORE}


@pytest.mark.slow
def test_an_algorithm_without_what_it_rests_on_takes_it_from_the_plant_in_every_row(tmp_path):
    scene = load_scene(DEMO, ["passivity={algorithm: unprotected}"])
    vary = ["simulation.plant.mass=0.1,0.4"]
    with run(scene, vary, tmp_path / "a", cycles=1200, controllers=["unprotected", "guarded"]) as table:
        assert "taken from the simulated plant: moving_mass" in table.remark(2)
        for row, mass in ((2, 0.1), (3, 0.4)):
            alone = load_scene(
                DEMO,
                [
                    f"passivity={{algorithm: guarded, moving_mass: {mass}, hand_force: 0, "
                    f"device_damping: 0.1, device_damping_bound: 0.1}}",
                    f"simulation.plant.mass={mass}",
                ],
            )
            assert table.figure("handle", "force_ripple")[row] == pytest.approx(
                run_scalar(alone, 1200)["force_ripple"], rel=1e-9
            )


def test_controllers_judge_the_same_scene(tmp_path):
    strong = load_scene(DEMO, ["environment.stiffness=5000", "bus.rate=100"])
    names = ["unprotected", "guarded"]
    with run(strong, [], tmp_path / "a", cycles=150, controllers=names) as table:
        found = table.figure("handle", "least_interaction")
    by_hand = [run_scalar(strong.with_port(with_algorithm(strong.ports[0], name)), 150) for name in names]
    assert found == pytest.approx([figures["least_interaction"] for figures in by_hand], rel=1e-9)
    assert found[0] < -1e-3


@pytest.mark.slow
def test_a_short_key_means_every_axis_also_one_with_its_own_section(two_axes, tmp_path):
    both = ["environment.stiffness=300,900", "simulation.plant.mass=0.3,0.6"]
    with run(two_axes(), both, tmp_path / "a", cycles=100) as table:
        assert table.axes == ["left", "right"]
        for row, (stiffness, mass) in enumerate(((300, 0.3), (300, 0.6), (900, 0.3), (900, 0.6))):
            scene = two_axes(
                f"environment.stiffness={stiffness}",
                f"axes.1.environment.stiffness={stiffness}",
                f"simulation.plant.mass={mass}",
                f"simulation.axes.right.plant.mass={mass}",
            )
            for index, name in enumerate(table.axes):
                by_hand = run_scalar(replace(scene, axes=(scene.axes[index],)), 100)
                assert table.figure(name, "travel")[row] == pytest.approx(by_hand["travel"], rel=1e-9)


@pytest.mark.slow
def test_a_full_key_means_one_axis_and_leaves_the_other_alone(two_axes, tmp_path):
    with run(two_axes(), ["axes.1.environment.stiffness=50,5000"], tmp_path / "a", cycles=100) as table:
        left, right = (table.figure(name, "torque_peak") for name in ("left", "right"))
        assert left[0] == left[1]
        assert right[0] != right[1]


@pytest.mark.slow
def test_noise_differs_from_scene_to_scene_and_repeats_from_sweep_to_sweep(two_axes, tmp_path):
    noisy = two_axes("simulation.effects=[{type: encoder_noise, deviation: 0.1 mm}]")
    found = []
    for chunk in (1, 4):
        with run(noisy, ["environment.damping=1:1.000001:4"], tmp_path / f"{chunk}", cycles=80, chunk=chunk) as table:
            found.append(table.figure("left", "travel"))
    assert found[0].tobytes() == found[1].tobytes()
    assert np.ptp(found[0]) > 1e-6


@pytest.mark.slow
@pytest.mark.parametrize(
    ("vary", "message"),
    [
        ("environment.stiffness=abc", "got 'abc'"),
        ("environment.stiffness=100,abc", "got 'abc'"),
        ("environment.stiffness=-5:10:4", "got -5"),
        ("environment.stiffness=100 N:200 N:4", "unit"),
        ("environment.stifness=100,200", "did you mean 'stiffness'"),
        ("bus.rate=0.5,100", "rate"),
        ("axes.3.torque_limit=1,2", "index '3'"),
        ("nothing.at.all=1,2", "unknown key"),
    ],
)
def test_a_value_that_is_wrong_by_itself_ends_the_sweep_before_it_begins(demo, tmp_path, vary, message):
    with pytest.raises(SceneError, match=message) as raised:
        sweep(demo, [vary], tmp_path / "a")
    assert "--vary" in str(raised.value)
    assert not (tmp_path / "a").exists()


def test_what_cannot_be_swept_is_refused(demo, tmp_path):
    real = load_scene(DEMO, ["simulation=null", "bus.channel=x"])
    with pytest.raises(InputError, match="has no `simulation`"):
        sweep(real, ["environment.stiffness=1,2"], tmp_path / "a")
    with pytest.raises(InputError, match="unknown metric"):
        sweep(demo, ["environment.stiffness=1,2"], tmp_path / "a", metrics=["beauty"])
    with pytest.raises(InputError, match="unknown passivity algorithm"):
        sweep(demo, ["environment.stiffness=1,2"], tmp_path / "a", controllers=["best"])
    with pytest.raises(InputError, match="give one"):
        sweep(demo, ["environment.stiffness=1,2"], tmp_path / "a", cycles=5, duration=1.0)


@pytest.mark.slow
@given(arrays(np.float64, st.integers(1, 40), elements=st.floats() | st.sampled_from([0.0, -0.0, 1.0, -1.0])))
def test_medians_extremes_and_shares_are_those_of_the_finite_values(values):
    class Table:
        metrics = ("margin", "mass_felt.share")
        figure = staticmethod(lambda _axis, _metric: values)

    found = _shares(Table(), "handle", np.ones(len(values), dtype=bool))  # type: ignore[arg-type]
    known = values[np.isfinite(values)]
    assert found.keys() == {"scenes", "margin_kept", "least_margin", "mass_felt"}
    assert found["scenes"] == len(values)
    assert found["least_margin"] == (known.min() if len(known) else None)
    middle = statistics.median(known.tolist()) if len(known) and np.abs(known).max() < 1e308 else None
    assert middle is None or found["mass_felt"] == pytest.approx(middle, rel=1e-15, abs=0.0)
    assert found["margin_kept"] == pytest.approx(np.mean(values >= -1e-6))


@pytest.mark.slow
def test_the_margin_of_guarded_is_short_by_no_more_than_the_counts_of_the_encoder_can_hide(tmp_path):
    """Booked with true positions it is kept exactly: half a count of error costs that times the torque's travel.

    Without a bus every torque acts at its SYNC.
    """
    scene = load_scene(
        DEMO, ["bus.rate=250", "environment.stiffness=450", "environment.position=0.05", "passivity.torque_window=0"]
    )
    metrics = ["margin", "accounted_margin", "accounted_error", "force_ripple", "torque_peak"]
    counts = "axes.0.counts_per_unit=1e5,1e6,1e8"
    with run(scene, [counts, "bus.rpdo=synchronous,event"], tmp_path / "a", cycles=500, metrics=metrics) as table:
        figure = {metric: table.figure("handle", metric) for metric in metrics}
        hidden = 0.5 / table.values("axes.0.counts_per_unit") * (figure["force_ripple"] + figure["torque_peak"])
    assert (figure["accounted_error"] <= hidden).all()
    assert (figure["margin"] >= -hidden).all()
    assert (figure["accounted_margin"] >= -1e-15).all()
    assert figure["margin"].min() < 0.0


@pytest.mark.parametrize(("scenes", "cycles", "pays"), [(8, 10_000, False), (2000, 400, False), (1000, 1000, True)])
def test_only_the_cycles_of_all_scenes_together_decide_whether_compiling_pays(scenes, cycles, pays):
    assert _pays(load_scene(DEMO), scenes, cycles) is pays


@pytest.mark.parametrize(("scenes", "pays"), [(400, True), (200, False)])
def test_a_small_sweep_of_scenes_with_events_compiles_too(scenes, pays):
    stop = "simulation.effects=[{type: hard_stop, side: upper, position: 0.02, stiffness: 1e5, damping: 50}]"
    assert _pays(load_scene(DEMO, [stop]), scenes, 400) is pays
