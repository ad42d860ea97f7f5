"""What a scene says of its simulated plants: effects, accuracy, compiled; and what is refused, with its line."""

import re
from pathlib import Path

import pytest

from canhaptic.cli.main import main
from canhaptic.scene.build import build
from canhaptic.scene.far_side import build_plant
from canhaptic.scene.load import load_scene
from canhaptic.scene.method import dear_holds, method_line
from tests.scene.scene_text import faults, scene_file

COULOMB = "{type: coulomb_friction, kinetic: 0.3 N, static: 0.5 N}"
STOPS = (
    "[{type: hard_stop, position: 1e-9, stiffness: 1e10}, "
    "{type: hard_stop, position: -1e-9, side: lower, stiffness: 1e10}]"
)


@pytest.mark.parametrize(
    ("effects", "expected"),
    [
        ("[{type: colomb_friction}]", r"scene.yaml:17:.*unknown effect 'colomb_friction'.*did you mean 'coulomb_fric"),
        ("[{type: coulomb_friction, kinetic: 0.5, static: 0.3}]", r":17:.*static 0.3 is below kinetic 0.5"),
        ("[{type: hard_stop, position: 0, stiffness: -1}]", r":17:.*stiffness: got -1, expected 0 < stiffness"),
        ("[{type: hard_stop, position: 0, stiffness: 1 N*s/m}]", r":17:.*stiffness: got '1 N\*s/m'"),
        (f"\n    - {COULOMB}\n    - {{type: backlash, gap: 1 mm}}", r":19:.*backlash: got no shaft_compliance"),
        (f"\n    - {COULOMB}\n    - {COULOMB}", r":18:.*one friction model"),
    ],
)
def test_a_bad_effect_is_refused_with_file_and_line(tmp_path: Path, effects: str, expected: str) -> None:
    lines = faults(tmp_path, ("simulation:\n", f"simulation:\n  effects: {effects}\n"))
    assert any(re.search(expected, line) for line in lines), "\n".join(lines)


def test_an_effect_that_does_not_fit_is_marked_although_another_is_named_first(tmp_path: Path) -> None:
    stribeck = "{type: stribeck_friction, kinetic: 0.3 N, static: 0.5 N, stribeck_velocity: 0.1}"
    lines = faults(tmp_path, ("simulation:\n", f"simulation:\n  effects:\n    - {COULOMB}\n    - {stribeck}\n"))
    [line] = [line for line in lines if "expected one friction model" in line]
    assert re.search(r"scene.yaml:19:\d+: simulation.effects.1: effects: got coulomb_friction and stribeck", line), line


def test_a_tremor_without_a_hand_and_a_negative_mass_are_refused_with_their_line(tmp_path: Path) -> None:
    user = "  user: {stiffness: 60, damping: 5, motion: {amplitude: 0.1, frequency: 0.5}}\n"
    [line] = faults(tmp_path, (user, "  effects: [{type: tremor, amplitude: 1 mm}]\n"))
    assert re.search(r"scene.yaml:\d+:\d+: simulation.effects.0: tremor: got no hand", line)
    [line] = faults(tmp_path, ("mass: 0.25", "mass: -0.25"))
    assert re.search(r"scene.yaml:17:\d+: simulation.plant.mass: got -0.25, expected 1e-12 <= mass", line)


@pytest.mark.parametrize(
    ("accuracy", "expected"),
    [
        ("auto", r"scene.yaml:2:11: accuracy: got 'auto' without a tolerance; write it as"),
        ("{substeps: 3}", r":2:\d+: accuracy: .*substeps 3 is not a power of two"),
        ("{event_bits: 25}", r":2:\d+: accuracy.event_bits: got 25, expected 1 <= event_bits <= 24"),
        ("{max_event: 25}", r":2:\d+: accuracy.max_event: unknown key; did you mean 'max_events'"),
        ("fine", r":2:\d+: accuracy: got 'fine', expected a mapping"),
    ],
)
def test_a_bad_accuracy_is_refused_with_file_and_line(tmp_path: Path, accuracy: str, expected: str) -> None:
    [line] = faults(tmp_path, ("duration: 1 s\n", f"duration: 1 s\naccuracy: {accuracy}\n"))
    assert re.search(expected, line), line


