"""What people read at the end: without protection, with a wrong declaration, of every scene that is shipped."""

import pytest

from tests.journeys.person import CONFIGS, Person, shown

DEMO = str(CONFIGS / "demo.yaml")
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


def test_a_handle_that_touched_nothing_is_no_failure(person: Person) -> None:
    result = person.runs(DEMO, "--duration", "0.3", "--set", "environment.position=-10 m", "--strict")
    assert shown(result) == {"no contact"}


@pytest.mark.slow
@pytest.mark.parametrize("name", SIMULATED)
def test_every_shipped_scene_says_yes_or_no_or_no_contact(name: str, person: Person) -> None:
    assert shown(person.runs(str(SIMULATED[name]))) <= {"yes", "no", "no contact"}
