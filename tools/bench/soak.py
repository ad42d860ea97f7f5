"""Does the cycle last? `python -m tools.bench.soak --minutes 10`: 1 kHz in real time, on a bus that loses frames.

The demo, in contact half of the time, with both logs: 1 % of all frames lost, jitter of 0.2 ms, the host stalled for
10 ms once a minute. What must hold at the end: the rig still runs; the account never said more than came in, and the
wall never gave out more than it took in, but for what the encoder can hide (half a count times the variation of the
torque); no SYNC less than half a period after the one before; every SYNC that counts as unanswered is one frame that
the bus lost or held back for too long, and the other way round; no memory and no descriptor more at the end than after
the first fifth, in this process and in the two that write the logs.
"""

import argparse
import os
import tempfile
from pathlib import Path

from canhaptic.cycle import run
from canhaptic.scene.build import Experiment, build
from canhaptic.scene.load import load_scene
from tools.bench.demo import CONFIG, IN_CONTACT, PERIOD, AccountWatch
from tools.bench.peers import SYNC, TPDO
from tools.bench.report import Row, publish

QUIET = 2  # [s] without faults at both ends: start and stop are not what is counted here
LEAST_MINUTES = 0.2
MOST_GROWTH = 2.0  # [MB] of resident memory; a leak of 64 bytes a cycle is 30 in ten minutes
PAGE = os.sysconf("SC_PAGE_SIZE")


def overrides_for(minutes: float) -> list[str]:
    """Returns what makes the demo a soak of so many minutes."""
    window = f"during: [{{begin: {QUIET} s, duration: {60.0 * minutes:g} s}}]"
    stall = "stall: [{begin: 5 s, duration: 10 ms, every: 60 s}]"
    return [
        *IN_CONTACT,
        f"simulation.bus={{drop: 0.01, jitter: 0.2 ms, {window}, {stall}}}",
    ]


class Watch:
    """Looks at every cycle and, after a fifth and at the end, at what the processes hold."""

    def __init__(self, experiment: Experiment, cycles: int) -> None:
        assert experiment.energy_log is not None
        assert experiment.bus_log is not None
        self.account = AccountWatch(experiment)
        self._processes = [os.getpid(), experiment.energy_log.pid, experiment.bus_log.pid]
        self._times = (cycles // 5, cycles)
        self._exchange = experiment.rig._exchange  # noqa: SLF001 - knows when each SYNC was sent
        self._last_sync = self.bursts = 0
        self.held: list[tuple[float, float, int]] = []  # memory of the master and of the writers [MB], descriptors

    def look(self, cycles: int) -> None:
        """Called once per cycle."""
        woken = self._exchange.woken
        self.bursts += woken - self._last_sync < PERIOD // 2
        self._last_sync = woken
        self.account.look()
        if cycles in self._times:
            master, *writers = map(memory, self._processes)
            self.held.append((master, sum(writers), sum(map(descriptors, self._processes))))


def memory(process: int) -> float:
    """Returns the resident memory of a process [MB]."""
    return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * PAGE / 1e6


def descriptors(process: int) -> int:
    """Returns the number of open descriptors of a process."""
    return len(os.listdir(f"/proc/{process}/fd"))


def lost_answers(experiment: Experiment) -> int:
    """Returns how many SYNCs cannot have been answered in time: by the counts of the faulty bus and of the link."""
    counts = experiment.faulty_buses[""].counts
    lost = counts["drop", "to_drive", SYNC] + counts["drop", "to_master", TPDO]
    return lost + int(experiment.rig.link_statistics()["late"])


def soak(minutes: float) -> list[Row]:
    """Runs for so many minutes and returns the table."""
    cycles = round((60.0 * minutes + 2 * QUIET) * 1e9 / PERIOD)
    with (
        tempfile.TemporaryDirectory() as folder,
        build(load_scene(CONFIG, overrides_for(minutes)), "real", f"{folder}/e.h5", f"{folder}/b.log") as experiment,
    ):
        watch = Watch(experiment, cycles)
        run(experiment.cycle, cycles, progress=watch.look)
        link, judge, rig = experiment.rig.link_statistics(), experiment.cycle.judge, experiment.rig
        lost = lost_answers(experiment)
        assert judge is not None
        over, bound = watch.account.overbelieved, watch.account.bound
        (master_then, writers_then, open_then), (master_now, writers_now, open_now) = watch.held
        grown, writers_grown = master_now - master_then, writers_now - writers_then
        done, missed, least = experiment.cycle.cycles, link["missed_tpdos"], judge.least[0]
        dropped = sum(log.dropped for log in (experiment.energy_log, experiment.bus_log) if log is not None)
        late = experiment.cycle.timing["wakeup_lateness"].quantile(0.5) * 1e6
        return [
            Row("cycles completed", done, "", "asked for", cycles, target="all", met=done == cycles),
            Row("over-believed energy, largest", over, "J", "bound", bound, target="<= bound", met=over <= bound),
            Row("least true energy", least, "J", "- bound", -bound, target=">= - bound", met=least >= -bound),
            Row("SYNC bursts", watch.bursts, "", target="0", met=watch.bursts == 0),
            Row("SYNCs skipped, never caught up", rig.skipped_syncs, ""),
            Row("SYNCs unanswered", missed, "", "frames lost or late", lost, target="equal", met=missed == lost),
            Row("success rate", link["success_rate"], ""),
            Row("growth of memory, master", grown, "MB", target=f"<= {MOST_GROWTH:g}", met=grown <= MOST_GROWTH),
            Row(
                "growth of memory, both writers",
                writers_grown,
                "MB",
                target=f"<= {MOST_GROWTH:g}",
                met=writers_grown <= MOST_GROWTH,
            ),
            Row("descriptors at the end", open_now, "", "before", open_then, target="equal", met=open_now == open_then),
            Row("rows and frames that the logs dropped", dropped, "", target="0", met=dropped == 0),
            Row("wake-up lateness, p50", late, "us"),
        ]


def main() -> None:
    """Reads how long, soaks, and publishes the table."""
    parser = argparse.ArgumentParser(description="One long run at 1 kHz in real time on a bus that loses frames.")
    parser.add_argument("--minutes", type=float, default=10.0, help=f"at least {LEAST_MINUTES} (default 10)")
    minutes = parser.parse_args().minutes
    if not minutes >= LEAST_MINUTES:
        parser.error(f"--minutes {minutes}: expected at least {LEAST_MINUTES}")
    publish("soak", soak(minutes), ["canhaptic", "python-can", "numpy", "h5py"])


if __name__ == "__main__":
    main()
