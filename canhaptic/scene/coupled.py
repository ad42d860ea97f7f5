"""The cycle of a rig with an axis that is coupled to a far side: packets in before the step, packets out after it."""

from collections.abc import Sequence
from typing import Any

from canhaptic.control.balance import EnergyBalance
from canhaptic.cycle import Cycle
from canhaptic.far.side import FarSide
from canhaptic.signals import Sample


class CoupledCycle(Cycle):
    """A `Cycle` with a link to a far side.

    Attributes:
        far: The link; set before the first step.
    """

    far: FarSide

    def __init__(self, *parts: Any) -> None:
        super().__init__(*parts)
        self._sessions, self._is_alive = 0, False

    def answer(self, samples: Sequence[Sample]) -> list[EnergyBalance]:
        """Complete the cycle as `Cycle.answer` does, and tell the far side."""
        far, session = self.far, self.far.session
        far.turn(samples, self.rig.periods)
        if session.is_alive is not self._is_alive or session.sessions != self._sessions:
            self._sessions, self._is_alive = session.sessions, session.is_alive
            what = f"session {session.sessions} begins" if session.is_alive else f"session {session.sessions} has ended"
            self._event(self.rig.sync_index, "far", self.rig.drives[far.axis].axis.name, what)
        balances = super().answer(samples)
        far.send()
        return balances

    def wind_down(self, samples: Sequence[Sample] | None = None) -> None:
        """Run the holds of a stop as `Cycle.wind_down` does; no more energy is sent."""
        self.far.stop()
        super().wind_down(samples)
