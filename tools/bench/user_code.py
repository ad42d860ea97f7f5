"""Does own code stall the cycle? `python -m tools.bench.user_code --seconds 60`: in its process, and where it may.

The same law at 1 kHz on the simulated drive in real time, in five places:

    package   the wall of the package: no own code
    process   own code in a process of its own
    thread    own code in a thread of the cycle's process, asked and answered as in a process of its own
    cycle     own code in the cycle
    canopen   the `canopen` package by hand: own code in the callback of a TPDO, no account, no limits

Own code is calm; or it spins for 50 ms each second, makes ten million objects and has them collected, or imports large
packages (scipy, matplotlib, numba, h5py) that its process had not; or it is stopped for 5 s: by SIGSTOP where it is a
process, else it sleeps. Each run is a process of its own, all take turns; each figure is the median over the rounds.
`late_holds` is out of the way. For `canopen` the time is from SYNC to RPDO, else that of the computation: where a stall
keeps back the SYNCs too, that time does not show it, and the longest gap between two torques sent does.

A last row is the time from a sample to its torque, through the process, at 1 kHz with nothing else in the loop.
"""

import argparse
import itertools
import multiprocessing
import os
import signal
import statistics
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from time import monotonic, monotonic_ns
from types import SimpleNamespace
from typing import Any, Final, NamedTuple

from canhaptic.cycle import run
from canhaptic.drive.clock import WallClock
from canhaptic.errors import CanHapticError
from canhaptic.scene.build import Experiment, build
from canhaptic.scene.load import for_program, load_scene
from canhaptic.scene.models import Scene
from canhaptic.scene.own_code import CodeProcess, LaterLaw, apart, reports_of
from canhaptic.signals import Sample
from tools.bench import peers
from tools.bench.demo import CONFIG, PERIOD
from tools.bench.paced import canopen_run, quantile
from tools.bench.report import Row, publish

STOPPED: Final = 5.0  # [s]
DEEDS: Final = {
    "calm": (1e9, "pass"),
    "spins": (1.0, "end = time.monotonic() + 0.05\n    while time.monotonic() < end: pass"),
    "collects": (4.0, "kept = [[] for _ in range(10_000_000)]; del kept; gc.collect()"),
    "imports": (1e9, "import h5py, matplotlib.pyplot, numba, scipy.optimize, scipy.signal, scipy.stats"),
    "is stopped": (1e9, "time.sleep({stopped})"),
}
"""What own code does now and then: how often [s], and its lines."""
DEED: Final = """
import gc, time
NEXT = [time.monotonic() + 1.0]

def now_and_then():
    if time.monotonic() < NEXT[0]:
        return
    {deed}
    NEXT[0] = time.monotonic() + {every}
"""
LAW: Final = """
from typing import Annotated
from canhaptic.extending import Environment, quantity

class Law(Environment):
    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0)] = 100.0

    def stored_energy(self, state: float) -> float:
        return 0.5 * self.stiffness * state * state

    def state_of_energy(self, energy: float, like: float) -> float:
        return like

    def effort(self, state: float) -> float:
        now_and_then()
        return self.stiffness * state
"""


class Found(NamedTuple):
    """What one run gave."""

    p99: float  # of the computation [us]
    skipped: int  # SYNCs
    late: int  # holds without an answer
    gap: float  # longest time between two torques sent, of all while the loop ran [ms]
    end: str  # why it ended before its time


class SentTorques:
    """The longest time between two torques sent on a bus; those of start and stop, which are zero, count."""

    def __init__(self, bus: Any) -> None:
        self._last, self.longest = 0, 0
        send = bus.send

        def noted(message: Any, timeout: float | None = None) -> None:
            if message.arbitration_id == peers.RPDO:
                self.note()
            send(message, timeout)

        bus.send = noted

    def note(self) -> None:
        """Notes that one is sent now, or that a loop begins or has ended."""
        now = monotonic_ns()
        self.longest = max(self.longest, now - (self._last or now))
        self._last = now


def deed_of(deed: str, where: str) -> str:
    """Returns the lines of a deed; a process of its own is stopped from outside."""
    every, lines = DEEDS[deed]
    lines = "pass" if deed == "is stopped" and where == "process" else lines.format(stopped=STOPPED)
    return DEED.format(every=every, deed=lines)


