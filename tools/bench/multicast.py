"""How punctual is the cycle at 1 kHz with the drive in another process, over UDP multicast on a private group?

The loops, and what is counted, are those of `paced`; the drive is `canhaptic drive` in a process of its own, and frames
do not leave the machine. Multicast on one machine is not a CAN bus: it shows what two processes and a socket cost. Best
of the interleaved repeats.
"""

import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import can

from canhaptic.errors import RigError
from canhaptic.scene.build import Experiment, build
from canhaptic.scene.load import load_scene
from tools.bench.demo import CONFIG
from tools.bench.paced import Run, bare_run, best_of, canhaptic_run, canopen_run, rows_of
from tools.bench.report import in_turn, publish

REPEATS = 3
PATIENCE = 500e-6  # [s] as long as the configuration waits for a TPDO
STARTS = 20  # tries to start while the other process is still importing


def private_bus() -> list[str]:
    """Returns the overrides that put the demo on a group and port of this process alone."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        port = probe.getsockname()[1]
    number = os.getpid()
    channel = f"239.76.{number // 250 % 250}.{1 + number % 250}"
    return [
        f"bus.channel={channel}",
        f"bus.options={{port: {port}, hop_limit: 0}}",
        "bus.interface=udp_multicast",
        "bus.heartbeat_timeout=5",  # [s]; neither process may give up while a busy machine holds the other
        "bus.stop_cycles=500",
    ]


@contextmanager
def drive_elsewhere(overrides: list[str]) -> Iterator[None]:
    """A drive in a process of its own, gone at the end of the block."""
    words = [word for override in overrides for word in ("--set", override)]
    with subprocess.Popen(
        [sys.executable, "-m", "canhaptic", "drive", str(CONFIG), *words], stderr=subprocess.PIPE
    ) as far:
        try:
            assert far.stderr is not None
            far.stderr.readline()  # "powered": it listens from here on
            yield
        finally:
            far.kill()


class Elsewhere:
    """What a peer takes over from a rig that has been started: its connection."""

    patience, pause = PATIENCE, 0.05

    def __init__(self, experiment: Experiment) -> None:
        self.bus: can.BusABC = experiment.rig.drives[0].link._bus  # noqa: SLF001 - the peers take over the connection

    def process(self, now: int) -> None:
        """Does nothing: the drive lives elsewhere."""


def with_rig(overrides: list[str], loop: Callable[[Experiment], Run]) -> Run:
    """Returns what a loop measures on a drive of its own."""
    with (
        drive_elsewhere(overrides),
        build(load_scene(CONFIG, [*overrides, "simulation=null"]), "real") as experiment,
    ):
        return loop(experiment)


def peer_of(experiment: Experiment) -> Elsewhere:
    """Brings the drive up for a peer."""
    for attempt in range(STARTS):
        try:
            experiment.rig.start()
            break
        except RigError:
            if attempt == STARTS - 1:
                raise
    return Elsewhere(experiment)


def main() -> None:
    """Measures the three, interleaved, and publishes the table."""
    ours = private_bus()
    left_alone = [*ours, "axes.0.watchdog=false"]  # a peer sends no heartbeat
    loops: dict[str, Callable[[], Run]] = {
        "canhaptic": lambda: with_rig(ours, canhaptic_run),
        "bare frames": lambda: with_rig(left_alone, lambda experiment: bare_run(peer_of(experiment))),
        "canopen": lambda: with_rig(left_alone, lambda experiment: canopen_run(peer_of(experiment))),
    }
    publish("multicast", rows_of(best_of(in_turn(loops, REPEATS))), ["canhaptic", "python-can", "canopen", "msgpack"])


if __name__ == "__main__":
    main()
