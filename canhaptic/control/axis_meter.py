"""Uncertainty of an axis's booked energy, and the energy that its device certainly dissipated.

**Position.** A position p_k = x_k + e_k, |e_k| <= e, is booked as -f_k (p_k - p_(k-1)). The sum of n holds is wrong by
-sum f_k (e_k - e_(k-1)), by parts at most e (|f_n| + sum |f_k - f_(k-1)|), with f_0 = 0: a constant torque adds
no uncertainty, however long the axis moves.

**Torque.** A motor that gives f (1 + s) + c for a torque f, |s| <= share and |c| <= offset, adds the uncertainty
sum (share |f_k| + offset) |x_k - x_(k-1)|, if the axis does not turn back within a hold.

**Late.** After its SYNC the previous torque still acts for a time theta: torque window and current lag together
(`hold_timing`). So each change adds |f_k - f_(k-1)| theta v, with v the speed in that time, unless the algorithm has a
tighter bound. `guarded` bounds no motion inside a hold if only damping or dry friction of the device is declared; v is
then the largest speed of the axis (`speed_limit`). What the device dissipates there covers the promise at the handle,
but says nothing about the sum at the motor. For algorithms without certificates v is an estimate, twice the larger mean
speed of the hold and the one before: with `speed_limit` no account would ever be judged active.

**Lost.** After lost process data the displacement D of n holds is known, and the torque f of the last of them, read
back. Booked is -f D, true is -sum f_j D_j, where f_j is a torque sent since then, or the previous one if commands were
lost too: |f_j - f| <= a. So the error is at most a sum over j < n of |D_j|, for any torques in any order. Each D_j
is bounded by the declared largest speed v of the axis alone (`speed_limit`; a faster axis is stopped):
|D_j| <= v T_j. The uncertainty is

    a v (T_1 + ... + T_(n-1)),

with T_n as well if the last torque is not read back for its own hold, plus the energy that the algorithm subtracted. It
is a bound for every hand, and large for a slow one; an algorithm with a declared hand force has a smaller bound
(`certified_torque`). What an algorithm subtracts, it subtracts for SYNCs without a sample, and these may be more than
the holds n: two frames of an EtherCAT line may lie in one hold. Booked minus -f D is known exactly, so its size is
added after every lost sample, also where n = 1 leaves no torque open: the bound above is that of the rest.

**Device.** A damping of at least b dissipates at least b D^2 / t in a time t in which the axis moves by D
(Cauchy-Schwarz), for every torque. A dry friction of at least f_c dissipates f_c along its path. The path is at
least that of the shortest motion within e of every position p: it rests until p is further than e away, and then
follows at e. Between two of its turns no motion within e of p is shorter.
"""

from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING, ClassVar, Final

from canhaptic.control.environments import Environment

if TYPE_CHECKING:
    from canhaptic.control.motion_checks import FrictionWatch, MassFelt


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Declared errors of position and torque of an axis, and bounds of its device's damping and friction."""

    sample_time: float = 1e-3  # longest period [s]
    position: float = 0.0  # error of a position, a constant part left out [m or rad]
    torque_share: float = 0.0  # error of the torque, of the torque
    torque_offset: float = 0.0  # error of the torque [N or N*m]
    acts_unasked: bool = False  # a torque may act where none was sent
    torque_limit: float = inf  # part of the booked torque that may not have acted [N or N*m]
    late: float = 0.0  # time after a SYNC for which the torque before may act, where the algorithm counts none [s]
    late_speed: float | None = None  # of the axis in that time; None: estimated [m/s or rad/s]
    counts_losses: bool = True  # whether the algorithm leaves the uncertainty of lost positions to this meter
    largest_speed: float = inf  # of the axis [m/s or rad/s]
    largest_torque: float = inf  # that is ever sent [N or N*m]
    device_damping: float | None = None  # at least [N*s/m or N*m*s/rad]; None: not declared
    device_friction: float | None = None  # dry, in motion, at least [N or N*m]; None: not declared
    device_damping_bound: float | None = None  # at most [N*s/m or N*m*s/rad]; None: not declared
    device_friction_bound: float | None = None  # dry, at most [N or N*m]; None: not declared

    @property
    def is_estimate(self) -> bool:
        """Whether the uncertainty due to late torques is an estimate."""
        return self.late > 0.0 and self.late_speed is None

    @property
    def most_dissipated(self) -> float:
        """Largest power that the device can dissipate [W]; infinite if undeclared."""
        damping, friction, speed = self.device_damping_bound, self.device_friction_bound, self.largest_speed
        if damping is None or friction is None or speed == inf:
            return inf
        return (damping * speed + friction) * speed


IDEAL: Final = Accuracy()


