"""A person has a dictionary of a drive and wants to feel a wall, or to move a mass, by the commands of the tutorial."""

import json

import numpy as np
import pytest

from canhaptic.logs.energy_reader import EnergyLog
from tests.journeys.person import FIT, OURS, Person, dictionary

FINE = ("--set", "axes.0.counts_per_unit=1e6 count/rad")  # mode 8 needs it, as `check` says
FELT = 0.1  # part of the mass by which the one that is felt may differ


@pytest.mark.slow
@pytest.mark.parametrize("name", [*OURS, *FIT])
def test_a_dictionary_leads_to_a_wall_that_is_felt(name: str, person: Person, request: pytest.FixtureRequest) -> None:
    person.types("new", dictionary(name, request), "--simulate", "--out", "rig.yaml")
    person.types("commission", "rig.yaml", "--yes", "--out", "mine.yaml")
    port = person.runs_one("mine.yaml", "--duration", "3", "--strict")
    assert port["verdict"] == "yes"
    assert port["rendered"]["stiffness"] >= 0.9


@pytest.mark.slow
@pytest.mark.campaign_for("*-16384")
@pytest.mark.parametrize("turn", [2_000, 4_096, 16_384])
@pytest.mark.parametrize("name", [*OURS, *FIT])
def test_a_coarse_encoder_leads_to_a_wall_that_is_felt(name: str, turn: int, person: Person, request) -> None:
    """Counts a turn of encoders with 500 lines and more, as people have them; nothing else is given."""
    person.types("new", dictionary(name, request), "--simulate", "--out", "rig.yaml")
    counts = f"axes.0.counts_per_unit={turn / (2.0 * np.pi)} count/rad"
    person.types("commission", "rig.yaml", "--yes", "--duration", "1", "--set", counts, "--out", "mine.yaml")
    port = person.runs_one("mine.yaml", "--duration", "3", "--strict")
    assert port["verdict"] == "yes"
    assert port["rendered"]["stiffness"] >= 0.9


def check_of_mass(person: Person, *sets: str) -> tuple[float, float]:
    """The mass that is asked for and the least that is felt, as `check` prints them."""
    found = json.loads(person.types("check", "rig.yaml", *sets, "--json"))
    [axis] = found["config"]["axes"].values()
    [least] = [hint["limit"] for hint in found["stability"] if hint["what"] == "mass felt at the first move, at least"]
    return axis["environment"]["mass"], least


def mass_felt(person: Person) -> float:
    """Mass that fits F = m a + b v + F_0, with the true motion of the handle and the force that the sensor shows."""
    with EnergyLog.open(person.folder / "run.h5") as log:
        [port], [truth], time = log.ports.values(), log.truth.values(), log.sample_time
        position, force = truth["position"], -port["torque_applied"]
    speed = (position[2:] - position[:-2]) / (2.0 * time)
    rise = (position[2:] - 2.0 * position[1:-1] + position[:-2]) / time**2
    rows = np.column_stack([rise, speed, np.ones_like(speed)])[20:-5]  # without the holds of the stop
    return float(np.linalg.lstsq(rows, force[1:-1][20:-5], rcond=None)[0][0])


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["velocity", "position"])
@pytest.mark.parametrize("name", ["cia402_admittance.eds", *FIT])
def test_a_dictionary_leads_to_a_mass_that_is_felt(name: str, mode: str, person: Person, request) -> None:
    sets = () if mode == "velocity" else FINE
    person.types("new", dictionary(name, request), "--display", mode, "--simulate", "--out", "rig.yaml")
    asked, least = check_of_mass(person, *sets)
    port = person.runs_one("rig.yaml", *sets, "--duration", "3", "--log", "run.h5")
    assert (port["passive"], port["plant_passive"]) != ("yes", "no")
    if "acceleration_limit: 50" in (person.folder / "rig.yaml").read_text():  # a drive with slower ramps: a soft hand
        assert mass_felt(person) == pytest.approx(max(asked, least), rel=FELT)
