"""A person forgets the gear of 14: the commissioning says so before a hundredth of the drive's torque was sent."""

import json

import can
import pytest

from tests.journeys.person import FIT, OURS, Person, dictionary

GEAR = 14.0
PER_MILLE = 10  # a hundredth of the torque of the axis at 1000 per mille, which is 14 times what the scene says


@pytest.mark.slow  # `tests/commission/test_torque_scale.py` finds the same with fewer steps
@pytest.mark.parametrize("name", [*OURS, *FIT])
def test_a_gear_that_was_forgotten_is_caught(name: str, person: Person, request: pytest.FixtureRequest) -> None:
    eds = dictionary(name, request)
    [rpdo] = [json.loads(person.types("check-eds", eds, "--json"))["map"]["rpdo"]]
    target = 2 * rpdo["entries"].index("0x6071:00/16")
    person.types("new", eds, "--simulate", "--out", "rig.yaml")
    motor, resolution = (0.512871, 1e-6) if name.startswith("maxon") else (1.0, 1e-3)
    geared = (
        f"simulation.drive.rated_torque={GEAR * motor}",
        f"simulation.drive.rated_torque_resolution={GEAR * resolution}",
    )
    sets = [word for value in (*geared, f"bus.channel={name}") for word in ("--set", value)]
    with can.Bus(interface="virtual", channel=name) as bus:
        words = ("commission", "rig.yaml", "--yes", "--travel", "0.1", "--duration", "0.1", "--out", "mine.yaml", *sets)
        report = json.loads(person.types(*words, "--json", status=1))
        frames = [
            frame for frame in iter(lambda: bus.recv(0.0), None) if frame.arbitration_id == int(rpdo["cob_id"], 0)
        ]
    sent = {abs(int.from_bytes(frame.data[target : target + 2], "little", signed=True)) for frame in frames}
    [row] = [row for row in report["findings"] if row["item"] == "torque scale"]
    assert row["verdict"] == "differs"
    assert float(row["found"]) == pytest.approx(GEAR, rel=0.1)
    assert 0 < max(sent) <= PER_MILLE
    [remedy] = [value for value in report["values"] if value["key"] in ("transmission", "rated_torque")]
    assert remedy["value"] / (motor if remedy["key"] == "rated_torque" else 1.0) == pytest.approx(GEAR, rel=0.1)
    kept = person.folder / "mine.yaml"
    assert any(line.startswith("unfinished: ") for line in kept.read_text().splitlines())
    kept.unlink()
    right = ["--set", f"axes.0.{remedy['key']}={remedy['value']}"]
    report = json.loads(person.types(*words, *right, "--json", status=None))
    assert [row["verdict"] for row in report.get("result", report)["findings"] if row["item"] == "torque scale"] == [
        "agrees"
    ]
