"""Maps: the border of a plain wall is that of theory; the worst of what is not drawn counts; pictures are made."""

import html
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from canhaptic.errors import InputError
from canhaptic.lab.render.map_picture import draw_map, edges_of, write_map
from canhaptic.lab.studies.map import (
    Cells,
    Chosen,
    Lines,
    _Border,
    _passes,
    border_of,
    colgate_stiffness,
    fields_of,
    panels_of,
    theory_at,
    usual_judgement,
)
from canhaptic.lab.studies.store import SweepTable
from canhaptic.lab.studies.sweep import sweep
from canhaptic.scene.load import load_scene

DEMO = str(Path(__file__).resolve().parents[3] / "configs" / "demo.yaml")
SOFT_HAND = "simulation.user={stiffness: 0.01, push: -1}"


@pytest.fixture(scope="module")
def plain_wall(tmp_path_factory):
    """A plain wall with the encoder's count, device damping and rate varied, held by a hand too soft to matter."""
    path = tmp_path_factory.mktemp("map") / "plain"
    scene = load_scene(DEMO, [SOFT_HAND, "bus.rpdo=event", "environment.damping=0"])
    vary = ["environment.stiffness=100:20000:log:161", "bus.rate=200,400,800", "simulation.plant.damping=1,2"]
    sweep(scene, vary, path, controllers=["unprotected"], cycles=20, metrics=["spectral_radius"])
    return path


@pytest.fixture(scope="module")
def two_controllers(tmp_path_factory):
    path = tmp_path_factory.mktemp("map") / "two"
    vary = ["environment.stiffness=100:2000:log:5", "bus.rate=50,100", "environment.damping=0,2"]
    friction = "simulation.effects=[{type: coulomb_friction, static: 0.1 N, kinetic: 0.1 N}]"
    scene = load_scene(DEMO, [friction, "bus.rpdo=event"])
    metrics = [
        "margin",
        "least_interaction",
        "least_covered",
        "diverged",
        "stiffness_rendered.share",
        "damping_rendered.share",
    ]
    sweep(scene, vary, path, controllers=["unprotected", "guarded"], duration=1.6, metrics=metrics, engine="python")
    return path


@pytest.mark.slow
def test_the_border_of_the_plain_wall_is_that_of_colgate_within_three_per_cent(plain_wall):
    with SweepTable(plain_wall) as table:
        [field] = fields_of(table)
        border = border_of(field, "environment.stiffness", ["bus.rate", "simulation.plant.damping"], "stable")
        step = 200.0 ** (1.0 / 160.0)
        for i, rate in enumerate((200.0, 400.0, 800.0)):
            for j, damping in enumerate((1.0, 2.0)):
                theory = theory_at(field, {"bus.rate": rate, "simulation.plant.damping": damping})
                assert theory.colgate == pytest.approx(2.0 * damping * rate)
                assert border.value[i, j] / 1.03 <= theory.colgate <= 1.03 * border.value[i, j] * step


@pytest.mark.slow  # compiles a loop, and marches 1.4 million cycles
def test_the_border_found_by_marching_is_that_of_colgate_within_three_per_cent(tmp_path):
    """Slow swings in a wall that is touched all the time: does the travel still grow in the second half of a run?"""
    wall = "environment={type: two_sided_wall, stiffness: 100, lower: 0, upper: 0}"
    scene = load_scene(
        DEMO, [SOFT_HAND.replace("-1", "0"), "bus.rpdo=event", wall, "simulation.plant.initial_position=0.04"]
    )
    vary = ["environment.stiffness=85:450:log:121", "bus.rate=100,200", "simulation.plant.damping=0.5,1"]
    travel = []
    for cycles in (1000, 2000):
        sweep(scene, vary, tmp_path / f"{cycles}", controllers=["unprotected"], cycles=cycles, metrics=["travel"])
        with SweepTable(tmp_path / f"{cycles}") as table:
            [field] = fields_of(table)
            travel.append(field.figure("travel")[..., 0])
    calm = travel[1] <= 1.0001 * travel[0]
    for i, rate in enumerate((100.0, 200.0)):
        for j, damping in enumerate((0.5, 1.0)):
            largest = field.values["environment.stiffness"][int(np.logical_and.accumulate(calm[:, i, j]).sum()) - 1]
            theory = theory_at(field, {"bus.rate": rate, "simulation.plant.damping": damping}).colgate
            assert theory == pytest.approx(2.0 * damping * rate)
            assert largest == pytest.approx(theory, rel=0.03)