def scene_of(where: str, deed: str, folder: Path) -> Scene:
    """Returns the demo with the wall of the package or the own law."""
    (folder / "law.py").write_text(deed_of(deed, where) + LAW)
    (folder / "scene.yaml").write_text(CONFIG.read_text())
    wall = "type: spring_damper_wall" if where == "package" else "type: law.py:Law"
    overrides = [f"environment={{{wall}, stiffness: 100, damping: 10, side: above, position: -0.05}}"]
    if where in ("process", "cycle"):
        overrides += [f"code_runs_in={where}", "late_holds=100000"]
    return load_scene(folder / "scene.yaml", overrides, allow_code=True)


class LawThread:
    """The law in a thread of this process: asked for at each SYNC, and answered when it has run."""

    def __init__(self, scene: Scene, experiment: Experiment) -> None:
        self.late, self._law = 0, LaterLaw(scene)
        self._controllers: Sequence[Any] = [port.controller for port in experiment.cycle.ports]
        self._sample: tuple[int, list[float]] | None = None
        self._answer, self._asked, self._wake = (-1, 0.0), -1, threading.Event()
        self._is_over = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while self._wake.wait() and not self._is_over:
            self._wake.clear()
            assert self._sample is not None
            index, reports = self._sample
            self._answer = (index, self._law.step(1, 0, reports)[0])

    def turn(self, samples: Sequence[Sample]) -> None:
        """Asks for what was answered to the sample before, and hands over this one."""
        in_time = self._answer[0] == self._asked
        self.late += not in_time
        self._controllers[0].ask(self._answer[1] if in_time else 0.0)
        self._asked = samples[0].sync_index
        self._sample = (self._asked, reports_of(samples, [0]))
        self._wake.set()

    def close(self) -> None:
        """Ends the thread."""
        self._is_over = True
        self._wake.set()
        self._thread.join()


@contextmanager
def stopped(pid: int) -> Iterator[None]:
    """A process stopped for a while, from a second on."""

    def send(number: int) -> None:
        with suppress(ProcessLookupError):  # the run has ended before
            os.kill(pid, number)

    timers = [
        threading.Timer(1.0, send, (signal.SIGSTOP,)),
        threading.Timer(1.0 + STOPPED, send, (signal.SIGCONT,)),
    ]
    for timer in timers:
        timer.start()
    yield
    for timer in timers:
        timer.join()


def one_run(where: str, deed: str, seconds: float) -> Found:
    """Returns what a run gave, in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        if where == "canopen":
            return by_canopen(deed, seconds)
        own = scene_of(where, deed, Path(folder))
        scene = for_program(own, "certificates") if where == "thread" else own
        with build(scene, "real") as experiment:
            code = LawThread(own, experiment) if where == "thread" else experiment.code
            if isinstance(code, LawThread):
                experiment.cycle.turn = code.turn
            end, sent = "", SentTorques(experiment.rig.drives[0].link._bus)  # noqa: SLF001 - what passes there alone
            try:
                if deed == "is stopped" and isinstance(code, CodeProcess):
                    with stopped(code._process.pid):  # noqa: SLF001 - no program needs it
                        run(experiment.cycle, round(seconds / scene.bus.sample_time))
                else:
                    run(experiment.cycle, round(seconds / scene.bus.sample_time))
            except CanHapticError as error:
                end = str(error)[:80]
            if isinstance(code, LawThread):
                code.close()
            p99 = 1e6 * experiment.cycle.timing["compute"].quantile(0.99)
            return Found(p99, experiment.rig.skipped_syncs, code.late if code else 0, 1e-6 * sent.longest, end)


def by_canopen(deed: str, seconds: float) -> Found:
    """Returns the same of the `canopen` package; a SYNC that no RPDO answered counts as late."""
    names: dict[str, Any] = {}
    exec(deed_of(deed, "canopen"), names)
    now_and_then: Callable[[], None] = names["now_and_then"]

    def law(position: float, last: float) -> int:
        now_and_then()
        return peers.law(position, last)

    cycles = round(seconds * 1e9 / PERIOD)
    with peers.BroughtUp("real", overrides=["bus.heartbeat_timeout=30"]) as peer:
        sent = SentTorques(peer.bus)
        sent.note()
        found = canopen_run(peer, law, cycles)
        sent.note()
    skipped = max(0, cycles - len(found.syncs))
    return Found(quantile(found.cycle, 0.99), skipped, found.missed(), 1e-6 * sent.longest, "")


def sample_to_torque(samples: int) -> list[float]:
    """Returns the times from handing over a sample until its torque is there [us], at 1 kHz, less the first ones."""
    asked: Any = SimpleNamespace(ask=lambda _torque: None)
    rig = SimpleNamespace(periods=1, end=lambda _reason, what: RuntimeError(what))
    times, clock = list[float](), WallClock()
    with tempfile.TemporaryDirectory() as folder:
        scene = apart(scene_of("process", "calm", Path(folder)))
        code = CodeProcess(scene, SimpleNamespace(rig=rig, controllers=[asked]), "real")  # type: ignore[arg-type]
        answers = code._answers  # noqa: SLF001 - where nothing but the cycle looks
        try:
            due = clock.now()
            for index in range(samples):
                due = max(due + PERIOD, clock.now())
                clock.wait_until(due)
                before, begin = answers.sequence, clock.now()
                code.turn([Sample(index, -0.06, 0.0, 0, fresh=True)])
                while answers.sequence == before and clock.now() - begin < PERIOD:
                    pass
                times.append(1e-3 * (clock.now() - begin))
        finally:
            code.close()
    return sorted(times[samples // 10 :])


def in_a_process(case: tuple[str, str], seconds: float) -> Found:
    """Returns what a run gave; nothing that it imported or left behind meets the next one."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("fork")) as pool:
        return pool.submit(one_run, *case, seconds).result()


