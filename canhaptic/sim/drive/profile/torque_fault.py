"""Faults of the simulated power stage: from a time on the motor gets another torque than the one demanded."""

from collections.abc import Sequence

from canhaptic.sim.drive import TorqueFault


class FaultyTorque:
    """Torque that acts, and the demand that 0x6074 shows, for each demand.

    Args:
        faults: Faults of the scene.
    """

    def __init__(self, faults: Sequence[TorqueFault]) -> None:
        self._faults = sorted(faults, key=lambda fault: fault.at)
        self._begin: int | None = None
        self._acting: TorqueFault | None = None
        self._stuck = self._last = 0

    def begin(self, now: int) -> None:
        """Start the clock of the faults [ns]."""
        self._begin = now

    def act(self, now: int, demand: int, quantum: float) -> tuple[int, int]:
        """Return the demand that is shown and the torque that acts, in counts.

        Args:
            now: Time [ns].
            demand: Demand of the power stage [counts].
            quantum: Torque of one count [N or N*m].
        """
        while self._begin is not None and self._faults and now - self._begin >= round(self._faults[0].at * 1e9):
            self._acting, self._stuck = self._faults.pop(0), self._last
        fault, torque = self._acting, demand
        if fault is not None:
            added = round(fault.torque / quantum)
            by_kind = {"twice": 2 * demand, "minus": -demand, "more": demand + added, "stuck": self._stuck}
            torque = by_kind[fault.kind]
        self._last = torque
        return (torque if fault is not None and fault.shown == "both" else demand), torque
