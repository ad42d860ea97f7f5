"""What people have in Python - a wall, a hand, an array, a figure - typed as they would, at the first try."""

import json
import linecache
import multiprocessing
import re
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

import canhaptic
from canhaptic.audit.recompute import recompute_all
from canhaptic.cli.main import main
from canhaptic.control.damping import DamperVelocity
from canhaptic.control.passivity.stepped import SteppedController
from canhaptic.control.passivity.unprotected import Reply, sampled_kernel
from canhaptic.errors import InputError, SceneError
from canhaptic.lab.studies import compare
from canhaptic.scene import given, own_code

Cell = Callable[[str], dict[str, Any]]


@pytest.fixture
def cell(monkeypatch: pytest.MonkeyPatch) -> Cell:
    """Runs a cell as a notebook does: its module has no file, and its lines are known to `linecache`."""
    notebook = ModuleType("notebook_of_a_test")
    monkeypatch.setitem(sys.modules, notebook.__name__, notebook)
    numbers = iter(range(100))

    def run(text: str) -> dict[str, Any]:
        name = f"<ipython-input-{next(numbers)}>"
        linecache.cache[name] = len(text), None, text.splitlines(keepends=True), name
        exec(compile(text, name, "exec"), vars(notebook))
        return vars(notebook)

    return run


WALL = """
import canhaptic
from canhaptic import Environment

class MyWall(Environment):
    stiffness: float = 200.0

    def effort(self, state):
        return self.stiffness * state
"""


