"""Does own code stall the cycle? `python -m tools.bench.user_code --seconds 60`: in its process, and in the cycle.

The same law at 1 kHz on the simulated drive in real time: the wall of the package (no own code), own code in a process
of its own, and own code in the cycle. Own code is calm; or every second it spins for 50 ms, makes a million objects, or
imports a large package anew; or its process is stopped (SIGSTOP) for a second. All take turns; each figure is the worst
or the median over the rounds. `late_holds` is out of the way.
"""

import argparse
import os
import signal
import statistics
import tempfile
import threading
from pathlib import Path
from typing import Final

from canhaptic.cycle import run
from canhaptic.errors import CanHapticError
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from tools.bench.demo import CONFIG
from tools.bench.report import Row, publish

DEEDS: Final = {
    "calm": "pass",
    "spins": "end = time.monotonic() + 0.05\n            while time.monotonic() < end: pass",
    "collects": "kept = [[n] for n in range(1_000_000)]; gc.collect()",
    "imports": "[sys.modules.pop(name) for name in [*sys.modules] if name.startswith('h5py')]; import h5py",
    "is stopped": "pass",
}
LAW: Final = """
import gc, sys, time
from typing import Annotated
from canhaptic.extending import OwnEnvironment, quantity
CALLS = [0.0]

class Law(OwnEnvironment):
    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0)] = 100.0

    def stored_energy(self, state: float) -> float:
        return 0.5 * self.stiffness * state * state

    def state_of_energy(self, energy: float, like: float) -> float:
        return like

    def effort(self, state: float) -> float:
        now = time.monotonic()
        if now - CALLS[0] > 1.0:
            CALLS[0] = now
            {deed}
        return self.stiffness * state
"""


def one_run(where: str, deed: str, seconds: float, folder: Path) -> tuple[float, int, int]:
    """Returns p99 of the computation [s], SYNCs skipped, and holds without an answer.

    Args:
        where: "package", "process" or "cycle".
        deed: What the law does now and then.
        seconds: Length of the run [s].
        folder: For the scene.
    """
    (folder / "law.py").write_text(LAW.format(deed=DEEDS[deed]))
    (folder / "scene.yaml").write_text(CONFIG.read_text())
    wall = "type: spring_damper_wall" if where == "package" else "type: law.py:Law"
    overrides = [f"environment={{{wall}, stiffness: 100, damping: 10, side: above, position: -0.05}}"]
    if where != "package":
        overrides += [f"code_runs_in={where}", "late_holds=100000"]
    scene = load_scene(folder / "scene.yaml", overrides, allow_code=True)
    with build(scene, "real") as experiment:
        code = experiment.code
        stops = []
        if deed == "is stopped" and code is not None:
            pid = code.pid
            stops = [
                threading.Timer(1.0, os.kill, (pid, signal.SIGSTOP)),
                threading.Timer(2.0, os.kill, (pid, signal.SIGCONT)),
            ]
            for timer in stops:
                timer.start()
        try:
            run(experiment.cycle, round(seconds / scene.bus.sample_time))
        except CanHapticError as error:
            print(f"{where}, {deed}: {str(error)[:100]}")
        for timer in stops:
            timer.join()
        return experiment.cycle.timing["compute"].quantile(0.99), experiment.rig.skipped_syncs, code.late if code else 0


def main() -> None:
    """Runs every case in turn and publishes the table."""
    parser = argparse.ArgumentParser(description="Whether own code stalls the cycle.")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    cases = [("package", "calm"), *(("process", deed) for deed in DEEDS)]
    cases += [("cycle", deed) for deed in DEEDS if deed != "is stopped"]
    found: dict[tuple[str, str], list[tuple[float, int, int]]] = {case: [] for case in cases}
    for _ in range(arguments.rounds):
        for case in cases:
            with tempfile.TemporaryDirectory() as folder:
                found[case].append(one_run(*case, arguments.seconds, Path(folder)))
    base = statistics.median(p99 for p99, _, _ in found[cases[0]])
    rows = []
    for (where, deed), runs in found.items():
        p99, skipped, late = (statistics.median(values) for values in zip(*runs, strict=True))
        note = f"skipped SYNCs {skipped:g}, late holds {late:g}"
        target, met = ("<= 1.2", p99 <= 1.2 * base) if where == "process" else ("", None)
        figure = f"{where}: {deed}, p99 of the computation"
        rows.append(Row(figure, 1e6 * p99, "us", "no own code", 1e6 * base, p99 / base, target, met, note))
        figure = f"{where}: {deed}, skipped SYNCs"
        rows.append(Row(figure, skipped, "", "no own code", found[cases[0]][0][1], note=note))
    policy = f"cores {os.cpu_count()}, scheduler {os.sched_getscheduler(0)}, load {os.getloadavg()[0]:.1f}"
    print(policy)
    publish("user_code", rows, ["canhaptic"])


if __name__ == "__main__":
    main()
