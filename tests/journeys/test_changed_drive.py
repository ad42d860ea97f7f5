"""A person commissions a rig; afterwards a colleague changes the drive with the vendor's tool."""

import pytest

from tests.journeys.person import EDS, Person

SETTINGS = {"0x6076": 1000, "0x6075": 5000, "0x607E": 0}


def drive_with(**changed: int) -> str:
    values = ", ".join(f"{key}: {value}" for key, value in {**SETTINGS, **changed}.items())
    return f"simulation.drive.objects={{{values}}}"


@pytest.mark.slow
def test_a_turned_polarity_and_another_rated_current_are_refused_before_the_drive_is_enabled(person: Person) -> None:
    text = (EDS / "cia402_servo.eds").read_text(encoding="utf-8")
    text += "\n[607E]\nParameterName=Polarity\nObjectType=0x7\nDataType=0x0005\nAccessType=rw\nDefaultValue=0\n"
    (person.folder / "drive.eds").write_text(f"{text}PDOMapping=0\n", encoding="utf-8")
    person.types("new", str(person.folder / "drive.eds"), "--simulate", "--out", "rig.yaml")
    rig = person.folder / "rig.yaml"
    rig.write_text(rig.read_text().replace("    objects:\n", "    objects:\n      0x6075: 5000\n"))
    words = ("commission", "rig.yaml", "--yes", "--travel", "0.1", "--duration", "0.1", "--out", "mine.yaml")
    person.types(*words)
    assert person.runs("mine.yaml", "--duration", "0.1")["status"] == "completed"
    for changed, named in (({"0x607E": 128}, "Polarity = 128, 0 at"), ({"0x6075": 4000}, "current = 4000, 5000 at")):
        person.types(
            "run", "mine.yaml", "--duration", "0.1", "--set", drive_with(**changed), "--bus-log", "bus.log", "--force",
            status=None,
        )  # fmt: skip
        assert f"{named} commissioning" in person.errors
        sent = [line.split()[2] for line in (person.folder / "bus.log").read_text().splitlines()]
        assert "201#0F000000" not in sent
        assert any(frame.startswith("601#40") for frame in sent)
