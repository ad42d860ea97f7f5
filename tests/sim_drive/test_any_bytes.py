"""For all bytes that arrive, the drive neither raises nor makes torque outside OPERATION ENABLED."""

import can
from hypothesis import given, settings
from hypothesis import strategies as st

from canhaptic.sim.drive.can.drive_node import DrivesOnBus
from canhaptic.sim.drive.profile.state_machine import DriveState
from tests.drawn import examples
from tests.sim_drive.drive_on_bus import NODE, PERIOD, TRAITS, Rig

COB_IDS = [0x000, 0x080, 0x085, 0x205, 0x305, 0x405, 0x605, 0x705, 0x77F]
INTERESTING = [
    "0105", "8005", "0205", "8105", "8205", "06000000", "07000000", "0f006400", "0f00ff7f", "80000000", "02000000",
    "2f60600000000000", "2f6060000a000000", "2b40600006000000", "2b4060000f000000", "2b71600064000000",
    "2300140105020080", "2300140105020000", "2f00160000000000", "2300160110006040", "2300160210007160",
    "2f00160002000000", "2f00140201000000", "2f001402ff000000", "2b17100001000000", "2316100101007f00",
    "2372600000000000", "2b07600000000000", "2b5a600005000000", "2f00180200000000", "2b00180501000000",
    "2306100001000000", "4008100000000000", "6000000000000000", "7000000000000000", "2106100004000000",
    "0d00000000000000", "05",
]  # fmt: skip
CONTENT = st.one_of(st.binary(max_size=8), st.sampled_from([bytes.fromhex(text) for text in INTERESTING]))
FRAMES = st.lists(
    st.tuples(st.one_of(st.sampled_from(COB_IDS), st.integers(0, 0x7FF)), CONTENT, st.integers(0, 3)), max_size=60
)


def check(rig: Rig, frames: list[tuple[int, bytes, int]]) -> None:
    for cob_id, content, advance in frames:
        rig.now += advance * PERIOD // 2
        rig.bus.send(can.Message(arbitration_id=cob_id, data=content, is_extended_id=False))
        rig.group.process(rig.now)
        if rig.drive.state is not DriveState.OPERATION_ENABLED:
            assert rig.drive.torque == 0.0
        assert abs(rig.drive.torque) <= 32.768
        assert rig.group.next_due() > rig.now
        while (message := rig.bus.recv(0)) is not None:
            assert len(message.data) <= 8


@settings(max_examples=examples(200), deadline=None)
@given(FRAMES, st.booleans())
def test_no_frames_make_the_drive_raise_or_push_while_not_enabled(
    frames: list[tuple[int, bytes, int]], enabled: bool
) -> None:
    with Rig() as rig:
        if enabled:
            rig.enable()
            rig.send(0x205, "0f006400")
            assert rig.drive.torque == 0.1
        check(rig, frames)


@settings(max_examples=examples(50), deadline=None)
@given(FRAMES)
def test_no_frames_make_a_drive_of_a_sparse_dictionary_raise(frames: list[tuple[int, bytes, int]]) -> None:
    with Rig(TRAITS / "empty_entries.eds", objects={0x6502: 0x200}) as rig:
        check(rig, frames)


def test_extended_remote_and_error_frames_are_no_frames_for_the_drive(rig: Rig) -> None:
    rig.start()
    for message in (
        can.Message(arbitration_id=0x205, data=b"\x06\0\0\0", is_extended_id=True),
        can.Message(arbitration_id=0x205, dlc=4, is_remote_frame=True, is_extended_id=False),
        can.Message(arbitration_id=0x205, data=b"\x06\0\0\0", is_error_frame=True, is_extended_id=False),
    ):
        rig.bus.send(message)
        rig.group.process(rig.now)
    assert rig.drive.state is DriveState.SWITCH_ON_DISABLED


def test_drives_of_a_group_share_one_connection() -> None:
    with Rig() as first, Rig(node_id=NODE + 1) as second:
        group = DrivesOnBus(first.drive._bus, (first.drive, second.drive))
        second.drive._bus = first.drive._bus
        first.bus.send(can.Message(arbitration_id=0, data=b"\1\0", is_extended_id=False))
        group.process(0)
        first.bus.send(can.Message(arbitration_id=0x080, is_extended_id=False))
        group.process(PERIOD)
        answers = []
        while (message := first.bus.recv(0)) is not None:
            answers.append(message.arbitration_id)
        assert answers == [0x185, 0x186]
        assert group.next_due() > PERIOD


def test_bus_that_refuses_frames_is_counted_and_survived(rig: Rig) -> None:
    class Refusing:
        def send(self, _message: can.Message) -> None:
            raise can.CanOperationError("no buffer space")

    rig.drive._bus = Refusing()  # type: ignore[assignment]
    rig.drive.inject_fault(0x2310)
    assert rig.drive.frames_lost == 1
