"""A simulated force sensor: the quantity that one value measures, and its errors.

true force -> first-order filter -> sample at the SYNC, or mean since the last -> gain, offset, drift, noise
           -> whole quanta -> late by whole samples -> frozen from some time on
"""

from collections import deque
from random import Random
from typing import Annotated, Literal

from canhaptic.units import Parameters, quantity

_NS_PER_S = 1e9


class SimulatedForceSensor(Parameters):
    """The errors of a simulated force sensor; an ideal one by default."""

    sampling: Literal["point", "mean", "impulse"] = "point"
    """What one value is: the force at the SYNC, its mean since the last, or its integral since the start."""
    filter: Annotated[float, quantity("Hz", ge=0.0, le=1e6)] = 0.0
    """Corner of a first-order filter before the sample; 0: none."""
    gain: Annotated[float, quantity("1", ge=-100.0, le=100.0)] = 1.0
    """Force shown over true force; -1: a wrong sign."""
    offset: Annotated[float, quantity("N", "N*m", ge=-1e6, le=1e6)] = 0.0
    """Shown at no force."""
    drift: Annotated[float, quantity("N/s", "N*m/s", ge=-1e6, le=1e6)] = 0.0
    """Change of the offset from the start of the plant."""
    noise: Annotated[float, quantity("N", "N*m", ge=0.0, le=1e6)] = 0.0
    """Standard deviation of each value; it is cut at three of it."""
    quantum: Annotated[float, quantity("N", "N*m", ge=0.0, le=1e6)] = 0.0
    """Step of the values, in addition to that of the object that carries them."""
    latency: Annotated[int, quantity("count", ge=0, le=16)] = 0
    """Delay of a value in whole samples."""
    freeze_at: Annotated[float, quantity("s", ge=0.0, le=1e6)] | None = None
    """Time from which the value stays as it is; None: never."""
    fault_offset: Annotated[float, quantity("N", "N*m", ge=-1e6, le=1e6)] = 0.0
    """A step of the offset at `fault_at`."""
    fault_at: Annotated[float, quantity("s", ge=0.0, le=1e6)] = 0.0
    """Time of that step."""


class ForceReading:
    """The values of one sensor, taken once at every SYNC.

    Args:
        sensor: Errors of the sensor.
        seed: Seed of the noise.
    """

    def __init__(self, sensor: SimulatedForceSensor, seed: int) -> None:
        self._sensor, self._seed = sensor, seed
        self.reset()

    def reset(self) -> None:
        """Return to the start."""
        self._random = Random(self._seed)
        self._late = deque([0.0] * self._sensor.latency)
        self._impulse, self._taken_at = 0.0, -1
        self._error = 0.0  # integral of what a running impulse has too much [N*s or N*m*s]
        self.value = 0.0

    def take(self, elapsed: int, force: float, impulse: float) -> float:
        """Reading at a SYNC [N or N*m; an impulse: N*s or N*m*s].

        Args:
            elapsed: Time since the start of the plant [ns]; repeated calls for one time give the same value.
            force: Force at this time, behind the filter [N or N*m].
            impulse: Integral of the force since the start [N*s or N*m*s].
        """
        if elapsed == self._taken_at:
            return self.value
        sensor, last = self._sensor, self._taken_at
        change, self._impulse, self._taken_at = impulse - self._impulse, impulse, elapsed
        time = elapsed / _NS_PER_S
        if sensor.freeze_at is not None and time >= sensor.freeze_at:
            return self.value
        error = sensor.offset + sensor.drift * time
        if time >= sensor.fault_at:
            error += sensor.fault_offset
        if sensor.noise:
            deviation = self._random.gauss(0.0, 1.0)
            error += sensor.noise * (-3.0 if deviation < -3.0 else 3.0 if deviation > 3.0 else deviation)
        if sensor.sampling == "impulse":
            self._error += error * (elapsed - max(last, 0)) / _NS_PER_S
            shown = sensor.gain * impulse + self._error
        else:
            if sensor.sampling == "mean":
                since = elapsed - last if last > 0 else elapsed
                force = change * _NS_PER_S / since if since else 0.0
            shown = sensor.gain * force + error
        if sensor.quantum:
            shown = round(shown / sensor.quantum) * sensor.quantum
        if self._late:
            self._late.append(shown)
            shown = self._late.popleft()
        self.value = shown
        return shown
