"""The lean virtual bus does what python-can's own does, next to it on the same channel."""

import threading
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import count

import can
import pytest
from can.interfaces.virtual import VirtualBus
from hypothesis import given
from hypothesis import strategies as st

from canhaptic.canopen.data_frame import DataFrame
from canhaptic.sim.bus.virtual_bus import LeanVirtualBus

CHANNELS = count()
FIELDS = [name for name in can.Message.__slots__ if name not in ("__weakref__", "channel", "is_rx")]


@pytest.fixture
def channel() -> str:
    return f"lean-{next(CHANNELS)}"


@pytest.fixture
def pair(channel: str) -> Iterator[tuple[LeanVirtualBus, LeanVirtualBus]]:
    with LeanVirtualBus(channel) as here, LeanVirtualBus(channel) as there:
        yield here, there


@given(
    message=st.builds(
        can.Message,
        timestamp=st.floats(0.0, 1e9),
        arbitration_id=st.integers(0, 0x1FFF_FFFF),
        is_extended_id=st.booleans(),
        is_error_frame=st.booleans(),
        data=st.binary(max_size=8),
        is_fd=st.booleans(),
        is_rx=st.booleans(),
        bitrate_switch=st.booleans(),
        error_state_indicator=st.booleans(),
    )
)
def test_every_field_arrives_as_through_the_stock_bus(message: can.Message) -> None:
    channel = f"lean-{next(CHANNELS)}"
    with (
        LeanVirtualBus(channel) as lean,
        VirtualBus(channel, preserve_timestamps=True) as stock,
        LeanVirtualBus(channel) as third,
    ):
        lean.send(message)
        by_lean = [stock.recv(0), third.recv(0)]
        stock.send(message)
        by_stock = third.recv(0)
        assert lean.recv(0) is not None, "the stock bus reaches it"
    for taken in by_lean:
        assert taken is not None
        assert taken.is_rx
        assert taken.channel == channel
        for name in FIELDS:
            assert getattr(taken, name) == getattr(by_stock, name) == getattr(message, name), name


def test_what_the_sender_or_another_receiver_changes_later_does_not_arrive(channel: str) -> None:
    with LeanVirtualBus(channel) as sender, LeanVirtualBus(channel) as first, LeanVirtualBus(channel) as second:
        message = can.Message(arbitration_id=1, is_extended_id=False, data=b"\x01\x02")
        sender.send(message)
        message.data[0], message.arbitration_id = 9, 9
        taken = first.recv(0)
        assert taken is not None
        taken.data[1] = 9
        other = second.recv(0)
    assert other is not None
    assert (other.arbitration_id, bytes(other.data)) == (1, b"\x01\x02")


@pytest.mark.parametrize("further", [0, 1, 2])
def test_a_frame_of_master_or_drive_arrives_as_any_other_and_no_two_takers_share_it(channel: str, further: int) -> None:
    with ExitStack() as stack:
        sender = stack.enter_context(LeanVirtualBus(channel))
        takers = [stack.enter_context(kind(channel)) for kind in (LeanVirtualBus, LeanVirtualBus, VirtualBus)]
        for closed in takers[further + 1 :]:
            closed.shutdown()
        frame = DataFrame()
        frame.timestamp, frame.arbitration_id, frame.channel = 1.5, 0x205, channel
        frame.data, frame.dlc = bytearray(b"\x01\x02"), 2
        sender.send(frame)
        taken = [taker.recv(0) for taker in takers[: further + 1]]
    expected = can.Message(timestamp=1.5, arbitration_id=0x205, is_extended_id=False, channel=channel, data=[1, 2])
    for message in taken:
        assert message is not None
        assert message.equals(expected, timestamp_delta=0.0, check_direction=False)
        assert message.is_rx
        message.data[0] = 9  # no other reader sees that


