"""Groups of axes in a sweep: a loop without a bus, which the loop over the bus confirms."""

from dataclasses import replace

import numpy as np
import pytest

from canhaptic.control.mechanisms.kinematics import Identity
from canhaptic.control.port_hamiltonian.shapes.box import Box
from canhaptic.errors import InputError
from canhaptic.lab.batch.cases import why_not_batchable
from canhaptic.lab.batch.scalar import run_scalar
from canhaptic.lab.studies.compare import compare
from canhaptic.lab.studies.store import SweepTable
from canhaptic.lab.studies.sweep import sweep
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.load import load_scene
from tests.lab.sweep.conftest_sweep import REPOSITORY

STAGE, LINKS, HANDLES = (
    REPOSITORY / "configs" / f"{name}.yaml" for name in ("xy_box", "five_bar_sphere", "two_handles")
)


@pytest.mark.slow
@pytest.mark.parametrize("path", [STAGE, LINKS], ids=lambda path: path.stem)
def test_a_group_without_a_bus_has_the_account_of_the_one_over_the_bus(path):
    scene = load_scene(path)
    group = scene.groups[0]
    compared = compare(scene, [group.passivity.name], duration=0.3).result
    [over_the_bus] = compared["rows"]
    alone = run_scalar(scene, compared["cycles"])
    assert alone["branches.exact"] == over_the_bus["branches.exact"] > 30
    assert alone["branches.free"] == over_the_bus["branches.free"]
    assert alone["accounted_error"] == pytest.approx(over_the_bus["accounted_error"], rel=1e-9)
    assert alone["least_interaction"] == pytest.approx(over_the_bus["least_interaction"], abs=1e-12)
    assert alone["damping_rendered.most"] == pytest.approx(over_the_bus["damping_rendered.most"], rel=1e-9)
    assert np.isnan(alone["travel"])


@pytest.mark.slow
def test_every_row_of_a_group_is_the_scene_written_by_hand(tmp_path):
    vary = ["groups.0.network.stiffness=500,3000", "groups.0.network.damping=2,20"]
    sweep(load_scene(STAGE), vary, tmp_path / "a", cycles=200)
    with SweepTable(tmp_path / "a") as table:
        assert list(table.axes) == ["stage"]
        assert table.status().tolist() == [1] * 4
        found = []
        for row in range(4):
            chosen = [f"{key}={float(table.values(key)[row])!r}" for key in table.keys]
            by_hand = run_scalar(load_scene(STAGE, chosen), 200)
            found.append(table.figure("stage", "believed_error")[row])  # the name of an earlier release
            assert found[-1] == by_hand["accounted_error"] > 0.0
            assert table.figure("stage", "torque_peak")[row] == by_hand["torque_peak"]
    assert len(set(found)) == 4


@pytest.mark.slow
def test_two_handles_are_two_plants():
    scene = load_scene(HANDLES)
    found = run_scalar(scene, 300)
    assert "coupling" in why_not_batchable(scene)
    assert found["diverged"] == 0.0
    assert found["torque_peak"] > 0.1
    assert found["least_interaction"] > -1e-6


def test_motors_that_move_with_others_are_refused_in_words():
    scene = load_scene(STAGE)
    kinematics = ComponentSpec("identity", Identity(axes=1))
    network = ComponentSpec("box", Box(stiffness=100.0, lower=(-0.1,), upper=(0.1,)))
    group = replace(scene.groups[0], axes=("x",), kinematics=kinematics, network=network)
    with pytest.raises(InputError, match="its mechanism x, y"):
        run_scalar(replace(scene, groups=(group,), axes=scene.axes[:1]), 10)
