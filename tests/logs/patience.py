"""Waiting for another process, without a time as the pass mark: only a wait in vain ends it."""

import threading
from collections.abc import Callable

_PAUSE = 0.01  # [s]
_PAUSES = 6000


def wait_for(condition: Callable[[], object]) -> None:
    """Returns once the condition holds."""
    pause = threading.Event()
    for _ in range(_PAUSES):
        if condition():
            return
        pause.wait(_PAUSE)
    raise AssertionError("waited in vain")
