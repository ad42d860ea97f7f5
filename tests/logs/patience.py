"""Waiting for another process, without a time as the pass mark: only a wait in vain ends it."""

import threading
from collections.abc import Callable

_PAUSE = 0.01  # [s]


def wait_for(condition: Callable[[], object], seconds: float = 60.0) -> None:
    """Returns once the condition holds."""
    pause = threading.Event()
    for _ in range(int(seconds / _PAUSE)):
        if condition():
            return
        pause.wait(_PAUSE)
    raise AssertionError("waited in vain")
