"""A list of environments or networks in a scene: its keys, what it prints, and what is refused."""

from typing import Any

import numpy as np
import pytest

import canhaptic
from canhaptic.audit.inspection import walls_of
from canhaptic.control.multi_axis import build_group_controller
from canhaptic.control.multi_axis.unprotected_group import UnprotectedGroup
from canhaptic.errors import SceneError
from canhaptic.lab.batch.cases import why_not_batchable
from canhaptic.lab.touch.two_sides import two_sides
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from canhaptic.scene.parts import loop_as_known
from canhaptic.view.series import notches_of

KNOB, PATH = "knob_with_stops", "path_in_a_box"
WALL = "{type: spring_damper_wall, stiffness: 1, damping: 0.1}"
PARTS = ("detents", "two_sided_wall", "viscous_medium")


def parts_of(*overrides: str) -> Any:
    return load_scene(KNOB, overrides).axes[0].environment.parts


class Gel(canhaptic.Environment):
    """Softer and softer."""

    def effort(self, state: float) -> float:
        return float(0.05 * np.arctan(20.0 * state))


def test_a_part_is_changed_by_its_place_or_by_its_type():
    by_place, by_type = parts_of("environment.1.upper=50 deg"), parts_of("environment.two_sided_wall.upper=50 deg")
    assert by_place == by_type != parts_of()
    assert tuple(part.name for part in by_place) == PARTS
    assert by_place[1].parameters.upper == pytest.approx(np.radians(50.0))


def test_what_is_resolved_is_the_list_with_its_defaults_and_makes_the_same_sum():
    scene = load_scene(KNOB)
    [axis] = scene.resolved()["axes"].values()
    assert [part["type"] for part in axis["environment"]] == list(PARTS)
    assert axis["environment"][0]["position"] == 0.0
    again = load_scene(KNOB, [f"environment={axis['environment']}".replace("'", "")])
    assert again.axes[0].environment == scene.axes[0].environment


def test_an_axis_replaces_the_shared_section_where_one_of_them_is_a_list():
    own = load_scene("demo", [f"axes.0.environment=[{WALL}, {{type: viscous_medium, damping: 3}}]"]).axes[0]
    assert own.environment.name == "spring_damper_wall + viscous_medium"
    assert load_scene(KNOB, [f"axes.0.environment={WALL}"]).axes[0].environment.name == "spring_damper_wall"
    assert load_scene(KNOB, [f"environment=[{WALL}]"]).axes[0].environment.name == "spring_damper_wall"


REFUSED = {
    "environment=[]": "environment: got an empty list, expected at least one environment",
    "environment.0.pich=2": "environment.0.pich: unknown key; did you mean 'pitch'?",
    "environment.1.stiffness=-1": "environment.1.stiffness: got -1, expected 0 <= stiffness",
    "environment.1={type: two_sided_wall, lower: 0.1, upper: 0.2, stiffness: 1}": r"environment: 0 \(detents\): .*no",
    "environment.1={type: guided_path}": "environment.1.type: got 'guided_path', a network of a group",
}


@pytest.mark.parametrize("override", REFUSED)
def test_a_fault_in_a_list_names_its_place(override):
    with pytest.raises(SceneError, match=REFUSED[override]):
        load_scene(KNOB, [override])


def test_a_sweep_says_why_no_compiled_loop_renders_a_sum():
    assert (
        why_not_batchable(load_scene(KNOB))
        == f"environment {' + '.join(PARTS)} is a sum, which no compiled loop renders"
    )


def test_a_display_renders_no_sum():
    with pytest.raises(SceneError, match="environment: a list is the sum of several, which an admittance display"):
        load_scene("admittance/wall", ["environment=[{type: virtual_mass, mass: 3}, {type: virtual_mass, mass: 2}]"])


def test_a_network_that_moves_by_itself_or_is_of_one_axis_does_not_add():
    wall = "{type: moving_wall, normal: [1, 0], offset: -0.01, amplitude: 0.001, frequency: 1, stiffness: 9}"
    with pytest.raises(SceneError, match=r"1 \(moving_wall\): cannot be added: it moves by itself"):
        load_scene(PATH, [f"groups.0.network.1={wall}"])
    with pytest.raises(SceneError, match="got 'detents', an environment of one axis"):
        load_scene(PATH, ["groups.0.network.1={type: detents}"])


def unprotected(network: Any) -> UnprotectedGroup:
    scene = load_scene(PATH)
    [group] = scene.groups
    loops = [loop_as_known(scene.axis(name)) for name in group.axes]
    kinematics: Any = group.kinematics.parameters
    made = build_group_controller(network, kinematics, "unprotected", None, loops)
    assert isinstance(made, UnprotectedGroup)
    return made


def test_the_forces_and_energies_of_networks_add():
    group = load_scene(PATH).groups[0]
    controllers = [unprotected(one.parameters) for one in (group.network, *group.network.parts)]
    chance, place = np.random.default_rng(1), np.zeros(2)
    for _ in range(60):
        place = place + chance.uniform(-4e-3, 4e-3, 2)
        whole, *parts = (made.step(place.tolist(), [0.0, 0.0]) for made in controllers)
        torques = [np.array(hold.torques) for hold in (whole, *parts)]
        assert torques[0] == pytest.approx(torques[1] + torques[2], rel=1e-9, abs=1e-12)


@pytest.mark.slow
def test_own_code_adds_to_what_is_built_in_and_its_log_gives_the_same_again(tmp_path):
    stops = {"type": "two_sided_wall", "lower": -0.3, "upper": 0.3, "stiffness": 0.5}
    result = canhaptic.simulate(KNOB, {"environment": [Gel, stops]}, duration=0.1)
    assert result.account.raw["ports"]["knob"]["environment"].endswith("two_sided_wall")
    assert result.account.verdict == "yes"


@pytest.mark.slow
def test_friction_in_a_medium_keeps_its_strain_and_writes_a_log(tmp_path):
    rubber = "[{type: coulomb_surface, friction: 2, stiffness: 900, damping: 1}, {type: viscous_medium, damping: 3}]"
    scene, log = load_scene("demo", [f"environment={rubber}"]), tmp_path / "run.h5"
    assert two_sides(scene).sliders[-1].title == "viscous_medium: damping"
    with build(scene, "free", log) as experiment:
        assert experiment.run_through(40)[1] is None
    with EnergyLog.open(log) as read:
        assert read.attributes["handle.damping_asked"] == 4.0
        assert read.attributes["handle.environment"] == "coulomb_surface + viscous_medium"


@pytest.mark.slow
def test_the_walls_of_a_sum_and_its_notches_are_in_its_log(tmp_path):
    log = tmp_path / "run.h5"
    with build(load_scene(KNOB), "free", log) as experiment:
        assert experiment.run_through(60)[1] is None
    with EnergyLog.open(log) as read:
        assert [side for _, side in walls_of(read, "knob")] == ["below", "above"]
        assert notches_of(read, "knob", -0.4, 0.4) == pytest.approx([-np.pi / 12, 0.0, np.pi / 12])
