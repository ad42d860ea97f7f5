"""Comparisons: the figures against an independent simulation, the same over CAN, and what a table says of failures."""

import json
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from rich.console import Console

from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import ALGORITHMS, LoopProperties, build_controller
from canhaptic.errors import InputError, ParameterError
from canhaptic.lab import render
from canhaptic.lab.batch import scalar
from canhaptic.lab.figures.figures import figures
from canhaptic.lab.loop.axis_loop import (
    LoopRun,
    Recorder,
    at_rate,
    loop_case,
    microseconds_per_step,
    under,
    with_algorithm,
)
from canhaptic.lab.reference import ContinuousReference
from canhaptic.lab.render.comparison import comparison_report, draw_comparison
from canhaptic.lab.studies.compare import compare
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.load import load_scene
from tests.control.reference_loop import USER_S, continuous, sampled

REPOSITORY = Path(__file__).resolve().parents[2]
HARD = sorted(  # those called sim_* are hard for the plant, not for the wall
    path for path in (REPOSITORY / "configs" / "hard").glob("*.yaml") if not path.stem.startswith("sim_")
)
SCENE = f"""\
# User S of `reference_loop`, an encoder and a torque fine enough not to matter.
duration: 1.5 s
bus: {{interface: virtual, rate: 1 kHz, rpdo: event}}
axes:
  - {{name: handle, node_id: 1, eds: {REPOSITORY}/eds/cia402_servo.eds, unit: m, counts_per_unit: 1e9,
     rated_torque: 10 kN, torque_limit: 30 N}}
environment: {{type: spring_damper_wall, stiffness: 1000, damping: 5}}
passivity: {{algorithm: guarded, moving_mass: 0.25, device_damping: 0.1, device_damping_bound: 0.1, torque_window: 0}}
simulation:
  plant: {{mass: 0.25, damping: 0.1}}
  user: {{stiffness: 300, damping: 3, motion: {{amplitude: 0.03, frequency: 1}}}}
"""


@pytest.fixture
def scene(tmp_path):
    (tmp_path / "scene.yaml").write_text(SCENE)

    def loaded(*overrides):
        """The scene; without a rated torque of its own its commands are as fine as no RPDO could carry."""
        made = load_scene(tmp_path / "scene.yaml", overrides)
        if any("rated_torque" in override for override in overrides):
            return made
        return replace(made, axes=tuple(map(with_fine_torque, made.axes)))

    return loaded


def with_fine_torque(axis):
    parameters = axis.parameters.model_copy(update={"rated_torque": 1e-3})
    return replace(axis, parameters=parameters, loop=axis.loop.model_copy(update={"torque_quantum": 1e-6}))


def account(scene, algorithm, **options):
    [row] = compare(scene, [algorithm], repeats=0, **options).result["rows"]
    return row


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["unprotected", "internal_dissipation", "guarded"])
@pytest.mark.parametrize("delay", [0, 1])
def test_every_figure_is_that_of_an_independent_simulation(scene, algorithm, delay):
    chosen = scene("bus.rpdo=" + ("synchronous" if delay else "event"))
    found = account(chosen, algorithm)
    axis = chosen.axes[0]
    loop = LoopProperties(sample_time=1e-3, delay=delay, moving_mass=0.25, device_damping=0.1, device_damping_bound=0.1)
    controller = build_controller(axis.environment.parameters, algorithm, None, loop)
    run = sampled(USER_S, controller, 1e-3, 1.499, delay)
    position, torque = continuous(USER_S, 1000.0, 5.0, 0.0, np.arange(0.0, 1.49905, 1e-4))
    error = run.position - position[::10]
    assert found["position_error.rms"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-3)
    assert found["position_error.max"] == pytest.approx(np.abs(error).max(), rel=1e-3)
    mean = 0.5 * (torque[1:14991] + torque[:14990]).reshape(-1, 10).mean(axis=1)
    force_error = run.torque - np.concatenate([[0.0], mean])
    assert found["force_error.rms"] == pytest.approx(np.sqrt(np.mean(force_error**2)), rel=5e-2)
    interaction = np.cumsum(-run.torque[1:] * np.diff(run.position))
    dissipated = np.cumsum([balance.h_r for balance in run.balances])[1:]
    assert found["least_interaction"] == pytest.approx(min(0.0, interaction.min()), abs=1e-7)
    assert found["margin"] == pytest.approx(min(0.0, (interaction - dissipated).min()), abs=1e-6)
    assert found["force_ripple"] == pytest.approx(np.abs(np.diff(run.torque)).sum(), rel=1e-2)
    ratio = found["force_ripple"] / found["force_ripple.ratio"]
    assert ratio == pytest.approx(np.abs(np.diff(torque)).sum(), rel=2e-3)


