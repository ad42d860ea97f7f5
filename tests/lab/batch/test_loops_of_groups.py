"""The loop of a group as a kernel: against the loop with the plants themselves, and compiled."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from canhaptic.control.mechanisms.kinematics import PoseAsked
from canhaptic.control.mechanisms.transmission import Transmission
from canhaptic.control.multi_axis.group_kernel import why_not_world
from canhaptic.errors import ParameterError
from canhaptic.lab.batch.closed_loop import LinearMotors
from canhaptic.lab.batch.network_loop import Explained, network_loop, shares
from canhaptic.lab.batch.scalar import render, run_network
from canhaptic.lab.studies.chunk import ENGINES
from canhaptic.lab.studies.compare import compare
from canhaptic.lab.studies.store import SweepTable
from canhaptic.lab.studies.sweep import sweep
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.load import load_scene
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import Scene
from canhaptic.sim.plant.effects.backlash import Backlash
from tests.lab.sweep.conftest_sweep import REPOSITORY

_SCALING = "groups.0.passivity={algorithm: step_scaling}"


def scene_of(name: str, *overrides: str) -> Scene:
    return load_scene(REPOSITORY / "configs" / f"{name}.yaml", list(overrides))


def values_of(meter: Explained) -> dict[str, float]:
    found = asdict(meter)
    return {**found.pop("figures"), **found}


def random_scene(name: str, seed: int) -> Scene:
    """One of many scenes: another network, rate, delay and moving mass."""
    random = np.random.default_rng(seed)
    overrides = [
        f"groups.0.network.stiffness={10.0 ** random.uniform(2.0, 4.5)!r}",
        f"groups.0.network.damping={random.integers(2) * 10.0 ** random.uniform(-1.0, 1.5):.17g}",
        f"bus.rpdo={('synchronous', 'event')[random.integers(2)]}",
        f"bus.rate={random.choice([250, 500, 1000])}",
    ]
    if random.random() < 0.5:
        return scene_of(name, *overrides, _SCALING)
    return scene_of(name, *overrides, f"groups.0.passivity.moving_mass={random.uniform(0.05, 0.2)!r}")


STAGE = "simulation.mechanisms.0"
FRICTION = "{kinetic: 0.4, static: 0.6}"
STOP = "{type: hard_stop, side: upper, position: 0.004, stiffness: 2e4, damping: 20}"
LUGRE = "{type: lugre_friction, kinetic: 0.3, static: 0.5, stribeck_velocity: 0.01, bristle_stiffness: 1e4}"
NOISE = "{type: encoder_noise, deviation: 2e-6}, {type: encoder_quantisation, count: 1e-5}"
WEAK = "{type: torque_saturation, limit: 2}, {type: torque_quantisation, quantum: 0.01}"
LAG = "{type: current_loop, time_constant: 300 us}"
WITH_EVENTS = {
    "stage with friction": ("xy_box", f"{STAGE}.friction_x={FRICTION}", f"{STAGE}.friction_y={FRICTION}"),
    "friction in x": ("xy_box", f"{STAGE}.friction_x={FRICTION}"),
    "handles with stops": (
        "two_handles",
        f"simulation.axes.first.effects=[{STOP}, {{type: coulomb_friction, kinetic: 0.2, static: 0.3}}]",
        f"simulation.axes.second.effects=[{STOP}]",
    ),
    "handles with current loop and LuGre": (
        "two_handles",
        f"simulation.axes.first.effects=[{LAG}]",
        f"simulation.axes.second.effects=[{LUGRE}]",
    ),
    "handles with noise and saturation": (
        "two_handles",
        f"simulation.axes.first.effects=[{NOISE}]",
        f"simulation.axes.second.effects=[{WEAK}]",
    ),
    "five-bar": ("five_bar_sphere",),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", WITH_EVENTS)
def test_motors_with_events_do_what_the_plants_do(kind: str) -> None:
    scene = scene_of(*WITH_EVENTS[kind])
    case = network_loop(scene, explains=True)
    assert case.why_not == ""
    by_plants = values_of(run_network(case.with_objects(scene), 200))
    in_loop = values_of(run_network(case, 200))
    assert in_loop == pytest.approx(by_plants, rel=1e-6, abs=1e-10)
    name, *effects = WITH_EVENTS[kind]
    if effects and kind != "friction in x":  # the hand moves y
        without = values_of(run_network(network_loop(scene_of(name)), 200))
        assert in_loop["interaction"] != pytest.approx(without["interaction"], rel=1e-3)
    assert in_loop["torque_peak"] > 0.0


def test_what_a_group_cannot_compile_is_named() -> None:
    case = network_loop(scene_of("xy_box"))
    assert case.why_not == why_not_world(case.world) == ""
    own = case.world._replace(mechanism=PoseAsked(Transmission(matrix=((1.0, 0.0), (0.0, 1.0)))))
    assert why_not_world(own) == "got PoseAsked, which is Python code of its own"


@pytest.mark.slow
@pytest.mark.parametrize(("name", "seed"), [("xy_box", 1), ("xy_box", 2), ("two_handles", 2)])
def test_motors_as_one_flow_do_what_the_plants_do(name: str, seed: int) -> None:
    scene = random_scene(name, seed)
    case = network_loop(scene, explains=True)
    assert not case.why_not
    by_plants = values_of(run_network(case.with_objects(scene), 200))
    by_flow = values_of(run_network(case, 200))
    assert by_flow == pytest.approx(by_plants, rel=1e-9, abs=1e-13)
    assert by_flow["torque_peak"] > 0.0


@pytest.mark.slow
def test_what_is_held_is_explained_by_spring_and_damper() -> None:
    share, damper = shares(run_network(network_loop(scene_of("xy_box"), explains=True), 1000))
    assert share == pytest.approx(1.0, abs=0.03)
    assert damper == pytest.approx(1.0, abs=0.05)
    weak = scene_of("xy_box", "groups.0.passivity.moving_mass=1e-3")  # next to nothing is certified
    assert shares(run_network(network_loop(weak, explains=True), 1000))[0] < 0.5


def test_nothing_felt_has_no_share() -> None:
    away = scene_of("xy_box", "groups.0.network.lower=[-1, -1]", "groups.0.network.upper=[1, 1]")
    assert np.isnan(shares(run_network(network_loop(away, explains=True), 100))).all()


def test_a_plant_that_cannot_be_built_is_refused_and_not_counted_as_diverged() -> None:
    scene, loose = scene_of("two_handles"), ComponentSpec("backlash", Backlash(gap=1e-4))
    axes = tuple(replace(axis, simulation=replace(simulation_of(axis), effects=(loose,))) for axis in scene.axes)
    with pytest.raises(ParameterError, match="shaft_compliance"):
        network_loop(replace(scene, axes=axes))


@pytest.mark.slow
def test_a_number_that_is_not_finite_ends_the_loop() -> None:
    case = network_loop(scene_of("xy_box"))
    motors = case.motors.made(True)
    assert isinstance(motors, LinearMotors)
    far = case.motors._replace(made=lambda _listed: motors._replace(state=[float("nan"), *motors.state[1:]]))
    assert run_network(case._replace(motors=far), 10).figures.diverged == 1.0


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.campaign_but("two_handles-4")
@pytest.mark.parametrize("scenes", [4, 30])
@pytest.mark.parametrize("name", ["xy_box", "two_handles"])
def test_compiled_it_has_the_same_bits(name: str, scenes: int) -> None:
    pytest.importorskip("numba")
    for seed in range(scenes):
        case = network_loop(random_scene(name, seed), explains=True)
        expected, found = (values_of(run_network(case, 500, engine)) for engine in ("python", "numba"))
        assert repr(found) == repr(expected), seed


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.campaign_but("stage with friction", "five-bar")
@pytest.mark.parametrize("kind", [kind for kind in WITH_EVENTS if kind != "friction in x"])
def test_compiled_motors_with_events_have_the_same_bits(kind: str) -> None:
    pytest.importorskip("numba")
    name, *overrides = WITH_EVENTS[kind]
    for stiffness in (300.0, 3000.0):
        case = network_loop(scene_of(name, *overrides, f"groups.0.network.stiffness={stiffness}"), explains=True)
        expected, found = (values_of(run_network(case, 500, engine)) for engine in ("python", "numba"))
        assert repr(found) == repr(expected)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_sweep_of_groups_says_what_computed_it(tmp_path) -> None:
    pytest.importorskip("numba")
    found = []
    for engine in ("python", "numba"):
        path = tmp_path / f"{engine}"
        sweep(scene_of("xy_box"), ["groups.0.network.stiffness=500,3000"], path, cycles=300, engine=engine)
        with SweepTable(path) as table:
            computed = "scalar" if engine == "python" else engine
            assert table.engine().tolist() == [ENGINES.index(computed)] * 2
            found.append(table.figure("stage", "accounted_error").tolist())
    assert found[0] == found[1]


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_compiled_every_sync_of_a_group_is_that_of_python_but_for_rounding() -> None:
    pytest.importorskip("numba")
    scene = scene_of("five_bar_sphere")
    slow, fast = (render(scene, 500, engine=engine) for engine in ("python", "numba"))
    assert (slow.engine, fast.engine) == ("python", "numba")
    for name in ("position", "true_position", "torque", "interaction", "believed", "dissipated", "damping"):
        np.testing.assert_allclose(getattr(fast, name), getattr(slow, name), rtol=1e-6, atol=1e-9, err_msg=name)
    assert fast.summary.branches == slow.summary.branches
    (group,) = scene.groups
    name = group.passivity.name
    [over_can], [compiled] = (
        compare(scene, [name], duration=0.3, engine=engine).result["rows"] for engine in ("python", "numba")
    )
    assert (over_can["engine"], compiled["engine"]) == ("python", "numba")
    branches = [name for name in compiled if name.startswith("branches.")]
    assert len(branches) > 5
    assert [compiled[name] for name in branches] == [over_can[name] for name in branches]
    for key in ("in", "out", "dissipated"):
        assert compiled[key] == pytest.approx(over_can[key], rel=1e-6)
    assert compiled["interaction"] == pytest.approx(over_can["interaction"], rel=1e-6)
    assert compiled["passive"] == "yes"