def test_colgates_condition_in_its_closed_forms():
    assert colgate_stiffness(1.0, 0.0, 1e-3, 0) == pytest.approx(2000.0)  # b > k T / 2
    assert colgate_stiffness(1.0, 0.3, 1e-3, 0) == pytest.approx(1400.0)  # b > k T / 2 + B
    assert colgate_stiffness(3.0, 0.0, 1e-3, 1) == pytest.approx(2000.0, rel=1e-5)  # b > 3 k T / 2
    assert colgate_stiffness(1.0, 1.5, 1e-3, 0) == 0.0


def test_colgates_condition_is_that_of_the_energy_of_any_motion():
    random = np.random.default_rng(1)
    period, damping, delay = 1e-3, 2.0, 1
    stiffness = colgate_stiffness(damping, 0.0, period, delay)
    for factor, is_passive in ((0.99, True), (1.05, False)):
        motions = [random.normal(size=400).cumsum() for _ in range(50)]
        motions += [np.sin(np.arange(4000) * angle) for angle in np.linspace(0.02, 3.1, 60)]  # from and back to rest
        least = 0.0
        for q in motions:
            q = np.concatenate([[0.0], q, q[-1] * np.linspace(1.0, 0.0, 2000)])
            moved = np.diff(q)
            felt = np.concatenate([[0.0], q])[: len(moved)]  # a hold late
            taken = factor * stiffness * np.cumsum(felt * moved) + damping / period * np.cumsum(moved * moved)
            least = min(least, taken[-1] / (moved @ moved))
        assert (least >= 0.0) == is_passive


@pytest.mark.slow
def test_abbott_and_okamura_ask_for_friction_over_half_a_count(two_controllers):
    with SweepTable(two_controllers) as table:
        [field, _] = fields_of(table)
        theory = theory_at(field, {"bus.rate": 50.0, "environment.damping": 0.0})
        assert theory_at(field, {"bus.rate": 50.0, "environment.damping": 2.0}).abbott_okamura is None
    assert theory.abbott_okamura == pytest.approx(2.0 * 0.1 / 1e-6)


@pytest.mark.slow
def test_the_border_beside_dry_friction_and_a_coarse_encoder_is_that_of_abbott_and_okamura(tmp_path):
    """The worst hand there is: to and fro over the edge of a count, turning at every SYNC."""
    count, swing = 1e-4, 1e-5
    overrides = [
        "bus.rpdo=event", "bus.rate=100", "axes.0.counts_per_unit=1e4", "axes.0.rated_torque=1",
        "axes.0.torque_limit=1", "environment.damping=0", "environment.position=0",
        f"simulation.plant={{mass: 0.25, damping: 0.1, initial_position: {-1.5 * count - swing!r}}}",
        f"simulation.user={{stiffness: 1e7, damping: 10, motion: {{amplitude: {swing!r}, frequency: 50, "
        f"phase: -1.5707963267948966, offset: {-1.5 * count!r}}}}}",
        "simulation.effects=[{type: coulomb_friction, static: 0.1 N, kinetic: 0.1 N}]",
    ]  # fmt: skip
    path = tmp_path / "friction"
    metrics = ["least_covered", "least_interaction", "diverged"]
    stiffnesses = "environment.stiffness=1000,1900,1950,2050,2100,3000"
    scene = load_scene(DEMO, overrides)
    sweep(scene, [stiffnesses], path, controllers=["unprotected"], cycles=100, metrics=metrics, engine="python")
    with SweepTable(path) as table:
        [field] = fields_of(table)
        assert theory_at(field, {}).abbott_okamura == pytest.approx(2000.0)
        assert usual_judgement(field) == "covered"
        assert _passes(field, "covered")[:, 0].tolist() == [True, True, True, False, False, False]
        assert not _passes(field, "passive").any()  # the port gives out energy; the friction of the device takes it


