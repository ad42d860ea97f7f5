"""A real Dask cluster on this machine: scheduler and workers as processes, free ports, a private folder."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

_REPOSITORY = Path(__file__).resolve().parents[3]
_START = 30.0  # [s]
_WORKER = ("--nthreads", "1", "--nworkers", "1", "--no-nanny", "--no-dashboard", "--memory-limit", "0")


class Cluster:
    """Scheduler and workers."""

    def __init__(self, folder: Path, workers: int) -> None:
        self._folder = folder
        self._file = folder / "scheduler.json"
        self._processes = [
            self._begin("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--no-show")
        ]
        self._wait(self._file.exists)
        self.address = self._address()
        self.workers = [self._begin("worker", *_WORKER, "--name", str(i)) for i in range(workers)]

    def _begin(self, what: str, *options: str) -> subprocess.Popen:
        command = [sys.executable, "-m", f"distributed.cli.dask_{what}", "--scheduler-file", str(self._file), *options]
        if what == "worker":
            command += ["--local-directory", str(self._folder)]
        environment = {**os.environ, "PYTHONPATH": str(_REPOSITORY)}
        with (self._folder / f"{what}.log").open("ab") as log:
            return subprocess.Popen(command, stdout=log, stderr=log, cwd=self._folder, env=environment)

    def _address(self) -> str:
        found: list[str] = []

        def is_read() -> bool:
            try:
                found.append(json.loads(self._file.read_text())["address"])
            except (ValueError, KeyError):
                return False
            return True

        self._wait(is_read)
        return found[0]

    def _wait(self, is_so) -> None:
        end = time.monotonic() + _START
        while not is_so():
            assert time.monotonic() < end, (self._folder / "scheduler.log").read_text()
            time.sleep(0.05)  # noqa: TID251

    def wait_for_workers(self) -> None:
        """Waits until all workers are connected."""
        with self._client() as client:
            client.wait_for_workers(len(self.workers), timeout=_START)

    def count_workers(self) -> int:
        """Returns how many workers the scheduler knows."""
        with self._client() as client:
            return len(client.nthreads())

    def _client(self):
        from distributed import Client

        return Client(self.address, set_as_default=False)

    def kill_worker(self) -> None:
        """Ends the first worker without a word."""
        self.workers[0].send_signal(signal.SIGKILL)
        self.workers[0].wait()

    def close(self) -> None:
        for process in (*self.workers, *self._processes):
            process.kill()
        for process in (*self.workers, *self._processes):
            process.wait()


@contextmanager
def dask_cluster(folder: Path, workers: int = 2):
    """Yields a running cluster."""
    cluster = Cluster(folder, workers)
    try:
        yield cluster
    finally:
        cluster.close()
