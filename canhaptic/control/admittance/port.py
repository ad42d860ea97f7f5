"""Energy through the port of an admittance display, with its uncertainty, and the declared properties of the display.

Energy INTO the display is positive: F dq, with F the force of the hand on the mass before the sensor. A `Sample` holds
-F as its `torque_applied`, the force of the display on the hand, so that eq. 2 of the paper is valid for both kinds of
display.

The energy of a hold and its error: D7 of `docs/theory/commands_of_a_display.md`.
"""

from dataclasses import dataclass, field
from math import isnan, nan, pi
from typing import Annotated, Literal, NamedTuple

from canhaptic.kernels import new
from canhaptic.units import Parameters, quantity


class AdmittanceProperties(Parameters):
    """Declared properties of an admittance display: its control loop, its force sensor, and its limits."""

    sample_time: Annotated[float, quantity("s", ge=1e-6, le=1.0)]
    """Time T from SYNC to SYNC."""
    jitter: Annotated[float, quantity("1", ge=0.0, le=0.5)] = 0.0
    """Largest relative deviation of a hold from T: from sample to sample it lasts T (1 +- jitter)."""
    delay: Annotated[int, quantity("count", ge=0, le=16)] = 1
    """Whole holds between the computation of a command and the hold in which it acts."""
    sampling: Literal["point", "mean", "impulse"] = "point"
    """Meaning of one force reading: `point`: value at a SYNC; `mean`: mean since the SYNC before; `impulse`: mean since
    the last reading that arrived."""
    latency: Annotated[int, quantity("count", ge=0, le=16)] = 0
    """Delay of a force reading in whole samples."""
    filter: Annotated[float, quantity("Hz", ge=0.0, le=1e6)] = 0.0
    """Corner frequency of the sensor's first-order filter; 0: no filter."""
    force_slew: Annotated[float, quantity("N/s", "N*m/s", gt=0.0)]
    """Upper bound of the rate of change of the force."""
    force_bend: Annotated[float, quantity("N/s^2", "N*m/s^2", gt=0.0)] = 1e15
    """Upper bound of the rate at which that changes inside a hold: the second derivative of the force."""
    handle_acceleration: Annotated[float, quantity("m/s^2", "rad/s^2", gt=0.0)]
    """Upper bound of the acceleration of the mass to which the encoder is fixed."""
    force_error: Annotated[float, quantity("N", "N*m", ge=0.0)] = 0.0
    """Upper bound of the error of one force reading: offset after the tare, drift, noise and quantization."""
    encoder_count: Annotated[float, quantity("m", "rad", ge=0.0)] = 0.0
    """Displacement of one encoder count; 0 for an ideal encoder."""
    speed_quantum: Annotated[float, quantity("m/s", "rad/s", ge=0.0)] = 0.0
    """Resolution of the velocity command; 0: ideal."""
    speed_limit: Annotated[float, quantity("m/s", "rad/s", gt=0.0)]
    """Largest speed that may be commanded."""
    acceleration_limit: Annotated[float, quantity("m/s^2", "rad/s^2", gt=0.0)]
    """Largest rate at which the commanded speed may rise; it may always fall to zero at once."""
    position_low: Annotated[float, quantity("m", "rad")] = -1e9
    """Least position to which a command may lead."""
    position_high: Annotated[float, quantity("m", "rad")] = 1e9
    """Largest position to which a command may lead."""
    torque_limit: Annotated[float, quantity("N", "N*m", gt=0.0)] = 1e9
    """Largest torque of the drive."""

    @property
    def longest_hold(self) -> float:
        """Longest duration of a hold [s]."""
        return self.sample_time * (1.0 + self.jitter)

    @property
    def is_mean(self) -> bool:
        """Whether a force reading is the mean over a hold instead of the value at the SYNC."""
        return self.sampling != "point"

    @property
    def is_impulse(self) -> bool:
        """Whether a force reading is the mean since the last received one, even if others between them were lost."""
        return self.sampling == "impulse"

    @property
    def lag(self) -> float:
        """Time constant of the sensor's filter [s]; 0: none."""
        return 1.0 / (2.0 * pi * self.filter) if self.filter else 0.0


class BookedHold(NamedTuple):
    """Result of booking at one SYNC: bounds of the energy that came in, and the motion."""

    energy: float  # that came in, at least [J]
    speed: float  # largest, at the time to which the account now reaches [m/s or rad/s]
    is_booked: bool  # whether the account reaches further than before
    moved: float  # since the SYNC before that came [m or rad]
    elapsed: float  # the time of that [s]
    most: float  # energy that came in, at most [J]


