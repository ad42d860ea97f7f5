"""Loops compiled with their plant whose every SYNC is kept: as the loop that Python runs, but for rounding."""

from dataclasses import replace

import numpy as np
import pytest

from canhaptic.control.balance import EnergyBalance
from canhaptic.lab.batch.closed_loop import CycleState, room_for
from canhaptic.lab.batch.scalar import record, render, work_of
from canhaptic.lab.loop.axis_loop import Reach, Recorder, loop_case
from canhaptic.lab.studies.accuracy.loop_sensitivity import engines_of, variants
from canhaptic.lab.studies.compare import compare
from canhaptic.scene.load import load_scene
from tests.lab.batch.test_event_plants import PLANTS, demo


def case_of(scene):
    return loop_case(scene.axes[0], scene)


@pytest.mark.parametrize("motors", [1, 2])
def test_a_row_holds_what_a_recorder_takes(motors):
    pytest.importorskip("numba")
    from canhaptic.lab.batch.compiled_loops import keep

    width = 17 + 3 * motors
    values = [float(i) for i in range(width)]
    balance = EnergyBalance(*values[-16:])  # type: ignore[arg-type]
    rows, recorder = [[0.0] * width, [0.0] * width], Recorder(motors)
    room, place = room_for(motors), CycleState(cycle=1, supplied=3.0, work=3.0)
    buffers = zip((room.seen, room.true, room.held), (1, 1 + motors, 1 + 2 * motors), strict=True)
    for buffer, first in buffers:
        buffer[:] = values[first : first + motors]
    keep(None, [], room, place, rows, balance)
    assert rows == [[0.0] * width, values]
    record(None, [], room, place, recorder, balance)
    assert recorder.run().rows.tolist() == rows[1:]


def test_what_cannot_be_compiled_runs_in_python_and_says_why():
    case = case_of(load_scene("configs/demo.yaml"))
    moved_from_outside = render(replace(case, simulation=None), 20, engine="numba")
    assert moved_from_outside.engine == "python: the plant does not come from a scene"
    assert moved_from_outside.position.tolist() == render(case, 20).position.tolist()


def test_compiling_pays_for_long_runs_and_for_forces_over_substeps():
    light, heavy = case_of(load_scene("configs/demo.yaml")), case_of(demo(PLANTS["LuGre"]))
    assert work_of(heavy, 1000) > work_of(light, 1000) == 1000
    scene = demo(PLANTS["LuGre"])
    of_study = variants(scene, scene)
    chosen = dict(zip([one.setting for one in of_study], engines_of(of_study, 10**9, "auto"), strict=True))
    assert {name: engine for name, engine in chosen.items() if engine == "numba"}
    assert chosen["unprotected"] == "python"  # alone it is over before it is compiled


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("plant", ["", "stop and friction", "LuGre"])
def test_compiled_a_run_is_that_of_python_but_for_rounding(plant):
    pytest.importorskip("numba")
    scene = demo(PLANTS.get(plant, ""), algorithm="unprotected")
    case = case_of(scene)
    slow, fast = (render(case, 1500, Reach(-1.0, 1.0), engine=engine) for engine in ("python", "numba"))
    assert (slow.engine, fast.engine) == ("python", "numba")
    for name in ("position", "true_position", "torque", "interaction", "believed", "dissipated", "damping"):
        np.testing.assert_allclose(getattr(fast, name), getattr(slow, name), rtol=1e-6, atol=1e-9, err_msg=name)
    assert fast.summary.branches == slow.summary.branches
    found = compare(scene, ["unprotected"], duration=0.2, repeats=0, engine="numba").result
    assert [row["engine"] for row in found["rows"]] == ["numba"]


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_compiled_a_run_that_diverges_ends_where_that_of_python_does():
    pytest.importorskip("numba")
    unstable = demo("", "environment.damping=2000", "simulation.plant.mass=0.01", algorithm="unprotected")
    for furthest in (0.05, 1e300):
        slow, fast = (
            render(case_of(unstable), 1500, Reach(-furthest, furthest), engine=engine) for engine in ("python", "numba")
        )
        assert (fast.ended, len(fast.position)) == (slow.ended, len(slow.position))
        assert slow.ended == "diverged" or furthest > 1.0
