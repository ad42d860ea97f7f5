"""The n-th call fails, for every n of a short run that presses on a wall: sends, receives, answers, calls, files.

Whatever fails: a torque that acts is ended by zero before anything else is sent, the drive is disabled or said not to be,
and the account is kept.
"""

import sys
from collections.abc import Callable, Iterator, Sequence
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
        self.fails, self.count, self.edge = fails, 0, None

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
            if event == "call" and frame.f_code.co_filename.startswith(PACKAGE):
                if not frame.f_code.co_filename.startswith(SIMULATED) and nth():
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
