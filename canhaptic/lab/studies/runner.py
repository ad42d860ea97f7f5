"""Run the jobs of a study: in this process, in a process pool, on a Dask cluster, or on any executor.

If a worker of a pool dies, the pool is replaced and its unfinished jobs are run again; Dask does that by itself.
"""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor
from concurrent.futures import wait as wait_for_jobs
from contextlib import closing, contextmanager
from multiprocessing.connection import wait
from typing import Any, Final, NamedTuple, TypeVar

from canhaptic.errors import CanHapticError, InputError, WorkersLostError
from canhaptic.extras import install_hint

T = TypeVar("T")

_CONNECT: Final = 10.0
"""Time allowed for a scheduler to answer [s]."""
_LOOK: Final = 0.2
"""Time between two polls of a request to stop [s]."""
_MOST_LOSSES: Final = 3
"""Largest number of pools lost in a row without a finished job in between."""


class Progress(NamedTuple):
    """How many cases of a study are finished, and whether a loop is being compiled."""

    done: int  # cases whose results are in the store
    total: int
    begun: int  # cases that an earlier run had finished
    compiles: bool = False  # whether a loop is being compiled


class Job(NamedTuple):
    """Some cases of a study that a worker computes together."""

    what: str  # description for messages, such as "scenes 0 to 49"
    cases: int  # number of its cases
    run: Callable[..., Any]  # function that a worker calls
    arguments: Callable[[], tuple[object, ...]]  # makes its arguments when the job is submitted
    take: Callable[[Any], None]  # stores its result


class Count:
    """Count of the finished cases, shown as it grows.

    Args:
        total: Number of all cases.
        begun: Number of cases that an earlier run had finished.
        progress: Called with the progress.

    Attributes:
        state: Progress so far.
    """

    def __init__(self, total: int, begun: int, progress: Callable[[Progress], None]) -> None:
        self.state, self._progress = Progress(begun, total, begun), progress
        progress(self.state)

    def add(self, cases: int) -> None:
        """Count further finished cases."""
        self.state = self.state._replace(done=self.state.done + cases)
        self._progress(self.state)

    def within(self, cases: int, *, compiles: bool) -> None:
        """Show how many cases of the running job are done, and whether their loop is being compiled."""
        self._progress(self.state._replace(done=self.state.done + cases, compiles=compiles))


class SerialExecutor(Executor):
    """Executor that runs each job immediately, in this thread."""

    def submit(self, fn: Callable[..., T], /, *args: object, **kwargs: object) -> Future[T]:
        """Run the job now, and return its completed future."""
        future: Future[T] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class Pool(Executor):
    """Executor of worker processes; `renew` replaces them after one died.

    They are spawned, so that they inherit no thread or lock of this process. They ignore Ctrl-C, and end when this
    process ends, for any reason.

    Args:
        workers: Number of processes.
    """

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self.executor = self._made()

    def submit(self, fn: Callable[..., T], /, *args: object, **kwargs: object) -> Future[T]:
        """Let a process run the job."""
        return self.executor.submit(fn, *args, **kwargs)

    def renew(self) -> None:
        """Replace the processes by new ones."""
        self.shutdown()
        self.executor = self._made()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = True) -> None:
        """End the processes after they have finished their running jobs."""
        self.executor.shutdown(wait, cancel_futures=cancel_futures)

    def _made(self) -> ProcessPoolExecutor:
        context = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(self.workers, mp_context=context, initializer=begin_worker)


@contextmanager
def pool_of(workers: int) -> Iterator[Pool | None]:
    """Yield a pool of processes, which is closed at the end; None for one worker, which is this process."""
    if workers == 1:
        yield None
        return
    with Pool(workers) as pool:
        yield pool