class AxisMeter:
    """Accumulates, hold by hold, the uncertainty of an axis's booked energy and the least dissipation of its device.

    Args:
        accuracy: Accuracy of the axis.
        environment: Environment rendered on it; None if a group renders it or it is unknown.
        watch: Check of the motion against the declared friction; None: no check.

    Attributes:
        accuracy: Accuracy of the axis.
        watch: Check of the motion against the declared friction, or None.
        resolution: Largest error so far of the booked energy, by sensors and drive [J]; never decreases.
        dissipated: Least energy dissipated by the device so far [J].
        damping_asked: Damping of the environment [N*s/m or N*m*s/rad]; 0 for a sum, whose damping depends on the place.
        position: Last booked position [m or rad].
        asked: Force of the environment's spring at the last position; 0 out of contact [N or N*m].
        books_least: Whether the booked energy is a lower bound of the energy received.
        felt: Fit of the apparent mass; only for an admittance display that renders a mass.
    """

    books_least: ClassVar[bool] = False
    felt: "MassFelt | None" = None

    def __init__(
        self, accuracy: Accuracy = IDEAL, environment: Environment | None = None, watch: "FrictionWatch | None" = None
    ) -> None:
        self.accuracy, self.watch = accuracy, watch
        self._environment = None if environment is None or environment.relaxes else environment
        is_sum = getattr(environment, "damps_by_place", False)
        self.damping_asked = 0.0 if environment is None or is_sum else environment.damping
        self._damping, self._friction = accuracy.device_damping or 0.0, accuracy.device_friction or 0.0
        self._blur, self._sample_time = 2.0 * accuracy.position, accuracy.sample_time
        self._booked_at = -1.0
        self._lazy: tuple[float, float]  # position of the shortest motion, from the first position on
        self.position = self._torque = self._changes = self._uneven = self._speed = 0.0
        self.resolution = self.dissipated = self.asked = 0.0

    @property
    def is_damped(self) -> bool:
        """Whether damping or friction of the device is declared."""
        return self.accuracy.device_damping is not None or self.accuracy.device_friction is not None

    def leave_open(self, torque: float, time: int, booked: float) -> None:
        """Add the energy uncertainty of holds with unknown torques; call it after the `take` that booked these holds.

        Args:
            torque: Largest difference of these torques from the booked one [N or N*m].
            time: Duration of the holds [sample times].
            booked: Energy that the algorithm already subtracted for them [J].
        """
        accuracy = self.accuracy
        if accuracy.counts_losses:
            energy = booked
            if torque:
                energy += torque * accuracy.largest_speed * time * accuracy.sample_time
            self._uneven += energy
            self.resolution += energy

    def take(self, position: float, torque: float, deadline: float, touches: bool) -> None:
        """Add the energy uncertainty of a booked hold, and the least dissipation of the device in it.

        Args:
            position: Position at the end of the hold [m or rad].
            torque: Torque booked for it [N or N*m].
            deadline: Sample times from the first SYNC to its end, which may be late.
            touches: Whether the hold was in contact.
        """
        environment = self._environment
        if environment is not None:
            self.asked = 0.0
            if touches and environment.contact(position):
                self.asked = environment.effort(environment.true_state(position, 0.0, 0.0))
        booked_at, self._booked_at = self._booked_at, deadline
        moved, self.position = abs(position - self.position), position
        if booked_at < 0:
            self._lazy = position - self.accuracy.position, position + self.accuracy.position
            self._compare(position, torque)
            return
        holds = deadline - booked_at
        if holds < 0.5:  # no two SYNCs are nearer
            holds = 0.5
        if self._damping:
            certain = moved - self._blur
            if certain > 0.0:
                self.dissipated += self._damping * certain * certain / (holds * self._sample_time)
        if self._friction:
            self.dissipated += self._friction * self._path_to(position)
            self._compare(position, torque)
        if torque or self._torque or self.accuracy.acts_unasked:
            self._leave_open(torque, moved, holds)
        else:
            self._speed = moved / holds

    def _compare(self, position: float, torque: float) -> None:
        if self.watch is not None:
            self.watch.take(position, torque, int(self._booked_at), self.asked)

    def _path_to(self, position: float) -> float:
        """Return the least distance that the axis has moved to be measured at a position [m or rad]; see the module."""
        low, high = self._lazy
        lowest, highest = position - self.accuracy.position, position + self.accuracy.position
        if lowest > high:
            self._lazy = lowest, lowest
            return lowest - high
        if highest < low:
            self._lazy = highest, highest
            return low - highest
        self._lazy = (lowest if lowest > low else low), (highest if highest < high else high)
        return 0.0

    def _leave_open(self, torque: float, moved: float, holds: float) -> None:
        accuracy, size, change = self.accuracy, abs(torque), abs(torque - self._torque)
        mean, before = moved / holds, self._speed
        self._speed = mean
        if accuracy.late:
            fastest = 2.0 * ((mean if mean > before else before) + self._blur) / accuracy.sample_time
            self._uneven += change * accuracy.late * (fastest if accuracy.late_speed is None else accuracy.late_speed)
        if size > accuracy.torque_limit:
            self._uneven += (size - accuracy.torque_limit) * (moved + self._blur)
        self._changes += change
        self._torque = torque
        if accuracy.torque_share or accuracy.torque_offset:
            farthest = moved + self._blur
            self._uneven += (accuracy.torque_share * size + accuracy.torque_offset) * farthest
        resolution = accuracy.position * (self._changes + size) + self._uneven
        if resolution > self.resolution:
            self.resolution = resolution


class SilentMeter(AxisMeter):
    """Meter of an admittance display. It adds no uncertainty: the algorithm already subtracts the sensors' errors.

    Args:
        felt: Fit of the apparent mass; None if the display renders no mass.
    """

    books_least = True

    def __init__(self, felt: "MassFelt | None" = None) -> None:
        super().__init__()
        self.felt = felt

    def leave_open(self, torque: float, time: int, booked: float) -> None:
        """Do nothing: the algorithm has subtracted the uncertainty of these holds from its own energy account."""

    def take(self, position: float, torque: float, deadline: float, touches: bool) -> None:
        """Store the position [m or rad], and add it with the force to the fit of the mass."""
        self.position = position
        if self.felt is not None:
            self.felt.take(position, torque, int(deadline))
