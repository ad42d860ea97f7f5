"""Groups of axes and simulated mechanisms in a scene: read, checked, resolved, shown in the schema and by `check`."""

import itertools
import json
from pathlib import Path
from typing import Any

import pytest

from canhaptic.control.multi_axis.group_certificates import axes_of
from canhaptic.control.multi_axis.group_controller import AxisGroup
from canhaptic.control.passivity import LoopProperties
from canhaptic.cycle import Cycle, run
from canhaptic.errors import ParameterError, SceneError
from canhaptic.scene.build import build
from canhaptic.scene.hints import hints_of
from canhaptic.scene.load import load_scene
from canhaptic.scene.method import method_line
from canhaptic.scene.parts import build_axis_controller, build_ports
from tests.control.network.networks import AxesApart
from tests.scene.scene_text import REPOSITORY

CONFIGS = REPOSITORY / "configs"
STAGE, LINKS, HANDLES = (CONFIGS / f"{name}.yaml" for name in ("xy_box", "five_bar_sphere", "two_handles"))

LINEAR = "; ".join(f"axes.left.{key}" for key in ("unit=m", "counts_per_unit=1e6", "rated_torque=2", "torque_limit=2"))
LINEAR += "; groups.0.passivity={algorithm: guarded, moving_mass: 0.001, hand_force: 0, device_damping_bound: 0}"


def faults(path: Path, *overrides: str) -> list[str]:
    with pytest.raises(SceneError) as caught:
        load_scene(path, overrides)
    return list(caught.value.faults)


@pytest.mark.parametrize(
    ("path", "override", "words"),
    [
        (STAGE, "groups.0.axes=[x, z]", "groups.0.axes.1: got 'z', expected the name of an axis: x, y"),
        (STAGE, "groups.0.axes=[x, x]", "'x', which is in a group already"),
        (STAGE, "groups.0.axes=[]", "expected names of axes"),
        (STAGE, "groups.0.axes=[x]", "environment: missing; give it here or in the axis"),
        (STAGE, "groups.0.kinematics={type: identity, axes: 3}", "has 3 motor axes, expected the 2 of the group: x, y"),
        (STAGE, "groups.0.network={type: sphere, centre: [0.0], radius: 1, stiffness: 1}", "sphere.centre: got 1"),
        (STAGE, "groups.0.name=x", "groups.0.name: got 'x', which is the name of an axis"),
        (STAGE, "groups.0.colour=red", "groups.0.colour: unknown key"),
        (STAGE, "groups.0.network.type=bax", "unknown network 'bax', expected one of"),
        (STAGE, "groups.0.network.stiffness=-1", "groups.0.network.stiffness: got -1, expected 0 <= stiffness"),
        (STAGE, "groups.0.network.stiffness=5 N*m/rad", "does not fit; expected [N/m]"),
        (
            STAGE,
            "groups.0.network={type: general, storages: [{type: spring, stiffness: -1}]}",
            "groups.0.network.storages.0.stiffness: got -1, expected 0 <= stiffness <= 1e9",
        ),
        (STAGE, "groups.0.network.stifness=5", "groups.0.network.stifness: unknown key; did you mean 'stiffness'?"),
        (STAGE, "groups.0.network=null", "groups.0.network: missing, expected type"),
        (STAGE, "groups.0.passivity={algorithm: guarded}", "got neither moving_mass of every axis"),
        (STAGE, "groups.0.passivity.algorithm=a_priori_dissipation", "unknown group algorithm 'a_priori_dissipation'"),
        (STAGE, "groups.0.passivity.delay=0", "groups.0.passivity.delay: got 0, but bus.rpdo: synchronous"),
        (STAGE, "groups=5", "groups: got 5, expected a list of groups"),
        (STAGE, "environment={type: free_space}", "environment: every axis is in a group"),
        (STAGE, "axes.x.environment={type: free_space}", "group 'stage' renders on this axis; leave it out"),
        (STAGE, "axes.x.passivity={alpha: 3 s/m^2}", "renders on this axis; give it in the group"),
        (LINKS, "groups.0.kinematics.base=2 m", "base: got 2 m, expected < 0.7 m"),
        (LINKS, "groups.0.kinematics.type=delta", "unknown kinematics 'delta'"),
        (
            LINKS,
            "simulation.mechanisms.0.type=six_bar",
            "unknown mechanism 'six_bar', expected one of: five_bar, xy_stage",
        ),
        (LINKS, "simulation.mechanisms.0.axes=[left]", "got 1 axes, expected the 2 of a five_bar"),
        (LINKS, "simulation.mechanisms.0.axes=[left, middle]", "got 'middle', expected the name of an axis"),
        (LINKS, "simulation.mechanisms.0.initial_angles=[180 deg, 0 deg]", "which is a singular pose"),
        (LINKS, "simulation.mechanisms.0.handle_mass=-1", "handle_mass: got -1, expected 0 <= handle_mass"),
        (LINKS, "simulation.mechanisms.0.hand.stiffness=1 N", "does not fit; expected [N/m]"),
        (LINKS, "simulation.mechanisms.0.hand.grip=1", "hand.grip: unknown key"),
        (
            LINKS,
            "simulation.axes={left: {plant: {mass: 1}}}",
            "moves a mechanism, which has masses and hand of its own",
        ),
        (LINKS, LINEAR, "got 'left' with unit m, expected unit: rad, in which the motors of a five_bar move"),
        (HANDLES, "simulation.mechanisms=[{type: xy_stage, axes: [first, second], mass_x: 1}]", "mass_y: missing"),
    ],
)
def test_what_is_wrong_is_one_clear_fault_at_its_place(path: Path, override: str, words: str) -> None:
    found = faults(path, *override.split("; "))
    assert any(words in line for line in found), found


