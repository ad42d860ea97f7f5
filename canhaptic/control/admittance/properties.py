"""Declared properties of an admittance display: its loop of SYNCs, its force sensor, its limits."""

from typing import Annotated, Literal

from canhaptic.units import Parameters, quantity


class DisplayProperties(Parameters):
    """The loop around a controller that takes forces and commands velocities."""

    sample_time: Annotated[float, quantity("s", ge=1e-6, le=1.0)]
    """Time T from SYNC to SYNC."""
    jitter: Annotated[float, quantity("1", ge=0.0, le=0.5)] = 0.0
    """Every hold, from sample to sample, lasts T (1 +- jitter)."""
    delay: Annotated[int, quantity("count", ge=0, le=16)] = 1
    """Whole holds between the computation of a command and the hold in which it acts."""
    sampling: Literal["point", "mean", "impulse"] = "point"
    """What one force is: its value at a SYNC, its mean since the one before, or since the last that came (impulse)."""
    latency: Annotated[int, quantity("count", ge=0, le=16)] = 0
    """Delay of a force in whole samples."""
    filter: Annotated[float, quantity("Hz", ge=0.0, le=1e6)] = 0.0
    """Corner of the sensor's first-order filter; 0: none."""
    force_slew: Annotated[float, quantity("N/s", "N*m/s", gt=0.0)]
    """Largest slew of the force, an over-estimate."""
    handle_acceleration: Annotated[float, quantity("m/s^2", "rad/s^2", gt=0.0)]
    """Largest acceleration of the mass with the encoder, an over-estimate."""
    force_error: Annotated[float, quantity("N", "N*m", ge=0.0)] = 0.0
    """Largest error of one force: offset after the tare, drift, noise and quantisation, an over-estimate."""
    encoder_count: Annotated[float, quantity("m", "rad", ge=0.0)] = 0.0
    """Displacement of one encoder count; 0 for an ideal encoder."""
    speed_quantum: Annotated[float, quantity("m/s", "rad/s", ge=0.0)] = 0.0
    """Smallest step of the command; 0: any."""
    speed_limit: Annotated[float, quantity("m/s", "rad/s", gt=0.0)]
    """Largest speed commanded."""
    acceleration_limit: Annotated[float, quantity("m/s^2", "rad/s^2", gt=0.0)]
    """Largest rise of the speed commanded per second; a fall to zero is never slowed."""
    position_low: Annotated[float, quantity("m", "rad")] = -1e9
    """Least position to which a command may lead."""
    position_high: Annotated[float, quantity("m", "rad")] = 1e9
    """Largest position to which a command may lead."""
    torque_limit: Annotated[float, quantity("N", "N*m", gt=0.0)] = 1e9
    """Largest torque of the drive."""

    @property
    def longest_hold(self) -> float:
        """Longest duration of a hold [s]: its cost and its uncertainty grow with it."""
        return self.sample_time * (1.0 + self.jitter)
