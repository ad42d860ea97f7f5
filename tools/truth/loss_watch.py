"""Which process data a faulty bus really lost, seen at both ends: by the drives themselves, and by the rig's samples.

A cycle has a loss for a port where the rig computed without a fresh position of one of its axes, or where one of its
drives was given no torque of the rig between that SYNC and the next. How many such cycles came in a row is what
`max_consecutive_losses` must cover. Nothing here is read from an account.
"""

from collections.abc import Callable
from typing import Any

from canhaptic.scene.build import Experiment


class LossWatch:
    """Counts, port by port, the cycles in a row in which something was lost.

    Args:
        experiment: Not run yet.

    Attributes:
        longest: Of any port.
    """

    def __init__(self, experiment: Experiment) -> None:
        self._rig = experiment.rig
        far: Any = experiment.far_side
        self._taken = [0] * len(far.drives)
        for place, drive in enumerate(far.drives):
            if hasattr(drive, "image"):  # on EtherCAT
                drive.image.take = self._counting_outputs(place, drive.image.take)
                continue
            for pdo in drive._process_data._rpdos:  # noqa: SLF001 - the drive itself, not what the rig believes
                pdo.load = self._counting(place, pdo.load)
        self._ports = [port.axes for port in experiment.cycle.ports]
        self._before = [0] * len(self._taken)
        self._fresh = [True] * len(self._taken)
        self._in_a_row = [0] * len(self._ports)
        self.longest, self._cycles = 0, 0

    @property
    def skipped(self) -> int:
        """SYNCs that the rig left out."""
        return int(self._rig.skipped_syncs)

    def __call__(self) -> None:
        """Called behind every cycle: judges the one before, whose torque has had its time to arrive."""
        self._cycles += 1
        came = [now > then for now, then in zip(self._taken, self._before, strict=True)]
        for port, axes in enumerate(self._ports):
            has_lost = not all(self._fresh[axis] and came[axis] for axis in axes)
            self._in_a_row[port] = self._in_a_row[port] + 1 if has_lost and self._cycles > 2 else 0  # two to begin
            self.longest = max(self.longest, self._in_a_row[port])
        self._before = list(self._taken)
        self._fresh = [sample.fresh for sample in self._rig.records[-1].samples]

    def _counting(self, place: int, load: Callable[[Any], None]) -> Callable[[Any], None]:
        def count(content: Any) -> None:
            self._taken[place] += 1
            load(content)

        return count

    def _counting_outputs(self, place: int, take: Callable[[Any], None]) -> Callable[[Any], None]:
        def count(outputs: Any) -> None:
            self._taken[place] += outputs is not None
            take(outputs)

        return count