def test_a_fault_of_the_kinematics_leaves_the_units_of_the_network_as_they_are() -> None:
    for fault, words in (("base=2 m", "base: got 2 m"), ("type=delta", "unknown kinematics 'delta'")):
        [found] = faults(LINKS, f"groups.0.kinematics.{fault}")
        assert words in found
        assert "a mapping" not in found


def test_an_axis_may_know_more_of_its_own_loop_than_the_group() -> None:
    scene = load_scene(STAGE, ["axes.y.passivity={moving_mass: 0.1 kg}"])
    assert [axis.loop.moving_mass for axis in scene.axes] == [0.2, 0.1]
    assert [axis.group for axis in scene.axes] == ["stage", "stage"]


def test_a_group_stays_within_the_limits_of_each_axis_before_it_is_certified() -> None:
    """What a limiter cut of one axis would turn the torque of the group."""
    limits = ["axes.y.torque_rate_limit=100 N/s", "axes.x.power_limit=0.05 W"]
    rises: list[float] = []
    for values in ([], limits):
        with build(load_scene(STAGE, values), "free") as experiment:
            cycle, sent = experiment.cycle, [0.0]
            group: Any = cycle.ports[0]

            def compare(_cycles: int, cycle: Cycle = cycle, sent: list[float] = sent, group: Any = group) -> None:
                for drive, torque in zip(cycle.rig.drives, group.balance.torques, strict=True):
                    assert abs(drive.limiter.last - torque) < 1e-12
                sent.append(group.balance.torques[1])

            run(cycle, 400, progress=compare)
        rises.append(max(abs(new) - abs(old) for old, new in itertools.pairwise(sent)))
    step = 100.0 * load_scene(STAGE).bus.sample_time
    assert 0.0 < rises[1] <= step + 1e-9 < rises[0]


def test_the_identity_counts_the_axes_of_its_group() -> None:
    scene = load_scene(HANDLES)
    assert scene.groups[0].kinematics.name == "identity"
    assert scene.groups[0].kinematics.parameters.model_dump()["axes"] == 2


def test_groups_and_mechanisms_belong_to_the_configuration_in_effect() -> None:
    scene, other = load_scene(LINKS), load_scene(LINKS, ["groups.0.network.stiffness=801"])
    hand = load_scene(LINKS, ["simulation.mechanisms.0.hand.stiffness=201"])
    assert len({scene.config_hash(), other.config_hash(), hand.config_hash()}) == 3
    resolved = json.loads(json.dumps(scene.resolved()))
    assert resolved["groups"]["stylus"]["axes"] == ["left", "right"]
    assert resolved["groups"]["stylus"]["network"]["stiffness"] == 800.0
    assert resolved["axes"]["left"]["environment"] == {"type": "group", "group": "stylus"}
    assert resolved["simulation"]["mechanisms"][0]["hand"]["damping"] == 5.0
    assert "plant" not in resolved["axes"]["left"]["simulation"]


