"""Decoding and scaling of the audit are written apart from the master's, and both give the same."""

import dataclasses
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canhaptic.audit.listened_axis import _RATED_TORQUE_COUNTS, _TORQUE_COUNTS, DeclaredDrive, ListenedAxis
from canhaptic.canopen import objects as od
from canhaptic.drive.profile.quirks import _QUIRKS, quirks_of
from canhaptic.drive.profile.scaling import AxisScaling
from canhaptic.drive.safety.power_states import drive_state
from canhaptic.errors import InputError
from canhaptic.logs.bus_reader import Frame
from canhaptic.logs.decoder import state_text

EDS = Path(__file__).parents[2] / "eds" / "cia402_servo.eds"
DRIVE = DeclaredDrive("x", 1, EDS, 1e4, 1, 1.0, 20.0, (), "before")
ENABLED = 0x27


def frame(can_id: int, data: bytes) -> Frame:
    return Frame(0, can_id, data, is_rx=True)


def tpdo(counts: int, per_mille: int) -> Frame:
    data = ENABLED.to_bytes(2, "little") + counts.to_bytes(4, "little", signed=True)
    return frame(0x181, data + per_mille.to_bytes(2, "little", signed=True))


def listened(**changes: Any) -> ListenedAxis:
    axis = ListenedAxis(dataclasses.replace(DRIVE, **changes))
    for number, entry in enumerate((0x60410010, 0x60640020, 0x60740010), 1):
        axis.take(frame(0x601, bytes([0x23, 0x00, 0x1A, number]) + entry.to_bytes(4, "little")))
        axis.take(frame(0x581, bytes([0x60, 0x00, 0x1A, number, 0, 0, 0, 0])))
    axis.take(frame(0x601, bytes([0x2F, 0x00, 0x1A, 0, 3, 0, 0, 0])))
    axis.take(frame(0x581, bytes([0x60, 0x00, 0x1A, 0, 0, 0, 0, 0])))
    return axis


def read_rated(axis: ListenedAxis, counts: int) -> ListenedAxis:
    index = od.RATED_TORQUE.to_bytes(2, "little")
    axis.take(frame(0x601, b"\x40" + index + bytes(5)))
    axis.take(frame(0x581, b"\x43" + index + b"\x00" + counts.to_bytes(4, "little")))
    return axis


@pytest.mark.parametrize("high", [0x00, 0x02, 0xFF])
def test_every_statusword_means_the_same_to_the_log_and_to_the_master(high: int) -> None:
    for low in range(256):
        assert state_text(high << 8 | low) == drive_state(high << 8 | low).value, hex(low)


def test_every_quirk_that_scales_is_known_to_the_audit() -> None:
    scaled = {"rated_torque_resolution": _RATED_TORQUE_COUNTS, "torque_resolution": _TORQUE_COUNTS}
    for field, table in scaled.items():
        assert dict(table) == {name: changes[field] for name, changes in _QUIRKS.items() if field in changes}


@pytest.mark.slow
@given(
    st.lists(st.integers(-(2**31), 2**31 - 1), min_size=1, max_size=20),
    st.integers(-(2**15), 2**15 - 1),
    st.floats(1e-2, 1e7),
    st.floats(1e-3, 1e4),
    st.sampled_from([1, -1]),
    st.sampled_from(["", *_TORQUE_COUNTS]),
)
def test_both_scalings_give_the_same_bits(counts, per_mille, counts_per_unit, rated, direction, quirk) -> None:
    quirks = (quirk,) if quirk else ()
    master = AxisScaling(counts_per_unit, rated * quirks_of(quirks).torque_scale, direction)
    axis = listened(counts_per_unit=counts_per_unit, rated_torque=rated, direction=direction, quirks=quirks)
    for cycle, value in enumerate(counts):
        axis.take(tpdo(value, per_mille))
        assert axis.is_enabled
        found = axis.sample(cycle)
        assert (found.position, found.torque_applied) == (master.position(value), master.torque(per_mille))
        axis.forget()


def test_the_rated_torque_of_the_frames_counts_and_must_be_that_of_the_scene() -> None:
    axis = read_rated(listened(rated_torque=None, transmission=2.0), 5000)
    axis.take(tpdo(0, 100))
    assert axis.sample(0).torque_applied == pytest.approx(1.0)  # 100 per mille of 5 N*m times 2
    axis = read_rated(listened(rated_torque=None, quirks=("rated_torque_micro",)), 5000)
    axis.take(tpdo(0, 1000))
    assert axis.sample(0).torque_applied == pytest.approx(5e-3)
    axis = read_rated(listened(rated_torque=20.0), 5000)
    axis.take(tpdo(0, 100))
    with pytest.raises(InputError, match=r"x: the frames state a rated torque \(0x6076\) of 5 and the scene 20"):
        axis.sample(0)
    axis = listened(rated_torque=None)
    axis.take(tpdo(0, 100))
    with pytest.raises(InputError, match="neither the frames nor the scene state the rated torque"):
        axis.sample(0)
