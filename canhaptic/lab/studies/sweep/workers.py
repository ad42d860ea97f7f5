"""Where chunks run: in this process, in a process pool, on a Dask cluster, on any executor of `concurrent.futures`.

A pool whose worker dies is made anew and what it had not finished is run again; Dask does that by itself.
"""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import wait
from typing import Final, TypeVar

from canhaptic.errors import InputError
from canhaptic.extras import install_hint

T = TypeVar("T")

_CONNECT: Final = 10.0
"""Time in which a scheduler must answer [s]."""


class SerialExecutor(Executor):
    """Runs what is submitted at once, in this thread."""

    def submit(self, fn: Callable[..., T], /, *args: object, **kwargs: object) -> Future[T]:
        """Return a future that is done."""
        future: Future[T] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class Pool:
    """Worker processes of our own; `renew` replaces them when one died.

    Started afresh (`spawn`), so that no thread or lock of this process lives on in them. They leave Ctrl-C to this
    process, and end when it does, however it ends.

    Args:
        workers: Number of processes.
    """

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self.executor = self._made()

    def renew(self) -> Executor:
        """Return new processes in the place of the old ones."""
        self.executor.shutdown(wait=True, cancel_futures=True)
        self.executor = self._made()
        return self.executor

    def close(self) -> None:
        """End the processes once they have finished what they are at."""
        self.executor.shutdown(wait=True, cancel_futures=True)

    def _made(self) -> ProcessPoolExecutor:
        context = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(self.workers, mp_context=context, initializer=_begin_worker)


def _begin_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    threading.Thread(target=_follow_parent, daemon=True).start()


def _follow_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


@contextmanager
def dask_executor(address: str) -> Iterator[tuple[Executor, int]]:
    """Yield (executor, number of threads of its workers) of a Dask cluster.

    Args:
        address: Address of the scheduler, as in tcp://10.0.0.5:8786.

    Raises:
        InputError: Dask is not installed, no scheduler answers, or it has no worker.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(f"--dask needs Dask; install it with: {install_hint('sweep')}") from error
    try:
        client = Client(address, timeout=_CONNECT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"--dask {address}: no scheduler answers there within {_CONNECT:g} s ({error}); "
            "start one with dask scheduler"
        ) from error
    try:
        threads = sum(client.nthreads().values())
        if not threads:
            raise InputError(f"--dask {address}: the cluster has no worker; start some with dask worker {address}")
        yield client.get_executor(pure=False), threads
    finally:
        client.close()
