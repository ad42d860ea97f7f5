"""Values that override a scene from the command line, and the faults that name them."""

from pathlib import Path

import pytest

from canhaptic.errors import SceneError
from canhaptic.scene.load import load_scene
from tests.scene.scene_text import SHIPPED_EDS, faults, scene_file


def test_overrides_are_laid_over_in_order(tmp_path: Path) -> None:
    overrides = [
        "axes.0.node_id=5",
        "axes.handle.node_id=6",
        "environment.stiffness=1e-3 kN/m",
        "log.energy=x.h5",
        'simulation.drive.objects."0x6091.1"=3',
        "simulation.user.motion={amplitude: 0.2, frequency: 2 Hz}",
    ]
    scene = load_scene(scene_file(tmp_path), overrides)
    [axis] = scene.axes
    assert axis.parameters.node_id == 6
    assert axis.environment.parameters.model_dump()["stiffness"] == 1.0
    assert scene.log.energy == Path("x.h5")
    assert axis.simulation is not None
    assert axis.simulation.drive.object_values() == {(0x6091, 1): 3}
    assert axis.simulation.user is not None
    assert axis.simulation.user.motion is not None
    assert axis.simulation.user.motion.amplitude == 0.2


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("axes.0.node_id", "got no PATH=VALUE"),
        ("=5", "got no PATH=VALUE"),
        ("axes..x=5", "got no PATH=VALUE"),
        ("axes.3.node_id=5", "axes.3: got index '3', expected 0 or a name: handle"),
        ("axes.hande.node_id=5", "axes.hande: got index 'hande', expected 0 or a name: handle; did you mean 'handle'?"),
        ("axes.-1.node_id=5", "axes.-1: got index '-1'"),
        ("axes.٣.node_id=5", "axes.٣: got index '٣'"),
        ("duration.x=5", "duration: got '1 s', which has no entry 'x'"),
        ("bus.rate=[1", "bus.rate: not valid YAML"),
        ("bus.rate={a: 1, a: 2}", "bus.rate.a: key 'a' is given twice"),
        ("bus=5", "bus: got 5, expected a mapping"),
        ("axes=5", "axes: got 5, expected a list of axes"),
        ("axes=[]", "axes: got an empty list, expected at least one axis"),
        ("axes.0=5", "axes.0: got 5, expected a mapping of name, node_id"),
    ],
)
def test_a_fault_of_an_override_names_the_override(tmp_path: Path, override: str, expected: str) -> None:
    lines = faults(tmp_path, overrides=(override,))
    assert any(line.startswith(f"--set {override}: {expected}") for line in lines), "\n".join(lines)


def test_an_override_that_is_not_yaml_is_one_short_fault(tmp_path: Path) -> None:
    [line] = faults(tmp_path, overrides=("bus.rate=[1" + " " * 5000,))
    assert len(line) < 300


def test_a_dictionary_in_an_override_is_relative_to_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own.eds").write_bytes(SHIPPED_EDS.read_bytes())
    path = scene_file(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert load_scene(path, ["axes.0.eds=own.eds"]).axes[0].parameters.eds == Path("own.eds")
    monkeypatch.chdir("/")
    with pytest.raises(SceneError, match="no such file"):
        load_scene(path, ["axes.0.eds=own.eds"])
