"""An axis that follows velocities: what its parameters, its dictionary and its frames must be."""

import can
import pytest

from canhaptic.canopen.eds import read_dictionary
from canhaptic.canopen.force_node import ForceNode
from canhaptic.drive.axis_parameters import AxisParameters, BusParameters
from canhaptic.drive.can.admittance_drive import AdmittanceDrive
from canhaptic.drive.can.link import Link
from canhaptic.drive.clock import VirtualClock
from canhaptic.drive.profile.admittance_parameters import AdmittanceParameters, ForceChannel, ForceParameters
from canhaptic.drive.profile.fitness import Verdict, profile_findings
from canhaptic.errors import ParameterError
from tests.drive.drive_bench import REPOSITORY, axis, private_channel

EDS = REPOSITORY / "eds" / "cia402_admittance.eds"
FORCE = {"per_count": 0.01, "range": 300.0, "slew": 5e3, "error": 0.5}


def display(drive_objects: dict[str, int] | None = None, **values: object) -> AxisParameters:
    """An axis whose sensor is an input of its drive."""
    force = ForceParameters(object="0x2205.1", **FORCE)  # type: ignore[arg-type]
    given = {"acceleration_limit": 50.0, "handle_acceleration": 80.0, "force": force} | values
    return axis(
        name="handle", eds=EDS, admittance=AdmittanceParameters(**given), speed_limit=1.0,
        drive_objects=drive_objects or {},
    )  # fmt: skip


def test_a_force_has_one_source() -> None:
    node = ForceNode(cob_id=0x190)
    for source in ({}, {"object": "0x2205.1", "node": node}):
        with pytest.raises(ParameterError, match=r"either object .* or node"):
            ForceParameters(**FORCE, **source)  # type: ignore[arg-type]
    assert ForceParameters(**FORCE, node=node).place is None  # type: ignore[arg-type]


def test_a_drive_that_brakes_is_given_the_declared_time() -> None:
    with can.Bus(interface="virtual", channel=private_channel()) as bus:
        of = display(stop_time=0.25)
        drive = AdmittanceDrive(
            Link(bus, VirtualClock()), of, read_dictionary(EDS, of.node_id), BusParameters(rate=1000.0)
        )
        assert drive.stop_time == 250_000_000


def test_a_ramp_in_the_drive_below_the_acceleration_limit_is_refused() -> None:
    for ramp, refused in ((4_900_000, True), (5_000_000, False)):  # counts/s^2, of 1e5 counts per metre
        of = display({"0x6083": ramp})
        found = [
            finding.verdict
            for finding in profile_findings(read_dictionary(EDS, of.node_id), of, 1_000_000)
            if "ramps" in finding.item
        ]
        assert found == ([Verdict.REFUSED] if refused else [])


def test_an_impulse_that_wraps_is_a_change_of_one_count() -> None:
    channel = ForceChannel(
        ForceParameters(node=ForceNode(cob_id=0x190, bits=16), sampling="impulse", **FORCE),
        1e-3,  # type: ignore[arg-type]
    )
    channel.take(0x7FFF)
    assert channel.take(-0x8000) == pytest.approx(0.01 / 1e-3)