@pytest.mark.slow
def test_the_energy_believed_is_that_of_the_whole_torque_with_a_modulated_damper_too(scene):
    damped = scene("passivity={algorithm: internal_dissipation, alpha: 1e6 s/m^2, moving_mass: 0.25}", "bus.rate=100")
    run = compare(damped, ["internal_dissipation"], repeats=0).runs["handle"]["internal_dissipation"]
    assert run.summary.recovered > 1e-6
    assert run.believed_error < 2e-8  # half a count of 1 nm times the variation of the torque


@pytest.mark.slow
def test_what_the_continuous_axis_still_moves_is_no_limit_cycle():
    time = np.arange(5000) * 1e-3
    ring = 5e-5 * np.sin(60.0 * time)
    still = np.where(time < 1.0, 0.01 * (1.0 - time), 0.0) - 1e-3
    nothing = np.zeros(5000)
    reference = ContinuousReference(still + ring, nothing, 1.0, time, nothing, "")  # type: ignore[arg-type]
    position = still + 3.0 * ring
    rows = np.zeros((5000, 19))
    rows[:, 1] = rows[:, 2] = position
    run = LoopRun(rows)
    found = figures(SpringDamperWall(stiffness=1e3), run, reference, 1e-3)
    assert found["limit_cycle"] == pytest.approx(2e-4, rel=1e-2)


@pytest.mark.slow
def test_over_can_every_figure_is_the_same_to_the_last_bit(scene):
    chosen = load_scene(REPOSITORY / "configs" / "hard" / "torque_saturation.yaml")
    for overrides in (chosen, scene("axes.0.rated_torque=10 N", "axes.0.counts_per_unit=1e6", "bus.rpdo=synchronous")):
        direct, over_can = (account(overrides, "guarded", duration=0.9, over_can=c) for c in (False, True))
        assert direct == over_can
        assert direct["force_ripple"] > 1.0


@pytest.mark.slow_but("slow_and_late")
@pytest.mark.parametrize("path", HARD, ids=lambda path: path.stem)
def test_guarded_gives_out_nothing_on_any_hard_scene(path):
    assert path.read_text().startswith("# ")  # what is hard about it
    loaded = load_scene(path)
    longest = min(loaded.run.duration, 3.0)  # type: ignore[type-var]
    [runs] = compare(loaded, ["guarded"], duration=longest, repeats=0).runs.values()
    run = runs["guarded"]
    assert run.ended == ""
    assert run.least_interaction >= -1e-6
    assert np.abs(run.torque).max() > 0.4  # the wall was felt


def test_there_are_at_least_ten_hard_scenes():
    assert len(HARD) >= 10


@pytest.mark.slow
def test_a_wall_that_rings_out_of_the_room_is_reported_as_diverged(scene):
    chosen = scene("environment.damping=600", "axes.0.torque_limit=1e5", "bus.rpdo=synchronous")
    found = account(chosen, "unprotected")
    assert found["status"] == "diverged"
    assert 0.0 < found["diverged"] < 1.5
    assert found["force_ripple.ratio"] is None


def test_an_algorithm_that_lacks_something_takes_the_plant_or_is_refused_with_its_reason(scene):
    bare = scene("passivity={algorithm: unprotected}")
    assert "device_damping 0.1" in account(bare, "energy_bounding", duration=0.1)["remark"]
    frictionless = scene("passivity={algorithm: unprotected}", "simulation.plant.damping=0")
    found = account(frictionless, "energy_bounding", duration=0.1)
    assert found["status"] == "refused"
    assert "device_damping" in found["remark"]


def test_what_two_algorithms_have_in_common_is_kept(scene):
    loaded = scene("passivity={algorithm: internal_dissipation, alpha: 200 s/m^2, velocity: windowed}")
    [port], [axis] = loaded.ports, loaded.axes
    kept: list[Any] = [with_algorithm(port, name).passivity.parameters for name in ("guarded", "unprotected")]
    assert (kept[0].alpha, kept[1].velocity) == (200.0, "windowed")
    assert with_algorithm(port, "internal_dissipation") is port
    heavy = replace(loaded, axes=(replace(axis, loop=axis.loop.model_copy(update={"moving_mass": 0.2})),))
    told = under(heavy, "energy_bounding").permitted().axes[0].loop  # which needs the damping of the device
    assert (told.moving_mass, told.device_damping) == (0.2, 0.1)


