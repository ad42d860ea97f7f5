"""Values that override a scene from the command line, and the faults that name them."""

import re
import warnings
from pathlib import Path

import pytest

from canhaptic.cli.long_command import notes
from canhaptic.cli.main import main
from canhaptic.control.admittance import DISPLAY_ALGORITHMS, DISPLAY_ENVIRONMENTS
from canhaptic.control.environments import ENVIRONMENTS
from canhaptic.control.passivity import ALGORITHMS
from canhaptic.errors import InputError, OverrideWarning, SceneError
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import Scene, require_no_guesses, values_to_set
from canhaptic.simulation import simulate
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
        ("stiffness=500", "stiffness: unknown key; did you mean environment.stiffness?"),
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


def test_a_dictionary_in_an_override_is_relative_to_the_current_folder(tmp_path, monkeypatch) -> None:
    (tmp_path / "own.eds").write_bytes(SHIPPED_EDS.read_bytes())
    path = scene_file(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert load_scene(path, ["axes.0.eds=own.eds"]).axes[0].parameters.eds == Path("own.eds")
    monkeypatch.chdir("/")
    with pytest.raises(SceneError, match="no such file"):
        load_scene(path, ["axes.0.eds=own.eds"])


# --- another type -----------------------------------------------------------------------------------------------------

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
SWITCHES = [
    ("demo.yaml", "passivity.algorithm", ALGORITHMS),
    ("demo.yaml", "axes.0.passivity.algorithm", ALGORITHMS),
    ("demo.yaml", "environment.type", ENVIRONMENTS),
    ("paper_fig5_100hz.yaml", "passivity.algorithm", ALGORITHMS),
    ("two_handles.yaml", "groups.0.passivity.algorithm", {"guarded": "", "step_scaling": "", "unprotected": ""}),
    ("admittance/virtual_mass.yaml", "passivity.algorithm", DISPLAY_ALGORITHMS),
    ("admittance/virtual_mass.yaml", "environment.type", DISPLAY_ENVIRONMENTS),
    ("admittance/guided_path.yaml", "groups.0.passivity.algorithm", DISPLAY_ALGORITHMS),
]

PLAIN_NAMES = [
    ("demo.yaml", "passivity.algorithm", "unprotected"),
    ("demo.yaml", "environment.type", "damper_wall"),
    ("admittance/virtual_mass.yaml", "passivity.algorithm", "unprotected"),
]


def switched(scene: str, *overrides: str) -> tuple[Scene, list[str]]:
    """The scene, and what was said of keys that were dropped."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        loaded = load_scene(CONFIGS / scene, overrides)
    return loaded, [str(warning.message) for warning in said]


@pytest.mark.parametrize(("scene", "key", "name"), [(scene, key, name) for scene, key, name in PLAIN_NAMES])
def test_a_plain_name_for_a_section_chooses_its_type(scene: str, key: str, name: str) -> None:
    """`passivity=unprotected` is `passivity.algorithm=unprotected`: the same scene, and the same keys dropped."""
    section = key.rpartition(".")[0]
    short, said = switched(scene, f"{section}={name}")
    long, said_before = switched(scene, f"{key}={name}")
    assert short.config_hash() == long.config_hash() != switched(scene)[0].config_hash()
    assert [text.partition(": ")[2] for text in said] == [text.partition(": ")[2] for text in said_before] != []


def test_a_wrong_plain_name_is_a_fault_of_the_key_that_it_stands_for() -> None:
    with pytest.raises(
        SceneError, match=r"--set passivity=unprotcted: passivity\.algorithm: unknown .*'unprotected'\?"
    ):
        load_scene(CONFIGS / "demo.yaml", ["passivity=unprotcted"])
    with pytest.raises(SceneError, match="expected a mapping of keys and values"):
        load_scene(CONFIGS / "demo.yaml", ["simulation.user=guarded"])  # which has no type


def test_real_drives_keep_what_protects_them_from_a_plain_name() -> None:
    real = ("bus.interface=socketcan", "bus.channel=can0", "simulation=null")
    with pytest.raises(SceneError, match="the drives may be real, so no key is dropped"):
        load_scene(CONFIGS / "demo.yaml", [*real, "passivity=unprotected"])


@pytest.mark.slow_but("passivity.algorithm=unprotected", "passivity={*")
@pytest.mark.parametrize("override", ["passivity=unprotected", "passivity.algorithm=unprotected",
                                      "passivity={algorithm: unprotected}"])  # fmt: skip
def test_no_override_takes_the_passivity_controller_from_real_drives(override: str, tmp_path, capsys) -> None:
    """Also where no key would be dropped; the file itself may say so, and a simulated rig takes each override."""
    text = re.sub(r"(?m)^  hand_(force|push):.*\n", "", (CONFIGS / "demo.yaml").read_text())
    text = text.replace("cia402_servo.eds", str(SHIPPED_EDS)).replace(
        "algorithm: guarded", "algorithm: passivity_observer"
    )
    scene = tmp_path / "scene.yaml"
    scene.write_text(text)
    real = ("bus.interface=socketcan", "bus.channel=can0")
    assert load_scene(scene, [override]).axes[0].passivity.name == "unprotected"
    with pytest.raises(InputError, match=r"missing: .*`algorithm: unprotected` in the file itself"):
        require_no_guesses(load_scene(scene, [*real, override]))
    scene.write_text(text.replace("algorithm: passivity_observer", "algorithm: unprotected"))
    assert not any("unprotected" in guess.key for guess in values_to_set(load_scene(scene, real)))
    said = [note for note in notes(load_scene(scene, real)) if "NO PASSIVITY CONTROLLER" in note]
    assert len(said) == 1
    assert not any("NO PASSIVITY" in note for note in notes(load_scene(scene)))
    assert main(["check", str(scene), "--set", real[0], "--set", real[1]]) == 1
    assert capsys.readouterr().out.startswith("handle: NO PASSIVITY CONTROLLER (algorithm: unprotected)")


@pytest.mark.slow_but("two_handles*", "demo.yaml-environment.type")
@pytest.mark.parametrize(("scene", "key"), [(scene, key) for scene, key, _ in SWITCHES])
def test_every_type_can_be_set_or_one_line_says_what_it_needs(scene: str, key: str) -> None:
    """What the line says is then typed: the path leads to a scene."""
    for name in next(table for of, path, table in SWITCHES if (of, path) == (scene, key)):
        overrides = [f"{key}={name}"]
        try:
            switched(scene, *overrides)
        except SceneError as error:
            [fault] = error.faults
            needed = re.findall(
                r"--set (?!axes.0.passivity.algorithm|passivity.algorithm|environment.type)(\S+)=('[^']+'|[\w.]+)",
                fault,
            )
            needed = needed or [(key, other) for other in re.findall(r"use the algorithm `(\w+)`", fault)]
            assert needed, fault
            in_place = [f"{path}={value.strip(chr(39))}" for path, value in needed]
            if name == "two_sided_wall":
                in_place[-1] = "environment.upper=2 m"  # one has to be above the other
            switched(scene, *overrides, *in_place)


def test_keys_that_only_the_old_type_has_are_dropped_and_named_in_one_line() -> None:
    scene, said = switched("hard/stiff_wall.yaml", "passivity.algorithm=unprotected")
    assert scene.axes[0].passivity.name == "unprotected"
    assert scene.axes[0].loop.moving_mass == 0.24  # what both know is kept
    assert said == [
        "--set passivity.algorithm=unprotected: passivity: hand_force, hand_push are ignored: "
        "'unprotected' does not use them"
    ]


def test_an_axis_that_is_set_to_another_type_keeps_what_is_known_of_its_loop() -> None:
    scene, [said] = switched("demo.yaml", "axes.0.passivity.algorithm=unprotected")
    assert scene.axes[0].loop.moving_mass == 0.2
    assert "axes.0.passivity: hand_force, hand_push are ignored" in said


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["passivity.hand_force=3"], "--set passivity.hand_force=3: passivity.hand_force: unknown key"),
        (["passivity.hand_frce=3"], "passivity.hand_frce: unknown key"),
    ],
)
def test_a_key_that_is_set_by_hand_is_never_dropped(overrides: list[str], words: str) -> None:
    with pytest.raises(SceneError, match=words):
        switched("demo.yaml", "passivity.hand_push=1", "passivity.algorithm=unprotected", *overrides)


def test_a_type_that_is_set_back_drops_nothing() -> None:
    scene, said = switched("demo.yaml", "passivity.algorithm=unprotected", "passivity.algorithm=guarded")
    assert not said
    assert scene.config_hash() == switched("demo.yaml")[0].config_hash()


def test_a_wrong_key_of_the_file_is_an_error_whatever_type_is_set(tmp_path: Path) -> None:
    text = (
        (CONFIGS / "demo.yaml")
        .read_text()
        .replace("hand_push:", "hand_psh:")
        .replace("cia402_servo.eds", str(SHIPPED_EDS))
    )
    scene = tmp_path / "scene.yaml"
    scene.write_text(text)
    with pytest.raises(SceneError, match="hand_psh: unknown key"), pytest.warns(OverrideWarning):
        load_scene(scene, ["passivity.algorithm=unprotected"])


@pytest.mark.parametrize("key", ["passivity.algorithm", "axes.0.passivity.algorithm"])
def test_of_a_real_bus_nothing_is_dropped(key: str) -> None:
    with pytest.raises(SceneError) as raised:
        load_scene(CONFIGS / "socketcan_example.yaml", [f"{key}=unprotected"])
    assert raised.value.faults == (
        f"--set {key}=unprotected: {key}: got 'unprotected' in place of 'guarded', which has no hand_force, hand_push; "
        "the drives may be real, so no key is dropped: take it out of the scene",
    )


@pytest.mark.slow
def test_a_script_sets_another_type_as_the_command_line_does() -> None:
    with pytest.warns(OverrideWarning, match="hand_force, hand_push are ignored"):
        result = simulate(CONFIGS / "demo.yaml", {"passivity.algorithm": "unprotected"}, duration=0.05, progress=False)
    assert result.account.raw["ports"]["handle"]["certificates"] == []
