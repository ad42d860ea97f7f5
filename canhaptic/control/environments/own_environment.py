"""Base class of a user-defined environment, which needs only its force or its potential.

    class CenteringSpring(Environment):
        stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0)] = 200.0

        def effort(self, state: float) -> float:
            return self.stiffness * state

The energy is the integral of the force (adaptive Gauss-Kronrod quadrature, to 1e-12 of its size). It is stored at the
end of every panel of the quadrature, so that a force with a kink costs no more than a smooth one. The state that stores
a given energy is found by Newton's method inside a bracket. Each takes some tens of calls of the force: if the closed
forms are known, override `stored_energy` and `state_of_energy` as well.
"""

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from typing import Annotated, ClassVar, Final, Literal, Self
from weakref import WeakKeyDictionary

from pydantic import model_validator

from canhaptic.control.environments import Everywhere, kept_on_side
from canhaptic.errors import OwnCodeError
from canhaptic.own_results import program_of
from canhaptic.units import Parameters, quantity

_TOLERANCE: Final = 1e-12  # of an integral, relative
_MOST_HALVINGS: Final = 40
_MOST_STEPS: Final = 100  # of the root finder; bisection alone ends within 64
_SMALLEST: Final = 1e-9  # [m or rad] first state that is tried
_DOUBLINGS: Final = 60
_NO_FORCE: Final = 1e-9
"""Largest force that counts as a rounding error of 0, such as a sine at pi [N or N*m]."""
_SLOPE_ROUNDING: Final = 1e-14
_TRIED: Final = tuple(10.0 ** (power / 16) for power in range(-80, 1))
"""Sizes of states at which the direction of a force is checked when a scene is loaded: 10 um to 1 m or rad."""
_DERIVATIVE_STEP: Final = 6e-6  # cube root of the rounding error: least error of a central difference
# Kronrod's 15 points on [-1, 1] with their weights, and the weights of Gauss's 7 points among them
# (Piessens and others, QUADPACK, 1983).
_NODES: Final = (
    (0.991455371120812639206854697526329, 0.022935322010529224963732008058970, 0.0),
    (0.949107912342758524526189684047851, 0.063092092629978553290700663189204, 0.129484966168869693270611432679082),
    (0.864864423359769072789712788640926, 0.104790010322250183839876322541518, 0.0),
    (0.741531185599394439863864773280788, 0.140653259715525918745189590510238, 0.279705391489276667901467771423780),
    (0.586087235467691130294144691258384, 0.169004726639267902826583426598550, 0.0),
    (0.405845151377397166906606412076961, 0.190350578064785409913256402421014, 0.381830050505118944950369775488975),
    (0.207784955007898467600689403773245, 0.204432940075298892414161999234649, 0.0),
)
_MIDDLE: Final = (0.209482141084727828012999174891714, 0.417959183673469387755102040816327)