@dataclass(slots=True)
class Port:
    """Energy account of one axis of an admittance display, kept from SYNC to SYNC."""

    settings: AdmittanceProperties
    positions: list[float] = field(default_factory=list)  # whose forces have not come, (latency + 1,) [m or rad]
    started: bool = False
    position: float = 0.0  # of the last SYNC that came [m or rad]
    missed: int = 0  # samples lost since
    moved: float = 0.0  # in the last hold [m or rad]
    newest: int = 0  # place of the last position
    origin: float = 0.0  # position to which the energy is booked [m or rad]
    force: float = 0.0  # force there [N or N*m]
    waiting: int = 0  # samples since
    mean: float = 0.0  # force with which the hold before was booked [N or N*m]
    uncertainty: float = 0.0  # sum of the uncertain energies [J]

    def begin(self, position: float, force: float) -> None:
        """Start the account at the first position [m or rad] and force [N or N*m]."""
        self.started, self.position, self.origin, self.force = True, position, position, force
        self.positions = [position] * (self.settings.latency + 1)

    def reopen(self) -> None:
        """Do not refund the encoder's error at the last booked SYNC: another proof replaces the booked energy there."""
        self.mean = 0.0

    def book(self, position: float, force: float) -> BookedHold:
        """Book the energy of the hold to which the received force belongs.

        Args:
            position: Position at this SYNC [m or rad].
            force: Force received at this SYNC [N or N*m].
        """
        settings, holds = self.settings, self.missed + 1
        moved = position - self.position
        self.position, self.moved = position, moved
        self.waiting += holds
        then = position  # the position that belongs to the force
        if settings.latency:
            for _ in range(self.missed):
                self._put(nan)
            self._put(position)
            then = self.positions[self.newest + 1 - len(self.positions)]
        self.missed = 0
        elapsed = holds * settings.sample_time
        if isnan(then):
            return new(BookedHold, (0.0, 0.0, False, moved, elapsed, 0.0))
        energy, speed, most = self._energy(then - self.origin, force, self.waiting)
        self.origin, self.force, self.waiting = then, force, 0
        return new(BookedHold, (energy, speed, True, moved, elapsed, most))

    def _put(self, position: float) -> None:
        self.newest = self.newest + 1 if self.newest + 1 < len(self.positions) else 0
        self.positions[self.newest] = position

    def _energy(self, moved: float, force: float, samples: int) -> tuple[float, float, float]:
        """Return least energy received [J], largest speed at the end [m/s or rad/s] and most energy received [J]."""
        settings = self.settings
        length, way = samples * settings.sample_time * (1.0 + settings.jitter), abs(moved)
        shortest = samples * settings.sample_time * (1.0 - settings.jitter)
        slew, acceleration, change = settings.force_slew, settings.handle_acceleration, force - self.force
        error, count = settings.force_error, settings.encoder_count
        fastest = (way + count) / shortest + 0.5 * acceleration * length
        if not settings.is_mean:
            mean, rise, square = 0.5 * (force + self.force), abs(change), length * length
            room = slew * slew * square - rise * rise
            uncertainty = rise * acceleration * square / 12.0
            if room > 0.0:  # between two samples the force leaves their line by the slew, or by what bends it
                uncertainty += fastest * min(room / (4.0 * slew), settings.force_bend * length * square / 12.0)
        elif samples == 1 or settings.is_impulse:
            mean = force
            uncertainty = slew * acceleration * length * length * length / 12.0
        else:  # of the holds before the last no mean came
            mean = force
            uncertainty = slew * length * (way + 0.25 * acceleration * length * length)
        if settings.lag > 0.0:
            mean += change * settings.lag / length
            uncertainty += 0.25 * slew * acceleration * length * length * settings.lag
            uncertainty += abs(change) * settings.lag * (1.0 / shortest - 1.0 / length) * way
            error += 2.0 * error * settings.lag / shortest
        if settings.is_impulse:  # it was divided by the sample time
            uncertainty += abs(mean) * way * settings.jitter / (1.0 - settings.jitter)
        uncertainty += error * (way + count)
        uncertainty += 0.5 * count * (abs(mean - self.mean) + abs(mean) - abs(self.mean))
        self.mean = mean
        self.uncertainty += uncertainty
        energy = mean * moved
        return energy - uncertainty, fastest, energy + uncertainty
