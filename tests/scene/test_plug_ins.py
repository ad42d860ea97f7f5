"""Parts of a run that a package offers: found, named, listed; a broken one costs nothing unless it is named."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import canhaptic
from canhaptic.cli.main import main
from canhaptic.errors import SceneError
from canhaptic.sim.plant.velocity_drive import OwnSensor
from canhaptic.simulation import load_any

CODE = """
def creeping(time: float, force: float, creep: float = 0.02):
    return force + creep


def count(log, first, end):
    with open(f"{log.path}.counted", "a") as file:
        file.write(f"{first} {end} {float(log.ports['handle']['position'][first]):.3f}\\n")


def fail(log, first, end):
    raise ValueError("no cable")


def show(path):
    print("shown:", path.name)
"""
ENTRIES = """
[canhaptic.algorithms]
unprotected = absent_for_tests:Mine
energy_tank = absent_for_tests:Mine
[canhaptic.sensors]
creeping = things_for_tests:creeping
gone = things_for_tests:Absent
[canhaptic.sinks]
count = things_for_tests:count
fail = things_for_tests:fail
broken = absent_for_tests:send
[canhaptic.displays]
paper = things_for_tests:show
broken = absent_for_tests:show
"""
SENSOR = "simulation.admittance.sensor"


@pytest.fixture(autouse=True)
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    about = tmp_path / "site" / "things-2.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: things\nVersion: 2.0\n")
    (about / "entry_points.txt").write_text(ENTRIES)
    (about.parent / "things_for_tests.py").write_text(CODE)
    monkeypatch.syspath_prepend(str(about.parent))
    yield about.parent
    sys.modules.pop("things_for_tests", None)


@pytest.mark.parametrize("algorithm", ["unprotected", "energy_tank"])
def test_no_package_takes_the_place_of_a_shipped_algorithm(algorithm: str) -> None:
    scene = load_any("demo", {"passivity": {"algorithm": algorithm}}, allow_code=False)
    assert (scene.axes[0].passivity.name, scene.axes[0].is_own, dict(scene.own_code)) == (algorithm, False, {})


def forces(sensor: object) -> list[float]:
    with canhaptic.build(load_any("admittance/wall", {SENSOR: sensor}, allow_code=False), "free") as experiment:
        canhaptic.run(experiment.cycle, 5)
        return [record.samples[0].torque_applied for record in experiment.rig.records]


@pytest.mark.slow
def test_a_sensor_of_a_package_a_class_and_a_function_indicate_the_same() -> None:
    class Mine(OwnSensor):
        creep: float = 0.02

        def indicates(self, time: float, force: float) -> float:
            return force + self.creep

    def with_creep(time: float, force: float, creep: float = 0.02) -> float:
        return force + creep

    offset = forces({"offset": 0.02})
    assert offset != forces({})
    assert offset == forces({"type": "creeping"}) == forces(Mine) == forces(with_creep)
    with pytest.raises(
        SceneError, match=r"got 'creping', which is unknown; expected FILE.py:Class or creeping or gone"
    ):
        forces({"type": "creping"})
    with pytest.raises(SceneError, match=r"gone: the plug-in things 2\.0 cannot be used"):
        forces({"type": "gone"})


@pytest.mark.slow
def test_what_is_installed_is_listed_and_a_broken_one_is_named_to_who_asks(tmp_path, capfd) -> None:
    assert main(["configs", "--json"]) == 0
    offered = json.loads(capfd.readouterr().out)["plug_ins"]
    assert offered["sink"] == {"count": "things 2.0", "fail": "things 2.0", "broken": "things 2.0"}
    assert main(["scope", str(tmp_path / "run.h5"), "--display", "paper"]) == 0
    assert "shown: run.h5" in capfd.readouterr().out
    for words, text in (
        (("run", "demo", "--sink", "cuont"), "unknown sink 'cuont': broken, count, fail; did you mean 'count'?"),
        (("run", "demo", "--sink", "broken"), "broken: the plug-in things 2.0 cannot be used (ModuleNotFoundError"),
        (("scope", "run.h5", "--display", "broken"), "broken: the plug-in things 2.0 cannot be used (ModuleNotF"),
    ):
        assert main(list(words)) == 2
        assert text in " ".join(capfd.readouterr().err.split())


@pytest.mark.slow
def test_a_sink_gets_every_row_once_and_one_that_fails_ends_no_run(tmp_path, capfd) -> None:
    log = tmp_path / "run.h5"
    words = ["run", "demo", "--duration", "0.3", "--pace", "free", "--log", str(log), "--json"]
    assert main([*words, "--sink", "count", "--sink", "fail"]) == 0
    output = capfd.readouterr()
    assert json.loads(output.out)["status"] == "completed"
    assert "the sink fail of things 2.0 failed (ValueError: no cable" in output.err
    taken = [line.split()[:2] for line in Path(f"{log}.counted").read_text().splitlines()]
    assert [first for first, _ in taken] == ["0", *(end for _, end in taken[:-1])]
    with canhaptic.EnergyLog.open(log) as written:
        assert taken[-1][1] == str(written.rows)
