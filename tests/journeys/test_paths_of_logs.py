"""Paths of people with a scene: they try it dry, record, inspect, replay, and are refused where they must be."""

import json

import pytest

from tests.journeys.person import CONFIGS, Person, shown

DEMO = str(CONFIGS / "demo.yaml")
IN_CONTACT = ("--duration", "0.3", "--set", "environment.side=above")


@pytest.mark.slow
def test_a_dry_run_shows_what_would_be_sent_and_its_log_can_be_opened(person: Person) -> None:
    result = person.runs(DEMO, *IN_CONTACT, "--no-torque", "--strict", "--log", "dry.h5", "--bus-log", "dry.log")
    assert shown(result) == {"dry run"}
    port = result["ports"]["handle"]
    assert (port["in"], port["out"], port["certificates"]) == (0.0, 0.0, [])
    assert port["withheld_torque"] > 0.1
    read = json.loads(person.types("inspect", "dry.h5", "--recompute", "--bus-log", "dry.log", "--json"))
    assert (read["verdict"], read["dry_run"]) == ("dry run", True)
    assert [found["mismatch"] for found in read["recomputed"]] == [None]
    person.types("replay", "dry.log", "--config", DEMO, *IN_CONTACT[2:], "--energy-log", "dry.h5")


@pytest.mark.slow
def test_a_recording_is_inspected_recomputed_and_replayed(person: Person) -> None:
    result = person.runs(DEMO, *IN_CONTACT, "--log", "run.h5", "--bus-log", "run.log")
    read = json.loads(person.types("inspect", "run.h5", "--recompute", "--bus-log", "run.log", "--json"))
    assert read["cycles"] == result["cycles"] == 303
    assert read["verdict"] == result["verdict"]
    assert person.types("inspect", "run.h5", "--check", "passive")
    assert "identical" in person.types("replay", "run.log", "--config", DEMO, *IN_CONTACT[2:])
