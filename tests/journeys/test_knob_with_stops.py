"""A person wants several effects at one handle, types them as a list, and turns, plots, compares and varies them."""

import json

import pytest

from tests.journeys.person import CONFIGS, Person

KNOB = """
environment:
  - {type: detents, peak: 40 mN*m, pitch: 15 deg}
  - {type: two_sided_wall, lower: -45 deg, upper: 45 deg, stiffness: 0.5 N*m/rad}
"""


def knob(person: Person) -> str:
    """The shipped knob without stops, whose environment the person replaces by a list."""
    text = (CONFIGS / "rotary_knob.yaml").read_text(encoding="utf-8")
    before, _, after = text.partition("environment:")
    path = person.folder / "knob.yaml"
    path.write_text(before + KNOB.lstrip() + "\n" + after[after.index("passivity:") :], encoding="utf-8")
    return str(path)


@pytest.mark.slow
def test_a_knob_with_stops_is_felt_at_the_first_try(person: Person) -> None:
    scene, picture = knob(person), person.folder / "knob.png"
    assert "the wall is felt" in person.types("check", scene)
    port = person.runs_one(scene, "--duration", "1.2", "--png", str(picture), "--log", str(person.folder / "run.h5"))
    assert port["environment"] == "detents + two_sided_wall"
    assert port["verdict"] == "yes"
    assert port["rendered"]["stiffness"] > 0.9
    assert picture.stat().st_size > 10_000
    person.types("inspect", str(person.folder / "run.h5"), "--recompute")
    person.types("run", scene, "--set", "environment.1.uper=2", status=2)
    assert "environment.1.uper: unknown key; did you mean 'upper'?" in person.errors


@pytest.mark.slow
def test_a_knob_with_stops_is_compared_varied_and_replayed(person: Person) -> None:
    scene, frames = knob(person), person.folder / "run.log"
    person.types("run", scene, "--duration", "0.5", "--bus-log", str(frames), "--pace", "free")
    person.types("replay", str(frames), "--config", scene)
    found = json.loads(person.types("compare", scene, "--duration", "0.3", "--json"))
    assert {row["environment"] for row in found["rows"]} == {"detents + two_sided_wall"}
    out = person.folder / "sweep.h5"
    vary = ("--vary", "environment.detents.peak=0.01,0.04", "--vary", "environment.1.stiffness=0.2,0.5")
    person.types("sweep", scene, *vary, "--duration", "0.2", "--out", str(out))
    assert out.exists()
