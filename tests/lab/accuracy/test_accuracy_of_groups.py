"""The references of groups: equations of mechanisms, and a network in continuous time, each against another way."""

from functools import partial
from typing import Any, cast

import numpy as np
import pytest

from canhaptic.control.multi_axis.group_kernel import GroupMotion as MotionState
from canhaptic.control.multi_axis.group_kernel import (
    MotionAhead,
    RequestedEfforts,
    begin_motion,
    follow,
    motion_memory,
    motion_settings,
    world_of,
    write_efforts,
)
from canhaptic.lab.batch.object_loop import motors_of
from canhaptic.lab.batch.scalar import render
from canhaptic.lab.judge.reference_group import mechanism_model
from canhaptic.lab.judge.solvers import located
from canhaptic.lab.loop.axis_loop import Reach, at_rate
from canhaptic.lab.reference import continuous_motion, group_model
from canhaptic.lab.studies.accuracy.loop_sensitivity import engines_of, settings_now, variants
from canhaptic.lab.studies.accuracy.plant_solvers import OURS, plants_of
from canhaptic.lab.studies.accuracy.study import AccuracyStudy
from canhaptic.lab.studies.accuracy.timing import ProcessorTime
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import Scene
from canhaptic.sim.plant import AccuracyParameters
from canhaptic.sim.plant.contact import DryFriction
from canhaptic.sim.plant.mechanism.five_bar_linkage import FiveBarLinkage
from canhaptic.sim.plant.mechanism.xy_stage import XYStage
from tests.lab.sweep.conftest_sweep import REPOSITORY
from tests.plant.mechanism.mechanism_scenes import HAND, LINKS, STAGE, OpenChains, integrated, stage, wavy

MS = 1_000_000


def scene_of(name: str, *overrides: str) -> Scene:
    return load_scene(REPOSITORY / "configs" / f"{name}.yaml", list(overrides))


@pytest.mark.slow
def test_the_five_bar_in_accelerations_is_two_open_chains_held_together() -> None:
    model, chains = mechanism_model(FiveBarLinkage(**LINKS), HAND), OpenChains()
    found = integrated(partial(model.rates, modes=model.first), model.start, wavy(100), 1e-3)
    expected = integrated(chains.rates, chains.start(), wavy(100), 1e-3)  # type: ignore[arg-type]
    assert np.ptp(expected[:, 0]) > 0.02
    assert np.abs(found[:, :2] - expected[:, :2]).max() < 1e-10
    assert np.abs(found[:, 2:4] - expected[:, 4:6]).max() < 1e-8


def test_the_stage_by_a_solver_is_the_exact_one() -> None:
    model, exact = mechanism_model(XYStage(**STAGE), HAND), stage()
    found = integrated(partial(model.rates, modes=model.first), model.start, wavy(100), 1e-3)
    exact.begin(0)
    for k, pair in enumerate(wavy(100)):
        exact.advance_to((k + 1) * MS, pair)
    assert np.abs(found[-1, :2] - exact.positions).max() < 1e-11
    works = [sum(getattr(exact.energy(axis), of) for axis in (0, 1)) for of in ("motor", "user")]
    assert model.works(found[-1]) == pytest.approx(works, abs=1e-11)


def held_finely(scene: Scene, cycles: int) -> np.ndarray:
    """Positions of a group whose motors hold what its network asks for at every SYNC, with nothing in between."""
    group = scene.groups[0]
    axes = [scene.axis(name) for name in group.axes]
    ideal = [axis.loop.model_copy(update={"encoder_count": 0.0}) for axis in axes]
    world = world_of(cast(Any, group.network.parameters), cast(Any, group.kinematics.parameters), tuple(ideal))
    settings = motion_settings(world, tuple(ideal))
    memory, state, motors = motion_memory(world, settings), MotionState(), motors_of(scene, axes)
    request, still = RequestedEfforts(*([0.0] * len(axes) for _ in range(4))), [0.0] * len(axes)
    before, rows = list(motors.positions()), [list(motors.positions())]
    begin_motion(world, settings, state, memory, before)
    for cycle in range(1, cycles):
        motors.advance_to(
            cycle * scene.bus.sample_time_ns, tuple(-s - d for s, d in zip(request.spring, request.damper, strict=True))
        )
        at = list(motors.positions())
        follow(world, settings, state, memory, at, [b - a for a, b in zip(before, at, strict=True)], 1)
        write_efforts(world, settings, state, memory, MotionAhead(0.0, still, still, False), request)
        before = at
        rows.append(at)
    return np.array(rows)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "start"), [("xy_box", 0.0), ("five_bar_sphere", 0.0), ("two_handles", 0.0)])
