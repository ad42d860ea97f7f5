"""A planar five-bar that two motors move together: lengths, masses and the linkage in motion."""

from typing import Annotated, ClassVar

from pydantic import model_validator

from canhaptic.axis_units import Motion
from canhaptic.errors import ParameterError
from canhaptic.signals import PlantEnergy
from canhaptic.sim.plant.mechanism.five_bar_motion import (
    FiveBarSettings,
    FiveBarState,
    advance_five_bar,
    five_bar_stack,
    is_near_singular,
    place_at,
    stored,
)
from canhaptic.sim.plant.mechanism.linkage import Linkage, linkage_of, singular, solved
from canhaptic.sim.plant.mechanism.plane_force import force_of_hand
from canhaptic.sim.plant.mechanism.sample_clock import SampleClock
from canhaptic.sim.plant.mechanism.task_hand import TaskHand
from canhaptic.units import Parameters, quantity

_Angle = Annotated[float, quantity("rad", ge=-100.0, le=100.0)]


class ElbowStop(Parameters):
    """Springs that keep the elbows' distance within bounds, short of where the distal links stretch or fold."""

    least: Annotated[float, quantity("m", ge=0.0, le=1e3)] = 0.0
    """Distance of the elbows below which the spring pushes them apart."""
    most: Annotated[float, quantity("m", gt=0.0, le=1e3)]
    """Distance beyond which it draws them together."""
    stiffness: Annotated[float, quantity("N/m", gt=0.0, le=1e8)]
    """Stiffness of the springs."""


class FiveBarLinkage(Parameters):
    """Lengths and masses of a five-bar; left and right alike."""

    motion: ClassVar[Motion] = "rad"
    axes: ClassVar[int] = 2
    order: ClassVar[int | None] = 2

    base: Annotated[float, quantity("m", ge=0.0, le=100.0)]
    """Distance of the two motors."""
    proximal: Annotated[float, quantity("m", gt=0.0, le=100.0)]
    """Length of the links on the motors."""
    distal: Annotated[float, quantity("m", gt=0.0, le=100.0)]
    """Length of the links that carry the handle."""
    motor_inertia: Annotated[float, quantity("kg*m^2", gt=0.0, le=1e4)]
    """Rotor and proximal link, about each motor."""
    distal_mass: Annotated[float, quantity("kg", ge=0.0, le=1e4)] = 0.0
    """Mass of each distal link, a uniform rod."""
    handle_mass: Annotated[float, quantity("kg", ge=0.0, le=1e4)] = 0.0
    """At the joint of the distal links."""
    damping: Annotated[float, quantity("N*m*s/rad", ge=0.0, le=1e4)] = 0.0
    """Viscous friction of the bearings of each motor."""
    elbow_stop: ElbowStop | None = None
    """Springs between the elbows; None: none."""
    initial_angles: tuple[_Angle, _Angle]
    """Angles of the left and the right motor, from +x, counterclockwise."""

    @model_validator(mode="after")
    def _stop_is_short_of_singular(self) -> "FiveBarLinkage":
        stop = self.elbow_stop
        if stop is not None and not stop.least < stop.most < 2.0 * self.distal:
            raise ValueError(
                f"elbow_stop from {stop.least:g} to {stop.most:g} m, expected least < most < {2.0 * self.distal:g} m "
                "(twice the distal length)"
            )
        return self

    def linkage(self) -> Linkage:
        """Return geometry and inertia."""
        return linkage_of(
            self.base, self.proximal, self.distal, self.motor_inertia, self.distal_mass, self.handle_mass
        )  # fmt: skip

    def build(self, hand: TaskHand | None, sample_time_ns: int, substeps: int) -> "FiveBarMotion":
        """Return it at rest at its initial angles.

        Raises:
            ParameterError: These are a singular pose.
        """
        return FiveBarMotion(self, hand, sample_time_ns, substeps)


