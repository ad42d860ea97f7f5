"""`simulation: {bus: ...}` in a scene: read, refused, described, and absent where it is not named."""

import json
from pathlib import Path

import pytest

from canhaptic.cli.main import main
from canhaptic.errors import ParameterError, SceneError
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from canhaptic.scene.method import method_line
from canhaptic.sim.bus.faulty_bus import BusEffects, Schedule, Window
from canhaptic.sim.bus.virtual_bus import LeanVirtualBus

REPOSITORY = Path(__file__).resolve().parents[2]
DEMO = REPOSITORY / "configs" / "demo.yaml"


def demo_with(folder: Path, bus: str) -> Path:
    """The demo with a section `simulation.bus`, its first entry on line 2 of the section."""
    path = folder / "scene.yaml"
    path.write_text(DEMO.read_text().replace("simulation:\n", f"simulation:\n  bus:\n{bus}"))
    return path


def test_a_scene_says_what_its_bus_does_with_units(tmp_path: Path) -> None:
    bus = "    drop: 0.01\n    delay: 200 us\n    foreign_rate: 2 kHz\n    freeze: [{begin: 1 s, duration: 50 ms}]\n"
    effects = load_scene(demo_with(tmp_path, bus)).bus_effects
    assert effects is not None
    assert (effects.drop, effects.delay, effects.foreign_rate) == (0.01, pytest.approx(2e-4), 2000.0)
    assert effects.freeze == (Window(begin=1.0, duration=0.05),)
    assert effects.named == ("drop", "delay", "foreign_rate", "freeze")


@pytest.mark.parametrize(
    ("bus", "expected"),
    [
        ("    dorp: 0.01\n", ":5: simulation.bus.dorp: unknown key; did you mean 'drop'?"),
        ("    drop: 1.5\n", ":11: simulation.bus.drop: got 1.5, expected 0 <= drop <= 1"),
        ("    drop: 5 V\n", ":11: simulation.bus.drop: got '5 V', "),
        ("    delay: 5 m\n", ":12: simulation.bus.delay: got '5 m', unit 'm' does not fit; expected [s]"),
        ("    delay: -1 ms\n", ":12: simulation.bus.delay: got '-1 ms', expected 0 <= delay <= 10 [s]"),
        ("    drop: 0.8\n    drop_burst: 2\n", "drop is 0.8, expected at most 0.666667 with a drop_burst of 2 frames"),
        ("    freeze: [{begin: 1}]\n", "simulation.bus.freeze.0.duration: missing, expected 0 < duration"),
        ("    freeze: [{duration: 2, every: 1}]\n", "every is 1 s, expected more than duration (2 s)"),
        ("    direction: up\n    drop: 0.1\n", "simulation.bus.direction: got 'up', expected 'both', 'to_drive' or"),
        (
            "    foreign_ids: [2048]\n    foreign_rate: 1\n",
            "foreign_ids.0: got 2048, expected 0 <= foreign_ids <= 2047",
        ),
        ("    foreign_ids: []\n    foreign_rate: 1\n", "foreign_ids is empty, expected at least one COB-ID"),
        ("    bring_up: true\n", "names no effect, expected one of: drop, duplicate,"),
        ("    []\n", "simulation.bus: got a list, expected a mapping"),
    ],
)
def test_what_is_wrong_with_a_bus_is_shown_with_its_place(bus: str, expected: str, tmp_path: Path) -> None:
    with pytest.raises(SceneError) as caught:
        load_scene(demo_with(tmp_path, bus))
    assert expected in str(caught.value)
    assert str(caught.value).startswith(f"{tmp_path}/scene.yaml:")


def test_the_command_line_can_name_and_take_away_an_effect(tmp_path: Path) -> None:
    path = demo_with(tmp_path, "    drop: 0.01\n")
    effects = load_scene(path, ["simulation.bus.drop=0.5", "simulation.bus.jitter=100 us"]).bus_effects
    assert effects is not None
    assert (effects.drop, effects.jitter) == (0.5, pytest.approx(1e-4))
    assert load_scene(path, ["simulation.bus=null"]).bus_effects is None
    assert load_scene(DEMO, ["simulation.bus.drop=0.5"]).bus_effects == BusEffects(drop=0.5)
    with pytest.raises(SceneError, match=r"--set simulation\.bus\.drop=2: simulation\.bus\.drop: got 2, expected 0 <="):
        load_scene(DEMO, ["simulation.bus.drop=2"])


def test_made_by_hand_the_parameters_check_themselves() -> None:
    with pytest.raises(ParameterError, match=r"BusEffects.drop: got -1"):
        BusEffects(drop=-1)
    with pytest.raises(ParameterError, match="names no effect"):
        BusEffects()


def test_the_configuration_in_effect_names_the_bus_only_where_it_has_effects() -> None:
    ideal, faulty = load_scene(DEMO), load_scene(DEMO, ["simulation.bus.drop=0.01"])
    assert "bus" not in ideal.resolved()["simulation"]
    assert faulty.resolved()["simulation"]["bus"]["drop"] == 0.01
    assert ideal.config_hash() != faulty.config_hash()
    assert "bus with drop" in method_line(faulty)
    assert "bus with" not in method_line(ideal)


def test_an_ideal_scene_is_built_with_a_bare_connection() -> None:
    with build(load_scene(DEMO)) as experiment:
        assert not experiment.faulty_buses
        assert type(experiment.rig.drives[0].link._bus) is LeanVirtualBus


def test_a_run_tells_what_its_bus_did(capsys: pytest.CaptureFixture[str]) -> None:
    within = "during: [{begin: 0.1 s, duration: 0.3 s}]"
    bus = f"simulation.bus={{drop: 0.05, ids: [0x181], {within}}}"
    assert main(["run", str(DEMO), "--duration", "0.5", "--json", "--set", bus]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["bus_effects"] == {"drop": {"to_master": result["link"]["missed_tpdos"]}}
    assert "bus with drop" in result["method"]


def test_windows_are_found_to_the_nanosecond() -> None:
    schedule = Schedule([Window(begin=1.0, duration=0.5, every=2.0), Window(begin=10.25, duration=1.0)])
    second = 1_000_000_000
    assert schedule.end(second - 1) == 0
    assert schedule.end(second) == schedule.end(1_499_999_999) == 1_500_000_000
    assert schedule.end(1_500_000_000) == 0
    assert schedule.end(7 * second) == 7_500_000_000
    assert schedule.end(11_200_000_000) == 11_500_000_000  # the longer of two that overlap
    assert schedule.end(10_300_000_000) == 11_500_000_000  # 11.25 s lies in the other