def test_the_continuous_group_is_what_ever_finer_holds_come_to(name: str, start: float) -> None:
    quick = "simulation.mechanisms.0.hand.motion.x.frequency=4 Hz"
    scene = scene_of(name, *([] if name == "two_handles" else [quick]))
    exact = continuous_motion(scene, 250_000, 800)
    apart = []
    for factor in (4, 8):
        finer = at_rate(scene, 1000.0 * factor)
        rows = held_finely(finer, 200 * factor + 1)[:: factor // 4]
        apart.append(np.abs(rows - exact.position).max())
    assert exact.apart < 1e-7
    assert np.abs(exact.impulse).max() > 1e-3  # something is felt
    assert apart[1] < 0.62 * apart[0] < 1e-3  # of order 1 in the hold


def rough(name: str) -> Scene:
    """A scene of a group whose guides have dry friction."""
    if name == "two_handles":
        friction = "[{type: coulomb_friction, kinetic: 2 N, static: 3 N}]"
        return scene_of(name, f"simulation.effects={friction}")
    mechanism = "simulation.mechanisms.0"
    x, y = "{kinetic: 0.5 N, static: 0.8 N}", "{kinetic: 0.2 N, static: 0.2 N}"
    quick = f"{mechanism}.hand.motion.x.frequency=4 Hz"
    return scene_of(name, f"{mechanism}.friction_x={x}", f"{mechanism}.friction_y={y}", quick)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["xy_box", "two_handles"])
def test_the_continuous_group_with_dry_friction_is_what_ever_finer_holds_come_to(name: str) -> None:
    scene = rough(name)
    exact = continuous_motion(scene, 1_000_000, 150)
    apart = []
    for factor in (4, 8):
        finer = at_rate(scene, 1000.0 * factor)
        apart.append(np.abs(held_finely(finer, 150 * factor + 1)[::factor] - exact.position).max())
    assert group_model(scene).switches
    assert (np.diff(exact.position, axis=0) == 0.0).any()  # stuck
    assert np.abs(np.diff(exact.position, axis=0)).max() > 1e-6  # sliding
    assert exact.apart < 1e-6
    assert apart[1] < 0.65 * apart[0] < 1e-3


@pytest.mark.slow
def test_a_group_with_dry_friction_is_studied() -> None:
    result = AccuracyStudy(rough("xy_box"), budget=0.0, duration=0.05).run()
    assert result["plant"][0]["position_error"] < 1e-9
    orders = {row["method"]: row["declared"] for row in result["orders"]}
    assert orders["RK4"] == 1
    assert all(row["position_error"] > 0.0 for row in result["loop"])


@pytest.mark.slow
def test_the_loop_of_a_box_comes_nearer_with_the_rate() -> None:
    result = AccuracyStudy(scene_of("xy_box"), budget=0.0, duration=0.2).run()
    rates = {row["rate"]: row for row in result["loop"] if row["group"] in ("as it is", "sample rate")}
    errors = [rates[rate]["position_error"] for rate in (250.0, 1000.0, 4000.0)]
    assert errors[0] > 2.0 * errors[1] > 4.0 * errors[2] > 0.0
    assert result["plant"][0]["setting"] == "exact"
    orders = {row["method"]: row["fitted"] for row in result["orders"]}
    assert orders["RK4"] == pytest.approx(4.0, abs=0.1)