class FiveBarMotion:
    """The five-bar in motion.

    Args:
        links: Lengths and masses of the links.
        hand: Hand at the handle; None without a hand.
        sample_time_ns: T [ns].
        substeps: Number of substeps in one sample time.

    Attributes:
        settings: Constants of the run.
        state: State of the motion.

    Raises:
        ParameterError: The initial angles are a singular pose.
    """

    def __init__(self, links: FiveBarLinkage, hand: TaskHand | None, sample_time_ns: int, substeps: int) -> None:
        self._clock = SampleClock(sample_time_ns)
        linkage, stop = links.linkage(), links.elbow_stop
        stiffness, least, most = (stop.stiffness, stop.least, stop.most) if stop is not None else (0.0, 0.0, 0.0)
        self.settings = FiveBarSettings(
            linkage, force_of_hand(hand), links.damping, stiffness, least, most, substeps, self._clock.tick_time
        )
        self._place, self._stack = place_at(linkage, *links.initial_angles), five_bar_stack()
        self.state = FiveBarState(*links.initial_angles)
        if not self._place.pose.is_regular:
            raise singular(linkage, *links.initial_angles, self._place.pose.span)
        self._stored_at_start = self.stored

    @property
    def positions(self) -> tuple[float, ...]:
        """True angles of the motors [rad]."""
        return self.state.left, self.state.right

    @property
    def velocities(self) -> tuple[float, ...]:
        """True velocities of the motors [rad/s]."""
        return solved(self._place.inertia, self.state.left_momentum, self.state.right_momentum)

    @property
    def handle(self) -> tuple[float, float]:
        """Where the handle is [m]."""
        return self._place.pose.handle

    @property
    def iterations(self) -> int:
        """Solver iterations since the start, a machine-independent price."""
        return self.state.iterations

    @property
    def stored(self) -> float:
        """Kinetic energy, and that in the elbow stop, from the state [J]."""
        return stored(self.settings, self.state, self._place)

    def begin(self, now: int) -> None:
        """Start the clock at `now` [ns]."""
        self._clock.begin(now)

    def advance_to(self, now: int, torques: tuple[float, ...]) -> None:
        """Move to `now` [ns] under torques [N*m] that were constant since the last call.

        Raises:
            ParameterError: `now` lies before the last call, or the links are pushed through a singular pose.
        """
        begin = self._clock.tick
        ticks = self._clock.pass_until(now)
        if ticks:
            left, right = torques
            self._place = advance_five_bar(
                self.settings, self.state, self._stack, self._place, begin, ticks, (left, right)
            )
            if self.state.stuck:
                raise self._stuck(self.state.stuck)

    def energy(self, axis: int) -> PlantEnergy:
        """Return the true works done through one motor coordinate since the start [J].

        The kinetic energy of coupled links belongs to no motor alone: `stored` is the balance of what this coordinate
        received. `stored_error` is the difference of the sum over both from the energy of the state.
        """
        now = self.state
        works = (now.left_motor, now.left_user, now.left_lost), (now.right_motor, now.right_user, now.right_lost)
        motor, user, lost = works[axis]
        return PlantEnergy(motor, user, lost, motor + user - lost)

    @property
    def stored_error(self) -> float:
        """Energy of the state beyond the accounts of both motors [J]: the integrator's error."""
        return self.stored - self._stored_at_start - sum(self.energy(axis).stored for axis in (0, 1))

    def _stuck(self, step: float) -> ParameterError:
        """Reason why no motion was found: a singular pose, or forces beyond any substep."""
        left, right = self.positions
        if is_near_singular(self.settings, self._place):
            return singular(self.settings.links, left, right, self._place.pose.span)
        return ParameterError(
            f"five_bar: no motion found at {left:.6g} and {right:.6g} rad within {step:.3g} s; raise "
            "accuracy.substeps, or lower the stiffness of elbow_stop or hand"
        )