@pytest.mark.slow
def test_what_is_not_drawn_counts_at_its_worst_and_one_failing_scene_ends_a_column(two_controllers):
    with SweepTable(two_controllers) as table:
        direct, guarded = fields_of(table)
        assert (usual_judgement(direct), usual_judgement(guarded)) == ("covered", "passive")
        by_both = border_of(direct, "environment.stiffness", ["bus.rate", "environment.damping"], "passive")
        worst = border_of(direct, "environment.stiffness", ["bus.rate"], "passive")
        assert worst.value.tolist() == by_both.value.min(axis=1).tolist()
        assert _passes(guarded, "passive").all()
        assert border_of(guarded, "environment.stiffness", ["bus.rate"], "passive").open.all()
        field = direct

        class Doctored:
            keys, values = field.keys, field.values

            def judged(self):
                return np.ones((5, 2, 2, 1), dtype=bool)

            def figure(self, _metric):
                energy = np.zeros((5, 2, 2, 1))
                energy[2, 1, 0] = -1.0
                return energy

        found: _Border = border_of(Doctored(), "environment.stiffness", ["bus.rate"], "passive")  # type: ignore[arg-type]
    assert found.value.tolist() == [field.values["environment.stiffness"][4], field.values["environment.stiffness"][1]]
    assert found.open.tolist() == [True, False]


@pytest.mark.slow
def test_scenes_that_were_refused_or_not_run_are_blank(tmp_path):
    path = tmp_path / "a"
    touching = load_scene(DEMO, ["environment.position=0.01"])
    sweep(touching, ["environment.stiffness=100,200", "bus.rate=100,3000"], path, cycles=20)
    with SweepTable(path) as table:
        border = border_of(fields_of(table)[0], "environment.stiffness", ["bus.rate"], "passive")
    assert np.isfinite(border.value).tolist() == [True, False]


@pytest.mark.slow
def test_the_usual_panels_and_one_of_a_chosen_figure(two_controllers):
    with SweepTable(two_controllers) as table:
        fields = fields_of(table)
        columns = panels_of(fields, Chosen(judgement="covered"))
        chosen = panels_of(fields, Chosen(x="environment.damping", y="bus.rate", metric="margin"))
    assert [len(column) for column in columns] == [4, 4]
    width = columns[0][0]
    assert isinstance(width, Lines)
    assert [line.label for line in width.lines if line.style == "measured"] == [
        "measured, damping 0 N*s/m",
        "measured, damping 2 N*s/m",
    ]
    assert any(line.style == "abbott_okamura" for line in width.lines)
    assert width.x_label == "bus.rate [Hz]"
    assert width.y_label == "environment.stiffness [N/m]"
    units = {"axes.0.torque_limit": "N", "simulation.axes.handle.plant.mass": "kg", "passivity.moving_mass": "kg"}
    assert {key: fields[0].label(key) for key in units} == {key: f"{key} [{unit}]" for key, unit in units.items()}
    [[cells], _] = chosen
    assert isinstance(cells, Cells)
    assert cells.values.shape == (2, 2)


@pytest.mark.slow
def test_without_a_stiffness_the_largest_detent_is_searched_over_the_rate(tmp_path):
    knob = load_scene(DEMO.replace("demo.yaml", "rotary_knob.yaml"))
    sweep(knob, ["environment.peak=0.02,0.04", "bus.rate=500,1000"], tmp_path / "a", cycles=20)
    with SweepTable(tmp_path / "a") as table:
        [[top, *_]] = panels_of(fields_of(table), Chosen())
    assert isinstance(top, Lines)
    assert (top.x_label, top.y_label) == ("bus.rate [Hz]", "environment.peak [N*m]")
    assert top.title.startswith("largest peak that is passive")


