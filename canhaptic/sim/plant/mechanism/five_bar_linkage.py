"""A five-bar in motion: nonlinear, so it is stepped by a discrete gradient, which keeps every joule.

With M(q) the inertia, W = 1/M, p the momentum, H = p'W p / 2 + V(q), one substep h solves

    q+ - q = h Wm (p + p+) / 2                 Wm the mean of W at both ends
    p+ - p = h (-G + tau - B (q+ - q) / h + F)   G . (q+ - q) = [p'(W+ - W) p + p+'(W+ - W) p+] / 4 + V+ - V, exactly

(Gonzalez, "Time integration and discrete Hamiltonian systems", J. Nonlinear Science 6, 1996), so that H+ - H is
tau . dq - dq'B dq / h + F . dq to rounding: the work of each motor is torque times displacement, friction only takes,
and the hand's spring, whose force F is mapped by a Jacobian J with J dq = dx exactly, gives back what it got. Order 2.
"""

from typing import Annotated, ClassVar, Final

from pydantic import model_validator

from canhaptic.axis_units import Motion
from canhaptic.errors import ParameterError
from canhaptic.signals import PlantEnergy
from canhaptic.sim.plant.mechanism.hand_force import HandForce
from canhaptic.sim.plant.mechanism.linkage import Inertia, Linkage, LinkagePose
from canhaptic.sim.plant.mechanism.sample_clock import SampleClock
from canhaptic.sim.plant.mechanism.task_hand import TaskHand
from canhaptic.sim.plant.propagator import TICKS
from canhaptic.units import Parameters, quantity

_ITERATIONS: Final = 60
_CONVERGED: Final = 1e-15  # [rad] of a correction, in addition to the rounding of the step
_ACCEPTED: Final = 1e-12  # [rad] where rounding lets it stagnate; or
_ENERGY_OPEN: Final = 1e-15  # of the energy at hand, which is all that it then leaves open
_FURTHEST: Final = 1.0  # [rad] in one substep; further away a solver has lost its way
_TINY: Final = 1e-11  # [rad^2] below which the secant correction of the handle's place is below its rounding
_TINIEST: Final = 1e-16  # [rad^2] below which that of the kinetic energy is, which gets small with the motion
_HALVINGS: Final = 18
_DEEP: Final = 10  # halvings, after which a singular pose close by is why
_DIVERGING: Final = 4.0  # times the last correction
_NEAR: Final = 1e-3  # of the distal length, of the handle from the line of the elbows or of these from each other

_Angle = Annotated[float, quantity("rad", ge=-100.0, le=100.0)]
_Pair = tuple[float, float]


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
        """Returns geometry and inertia."""
        return Linkage(
            self.base, self.proximal, self.distal, self.motor_inertia, self.distal_mass, self.handle_mass
        )  # fmt: skip

    def build(self, hand: TaskHand | None, sample_time_ns: int, substeps: int) -> "_FiveBarMotion":
        """Returns it at rest at its initial angles.

        Raises:
            ParameterError: These are a singular pose.
        """
        return _FiveBarMotion(self, hand, sample_time_ns, substeps)


class _Place:
    """A pose with its inertia."""

    __slots__ = ("angles", "inertia", "pose")

    def __init__(self, linkage: Linkage, left: float, right: float) -> None:
        self.angles = (left, right)
        self.pose: LinkagePose = linkage.pose(left, right)
        self.inertia: Inertia = linkage.inertia(self.pose)