def begin_worker() -> None:
    """Initialise a worker process: ignore Ctrl-C, use one thread for linear algebra, and end with the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    end_with_parent()


def end_with_parent() -> None:
    """Let this process end as soon as its parent has ended, for any reason."""
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
        address: Address of the scheduler, such as tcp://10.0.0.5:8786.

    Raises:
        InputError: Dask is not installed, no scheduler answers, or the cluster has no worker.
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
    with closing(client):
        threads = sum(client.nthreads().values())
        if not threads:
            raise InputError(f"--dask {address}: the cluster has no worker; start some with dask worker {address}")
        yield client.get_executor(pure=False), threads


def run_jobs(
    jobs: Sequence[Job],
    executor: Executor | None,
    stop_requested: Callable[[], bool],
    where: object,
    count: Count,
    in_flight: int = 4,
) -> None:
    """Run jobs until all are finished or a stop is requested; running jobs are still completed and stored.

    Args:
        jobs: The jobs, in the order of their submission.
        executor: Executor; None: this thread. A `Pool` gets two jobs per process at a time.
        stop_requested: Polled regularly.
        where: Place of the results, for messages.
        count: Count of the finished cases.
        in_flight: Largest number of jobs submitted to another executor and not yet taken.

    Raises:
        CanHapticError: A job fails with this error.
        WorkersLostError: Workers die repeatedly, or cannot run a job.
    """
    if executor is None or isinstance(executor, Pool):
        in_flight = 1 if executor is None else 2 * executor.workers
    _Run(jobs, executor or SerialExecutor(), in_flight, where, count).until(stop_requested)


class _Run:
    """State of `run_jobs`: jobs that wait, and jobs that are submitted."""

    def __init__(self, jobs: Sequence[Job], executor: Executor, in_flight: int, where: object, count: Count) -> None:
        self._waiting, self._executor, self._in_flight = [*jobs][::-1], executor, in_flight
        self._where, self._count = where, count
        self._out: dict[Future[Any], Job] = {}
        self._losses = 0

    def until(self, stop_requested: Callable[[], bool]) -> None:
        try:
            while (self._waiting or self._out) and not stop_requested():
                self._submit()
                ready, _ = wait_for_jobs(self._out, timeout=_LOOK, return_when=FIRST_COMPLETED)
                for future in ready:
                    self._take(future)
        finally:
            for future in self._out:
                future.cancel()
        for future in [*self._out]:
            if not future.cancelled():  # what is under way is not thrown away
                self._take(future)

    def _submit(self) -> None:
        while self._waiting and len(self._out) < self._in_flight:
            job = self._waiting.pop()
            try:
                self._out[self._executor.submit(job.run, *job.arguments())] = job
            except BrokenExecutor as error:
                self._lost(job, error)
                return

    def _take(self, future: Future[Any]) -> None:
        job = self._out.pop(future, None)
        if job is None:
            return
        try:
            result = future.result()
        except BrokenExecutor as error:
            self._lost(job, error)
        except CanHapticError:
            raise
        except (Exception, CancelledError) as error:
            raise WorkersLostError(
                f"{self._where}: {job.what} failed in a worker ({type(error).__name__}: {error}); workers need the "
                "same canhaptic and the drive's EDS at the same path; finished work is kept; continue with --resume"
            ) from error
        else:
            job.take(result)
            self._count.add(job.cases)
            self._losses = 0

    def _lost(self, job: Job, error: BrokenExecutor) -> None:
        """Queue a job and all other unfinished ones again with new workers, unless workers died too often."""
        self._waiting += [job, *self._out.values()]
        self._out.clear()
        self._losses += 1
        if not isinstance(self._executor, Pool) or self._losses >= _MOST_LOSSES:
            raise WorkersLostError(
                f"{self._where}: the workers died {self._losses} times in a row without finishing a chunk "
                f"({error or type(error).__name__}); finished work is kept: look for the cause (memory?), then "
                "--resume with fewer workers, or begin a new folder with a smaller --chunk"
            ) from error
        self._executor.renew()