@pytest.mark.slow
def test_own_wall_in_a_notebook(cell: Cell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cell(WALL)
    text = 'result = canhaptic.simulate("demo", {"environment": MyWall(stiffness=300)}, duration=0.6, progress=False)'
    result = cell(text)["result"]
    assert result.account.passive == "yes"
    assert result.account["handle"].energy_in > 1e-4
    path = result.save(tmp_path / "run.h5")
    with canhaptic.EnergyLog(path) as log:
        assert "self.stiffness * state" in str(log.attributes["own_source"])
        assert [port["mismatch"] for port in recompute_all(log)] == [None]
        monkeypatch.setattr(own_code, "GIVEN", {})  # as in another process
        with pytest.raises(SceneError, match=r"MyWall: .* another process does not have; put it into a file"):
            recompute_all(log)


PARTS = """
def spring(state, stiffness=300.0):
    return stiffness * state

def tug(time, position, velocity):
    return -8.0 if time > 0.05 else 0.0

def drag(time, position, velocity, viscosity=3.0):
    return -viscosity * velocity

from canhaptic.control.passivity.unprotected import Reply

def half(run, hold, asked):
    return Reply(0.5, 0.5 * asked.spring, 0.5 * asked.damper, 0.0, 0.5 * asked.damping)
"""


@pytest.mark.slow
def test_functions_are_a_wall_a_hand_an_effect_and_an_algorithm(cell: Cell) -> None:
    made = cell(PARTS)
    parts = {"environment": made["spring"], "environment.stiffness": 500.0, "passivity": made["half"]}
    parts |= {"simulation.user": made["tug"], "simulation.effects": [made["drag"]]}
    result = canhaptic.simulate("demo", parts, duration=0.3, progress=False)
    [axis] = result.scene.axes
    assert axis.environment.parameters.model_dump()["stiffness"] == 500.0
    assert {name.split(":")[1] for name in result.scene.own_code} == {"spring", "tug", "drag", "half"}
    columns = result.to_numpy()
    place, torque = columns["handle.position"], columns["handle.torque_applied"]
    assert place[-1] < -1e-3  # the hand tugs
    assert torque[280] == pytest.approx(-0.5 * 500.0 * place[278], rel=0.02)  # half of the spring, samples later
    without = canhaptic.simulate("demo", {**parts, "simulation.effects": []}, duration=0.15, progress=False)
    assert without.to_numpy()["handle.position"].min() < place[: len(without.time)].min()  # it drags no longer
    swept = canhaptic.sweep("demo", {"environment.stiffness": [100, 400]}, changes=parts, duration=0.02)
    assert len(swept["handle.least_interaction"]) == 2
    with canhaptic.open_rig("demo", {"simulation.user": made["tug"]}, duration=0.1) as rig:
        assert min(sample["handle"].position for sample in rig) < 0.0


class Half(SteppedController):
    parameters_type = DamperVelocity
    kernel = sampled_kernel(lambda run, hold, asked: Reply(0.5, 0.5 * asked.spring, 0.0, 0.0, 0.0))


@pytest.mark.slow
def test_algorithms_of_ones_own_are_compared_by_their_names(monkeypatch: pytest.MonkeyPatch) -> None:
    solved = Mock(wraps=compare.reference_of)
    monkeypatch.setattr(compare, "reference_of", solved)

    def third(run: Any, hold: Any, asked: Any) -> Reply:
        return Reply(0.3, 0.3 * asked.spring, 0.0, 0.0, 0.0)

    found = canhaptic.compare("demo", [Half, "unprotected", third], duration=0.03, repeats=0)
    assert [row["algorithm"] for row in found.result["rows"]] == ["Half", "unprotected", "third"]
    assert set(found.runs["handle"]) == {"Half", "unprotected", "third"}
    assert solved.call_count == 1  # one continuous run for all of them
    with pytest.raises(InputError, match="expected the name of an algorithm, or a class or a function"):
        canhaptic.compare("demo", [canhaptic.Environment])
    with pytest.raises(InputError, match="expected names; give it as changes"):
        canhaptic.sweep("demo", {"environment.damping": [1.0]}, controllers=[Half])
    with pytest.raises(InputError, match=r"slope is a class or function of this program, which no other process has"):
        canhaptic.simulate("demo", {"environment": slope, "code_runs_in": "process"}, progress=False)


def test_a_function_with_other_arguments_is_told_which_it_has() -> None:
    with pytest.raises(InputError, match=r"\(state, more\): expected effort\(state\), and further arguments"):
        canhaptic.simulate("demo", {"environment": lambda state, more: 0.0}, progress=False)


class Frame:
    """What a frame of pandas has of it."""

    def __init__(self, rows: Any) -> None:
        self._rows = rows

    def to_numpy(self) -> Any:
        return np.array(self._rows)


@pytest.mark.slow
def test_recorded_hand_from_an_array(monkeypatch: pytest.MonkeyPatch) -> None:
    time = np.linspace(0.0, 0.4, 401)
    array = np.column_stack((time, -0.1 * np.sin(5.0 * time)))
    result = canhaptic.simulate("demo", {"simulation.user.motion": array}, duration=0.4, progress=False)
    assert result.to_numpy()["handle.position"].min() < -0.04  # through the grip of the demo
    assert given.plain(Frame(array), ("user", "motion")) == given.plain(array.tolist(), ("motion",))
    by_array = canhaptic.sweep(
        "demo", {"environment.damping": [0.0]}, changes={"simulation.user.motion": array}, duration=0.3
    )
    assert np.isfinite(np.asarray(by_array["handle.least_interaction"], dtype=float)).all()
    monkeypatch.setattr("canhaptic.sim.plant.user.GIVEN", {})
    with pytest.raises(SceneError, match=r"numpy\.savetxt"):
        canhaptic.load_scene("demo", result.scene.overrides)


@pytest.mark.parametrize(
    ("array", "expected"),
    [
        (np.zeros(5), r"shape \(5,\), expected \(n, 2\).*column_stack"),
        (np.zeros((5, 3)), r"shape \(5, 3\)"),
        ([(0.0, 0.0), (0.0, 1.0)], "row 1: got time 0 s, expected one after 0 s"),
        ([(0.0, 0.0), (1.0, np.nan)], "row 1: got nan at 1 s"),
    ],
)
def test_an_array_that_is_no_motion_is_one_error(array: object, expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        canhaptic.simulate("demo", {"simulation.user.motion": array}, progress=False)


@pytest.mark.slow
def test_a_mapping_may_hold_objects(cell: Cell) -> None:
    wall = cell(WALL)["MyWall"]
    demo = canhaptic.load_scene("demo")
    axis = {"name": "handle", "node_id": 1, "eds": str(demo.axes[0].parameters.eds), "unit": "m"}
    axis |= {"counts_per_unit": 1e6, "rated_torque": 10.0, "torque_limit": 20.0}
    motion = np.array([(0.0, 0.0), (0.2, -0.02)])
    user = {"stiffness": 60.0, "damping": 5.0, "motion": motion}
    scene = {"duration": 0.1, "bus": {"interface": "virtual", "rate": 1000.0}, "axes": [axis], "environment": wall}
    scene |= {"passivity": {"algorithm": "unprotected"}, "simulation": {"plant": {"mass": 0.25}, "user": user}}
    result = canhaptic.simulate(scene, progress=False)
    assert [name.split(":")[1] for name in result.scene.own_code] == ["MyWall"]


def test_what_touch_cannot_take_along_is_told(cell: Cell) -> None:
    changes = {"environment": cell(WALL)["MyWall"]}
    with pytest.raises(InputError, match=r"MyWall: is defined in a notebook .* define it in a file of its own"):
        canhaptic.touch("demo", changes)


def test_a_script_that_calls_touch_again_in_its_other_process_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(multiprocessing.current_process(), "_inheriting", True, raising=False)
    with pytest.raises(InputError, match=r"another process imports this script; call touch under `if __name__"):
        canhaptic.touch("demo")


def test_what_touch_takes_along_is_there_in_another_process(monkeypatch: pytest.MonkeyPatch) -> None:
    overrides = [f"environment={json.dumps(given.plain(slope, ('environment',)))}"]
    parcelled, there = given.parcel(overrides, "a test"), dict[str, Any]()
    for module in (given, own_code):
        monkeypatch.setattr(module, "GIVEN", there)
    given.unpack(parcelled)
    [axis] = canhaptic.load_scene("demo", overrides).axes
    assert axis.environment.parameters.model_dump()["stiffness"] == 7.0


def slope(state: float, stiffness: float = 7.0) -> float:
    return stiffness * state


@pytest.mark.slow
def test_figure_of_88_mm(tmp_path: Path) -> None:
    result = canhaptic.simulate("demo", duration=1.3, progress=False)
    with pytest.raises(InputError, match=r"got 'run\.pdf', expected another SimulationResult .*savefig\('run\.pdf'\)"):
        result.plot("run.pdf")  # type: ignore[arg-type]
    figure = result.plot(panels=["position", "torque"], width="88 mm")
    for name in ("figure.svg", "figure.pdf"):
        figure.savefig(tmp_path / name)
    svg = (tmp_path / "figure.svg").read_text()
    assert 'width="249.448819pt"' in svg  # 88 mm
    assert {"position", "force", "time [s]", "wall"} <= set(re.findall(r"<text[^>]*>([^<]*)", svg))
    pdf = (tmp_path / "figure.pdf").read_bytes()
    assert re.search(rb"/MediaBox \[ 0 0 249\.448\d* ", pdf)
    assert b"/Type3" not in pdf  # letters as drawings
    pages = [zlib.decompress(of) for of in re.findall(rb"FlateDecode.*?stream\r?\n(.*?)endstream", pdf, re.DOTALL)]
    words = [
        b"".join(re.findall(rb"\(\0(.)\)", of)) for page in pages for of in re.findall(rb"BT(.*?)ET", page, re.DOTALL)
    ]
    assert {b"position", b"force", b"wall"} <= set(words)
    assert b"/ToUnicode" in pdf
    log = result.save(tmp_path / "run.h5")
    options = ["--pdf", str(tmp_path / "motion.pdf"), "--panels", "motion", "--width", "88 mm"]
    assert main(["inspect", str(log), *options]) == 0
    with canhaptic.EnergyLog(log) as opened:
        assert [axes.get_title(loc="left") for axes in opened.plot(panels=["energy"], width=0.1).axes] == ["energy"]
        for wrong, expected in (({"panels": ["enrgy"]}, "'enrgy', expected names among"), ({"width": "88 N"}, "88 mm")):
            with pytest.raises(InputError, match=expected):
                opened.plot(**wrong)