@pytest.mark.slow
def test_on_top_are_all_algorithms_in_one_panel_with_theory(two_controllers):
    with SweepTable(two_controllers) as table:
        fields = fields_of(table)
        columns = panels_of(fields, Chosen())
        stiffnesses, rates = (fields[0].values[key] for key in ("environment.stiffness", "bus.rate"))
        expected = {}
        for field in fields:
            passes = (field.figure("least_covered") >= -1e-9) & (field.figure("diverged") == 0.0)
            near = np.abs(field.figure("stiffness_rendered.share") - 1.0) <= 0.05
            for j, damping in enumerate((0.0, 2.0)):
                for i in range(len(rates)):
                    largest = 0.0
                    for k, stiffness in enumerate(stiffnesses):
                        if not passes[k, i, j, 0]:
                            break
                        largest = stiffness if near[k, i, j, 0] else largest
                    expected[field.algorithm, damping, i] = largest or np.nan
    assert [len(column) for column in columns] == [4, 4]
    for damping, column in zip((0.0, 2.0), columns, strict=True):
        panel = column[0]
        assert isinstance(panel, Lines)
        lines = {line.label: line for line in panel.lines}
        assert [line.style for name, line in lines.items() if name in ("unprotected", "guarded")] == [
            "measured",
            "ours",
        ]
        for name in ("unprotected", "guarded"):
            np.testing.assert_array_equal(lines[name].y, [expected[name, damping, i] for i in range(len(rates))])
        assert ("Colgate, plain wall" in lines) == (damping == 0.0)  # its damper of 2 N*s/m is beyond the device's
        assert "largest certificate of guarded" in lines
        assert panel.title.startswith("stiffest wall that is passive at the handle and within 5 %")
        assert panel.note.startswith("solid: simulated, broken: theory; ")
        assert panel.note.endswith("; unprotected passes for this hand alone: it promises no passivity")


@pytest.mark.slow
def test_a_border_is_named_by_what_its_wall_is_and_a_map_with_nothing_finished_is_judged_as_a_full_one(tmp_path):
    path, vary = tmp_path / "part", ["environment.stiffness=100,2000", "bus.rate=500,1000"]
    asked: dict[str, Any] = {"controllers": ["guarded", "unprotected"], "duration": 0.01, "chunk": 4}
    polls = iter([False, True])
    sweep(load_scene(DEMO), vary, path, stop_requested=lambda: next(polls, True), engine="python", **asked)
    with SweepTable(path) as table:
        _, unprotected = fields_of(table)
        assert not unprotected.judged().any()
        assert usual_judgement(unprotected) == "stable"
        titles = [column[0].title for column in panels_of([unprotected], Chosen(judgement="stable"))]
        assert titles == ["unprotected: largest stiffness that is stable, not passive"]


def test_the_eigenvalues_of_a_hand_that_hardly_holds_are_at_colgates_bound(plain_wall):
    with SweepTable(plain_wall) as table:
        theory = theory_at(fields_of(table)[0], {"bus.rate": 400.0, "simulation.plant.damping": 1.0})
    assert theory.eigenvalues == pytest.approx(800.0, rel=0.04)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["grid", "one key"])
def test_pictures_and_pages_are_made_of_grids_and_of_one_key(request, kind, tmp_path):
    pytest.importorskip("matplotlib")
    path, scene = tmp_path / "a", load_scene(DEMO)
    options: dict[str, Any] = {"cycles": 20, "metrics": ["margin", "diverged"]}
    if kind == "grid":
        path = request.getfixturevalue("two_controllers")
    else:
        sweep(scene, ["environment.stiffness=1e2:1e4:log:5"], path, **options)
    with SweepTable(path) as table:
        columns = panels_of(fields_of(table), Chosen())
    draw_map(columns, "caption", tmp_path / "map.png")
    assert (tmp_path / "map.png").read_bytes()[:4] == b"\x89PNG"
    write_map(columns, "a <caption>", tmp_path / "map.html")
    page = (tmp_path / "map.html").read_text()
    assert "a <caption>" not in page
    assert "<script src" not in page
    assert "<link" not in page
    for panel in (panel for column in columns for panel in column if isinstance(panel, Lines)):
        for line in panel.lines:
            assert page.count(f'<td class="key">{html.escape(line.label)}</td>') >= len(line.x)


def test_edges_lie_halfway_between_neighbours():
    assert edges_of(np.array([1.0, 2.0, 4.0])).tolist() == [0.5, 1.5, 3.0, 5.0]
    assert edges_of(np.array([1.0, 100.0])) == pytest.approx([0.1, 10.0, 1000.0])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("chosen", "message"),
    [
        (Chosen(x="bus.bitrate"), "was not varied"),
        (Chosen(x="bus.rate", y="bus.rate"), "give two keys"),
        (Chosen(metric="travel"), "not in the sweep"),
    ],
)
def test_what_cannot_be_drawn_is_named(two_controllers, chosen, message):
    with SweepTable(two_controllers) as table, pytest.raises(InputError, match=message):
        panels_of(fields_of(table), chosen)
