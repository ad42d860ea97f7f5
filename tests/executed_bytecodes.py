"""Executed bytecodes: a price of Python code that is the same in every run on one version of Python."""

import sys
from collections.abc import Callable
from types import FrameType
from typing import Any


def executed_bytecodes(work: Callable[[], object]) -> int:
    """Returns how many bytecodes `work` executes, in itself and in all Python that it calls."""
    count = 0

    def trace(frame: FrameType, event: str, _argument: Any) -> Any:
        nonlocal count
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        if event == "opcode":
            count += 1
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        work()
    finally:
        sys.settrace(before)
    return count
