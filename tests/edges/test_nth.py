"""The n-th call fails, for every n of a short run that presses on a wall: sends, receives, answers, calls, files.

In each case a torque that acts is ended by zero before anything else is sent, the drive is disabled or said not to
be, and the account is kept.
"""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

import can
import pytest

import canhaptic
from canhaptic.errors import CanHapticError
from tests.edges.short_run import Edge, Outcome, pressed

PACKAGE = str(Path(canhaptic.__file__).parent)
SIMULATED = f"{PACKAGE}/sim/"
CYCLES = 40


class Nth:
    """Counts calls, and fails at those that are chosen.

    Args:
        fails: Whether the n-th call fails, from 1 on.
        edge: The run, which notes frames from the first failure on.
    """

    def __init__(self, fails: Callable[[int], bool]) -> None:
        self.fails, self.count = fails, 0
        self.edge: Edge | None = None

    def __call__(self) -> bool:
        self.count += 1
        if not self.fails(self.count):
            return False
        if self.edge is not None:
            self.edge.is_done = True
        return True


def refused(nth: Nth, error: Callable[[], Exception]) -> Callable[[Edge], None]:
    """The interface refuses frames of the master."""

    def prepare(edge: Edge) -> None:
        nth.edge = edge

        def sent(message: can.Message) -> can.Message:
            if nth():
                raise error()
            return message

        edge.master.on_send = sent

    return prepare


def unread(nth: Nth, error: Callable[[], Exception]) -> Callable[[Edge], None]:
    """The interface cannot be read."""

    def prepare(edge: Edge) -> None:
        nth.edge = edge
        recv = edge.master.recv

        def received(timeout: float | None = None) -> can.Message | None:
            if nth():
                raise error()
            return recv(timeout)

        edge.master.recv = received

    return prepare


def unanswered(nth: Nth, answer: bytes | None) -> Callable[[Edge], None]:
    """The drive's SDO server aborts a request, or does not answer it."""

    def prepare(edge: Edge) -> None:
        nth.edge = edge

        def answered(message: can.Message) -> can.Message | None:
            if message.arbitration_id != 0x580 + edge.drive.node_id or not nth():
                return message
            if answer is None:
                return None
            message.data[0] = 0x80
            message.data[4:8] = answer
            return message

        edge.far.on_send = answered

    return prepare


def out_of_memory(nth: Nth) -> Callable[[Edge], None]:
    """A call inside the package, but for the simulated side, finds no memory."""

    def prepare(edge: Edge) -> None:
        nth.edge = edge

        def profiled(frame: FrameType, event: str, _argument: Any) -> None:
            file = frame.f_code.co_filename
            is_ours = event == "call" and file.startswith(PACKAGE) and not file.startswith(SIMULATED)
            if is_ours and not edge.is_over and nth():
                raise MemoryError

        sys.setprofile(profiled)

    return prepare


def busy() -> Exception:
    return can.CanOperationError("No buffer space available", 105)


def outcome(prepare: Callable[[Edge], None]) -> Outcome:
    try:
        return pressed(prepare=prepare, cycles=CYCLES, at=10**9)
    finally:
        sys.setprofile(None)


def total(fault: Callable[[Nth], Callable[[Edge], None]]) -> int:
    """Calls of a whole run."""
    nth = Nth(lambda n: False)
    outcome(fault(nth))
    return nth.count


FAULTS: dict[str, Callable[[Nth], Callable[[Edge], None]]] = {
    "send": lambda nth: refused(nth, busy),
    "receive": lambda nth: unread(nth, busy),
    "send without memory": lambda nth: refused(nth, MemoryError),
    "receive without memory": lambda nth: unread(nth, MemoryError),
    "SDO aborted": lambda nth: unanswered(nth, bytes.fromhex("00 00 00 08")),
    "SDO unanswered": lambda nth: unanswered(nth, None),
    "call without memory": out_of_memory,
}
HOW: dict[str, Callable[[int], Callable[[int], bool]]] = {
    "once": lambda n: lambda number: number == n,
    "twice": lambda n: lambda number: number in (n, n + 1),
    "for ever": lambda n: lambda number: number >= n,
}
CELLS = [
    *((fault, "once") for fault in FAULTS),
    ("send", "twice"),
    *((fault, "for ever") for fault in list(FAULTS)[:4]),
]
CALLS, LATER = 11, 3
"""Every eleventh of 8,000 calls, and every third place of what fails more than once: the cycles are alike."""
BEFORE_THE_START = 10
"""Calls before anything is sent, of which an error needs no account."""


def require_safe(seen: Outcome, what: str) -> None:
    """Require that a run with a failure ended, or went on, as it has to."""
    assert seen.error is None or isinstance(seen.error, CanHapticError), (what, seen.error)
    assert seen.result["ports"], what
    assert seen.is_disabled_or_said, (what, seen.error)
    if seen.edge.was_pressing and seen.error is not None:
        assert seen.is_zero_first, (what, seen.frames)
        assert (seen.syncs_to_zero or 0) <= 1, (what, seen.frames)


def places(fault: str, how: str) -> Sequence[int]:
    is_call = fault == "call without memory"
    step = CALLS if is_call else 1 if how == "once" else LATER
    return range(BEFORE_THE_START if is_call else 1, total(FAULTS[fault]) + 1, step)


@pytest.mark.parametrize("name", ["watch_statusword", "_require_no_other_master"])
def test_a_start_that_fails_after_its_last_step_disables_the_drives(name: str) -> None:
    def prepare(edge: Edge) -> None:
        def profiled(frame: FrameType, event: str, _argument: Any) -> None:
            if event == "call" and frame.f_code.co_name == name:
                raise MemoryError

        sys.setprofile(profiled)

    seen = outcome(prepare)
    assert isinstance(seen.error, CanHapticError)
    assert not seen.edge.drive.servo.is_powered
    assert seen.result["ports"]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # of generators that end without memory
@pytest.mark.timeout(1200)  # half a minute of a processor, longer on a busy machine
@pytest.mark.campaign_for("call without memory-*")  # two hundred places
@pytest.mark.parametrize(("fault", "how"), CELLS)
def test_wherever_it_fails_zero_comes_first_and_nothing_is_lost(fault: str, how: str) -> None:
    syncs: set[int | None] = set()
    for n in places(fault, how):
        seen = outcome(FAULTS[fault](Nth(HOW[how](n))))
        require_safe(seen, f"{fault} {how} at {n}")
        if seen.edge.was_pressing and seen.error is not None:
            syncs.add(seen.syncs_to_zero)
    assert syncs <= {0, 1, None}  # None: no frame goes out any more


@pytest.mark.slow_but("receive", "send without memory", "SDO unanswered")
@pytest.mark.parametrize("fault", FAULTS)
def test_at_a_few_places_zero_comes_first_and_nothing_is_lost(fault: str) -> None:
    every = places(fault, "once")
    for part, how in ((0.6, "once"), (0.7, "for ever"), (0.93, "once")):  # contact, contact, stop
        n = every[int(part * len(every))]
        require_safe(outcome(FAULTS[fault](Nth(HOW[how](n)))), f"{fault} {how} at {n}")