def test_frames_come_in_order_and_not_back_to_their_sender(pair: tuple[LeanVirtualBus, LeanVirtualBus]) -> None:
    here, there = pair
    for cob_id in (3, 1, 2):
        here.send(can.Message(arbitration_id=cob_id, is_extended_id=False))
    came = [there.recv(0), there.recv(0.0), there.recv(0.5), there.recv(0)]
    assert [None if message is None else message.arbitration_id for message in came] == [3, 1, 2, None]
    assert here.recv(0) is None
    assert here.recv(0.001) is None


def test_a_frame_of_another_thread_ends_the_wait(pair: tuple[LeanVirtualBus, LeanVirtualBus]) -> None:
    here, there = pair
    thread = threading.Timer(0.01, here.send, [can.Message(arbitration_id=5, is_extended_id=False)])
    thread.start()
    message = there.recv(None)
    thread.join()
    assert message is not None
    assert message.arbitration_id == 5


def test_a_bell_that_rings_late_for_a_frame_already_taken_does_not_end_the_wait(
    pair: tuple[LeanVirtualBus, LeanVirtualBus],
) -> None:
    """A sender that is held up between its frame and the bell: the frame is taken and the next one awaited."""

    class Bell:
        rung = 0

        def acquire(self, blocking: bool = True, timeout: float = -1.0) -> bool:
            self.rung += blocking
            if self.rung == 2:
                there.waiting.append(frame)
            return True

    here, there = pair
    frame = can.Message(arbitration_id=5, is_extended_id=False)
    there.queue._bell = Bell()  # type: ignore[attr-defined]
    assert there.recv(30.0) is frame
    here.shutdown()


@pytest.mark.timeout(60)
def test_a_wait_shorter_than_the_machine_can_count_ends(pair: tuple[LeanVirtualBus, LeanVirtualBus]) -> None:
    """A run in real time hung for ever on a busy machine, in `queue.SimpleQueue.get` with a timeout gone by."""
    here, there = pair
    for _ in range(2000):
        here.send(can.Message(arbitration_id=5, is_extended_id=False))
        assert there.recv(0.0) is not None
        assert there.recv(1e-6) is None
        assert there.recv(-1.0) is None


def test_frames_of_many_threads_all_arrive(channel: str) -> None:
    with LeanVirtualBus(channel) as there, LeanVirtualBus(channel) as first, LeanVirtualBus(channel) as second:

        def send(bus: LeanVirtualBus) -> None:
            for number in range(500):
                bus.send(can.Message(arbitration_id=number, is_extended_id=False))

        threads = [threading.Thread(target=send, args=(bus,)) for bus in (first, second)]
        for thread in threads:
            thread.start()
        came = [there.recv(60.0) for _ in range(1000)]
        for thread in threads:
            thread.join()
    numbers = sorted(message.arbitration_id for message in came if message is not None)
    assert numbers == sorted([*range(500), *range(500)])


def test_filters_and_the_notifier_of_python_can_work(pair: tuple[LeanVirtualBus, LeanVirtualBus]) -> None:
    here, there = pair
    there.set_filters([{"can_id": 0x20, "can_mask": 0x7FF, "extended": False}])
    taken: list[int] = []
    came = threading.Event()

    def listen(message: can.Message) -> None:
        taken.append(message.arbitration_id)
        came.set()

    with can.Notifier(there, [listen], timeout=0.01):
        for cob_id in (0x10, 0x20):
            here.send(can.Message(arbitration_id=cob_id, is_extended_id=False))
        assert came.wait(60.0)
    assert taken == [0x20]


def test_a_connection_that_was_shut_down_refuses_and_hears_nothing(channel: str) -> None:
    here, there = LeanVirtualBus(channel), LeanVirtualBus(channel)
    there.shutdown()
    here.send(can.Message(arbitration_id=1, is_extended_id=False))
    for use in (lambda: there.recv(0), lambda: there.send(can.Message())):
        with pytest.raises(can.CanOperationError, match="closed"):
            use()
    here.shutdown()