def test_a_scene_without_groups_says_nothing_of_them() -> None:
    resolved = load_scene(CONFIGS / "demo.yaml").resolved()
    assert "groups" not in resolved
    assert "mechanisms" not in resolved["simulation"]


def test_an_axis_of_a_group_has_no_controller_of_its_own() -> None:
    scene = load_scene(STAGE)
    with pytest.raises(ParameterError, match="unknown passivity algorithm 'group'"):
        build_axis_controller(scene.axes[0])
    [group] = build_ports(scene)
    assert isinstance(group, AxisGroup)
    assert (group.name, group.axes) == ("stage", (0, 1))


def test_the_method_says_what_of_the_far_side_is_not_exact() -> None:
    assert "five_bar of order 2" in method_line(load_scene(LINKS))
    assert "order" not in method_line(load_scene(STAGE))


def test_substeps_of_the_accuracy_reach_the_mechanism() -> None:
    assert load_scene(LINKS, ["accuracy={substeps: 4}"]).mechanisms[0].substeps == 4


def test_hints_are_those_of_the_groups_certificates_for_each_axis() -> None:
    scene = load_scene(STAGE)
    held = [hint for hint in hints_of(scene) if hint.what == "stiffness, certified by hand force"]
    assert [(hint.axis, hint.requested, hint.unit) for hint in held] == [("x", 1500.0, "N/m"), ("y", 1500.0, "N/m")]
    assert held[0].limit == pytest.approx(0.2 / (6 * 1e-3**2))  # m / 6 T^2 at delay 1 (design 2.4)
    turning = [hint for hint in hints_of(load_scene(LINKS)) if hint.what == "stiffness, certified by hand force"]
    assert [(hint.unit, hint.requested) for hint in turning] == [("N*m/rad", None)] * 2


def test_hints_say_what_lost_frames_and_a_hand_on_every_axis_leave() -> None:
    def held(*overrides: str) -> Any:
        hints = {hint.what: hint for hint in hints_of(load_scene(HANDLES, overrides)) if hint.axis == "first"}
        return hints["stiffness, certified by hand force"], hints.get("stretch before a coupling pulls")

    plain, none = held("groups.0.passivity.max_consecutive_losses=0")
    assert (plain.limit, none) == (pytest.approx(0.2 / (6 * 1e-3**2)), None)  # delay 1: m / 6 T^2
    lossy, extension = held("groups.0.passivity.max_consecutive_losses=1")
    assert lossy.limit == pytest.approx(0.2 / (12 * 1e-3**2))  # three holds: 2 (1 + 2 + 3)
    assert "max_consecutive_losses 1: 3 holds" in lossy.text
    assert extension.limit == pytest.approx(6e-3)  # 2 H T, in m for each m/s
    pulled, _ = held("groups.0.passivity.max_consecutive_losses=0", "groups.0.passivity.hand_force=10")
    assert pulled.limit == pytest.approx(0.2 / (6 * 1e-3**2) * 20.0 / (20.0 + 10.0 * 2.0**0.5))  # torque limit 20 N
    assert "on each of 2 axes" in pulled.text


def test_the_hint_for_lost_frames_is_what_the_certificates_do() -> None:
    scene = load_scene(HANDLES, ["groups.0.passivity.max_consecutive_losses=1"])
    loops = [LoopProperties(sample_time=1e-3, delay=1, moving_mass=0.2, device_damping_bound=0.0)] * 2
    apart = AxesApart(axes_of(tuple(loops), 0.0, None), 1, 1)
    still, torques = (0.0, 0.0), (20.0, 0.0)
    apart.take(still, still, torques, [torques])
    limit = next(h.limit for h in hints_of(scene) if h.what == "stiffness, certified by hand force")
    assert limit is not None
    assert apart.share_per_axis(torques, 0.999 * 20.0**2 / (2.0 * limit)) < 1.0
    assert apart.share_per_axis(torques, 1.001 * 20.0**2 / (2.0 * limit)) == 1.0


def test_the_drives_of_a_mechanism_share_it() -> None:
    with build(load_scene(STAGE)) as experiment:
        assert experiment.far_side is not None
        x, y = (drive.servo.motor for drive in experiment.far_side.drives)
        assert x.shared is y.shared  # type: ignore[attr-defined]
        assert experiment.plants == []