class Environment(Everywhere, Parameters):
    """A storage with a damper, given by `effort` or by `potential`; it acts on both sides of `position`, or on one.

    The torque, minus `effort`, must point back to state 0, where nothing is stored: effort(x) x >= 0. A scene that
    violates this up to 1 m or rad is refused, and a run that meets such a force ends. A force that changes sign between
    resting positions, as in notches, needs a contact zone for each of them, as `detents` have.
    """

    position: Annotated[float, quantity("m", "rad")] = 0.0
    """Where the state is 0: the resting position, or the surface."""
    side: Literal["both", "below", "above"] = "both"
    """Where the force acts: everywhere, or, as in a wall, only below or above its position."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e7)] = 0.0
    """Damping coefficient; the damper acts in contact only."""

    linear_stiffness: ClassVar[None] = None

    @model_validator(mode="after")
    def _points_back(self) -> Self:
        kind = type(self)
        if (kind.contact, kind.state_of_energy) != (Environment.contact, Environment.state_of_energy):
            return self  # it has zones of its own
        for size in _TRIED:
            for state in (size, -size) if self.side == "both" else (-size if self.side == "below" else size,):
                try:
                    force = self.effort(state)
                except _TurnedError as error:
                    raise ValueError(error.what) from error
                except Exception:  # own code may raise anything, at a place that no run may reach
                    return self
                if force * state < 0.0:
                    raise ValueError(_words_of(state, force))
        return self

    def potential(self, state: float) -> float:
        """Return the energy [J] stored at a state [m or rad], >= 0 and 0 at state 0; by default from `effort`."""
        if self not in _WORKS:
            _WORKS[self] = _Work(self.effort), _Work(self.effort)
        return _WORKS[self][state < 0.0].until(state)

    def effort(self, state: float) -> float:
        """Return the force [N or N*m] at a state [m or rad]; by default the slope of `potential`."""
        step = _DERIVATIVE_STEP * max(abs(state), 1e-3)
        low, high = self.potential(state - step), self.potential(state + step)
        slope = (high - low) / (2.0 * step)
        if slope * state < 0.0 and abs(slope) > _SLOPE_ROUNDING * max(abs(low), abs(high)) / step:
            raise _turned(self.potential, state, slope)
        return slope

    def surfaces(self) -> Sequence[float]:
        """Return the positions where contact begins or ends [m or rad], to simulate the continuous environment.

        A class that overrides `contact` or `true_state` must override this as well, or has no continuous reference.
        """
        return () if self.side == "both" else (self.position,)

    def contact(self, position: float) -> int:
        """Return 1 where the environment acts, else 0."""
        beyond = position < self.position if self.side == "below" else position > self.position
        return int(self.side == "both" or beyond)

    def true_state(self, position: float, displacement: float, previous: float) -> float:
        """Return x = q - q_w [m or rad] (eq. 14)."""
        return position - self.position

    def admissible(self, state: float, true: float) -> float:
        """Return the state, or 0 if it lies outside the surface of a wall."""
        return state if self.side == "both" else kept_on_side(state, true)

    def one_way(self, position: float) -> tuple[float, float]:
        """Return the interval on a position's side of state 0, in which the force does not reverse [m or rad]."""
        if position == self.position:
            return position, position
        return (-math.inf, self.position) if position < self.position else (self.position, math.inf)

    def rests(self) -> tuple[float, float]:
        """Return the positions at which nothing is stored, from and to [m or rad]."""
        return (
            -math.inf if self.side == "above" else self.position
        ), math.inf if self.side == "below" else self.position

    def stored_energy(self, state: float) -> float:
        """Return the potential [J]."""
        return self.potential(state)

    def state_of_energy(self, energy: float, like: float) -> float:
        """Return the state on the side of `like` that stores `energy` [J]; the farthest one tried if none does."""
        return state_of(self.stored_energy, self.effort, energy, like)


OwnEnvironment = Environment
"""The former name, for one release."""


def _words_of(state: float, force: float) -> str:
    return (
        f"effort({state:.4g}) is {force:.4g}, expected the sign of the state: it is the force that holds the handle "
        "there (effort(x) x >= 0); a force that changes sign between resting positions needs a contact zone for each: "
        "use `detents`, or write `contact`"
    )


class _TurnedError(OwnCodeError):
    """Raised for an environment whose force does not point back to state 0."""


def _turned(method: Callable[[float], float], state: float, force: float) -> OwnCodeError:
    return _TurnedError(program_of(getattr(method, "__self__", method)), _words_of(state, force))


class _Work:
    """Work of a force from 0 to any state on one side, stored at the ends of the panels of its quadrature.

    The table grows by octaves from `_SMALLEST`, so that its panels do not depend on the order of the calls.
    """

    def __init__(self, force: Callable[[float], float]) -> None:
        self._force = force
        self._ends, self._works = [0.0], [0.0]  # sizes of states, and the work up to them [J]

    def until(self, state: float) -> float:
        """Return the work from 0 to a state [J]."""
        size = abs(state)
        while self._ends[-1] < size:
            self._extend(math.copysign(1.0, state))
        place = bisect_right(self._ends, size) - 1
        start = math.copysign(self._ends[place], state)
        return self._works[place] + (integral(self._inward, state, start) if start != state else 0.0)

    def _extend(self, sign: float) -> None:
        last = self._ends[-1]
        panels: list[tuple[float, float]] = []
        integral(self._inward, sign * (2.0 * last or _SMALLEST), sign * last, panels)
        for end, work in sorted((abs(end), work) for end, work in panels):
            self._ends.append(end)
            self._works.append(self._works[-1] + work)

    def _inward(self, state: float) -> float:
        force = self._force(state)
        if force * state < 0.0 and abs(force) > _NO_FORCE:
            raise _turned(self._force, state, force)
        return force