@pytest.mark.slow
def test_at_rest_the_stiffness_is_that_of_the_wall_and_nothing_cycles(scene):
    leaning = scene("simulation.user={damping: 10, push: -5}", "duration=4 s")
    found = account(leaning, "unprotected")
    assert found["stiffness_at_rest.value"] == pytest.approx(1000.0, rel=1e-4)
    assert found["stiffness_at_rest.share"] == pytest.approx(1.0, rel=1e-4)
    assert found["limit_cycle"] < 1e-7
    assert account(scene(), "unprotected")["stiffness_at_rest.value"] is None  # a hand that moves has no rest


@pytest.mark.slow
def test_a_run_that_stops_has_a_code_and_its_reason_is_a_remark(scene):
    fine = "axes.0.counts_per_unit=1e6", "bus.rpdo=synchronous", "axes.0.speed_limit=0.01 m/s"
    found = account(scene(*fine, "axes.0.rated_torque=10 N"), "unprotected", duration=0.5, over_can=True)
    assert found["status"] == "stopped"
    assert "faster than the speed limit" in found["remark"]
    assert found["position_error.max"] > 0.0
    other_drive = scene(*fine, "axes.0.rated_torque=10 N", "simulation.drive={rated_torque: 5 N}")
    found = account(other_drive, "unprotected", duration=0.5, over_can=True)  # never starts
    assert found["status"] == "stopped"
    assert "rated torque" in found["remark"]
    assert "position_error.rms" not in found


@pytest.mark.slow
def test_another_rate_may_be_beyond_the_bus_but_not_over_can(scene):
    assert account(scene(), "guarded", rate=8000.0, duration=0.6)["position_error.rms"] < 2e-5
    assert at_rate(scene(), 8000.0).axes[0].loop.sample_time == 125e-6
    with pytest.raises(InputError, match="without a bus"):
        compare(scene(), ["unprotected"], rate=8000.0, over_can=True)
    with pytest.raises(ParameterError, match="rate"):
        at_rate(scene(), 1e6)


def test_a_real_rig_and_an_unknown_algorithm_are_refused(scene):
    with pytest.raises(InputError, match="simulation"):
        compare(load_scene(REPOSITORY / "configs" / "socketcan_example.yaml"))
    with pytest.raises(ParameterError, match="did you mean 'guarded'"):
        compare(scene(), ["gaurded"])


class Ledge(SpringDamperWall):
    """A wall of a user's own, for which the study has no equations."""


def test_without_a_continuous_reference_the_errors_are_left_out(scene):
    own = scene()
    wall = ComponentSpec("ledge", Ledge(**own.axes[0].environment.parameters.model_dump()))
    own = replace(own, axes=(replace(own.axes[0], environment=wall),))
    result = compare(own, ["unprotected"], duration=0.6, repeats=0).result
    [row] = result["rows"]
    assert row["reference.method"].startswith("none: environment: got Ledge, for which there is no continuous run")
    assert row["position_error.rms"] is None
    assert row["interaction"] > 0.0
    assert "position error" not in text_of(result)


@pytest.mark.slow
def test_a_plant_that_switches_has_a_reference_in_any_environment(scene):
    nonlinear = "environment={type: hardening_wall, stiffness: 200, hardening: 1e7}"
    friction = "simulation.effects=[{type: coulomb_friction, kinetic: 0.1, static: 0.2}]"
    [row] = compare(scene(nonlinear, friction), ["unprotected"], duration=0.3, repeats=0).result["rows"]
    assert row["reference.method"].startswith("DOP853")
    assert row["position_error.max"] < 1e-3


