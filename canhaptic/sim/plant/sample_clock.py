"""The time of a plant: whole ticks of T / 2^24 since its epoch, so that k sample times are exactly k steps."""

from canhaptic.errors import ParameterError
from canhaptic.sim.plant.propagator import TICKS


class SampleClock:
    """Base of what moves by ticks since its epoch; at rest until `begin`.

    Args:
        sample_time_ns: T [ns].

    Attributes:
        tick: Present tick.
        tick_time: Duration of a tick [s].

    Raises:
        ParameterError: The sample time is below 1 ns.
    """

    def __init__(self, sample_time_ns: int) -> None:
        if sample_time_ns < 1:
            raise ParameterError(f"sample time: got {sample_time_ns} ns, expected at least 1 ns; lower the rate")
        self.sample_time_ns = sample_time_ns
        self.tick_time = sample_time_ns * 1e-9 / TICKS
        self._epoch: int | None = None
        self.tick = 0

    def begin(self, now: int) -> None:
        """Start the clock: `now` [ns] is the epoch, the state there is the initial one. Later calls change nothing."""
        if self._epoch is None:
            self._epoch = now

    def pass_until(self, now: int) -> int:
        """Return the ticks from the last call to `now` [ns], rounded; 0 before `begin`.

        Raises:
            ParameterError: `now` lies before the last call.
        """
        if self._epoch is None:
            return 0
        tick = ((now - self._epoch) * TICKS + self.sample_time_ns // 2) // self.sample_time_ns
        ticks = tick - self.tick
        if ticks < 0:
            raise ParameterError(f"time went back: got {now} ns, {-ticks} ticks before the last call")
        self.tick = tick
        return ticks