def medians(runs: Sequence[Found]) -> list[float]:
    """Returns p99 [us], SYNCs skipped, holds without an answer and the longest gap [ms] over the rounds."""
    return [statistics.median(values) for values in list(zip(*runs, strict=True))[:4]]


def cpu_times() -> tuple[float, float]:
    """Returns the processor time of the whole computer, and that of this benchmark [s]."""
    user, nice, system, _idle, _wait, *rest = map(int, Path("/proc/stat").read_text().split("\n")[0].split()[1:9])
    return (user + nice + system + sum(rest)) / os.sysconf("SC_CLK_TCK"), sum(os.times()[:4])


def rows_of(found: dict[tuple[str, str], list[Found]], calm: tuple[str, str]) -> Iterator[Row]:
    """Rows of every case: computation, skipped SYNCs and longest gap, next to those of the calm package."""
    base, least, _, shortest = medians(found[calm])
    for (where, deed), runs in found.items():
        p99, skipped, late, gap = medians(runs)
        ends = {one.end for one in runs if one.end}
        note = f"late holds {late:g}" + "".join(f"; ended: {end}" for end in ends)
        is_apart = where == "process"
        yield Row(
            f"{where}: {deed}, p99 of the computation", p99, "us", "no own code", base, p99 / base,
            "<= 1.2" if is_apart else "", p99 <= 1.2 * base if is_apart else None, note
        )  # fmt: skip
        yield Row(
            f"{where}: {deed}, skipped SYNCs", skipped, "", "no own code", least, None,
            "no more" if is_apart else "", skipped <= least if is_apart else None
        )  # fmt: skip
        yield Row(f"{where}: {deed}, longest gap between torques", gap, "ms", "no own code", shortest)


def main() -> None:
    """Runs every case in turn and publishes the table."""
    parser = argparse.ArgumentParser(description="Whether own code stalls the cycle.")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    cases = [("package", "calm"), *itertools.product(("process", "thread", "cycle", "canopen"), DEEDS)]
    found: dict[tuple[str, str], list[Found]] = {case: [] for case in cases}
    begin, (all_before, own_before) = monotonic(), cpu_times()
    for _ in range(arguments.rounds):
        for case in cases:
            found[case].append(in_a_process(case, arguments.seconds))
            print(f"{monotonic() - begin:.0f} s: {case}: {found[case][-1]}", file=sys.stderr)
    rows = list(rows_of(found, cases[0]))
    times = sample_to_torque(5_000)
    for name, fraction, target in (("p50", 0.5, 30.0), ("p99", 0.99, 150.0)):
        value = times[int(fraction * len(times))]
        rows.append(Row(f"sample to torque through the process, {name}", value, "us", target=f"<= {target:g} us",
                        met=value <= target))  # fmt: skip
    all_after, own_after = cpu_times()
    others = (all_after - all_before - own_after + own_before) / (monotonic() - begin)
    policy = (
        f"cores {len(os.sched_getaffinity(0))} of {os.cpu_count()}, scheduling policy {os.sched_getscheduler(0)} "
        f"(0: SCHED_OTHER), {others:.2f} cores used by other programs meanwhile, load {os.getloadavg()[0]:.1f}"
    )
    print(policy)
    publish("user_code", rows, ["canhaptic", "canopen", "python-can"], {"policy": policy})


if __name__ == "__main__":
    main()