def text_of(result, width=100):
    console = Console(width=width, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    with console.file:
        console.print(comparison_report(result))
    return console.export_text()


@pytest.mark.slow
def test_table_and_json_show_every_algorithm(scene):
    done = []
    comparison = compare(scene(), duration=0.6, repeats=1, progress=done.append)
    assert done
    assert done == sorted(done)
    assert json.loads(json.dumps(comparison.result, allow_nan=False)) == comparison.result
    table = text_of(comparison.result, width=200)
    assert max(len(line.rstrip()) for line in table.splitlines()[2:]) <= 200
    assert "…" not in text_of(comparison.result)
    for name in ALGORITHMS:
        assert name.split("_")[-1] in table
    assert {row["algorithm"] for row in comparison.result["rows"] if row["microseconds_per_step"] > 0.0} == {
        *ALGORITHMS
    }


@pytest.mark.slow
def test_a_picture_that_cannot_be_written_or_has_nothing_to_show_is_refused(scene, tmp_path):
    comparison = compare(scene(), ["unprotected"], duration=0.1, repeats=0)
    with pytest.raises(InputError, match="cannot be written"):
        draw_comparison(comparison, tmp_path / "no_folder" / "picture.png")
    refused = compare(scene("simulation.plant.damping=0", "passivity={algorithm: unprotected}"), ["energy_bounding"])
    with pytest.raises(InputError, match="nothing to draw"):
        draw_comparison(refused, tmp_path / "picture.png")


@pytest.mark.slow
def test_many_algorithms_are_drawn_in_bands_below_each_other(scene, monkeypatch):
    comparison, kept = compare(scene(), ["unprotected"], duration=0.05, repeats=0), []
    names, [row], [run] = (
        [f"algorithm {k}" for k in range(7)],
        comparison.result["rows"],
        comparison.runs["handle"].values(),
    )
    comparison.result["rows"] = [{**row, "algorithm": name} for name in names]
    monkeypatch.setattr(render, "save_picture", lambda figure, _: kept.append(figure))
    draw_comparison(replace(comparison, runs={"handle": dict.fromkeys(names, run)}), "")
    [figure] = kept
    shown = {title: panel for panel in figure.axes if (title := panel.get_title(loc="left")) in names}
    assert list(shown) == names  # 4 in the first band, then 3
    assert [panel.get_visible() for panel in figure.axes].count(True) == 7 * 3
    assert len({panel.get_ylim() for panel in shown.values()}) == 1  # one scale
    assert {panel.texts[0].get_text() for panel in shown.values()} == {"passive"}


@pytest.mark.slow
def test_each_column_of_a_picture_says_whether_its_algorithm_gave_energy_out(monkeypatch):
    scene, kept = load_scene(REPOSITORY / "configs" / "hard" / "stiff_wall.yaml"), []
    comparison = compare(scene, ["unprotected", "guarded"], duration=0.6, repeats=0)
    monkeypatch.setattr(render, "save_picture", lambda figure, _: kept.append(figure))
    draw_comparison(comparison, "")
    said = {panel.get_title(loc="left"): panel.texts[0].get_text() for panel in kept[0].axes if panel.texts}
    assert said["guarded"] == "passive"
    assert said["unprotected"].startswith("gave out ")
    assert said["unprotected"].endswith(" mJ")


def test_a_budget_of_time_replays_at_least_one_block_of_each_algorithm(scene):
    loop, steps = loop_case(scene().axes[0], scene()), [0]
    run, case = scalar.render(loop, 1000), Mock()
    controller = loop.controller()

    def step(position, torque):
        steps[0] += 1
        return controller.step(position, torque)

    case.controller.return_value.step = step
    for budget, repeats, replayed in ((inf, 2, 2000), (1e-9, 3, 250)):
        steps[0] = 0
        [time] = microseconds_per_step({"": (case, run)}, repeats, budget).values()
        assert (steps[0], 0.0 < time < 1e4) == (replayed, True)


@pytest.mark.slow
def test_a_run_that_ended_before_its_first_sync_is_left_out_of_times_and_pictures(scene, tmp_path):
    comparison = compare(scene(), ["unprotected"], duration=0.1, repeats=0)
    runs = comparison.runs["handle"]
    ended = Recorder().run("stopped", "the drive did not start")
    case = loop_case(scene().axes[0], scene())
    assert list(microseconds_per_step({"ended": (case, ended), "ran": (case, runs["unprotected"])}, 1)) == ["ran"]
    draw_comparison(replace(comparison, runs={"handle": {"ended": ended, **runs}}), tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 0
    with pytest.raises(InputError, match="nothing to draw"):
        draw_comparison(replace(comparison, runs={"handle": {"ended": ended}}), tmp_path / "none.png")


@pytest.mark.slow
def test_two_axes_are_compared_each_with_its_own_reference(tmp_path):
    second = """- {name: knob, node_id: 2, eds: cia402_servo.eds, unit: rad, counts_per_unit: 1e5, rated_torque: 1,
     torque_limit: 2, environment: {type: viscous_medium, damping: 0.05}}\n"""
    hand = "{stiffness: 1, damping: 0.02, motion: {amplitude: 1, frequency: 1}}"
    own = f"  axes: {{knob: {{plant: {{mass: 0.001}}, user: {hand}}}}}\n"
    text = SCENE.replace("environment:", f"  {second}environment:", 1) + own
    (tmp_path / "two.yaml").write_text(text)
    comparison = compare(load_scene(tmp_path / "two.yaml"), ["unprotected"], duration=0.3, repeats=0)
    assert {row["port"]: row["unit"] for row in comparison.result["rows"]} == {"handle": "m", "knob": "rad"}
    assert comparison.references["knob"].travel > 0.1
    assert "mrad" in text_of(comparison.result)
    draw_comparison(comparison, tmp_path / "two.png")
    assert (tmp_path / "two.png").stat().st_size > 10_000
