"""Parameters of the cycle of a rig, the same on every kind of bus: every value in SI, with its unit and range."""

from typing import Annotated, Self

from pydantic import model_validator

from canhaptic.host.realtime import RealtimeParameters
from canhaptic.units import Parameters, quantity


class CycleParameters(Parameters):
    """The cycle of a rig on any bus: its rate, and its reaction to missing frames."""

    rate: Annotated[float, quantity("Hz", ge=1.0, le=20_000.0)]
    """SYNCs per second."""
    hold_cycles: Annotated[int, quantity("count", ge=0, le=1000)] = 2
    """Missed cycles for which the last torque is held."""
    stop_cycles: Annotated[int, quantity("count", ge=1, le=10_000)] = 20
    """Missed cycles after which the rig stops; between hold and stop the torque is zero."""
    loss_limit: Annotated[float, quantity("1", ge=0.0, le=1.0)] = 0.1
    """Share of the SYNCs that may lose their sample or torque for ever, or that the computer may skip. Losses beyond it
    add up; `stop_cycles` end the run, or a quarter of the SYNCs of 1 s if that is less, at least 10. 1: unlimited."""
    stop_ramp: Annotated[float, quantity("s", ge=0.0, le=0.05)] = 0.02
    """Longest ramp of an operator's stop. It is tried where a certificate bounds the energy that may still come out by
    `energy_loss_limit`; otherwise the torque falls to zero in one hold."""
    spin_margin: Annotated[float, quantity("s", ge=0.0, le=0.01)] = 200e-6
    """Time before a deadline from which the clock spins instead of sleeping."""
    realtime: RealtimeParameters = RealtimeParameters()
    """Real-time settings that the thread of the cycle asks of the operating system."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.stop_cycles <= self.hold_cycles:
            raise ValueError(f"stop_cycles is {self.stop_cycles}, expected more than hold_cycles ({self.hold_cycles})")
        return self

    @property
    def sample_time_ns(self) -> int:
        """Sample time, rounded to whole nanoseconds [ns]; every part of the package uses this value."""
        return round(1e9 / self.rate)

    @property
    def sample_time(self) -> float:
        """Sample time [s], equal to `sample_time_ns`."""
        return self.sample_time_ns * 1e-9

    @property
    def delay(self) -> int:
        """Whole holds from the computation of a torque to the hold in which it acts."""
        raise NotImplementedError

    @property
    def heartbeat_cycles(self) -> int:
        """Sample times between the master's signs of life."""
        raise NotImplementedError

    @property
    def master_silence_ns(self) -> int:
        """Silence [ns] of the master that a drive tolerates."""
        raise NotImplementedError

    @property
    def drive_silence_ns(self) -> int:
        """Longest silence of a drive that the master tolerates [ns]."""
        raise NotImplementedError
