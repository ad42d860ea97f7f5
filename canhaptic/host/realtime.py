"""Real-time settings of the thread that runs the cycle: priority, processors, locked memory, garbage collection.

Only configured settings are requested, and all are released at the end. A refusal never stops a run; the report gives
the operating system's reason, such as a missing privilege.
"""

import ctypes
import gc
import os
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from typing import Annotated, Final

from canhaptic.units import Parameters, quantity

GRANTED: Final = "granted"


class RealtimeParameters(Parameters):
    """Requested settings; none by default."""

    priority: Annotated[int, quantity("1", ge=1, le=99)] | None = None
    """SCHED_FIFO priority of the thread that runs the cycle; threads and processes it starts do not inherit it."""
    cpus: tuple[Annotated[int, quantity("1", ge=0, le=4095)], ...] | None = None
    """Processors that the thread may run on."""
    lock_memory: bool = False
    """Locks the memory that the process has at the start (mlockall), so that no page is swapped out."""
    freeze_garbage: bool = False
    """Freezes the objects that exist at the start, so that the garbage collector skips them (gc.freeze)."""


class Realtime:
    """Real-time settings of a thread, requested by `begin` and released by `end`.

    Args:
        parameters: Requested settings.

    Attributes:
        report: Name of a setting -> "granted", or "refused: " and the reason. Empty before `begin`.
    """

    def __init__(self, parameters: RealtimeParameters) -> None:
        self._parameters = parameters
        self._undo = ExitStack()
        self.report: dict[str, str] = {}

    def begin(self) -> None:
        """Request all settings for the calling thread; earlier ones are released first."""
        self.end()
        self.report = {}
        asked = self._parameters
        if asked.cpus is not None:
            self._ask("cpus", partial(self._pin, asked.cpus))
        if asked.lock_memory:
            self._ask("lock_memory", self._lock_memory)
        if asked.freeze_garbage:
            self._ask("freeze_garbage", self._freeze_garbage)
        if asked.priority is not None:
            self._ask("priority", partial(self._raise_priority, asked.priority))

    def end(self) -> None:
        """Release all settings, in the thread that called `begin`; a second call does nothing."""
        self._undo.close()

    def _ask(self, name: str, ask: Callable[[], None]) -> None:
        try:
            ask()
        except AttributeError:
            self.report[name] = "refused: this platform does not offer it"
        except (OSError, ValueError) as error:
            self.report[name] = f"refused: {error}"
        else:
            self.report[name] = GRANTED

    def _pin(self, cpus: tuple[int, ...]) -> None:
        before = os.sched_getaffinity(0)
        os.sched_setaffinity(0, cpus)
        self._undo.callback(os.sched_setaffinity, 0, before)

    def _lock_memory(self) -> None:
        system = ctypes.CDLL(None, use_errno=True)
        if system.mlockall(1):  # MCL_CURRENT: later pages are not locked, lest a limit makes them fail
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number))
        self._undo.callback(system.munlockall)

    def _freeze_garbage(self) -> None:
        gc.collect()
        gc.freeze()
        self._undo.callback(gc.unfreeze)

    def _raise_priority(self, priority: int) -> None:
        policy, before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
        self._undo.callback(os.sched_setscheduler, 0, policy, before)