_WORKS: Final[WeakKeyDictionary[Environment, tuple[_Work, _Work]]] = WeakKeyDictionary()


def integral(
    function: Callable[[float], float], end: float, start: float = 0.0, panels: list[tuple[float, float]] | None = None
) -> float:
    """Return the integral of a function from `start` to `end`, to 1e-12 of the integral of its absolute value.

    `panels` receives the end of each panel that was not halved, and its integral.

    Intervals are halved where Kronrod's 15 points and Gauss's 7 disagree, and where a jump may lie between an end and
    the outermost point, which neither rule can see; a jump is enclosed to 2^-40 of the way.
    """
    whole, error, size = _panel(function, start, end)
    allowed = _TOLERANCE * size
    total, waiting = 0.0, [(start, end, whole, error, 0)]
    while waiting:
        left, right, found, error, halvings = waiting.pop()
        if not error > allowed or halvings == _MOST_HALVINGS:  # NaN ends it: halved, it would never
            total += found
            if panels is not None:
                panels.append((right, found))
            continue
        middle = 0.5 * (left + right)
        for begin, stop in ((left, middle), (middle, right)):
            part, part_error, _ = _panel(function, begin, stop)
            waiting.append((begin, stop, part, part_error, halvings + 1))
    return total


def _panel(function: Callable[[float], float], left: float, right: float) -> tuple[float, float, float]:
    """Return the integral by Kronrod's rule, its error, and the integral of the size."""
    half, middle = 0.5 * (right - left), 0.5 * (left + right)
    value = function(middle)
    kronrod, gauss, size = _MIDDLE[0] * value, _MIDDLE[1] * value, _MIDDLE[0] * abs(value)
    for node, weight, gauss_weight in _NODES:
        low, high = function(middle - half * node), function(middle + half * node)
        kronrod += weight * (low + high)
        gauss += gauss_weight * (low + high)
        size += weight * (abs(low) + abs(high))
    unseen = max(_jump(function, middle, half), _jump(function, middle, -half))
    return half * kronrod, abs(half) * max(abs(kronrod - gauss), unseen), abs(half) * size


def _jump(function: Callable[[float], float], middle: float, half: float) -> float:
    """Return the most that a jump beyond the outermost point adds to an integral over [-1, 1]; 0 for a smooth function.

    A smooth function changes less from that point to the end than twice what it changes from the point before.
    """
    outermost, before = _NODES[0][0], _NODES[1][0]
    last = function(middle + half * outermost)
    change = abs(function(middle + half) - last) - 2.0 * abs(last - function(middle + half * before))
    return (1.0 - outermost) * max(0.0, change)


def state_of(stored: Callable[[float], float], effort: Callable[[float], float], energy: float, like: float) -> float:
    """Return the state with the sign of `like` that stores an energy [J]; the farthest one tried if none does.

    Newton's method, with bisection if a step would leave the bracket.
    """
    if energy <= 0.0:
        return 0.0
    sign = math.copysign(1.0, like)
    low, high = 0.0, max(abs(like), _SMALLEST)
    for _ in range(_DOUBLINGS):
        if stored(sign * high) >= energy:
            break
        low, high = high, 2.0 * high
    else:
        return sign * high
    state = high
    for _ in range(_MOST_STEPS):
        excess = stored(sign * state) - energy
        if excess == 0.0:
            break
        low, high = (low, state) if excess > 0.0 else (state, high)
        slope = sign * effort(sign * state)
        newton = state - excess / slope if slope > 0.0 else low
        following = newton if low < newton < high else 0.5 * (low + high)
        if following == state:
            break
        state = following
    return sign * state
