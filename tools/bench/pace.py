"""How punctual is the cycle at 1 kHz, in one process that holds only master and simulated drive?

The loops, and what is counted, are those of `paced`. The peers run on python-can's stock virtual bus. Best of the
interleaved repeats.
"""

from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from tools.bench.demo import CONFIG
from tools.bench.paced import Run, bare_run, best_of, canhaptic_run, canopen_run, rows_of
from tools.bench.peers import BroughtUp
from tools.bench.report import in_turn, publish

REPEATS = 3
HEARTBEAT = "bus.heartbeat_timeout=5"  # [s]; the peers have no time to spare for one


def canhaptic() -> Run:
    """The product."""
    with build(load_scene(CONFIG, [HEARTBEAT]), "real") as experiment:
        return canhaptic_run(experiment)


def bare() -> Run:
    """python-can and struct."""
    with BroughtUp("real", overrides=[HEARTBEAT]) as peer:
        return bare_run(peer)


def natural() -> Run:
    """The `canopen` package."""
    with BroughtUp("real", overrides=[HEARTBEAT]) as peer:
        return canopen_run(peer)


def main() -> None:
    """Measures the three, interleaved, and publishes the table."""
    loops = {"canhaptic": canhaptic, "bare frames": bare, "canopen": natural}
    publish("pace", rows_of(best_of(in_turn(loops, REPEATS))), ["canhaptic", "python-can", "canopen"])


if __name__ == "__main__":
    main()
