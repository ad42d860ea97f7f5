"""A person asks check-eds, new, check and run about one drive: their answers agree, and a refused run sends nothing."""

import json
import re

import pytest

from tests.journeys.person import FIT, OURS, UNFIT, Person, dictionary

MODES = {"CST": (), "CSV": ("--display", "velocity"), "CSP": ("--display", "position")}
GEARED = ("--set", "axes.0.transmission=14")
STATUSES = re.compile(
    r"Simulation: (?:ready|not usable|no section `simulation`)\. Hardware: (\d+ values to set|not usable)"
)


def hardware(text: str) -> str:
    """The status of hardware in a text."""
    [found] = set(STATUSES.findall(text))
    return str(found)


@pytest.mark.slow_but("cia402_servo.eds-CSV", "cia402_servo.eds-CSP")
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", [*OURS, *FIT, *UNFIT])
def test_check_eds_new_check_and_run_agree(name: str, mode: str, person: Person, request) -> None:
    eds, words = dictionary(name, request), MODES[mode]
    found = json.loads(person.types("check-eds", eds, *words, "--json", status=None))
    said = hardware(found["statuses"])
    if found["verdict"] == "not usable":
        assert said == "not usable"
        person.types("new", eds, *words, "--out", "rig.yaml", status=2)
        return
    for simulate in (("--simulate",), ()):
        scene = f"rig{len(simulate)}.yaml"
        person.types("new", eds, *words, *simulate, "--out", scene)
        checked = json.loads(person.types("check", scene, "--json", status=0 if simulate else 1))
        assert checked["fitness"] == [found["verdict"]]
        assert hardware(checked["verdict"]) == said
        assert len(checked["to_set"]) == int(said.split()[0])
        if simulate:
            person.runs(scene, "--duration", "0.02")
            if "transmission:" in (person.folder / scene).read_text():  # the twin's motor has the gear too
                person.runs(scene, "--duration", "0.02", *GEARED)
        else:
            person.types("run", scene, "--bus-log", "frames.log", status=2)
            assert hardware(person.errors) == said
            assert not (person.folder / "frames.log").exists()  # the bus was not even opened