class _FiveBarMotion:
    """The five-bar in motion.

    Args:
        links: Lengths and masses.
        hand: At the handle; None without a hand.
        sample_time_ns: T [ns].
        substeps: In one sample time.

    Attributes:
        order: Of the error in the substep.
        iterations: Solver iterations since the start, a machine-independent price.
    """

    order = FiveBarLinkage.order

    def __init__(self, links: FiveBarLinkage, hand: TaskHand | None, sample_time_ns: int, substeps: int) -> None:
        self._clock = SampleClock(sample_time_ns)
        self._linkage = links.linkage()
        self._damping, self._stop = links.damping, links.elbow_stop
        self._hand = HandForce(hand) if hand is not None else None
        self._substeps = substeps
        self._place = _Place(self._linkage, *links.initial_angles)
        self._momentum: _Pair = (0.0, 0.0)
        self._motor, self._user, self._lost = [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]
        self._stored_at_start = self.stored
        self.iterations = 0

    @property
    def positions(self) -> tuple[float, ...]:
        """True angles of the motors [rad]."""
        return self._place.angles

    @property
    def velocities(self) -> tuple[float, ...]:
        """True velocities of the motors [rad/s]."""
        return self._place.inertia.solve(*self._momentum)

    @property
    def handle(self) -> tuple[float, float]:
        """Where the handle is [m]."""
        return self._place.pose.handle

    @property
    def stored(self) -> float:
        """Kinetic energy, and that in the elbow stop, from the state [J]."""
        left, right = self._momentum
        v_left, v_right = self._place.inertia.solve(left, right)
        return 0.5 * (left * v_left + right * v_right) + self._potential(self._place.pose)

    def begin(self, now: int) -> None:
        """Starts the clock at `now` [ns]."""
        self._clock.begin(now)

    def advance_to(self, now: int, torques: tuple[float, ...]) -> None:
        """Moves to `now` [ns] under torques [N*m] that were constant since the last call.

        Raises:
            ParameterError: `now` lies before the last call, or the links are pushed through a singular pose.
        """
        clock = self._clock
        begin = clock.tick
        ticks = clock.pass_until(now)
        if ticks:
            count = -(-ticks * self._substeps // TICKS)
            step = ticks * clock.tick_time / count
            start = begin * clock.tick_time
            for k in range(count):
                self._substep(start + k * step, step, torques, 0)

    def energy(self, axis: int) -> PlantEnergy:
        """Returns the true works done through one motor coordinate since the start [J].

        The kinetic energy of coupled links belongs to no motor alone: `stored` is what this coordinate received on
        balance. `stored_error` says how far the sum over both is from the energy of the state.
        """
        motor, user, lost = self._motor[axis], self._user[axis], self._lost[axis]
        return PlantEnergy(motor, user, lost, motor + user - lost)

    @property
    def stored_error(self) -> float:
        """Energy of the state beyond what the accounts of both motors say [J]: what the integrator leaves open."""
        received = sum(self._motor) + sum(self._user) - sum(self._lost)
        return self.stored - self._stored_at_start - received

    # --- one substep --------------------------------------------------------------------------------------------------

    def _substep(self, time: float, step: float, torques: tuple[float, ...], depth: int) -> None:
        """Takes one substep, in halves where the solver does not converge."""
        try:
            solved = self._solved(time, step, torques)
        except ParameterError:
            solved = None
        if solved is None:
            if depth == _HALVINGS or (depth >= _DEEP and self._near_singular()):
                raise self._stuck(step)
            self._substep(time, 0.5 * step, torques, depth + 1)
            self._substep(time + 0.5 * step, 0.5 * step, torques, depth + 1)
            return
        after, momentum, hand = solved
        for axis in (0, 1):
            displacement = after.angles[axis] - self._place.angles[axis]
            self._motor[axis] += torques[axis] * displacement
            self._user[axis] += hand[axis] * displacement
            self._lost[axis] += self._damping * displacement * displacement / step
        self._place, self._momentum = after, momentum

    def _near_singular(self) -> bool:
        least, most = _NEAR * self._linkage.distal, (2.0 - _NEAR * _NEAR) * self._linkage.distal
        return not least < self._place.pose.span < most

    def _stuck(self, step: float) -> ParameterError:
        """Returns why no motion was found: a singular pose, or forces beyond any substep."""
        left, right = self._place.angles
        if self._near_singular():
            return self._linkage.singular(left, right, self._place.pose.span)
        return ParameterError(
            f"five_bar: no motion found at {left:.6g} and {right:.6g} rad within {step:.3g} s; raise "
            "accuracy.substeps, or lower the stiffness of elbow_stop or hand"
        )

    def _solved(self, time: float, step: float, torques: tuple[float, ...]) -> tuple[_Place, _Pair, _Pair] | None:
        """Returns (place, momentum, hand's torques) after a substep; None when it did not converge."""
        before = self._place
        left, right = before.angles
        v_left, v_right = before.inertia.solve(*self._momentum)
        d_left, d_right = step * v_left, step * v_right
        slope = self._slope(before, step)
        last, enough = float("inf"), _ENERGY_OPEN * self.stored
        for _ in range(_ITERATIONS):
            if not abs(d_left) + abs(d_right) < _FURTHEST:  # NaN as well
                return None
            self.iterations += 1
            after = _Place(self._linkage, left + d_left, right + d_right)
            momentum = self._momentum_after(before, after, step)
            force, hand = self._force(before, after, momentum, time, step, torques)
            r_left = (momentum[0] - self._momentum[0]) / step - force[0]
            r_right = (momentum[1] - self._momentum[1]) / step - force[1]
            c_left, c_right = slope.solve(r_left, r_right)
            size = abs(c_left) + abs(c_right)
            if size <= _CONVERGED:
                return after, momentum, hand
            if size >= 0.5 * last and (size <= _ACCEPTED or abs(r_left * d_left) + abs(r_right * d_right) <= enough):
                return after, momentum, hand
            if not size < _DIVERGING * last:
                return None
            last = size
            d_left, d_right = d_left - c_left, d_right - c_right
        return None

    def _momentum_after(self, before: _Place, after: _Place, step: float) -> _Pair:
        """Returns p+ of q+ - q = h Wm (p + p+) / 2."""
        w0, w1 = before.inertia, after.inertia
        det0, det1 = w0.a * w0.c - w0.b * w0.b, w1.a * w1.c - w1.b * w1.b
        mean = Inertia(
            0.5 * (w0.c / det0 + w1.c / det1), -0.5 * (w0.b / det0 + w1.b / det1), 0.5 * (w0.a / det0 + w1.a / det1)
        )
        v_left, v_right = (
            (after.angles[0] - before.angles[0]) / step,
            (after.angles[1] - before.angles[1]) / step,
        )
        p_left, p_right = mean.solve(v_left, v_right)
        return 2.0 * p_left - self._momentum[0], 2.0 * p_right - self._momentum[1]

    def _force(
        self, before: _Place, after: _Place, momentum: _Pair, time: float, step: float, torques: tuple[float, ...]
    ) -> tuple[_Pair, _Pair]:
        """Returns (all generalised forces, those of the hand) [N*m] over the substep."""
        (a_left, a_right), (b_left, b_right) = before.angles, after.angles
        change = (b_left - a_left, b_right - a_right)
        middle = _Place(self._linkage, a_left + 0.5 * change[0], a_right + 0.5 * change[1])
        gradient = self._gradient(before, middle, after, momentum, change)
        rate = self._damping / step
        force = [torques[axis] - gradient[axis] - rate * change[axis] for axis in (0, 1)]
        hand = (0.0, 0.0)
        if self._hand is not None:
            x, y = self._hand.force(before.pose.handle, after.pose.handle, time, step)
            (xl, xr), (yl, yr) = _secant_jacobian(before.pose, middle.pose, after.pose, change)
            hand = (xl * x + yl * y, xr * x + yr * y)
        return (force[0] + hand[0], force[1] + hand[1]), hand

    def _gradient(self, before: _Place, middle: _Place, after: _Place, momentum: _Pair, change: _Pair) -> _Pair:
        """Returns G: the discrete gradient of the kinetic energy at given momenta, and of the stop's potential."""
        rates = self._linkage.inertia_rates(middle.pose)
        left = right = value = 0.0
        for p in (self._momentum, momentum):
            v = middle.inertia.solve(*p)
            left -= 0.25 * rates[0].product(*v)
            right -= 0.25 * rates[1].product(*v)
            v0, v1 = before.inertia.solve(*p), after.inertia.solve(*p)
            value += 0.25 * (p[0] * (v1[0] - v0[0]) + p[1] * (v1[1] - v0[1]))
        square = change[0] * change[0] + change[1] * change[1]
        if square > _TINIEST:
            excess = (value - left * change[0] - right * change[1]) / square
            left, right = left + excess * change[0], right + excess * change[1]
        if self._stop is None:
            return left, right
        push = self._stop_gradient(self._stop.stiffness, before.pose, middle.pose, after.pose, change)
        return left + push[0], right + push[1]

    # --- the elbow stop -----------------------------------------------------------------------------------------------

    def _depth(self, span: float) -> float:
        """Returns how far the elbows are beyond their stop, positive where too far apart; 0 without one [m]."""
        if self._stop is None:
            return 0.0
        return max(0.0, span - self._stop.most) - max(0.0, self._stop.least - span)

    def _potential(self, pose: LinkagePose) -> float:
        return 0.5 * self._stop.stiffness * self._depth(pose.span) ** 2 if self._stop is not None else 0.0

    def _stop_gradient(
        self, stiffness: float, before: LinkagePose, middle: LinkagePose, after: LinkagePose, change: _Pair
    ) -> _Pair:
        """Returns the discrete gradient of the potential; corrected always, for its slope has a kink."""
        pull = stiffness * self._depth(middle.span)
        by_left, by_right = self._linkage.span_rates(middle)
        left, right = pull * by_left, pull * by_right
        square = change[0] * change[0] + change[1] * change[1]
        if square > 0.0:
            value = self._potential(after) - self._potential(before)
            excess = (value - left * change[0] - right * change[1]) / square
            left, right = left + excess * change[0], right + excess * change[1]
        return left, right

    def _slope(self, place: _Place, step: float) -> Inertia:
        """Returns an estimate of d(residual)/d(displacement): inertia, damping, hand and stop."""
        inertia, damping = place.inertia, self._damping / step
        scale = 2.0 / (step * step)
        a, b, c = scale * inertia.a + damping, scale * inertia.b, scale * inertia.c + damping
        (xl, xr), (yl, yr) = place.pose.jacobian
        if self._hand is not None:
            k = self._hand.slope(step)
            a += xl * (k.xx * xl + k.xy * yl) + yl * (k.xy * xl + k.yy * yl)
            b += xl * (k.xx * xr + k.xy * yr) + yl * (k.xy * xr + k.yy * yr)
            c += xr * (k.xx * xr + k.xy * yr) + yr * (k.xy * xr + k.yy * yr)
        if self._stop is not None and self._depth(place.pose.span) != 0.0:
            left, right = self._linkage.span_rates(place.pose)
            half = 0.5 * self._stop.stiffness
            a, b, c = a + half * left * left, b + half * left * right, c + half * right * right
        return Inertia(a, b, c)


def _secant_jacobian(
    before: LinkagePose, middle: LinkagePose, after: LinkagePose, change: _Pair
) -> tuple[_Pair, _Pair]:
    """Returns the Jacobian in the middle, corrected so that it maps the displacement of the motors to the handle's."""
    square = change[0] * change[0] + change[1] * change[1]
    (xl, xr), (yl, yr) = middle.jacobian
    if square <= _TINY:
        return (xl, xr), (yl, yr)
    ex = (after.handle[0] - before.handle[0] - xl * change[0] - xr * change[1]) / square
    ey = (after.handle[1] - before.handle[1] - yl * change[0] - yr * change[1]) / square
    return (xl + ex * change[0], xr + ex * change[1]), (yl + ey * change[0], yr + ey * change[1])
