"""Two coupled handles for a minute on a bus that loses frames: passive together, and where are they at the end?

`python -m tools.bench.handles`: `configs/two_handles.yaml` over the whole CAN path, 1 kHz, a sample of delay, 1 % of
all frames lost, with `max_consecutive_losses` from 0 to 4, and once without a loss. Energies and positions are
those of the plant.
"""

import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from canhaptic.cycle import run
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.result import run_result
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from tools.bench.report import Row, publish

SCENE = Path(__file__).resolve().parents[2] / "configs" / "two_handles.yaml"
CYCLES = 60_000
LAST = 4_000  # cycles at the end, over which the drift is looked for
STIFFNESS = 1000.0  # of the coupling in the scene [N/m]


class Coupled(NamedTuple):
    """What became of the two handles."""

    rms: float  # distance [m]
    drift: float  # distance at which the coupling is without force in the last cycles [m]
    least: float  # least true energy that the motors took in together [J]
    longest: int  # hold [sample times]
    certificate: str


def couple(max_consecutive_losses: int, drop: float) -> Coupled:
    """Runs the scene for a minute of its time."""
    bus = f"{{drop: {drop}}}" if drop else "{jitter: 1 us}"  # an ideal bus is named by no section at all
    scene = load_scene(
        SCENE, [f"groups.0.passivity.max_consecutive_losses={max_consecutive_losses}", f"simulation.bus={bus}"]
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.h5"
        with build(scene, "free", path) as experiment:
            run(experiment.cycle, CYCLES)
            ports = run_result(experiment.cycle, status="completed", config_hash="", method="")["ports"]
        with EnergyLog.open(path) as log:
            return _judge(log, ports["coupling"]["longest_hold"], ports["coupling"]["certificate"])


def _judge(log: EnergyLog, longest: int, certificate: str) -> Coupled:
    distance = log.truth["first"]["position"] - log.truth["second"]["position"]
    first, second = (log.ports[name]["torque_applied"][-LAST:] for name in ("first", "second"))
    stronger = np.where(np.abs(first) >= np.abs(second), first, -second)  # the other may be limited
    return Coupled(
        rms=float(np.sqrt(np.mean(distance**2))),
        drift=float(np.median(distance[-LAST:] + stronger / STIFFNESS)),
        least=float((-log.truth["coupling"]["motor"]).min()) + 0.0,  # no negative zero
        longest=longest,
        certificate=certificate,
    )


def rows() -> list[Row]:
    """Returns the table."""
    table = []
    for max_consecutive_losses, drop in ((0, 0.0), (0, 0.01), (1, 0.01), (2, 0.01), (4, 0.01)):
        name = f"max_consecutive_losses {max_consecutive_losses}, " + ("1 % lost" if drop else "no loss")
        found = couple(max_consecutive_losses, drop)
        drift = 1e6 * found.drift
        note = f"certificate {found.certificate.replace('_', ' ')}"
        table += [
            Row(f"drift, {name}", drift, "um", target="within 100", met=abs(drift) < 100.0),
            Row(f"distance, rms, {name}", 1e3 * found.rms, "mm"),
            Row(f"least true energy, {name}", found.least, "J", target=">= -1e-6", met=found.least >= -1e-6),
            Row(f"longest hold, {name}", found.longest, "sample times", note=note),
        ]
    return table


if __name__ == "__main__":
    publish("handles", rows(), ["canhaptic", "numpy", "h5py"])
