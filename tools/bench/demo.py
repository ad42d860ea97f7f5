"""The demo, as it is shipped and with several axes: what most benchmarks run, and what must be true of every run."""

from pathlib import Path
from typing import Any

import yaml

from canhaptic.scene.build import Experiment
from canhaptic.scene.load import scene_from_text
from canhaptic.scene.models import Scene
from canhaptic.sim.drive.can.drive_node import SimulatedDrive
from canhaptic.sim.drive.profile.state_machine import DriveState

CONFIG = Path(__file__).resolve().parents[2] / "configs" / "demo.yaml"
PERIOD = 1_000_000  # [ns]
COUNT = 1e-6  # [m]
IN_CONTACT = (
    "environment.position=0",
    "passivity={algorithm: guarded, moving_mass: 0.2 kg, device_damping_bound: 0.2 N*s/m, hand_force: 0 N, "
    "max_consecutive_losses: 4}",
)
"""Overrides for a run in which the hand is in the wall half of the time, and frames may be lost."""
_FELT = -0.01  # [J] that the motor of a rendered wall has done on the hand, and less


def demo_of(axes: int, rate: float, enable_delay: float = 0.0) -> Scene:
    """Returns the demo with so many axes, all alike.

    Args:
        axes: How many.
        rate: Of the SYNC [Hz].
        enable_delay: What each drive takes to enable [s].
    """
    return scene_from_text(yaml.safe_dump(demo_values(axes, rate, enable_delay)), str(CONFIG))


def demo_values(axes: int, rate: float, enable_delay: float = 0.0) -> dict[str, Any]:
    """Returns the values of the scene of `demo_of`."""
    document: dict[str, Any] = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    [first] = document["axes"]
    document["axes"] = [{**first, "name": f"axis{n}", "node_id": n} for n in range(1, axes + 1)]
    document["bus"]["rate"] = rate
    drive = document["simulation"]["drive"]
    drive["objects"] = {f"{index:#06x}": value for index, value in drive["objects"].items()}
    drive["enable_delay"] = enable_delay
    return document


def drive_of(experiment: Experiment) -> SimulatedDrive:
    """Returns the only simulated drive."""
    assert experiment.far_side is not None
    [drive] = experiment.far_side.drives
    return drive


def require_rendered(drive: SimulatedDrive) -> None:
    """Makes sure that a loop did its job: the drive still enabled, and the wall took energy from the user."""
    if drive.state is not DriveState.OPERATION_ENABLED or not drive.truth().energy.motor < _FELT:
        raise SystemExit(f"the loop did not render the wall: {drive.state.name}, {drive.truth()}")


class AccountWatch:
    """Looks at every cycle of the demo whether its account says more than came in.

    Attributes:
        overbelieved: The most by which it ever did [J].
        variation: Of the torque [N].
    """

    def __init__(self, experiment: Experiment) -> None:
        self._cycle = experiment.cycle
        self._drive = drive_of(experiment)
        self._last = self.variation = self.overbelieved = 0.0

    def look(self) -> None:
        """Called once per cycle; the account is judged only where a position has just closed it."""
        cycle, torque = self._cycle, self._drive.torque
        self.variation += abs(torque - self._last)
        self._last = torque
        if cycle.judge is not None and cycle.rig.records[-1].samples[0].fresh:
            self.overbelieved = max(self.overbelieved, cycle.ledgers[0].interaction - cycle.judge.interaction[0])

    @property
    def bound(self) -> float:
        """What the encoder can hide: half a count times the variation of the torque [J]."""
        return 0.5 * COUNT * self.variation
