"""What people read at the end: without protection, with a wrong declaration, of every scene that is shipped."""

import pytest

from tests.journeys.person import CONFIGS, Person, shown

DEMO = str(CONFIGS / "demo.yaml")
SHAFT = "simulation.effects=[{type: shaft_compliance, load_mass: 0.15 kg, stiffness: 2e4 N/m, damping: 1 N*s/m}]"
WRONG_MASS = (
    *("environment.stiffness=20000", "environment.damping=0", "passivity.hand_force=20"),
    *("simulation.plant.mass=0.1", "passivity.moving_mass=0.226", SHAFT),
)
FOLDERS = ("admittance", "published", "hard", ".")  # those of accuracy are plants for `canhaptic accuracy`
SCENES = sorted(path for folder in FOLDERS for path in (CONFIGS / folder).glob("*.yaml"))
SIMULATED = {
    f"{path.parent.name}/{path.stem}": path
    for path in SCENES
    if "simulation:" in path.read_text() and not path.stem.startswith("far_")  # two rigs, run together
}


@pytest.mark.filterwarnings("default::canhaptic.errors.OverrideWarning")  # the command prints it
def test_without_protection_the_word_is_no_and_the_dropped_keys_are_named(person: Person) -> None:
    scene = str(CONFIGS / "hard" / "stiff_wall.yaml")
    words = (scene, "--set", "passivity.algorithm=unprotected", "--duration", "0.6")
    assert shown(person.runs(*words)) == {"no"}
    assert "hand_force, hand_push are ignored" in person.errors
    person.runs(*words, "--strict", status=1)


@pytest.mark.slow
@pytest.mark.parametrize("duration", ["4", "10", "20"])
def test_what_the_account_knows_at_four_seconds_it_still_says_later(duration: str, person: Person) -> None:
    sets = [word for key in WRONG_MASS for word in ("--set", key)]
    port = person.runs_one(DEMO, "--duration", duration, *sets)
    assert (port["passive"], port["verdict"]) == ("no", "no")
    assert "moving_mass" in port["suspects"]


@pytest.mark.slow
def test_a_second_recording_does_not_replace_the_first_unless_it_is_forced(person: Person) -> None:
    words = (DEMO, "--duration", "0.1", "--log", "run.h5", "--bus-log", "run.log")
    person.runs(*words)
    first = (person.folder / "run.h5").read_bytes(), (person.folder / "run.log").read_bytes()
    person.runs(*words, status=2)
    assert "--force" in person.errors
    assert first == ((person.folder / "run.h5").read_bytes(), (person.folder / "run.log").read_bytes())
    person.runs(*words, "--force")


@pytest.mark.slow
def test_a_wall_that_renders_nothing_says_so_with_the_key_to_blame(person: Person) -> None:
    words = (DEMO, "--duration", "2", "--set", "environment.side=above", "--set", "passivity.current_lag=5 ms")
    result = person.runs(*words, "--strict", status=1)
    assert shown(result) == {"nothing rendered"}
    assert "current_lag" in result["ports"]["handle"]["advice"]


def test_a_handle_that_touched_nothing_is_no_failure(person: Person) -> None:
    result = person.runs(DEMO, "--duration", "0.3", "--set", "environment.position=-10 m", "--strict")
    assert shown(result) == {"no contact"}


@pytest.mark.slow
@pytest.mark.parametrize("name", SIMULATED)
def test_every_shipped_scene_says_yes_or_no_or_no_contact(name: str, person: Person) -> None:
    assert shown(person.runs(str(SIMULATED[name]))) <= {"yes", "no", "no contact"}