@pytest.mark.slow
def test_a_group_that_diverges_is_said_so() -> None:
    scene = scene_of("xy_box")
    run = render(scene, 400, Reach(-1e-3, 1e-3))
    assert run.ended == "diverged"
    assert run.position.shape == (len(run.interaction), 2)


ROUGH: dict[str, Any] = {
    "friction_x": DryFriction(static=4.0, kinetic=2.0), "friction_y": DryFriction(static=1.5, kinetic=1.5),
    "initial_position": (0.0, 0.25),
}  # fmt: skip


@pytest.mark.slow
def test_a_stage_that_sticks_and_slides_is_the_exact_one() -> None:
    model, exact = mechanism_model(XYStage(**{**STAGE, **ROUGH}), HAND), stage(**ROUGH)
    torques = [(1.5 * np.sin(0.06 * k), 0.6 * np.cos(0.09 * k)) for k in range(400)]
    motion = located(model, torques, MS, "DOP853", 1e-12, 1e-15)
    exact.begin(0)
    found = []
    for k, pair in enumerate(torques):
        exact.advance_to((k + 1) * MS, pair)
        found.append([*exact.positions, *exact.velocities])
    still = (np.abs(np.array(found)[:, 2:]) < 1e-9).sum(axis=0)
    assert exact.events >= 6  # changes between sticking and sliding
    assert (still >= 5).all()  # both guides were stuck for some holds
    assert np.abs(np.hstack([motion.position, motion.velocity]) - found).max() < 1e-9
    works = [sum(getattr(exact.energy(axis), of) for axis in (0, 1)) for of in ("motor", "user")]
    assert (motion.motor[-1], motion.user[-1]) == pytest.approx(works, abs=1e-9)


def test_a_group_names_its_present_settings_like_an_axis() -> None:
    now = settings_now(scene_of("xy_box"))
    assert (now["torque step"], now["encoder count"]) == ("0.01 N", "1e-06 m")


def test_a_group_is_compiled_where_one_size_of_it_runs_long_enough() -> None:
    pytest.importorskip("numba")
    every = variants(scene_of("xy_box"), scene_of("xy_box"))
    second = 10**9
    assert set(engines_of(every, second, "auto")) == {"python"}
    assert set(engines_of(every, second, "numba")) == {"numba"}
    chosen = {of.group: engine for of, engine in zip(every, engines_of(every, 200 * second, "auto"), strict=True)}
    assert chosen["as it is"] == chosen["torque step"] == "numba"  # one compiled loop for several variants
    assert chosen["RPDO"] == "python"  # the only one with rings of its lengths


@pytest.mark.slow
def test_an_effect_of_one_plant_of_a_group_is_priced_against_that_plant() -> None:
    scene = rough("two_handles")
    study = AccuracyStudy(scene, budget=0.0, duration=0.02)
    plants = plants_of(study.alone, 20, lambda: False)
    assert list(plants.measure_effects(AccuracyParameters()))
    first, second = scene.groups[0].axes
    seconds = {
        f"{first}:": 5.0,
        f"{first}: coulomb_friction": 4.0,
        f"{second}:": 9.0,
        f"{second}: coulomb_friction": 7.0,
    }
    assert set(plants.without) == set(seconds)
    study._times = {f"without {name}": ProcessorTime(time, 0.01, 3) for name, time in seconds.items()}
    saved = [row["us_saved_per_period"] * study.holds * 1e-6 for row in study._effect_rows(plants)]
    assert saved == pytest.approx([1.0, 2.0])


@pytest.mark.slow
def test_our_settings_are_tried_where_only_one_plant_of_a_group_has_friction() -> None:
    friction = "simulation.axes.second.effects=[{type: coulomb_friction, kinetic: 2 N, static: 3 N}]"
    plants = plants_of(AccuracyStudy(scene_of("two_handles", friction)).alone, 20, lambda: False)
    assert list(plants.measure())
    ours = [row["setting"] for row in plants.rows if row["method"] == OURS]
    assert len(set(ours)) == len(ours) > 1
    assert all("bits" in setting for setting in ours)
    assert all(row["status"] == "ok" for row in plants.rows if row["method"] == OURS)