def test_accuracy_reaches_the_plant_and_the_hash(tmp_path: Path) -> None:
    path = scene_file(tmp_path)
    plain, coarse = load_scene(path), load_scene(path, ["accuracy={event_bits: 8, substeps: 4, max_events: 7}"])
    simulation = coarse.axes[0].simulation
    assert simulation is not None
    accuracy = build_plant(simulation, 1_000_000).accuracy
    assert (accuracy.event_bits, accuracy.substeps, accuracy.max_events) == (8, 4, 7)
    assert plain.config_hash() != coarse.config_hash()


def test_a_run_ends_where_the_plant_has_more_events_than_are_allowed(tmp_path, capfd) -> None:
    path = scene_file(tmp_path)
    status = main(
        [
            "run",
            str(path),
            "--pace",
            "free",
            "--set",
            f"simulation.effects={STOPS}",
            "--set",
            "accuracy={max_events: 3}",
        ]
    )
    assert status in {1, 3}  # in the start, or in the cycle
    assert "more than 3 changes of mode in one sample time" in capfd.readouterr().err


def test_the_method_line_tells_events_and_products(tmp_path: Path) -> None:
    path = scene_file(tmp_path)
    scene = load_scene(path, [f"simulation.effects=[{COULOMB}]"])
    with build(scene) as experiment:
        experiment.rig.start()
        for _ in range(20):
            experiment.cycle.step()
        [plant] = experiment.plants
        line = method_line(scene, experiment.plants, 20)
        assert "plant exact between SYNCs; torque acts" in line
        assert f"products per period, {plant.events} event" in line


@pytest.mark.slow
def test_a_run_and_a_check_announce_a_swing_that_makes_holds_dear(tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    path = str(scene_file(tmp_path))
    stop = "simulation.effects=[{type: hard_stop, position: 0.2, stiffness: 1e9 N/m}]"
    swinging = ["simulation.plant={mass: 1e-6 kg}", "simulation.user.damping=0.01", stop]
    [line] = dear_holds(load_scene(path, swinging))
    assert (
        "rad in one sample time (upper_stop touching), up to 25000 matrix products, about 0.1 s, for each; give" in line
    )
    given = [word for item in swinging for word in ("--set", item)]
    assert main(["run", path, "--duration", "0.01", *given]) == 0
    assert line in capfd.readouterr().err
    assert main(["check", path, *given]) == 0
    assert line in " ".join(capfd.readouterr().out.split())
    assert dear_holds(load_scene(path, [*swinging[:1], stop])) == []  # the hand's damping stops it


@pytest.mark.slow
def test_a_hand_that_passes_no_notch_is_said_to_and_check_calls_a_notch_a_notch(capsys: pytest.CaptureFixture) -> None:
    knob = str(Path(__file__).parents[2] / "configs" / "rotary_knob.yaml")
    assert dear_holds(load_scene(knob)) == []
    assert dear_holds(load_scene(knob, ["environment.pitch=1 rad"])) == []  # crests at half a pitch, passed by 45 deg
    [line] = dear_holds(load_scene(knob, ["environment.pitch=30 rad"]))
    assert line.startswith("knob: the hand moves from -0.785 to 0.785 rad and passes no notch: environment.pitch is 30")
    assert main(["check", knob]) == 0
    assert "; the notch is felt" in capsys.readouterr().out


def test_a_scene_cannot_ask_for_compiled_plants(tmp_path: Path) -> None:
    [line] = faults(tmp_path, ("simulation:\n", "simulation:\n  compiled: true\n"))
    assert re.search(r"scene.yaml:17:\d+: simulation.compiled: unknown key", line)
