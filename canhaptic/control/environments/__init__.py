"""Virtual environments of one axis, each in its own file: the table of their names, and what they have in common.

An environment is a storage, a damper in parallel, and zones of contact.

The torque of an environment is always

    torque = -effort(state) - damping * velocity

with `state` the displacement of its storage and `velocity` the velocity of that state. A passivity algorithm decides
which state and velocity the energy account permits; the environment maps them to energy and effort.

In the cycle an environment is a plain object (`plain`) instead of a pydantic model, whose attributes take ten times as
long to read. The plain object has the functions of the model's class. Its properties are evaluated once, because an
environment never changes.
"""

from collections.abc import Callable, Mapping
from functools import cache
from math import copysign, inf, sqrt
from types import FunctionType
from typing import Annotated, Any, ClassVar, Final, Literal, NamedTuple, Protocol, TypeVar

from canhaptic.units import Parameters, quantity

_HERE: Final = "canhaptic.control.environments"

ENVIRONMENTS: Final[dict[str, str]] = {
    "spring_damper_wall": f"{_HERE}.spring_damper_wall:SpringDamperWall",
    "two_sided_wall": f"{_HERE}.two_sided_wall:TwoSidedWall",
    "hardening_wall": f"{_HERE}.hardening_wall:HardeningWall",
    "detents": f"{_HERE}.detents:Detents",
    "viscous_medium": f"{_HERE}.viscous_medium:ViscousMedium",
    "viscoelastic_medium": f"{_HERE}.viscoelastic_medium:ViscoelasticMedium",
    "coulomb_surface": f"{_HERE}.coulomb_surface:CoulombSurface",
    "damper_wall": f"{_HERE}.damper_wall:DamperWall",
    "free_space": f"{_HERE}.free_space:FreeSpace",
}
"""Name in a scene -> "module:Class"; the class is the parameter model and the environment in one."""


class Environment(Protocol):
    """A virtual environment of one axis. Immutable: everything that changes belongs to the controller.

    An environment with more than one way out may also have `one_way(position)`: the ends [m or rad] of the interval
    around a position in which the effort keeps its direction. Without it the effort is assumed to reverse anywhere.
    The damping of a sum depends on the place: it has `damps_by_place`, and its `damping` is the largest.
    """

    @property
    def damping(self) -> float:
        """Coefficient of the damper in parallel with the storage [N*s/m or N*m*s/rad], >= 0."""

    @property
    def linear_stiffness(self) -> float | None:
        """Stiffness k if the stored energy is k x^2 / 2 [N/m or N*m/rad]; None for any other storage.

        A number lets the algorithms use the closed solution of eq. 16, None the safeguarded solve of eq. 8.
        """

    @property
    def relaxes(self) -> bool:
        """Whether `relaxed` may change a state."""

    def contact(self, position: float) -> int:
        """Return 0 out of contact, else the number of the zone of contact at a position [m or rad] (eq. 12).

        Moving from one zone to another is an exit and a start at once: the states of two zones are not comparable.
        """

    def true_state(self, position: float, displacement: float, previous: float) -> float:
        """Return the state [m or rad] of the continuous environment, in contact (x = q - q_w of eq. 14).

        Args:
            position: Axis position [m or rad].
            displacement: Motion during the hold that ended here [m or rad].
            previous: The true state before that hold in the same zone, 0 when the zone was entered in it. Only
                environments that are not fixed in space use it.
        """

    def admissible(self, state: float, true: float) -> float:
        """Return the state [m or rad], or the nearest one that is possible in the contact zone of the state `true`.

        A wall does not pull: it replaces a state outside its surface by 0. An environment without a surface changes
        nothing.
        """

    def stored_energy(self, state: float) -> float:
        """Return the energy [J] stored at a state, >= 0, and 0 at state 0."""

    def effort(self, state: float) -> float:
        """Return the gradient of the stored energy at a state [N or N*m]."""

    def state_of_energy(self, energy: float, like: float) -> float:
        """Return the state [m or rad] that stores `energy` [J], on the same side of state 0 as the state `like`.

        If none stores that much: the state that comes nearest. A periodic storage stays on the flank of `like`.
        """

    def relaxed(self, state: float, sample_time: float) -> float:
        """Return the state after one hold of internal relaxation or yield, which never stores more energy.

        The energy lost is dissipated, not leaked. Without `relaxes` the state does not change.
        """

    def damping_at(self, state: float) -> float:
        """Return the damping coefficient that acts at a state, in contact [N*s/m or N*m*s/rad]."""


def same_anywhere(environment: Any, state: float) -> float:
    """Return the damping [N*s/m or N*m*s/rad]: `damping_at` of an environment whose damper is the same anywhere."""
    damping: float = environment.damping
    return damping


def nowhere(_environment: object, position: float) -> tuple[float, float]:
    """Return an empty interval [m or rad]: `one_way` of an environment whose effort may reverse at any position."""
    return position, position


def outside_of(environment: Environment) -> float:
    """Return the direction out of an environment, 1 or -1; 0 if it has none or several, or if its surface may move."""
    side = {"below": 1.0, "above": -1.0}.get(getattr(environment, "side", ""), 0.0)
    return side if is_ours(environment, "contact", "true_state") else 0.0


def knows_turns(environment: Environment) -> bool:
    """Return whether an environment states reliably, by `one_way`, where the effort of a contact reverses."""
    if not hasattr(environment, "one_way"):
        return False
    return not is_ours(environment, "one_way") or is_ours(environment, "contact", "true_state")


def is_ours(environment: Environment, *methods: str) -> bool:
    """Return whether methods come from this package, whose environments have surfaces fixed in space."""
    ours = __name__.rpartition(".")[0]
    return all(getattr(type(environment), name).__module__.startswith(ours) for name in methods)


_Environment = TypeVar("_Environment")


class _Form(NamedTuple):
    """A parameter model as a plain class: the members that its classes add to `Parameters`."""

    plain: Any  # class with the methods and the values of the class
    derived: Mapping[str, Callable[[Any], Any]]  # properties


def plain(environment: _Environment) -> _Environment:
    """Return a parameter model as a plain object with its methods and numbers, any other object unchanged."""
    kind: Any = type(environment)
    if _form_of(kind) is None or getattr(environment, "__pydantic_private__", None):
        return environment
    return plain_with(kind, vars(environment))  # type: ignore[no-any-return]


def plain_with(kind: Any, fields: Mapping[str, Any]) -> Any:
    """Return a plain object of a model's class with given fields, without validation."""
    form = _form_of(kind)
    if form is None:
        raise TypeError(f"{kind.__name__}: expected a class of parameters")
    twin = form.plain()
    for name, value in fields.items():
        setattr(twin, name, value)
    if getattr(kind, "damps_by_place", False):  # a sum
        twin.parts, twin.notched = tuple(map(plain, twin.parts)), plain(twin.notched)
    for name, derive in form.derived.items():
        setattr(twin, name, derive(twin))
    return twin


@cache
def _form_of(kind: Any) -> _Form | None:
    """Return the plain form of a model's class; None if it would behave differently."""
    if not issubclass(kind, Parameters):
        return None
    members: dict[str, Any] = {}
    for base in reversed(kind.__mro__):
        if not issubclass(Parameters, base):
            own = {name: value for name, value in vars(base).items() if _is_own(name, value)}
            if any(_names_its_class(value) for value in own.values()):
                return None  # `super()` works in the class alone that it was written in
            members |= own
    if "contact" in members:
        members.setdefault("one_way", nowhere)
        members.setdefault("damping_at", same_anywhere)
    derived = {name: value.fget for name, value in members.items() if isinstance(value, property) and value.fget}
    kept = {name: value for name, value in members.items() if not isinstance(value, property)}
    attributes = {**kept, "__doc__": kind.__doc__, "__module__": kind.__module__}
    return _Form(type(kind.__name__, (), attributes), derived)


def _is_own(name: str, value: object) -> bool:
    is_of_pydantic = type(value).__module__.startswith("pydantic")
    return not (name.startswith("__") or hasattr(Parameters, name) or is_of_pydantic)


def _names_its_class(value: object) -> bool:
    if isinstance(value, property):
        return any(map(_names_its_class, (value.fget, value.fset, value.fdel)))
    return isinstance(value, FunctionType) and "__class__" in value.__code__.co_freevars


Side = Literal["below", "above"]
"""Where a wall is solid: below its position (q < q_w, eq. 12) or above it."""


class Everywhere:
    """Common part of environments that act at every position and never relax; their state follows the axis."""

    relaxes: ClassVar[bool] = False

    def contact(self, position: float) -> int:
        """Return 1: every position is in contact."""
        return 1

    def true_state(self, position: float, displacement: float, previous: float) -> float:
        """Return the displacement since the first position [m or rad], before any relaxation."""
        return previous + displacement

    def admissible(self, state: float, true: float) -> float:
        """Return the state: there is no surface."""
        return state

    def relaxed(self, state: float, sample_time: float) -> float:
        """Return the state: nothing relaxes."""
        return state

    damping_at = same_anywhere


class StoresNothing(Everywhere):
    """Common part of environments without a storage."""

    def stored_energy(self, state: float) -> float:
        """Return 0 J."""
        return 0.0

    def effort(self, state: float) -> float:
        """Return 0 N."""
        return 0.0

    def state_of_energy(self, energy: float, like: float) -> float:
        """Return 0 J: no state stores energy."""
        return 0.0

    def rests(self) -> tuple[float, float]:
        """Return every position: nothing is stored anywhere."""
        return -inf, inf


def kept_on_side(state: float, true: float) -> float:
    """Return the rendered state [m or rad], or 0 if the surface lies between it and the true state."""
    return state if state * true >= 0.0 else 0.0


class OneSided(Everywhere, Parameters):
    """Common part of walls: solid on one `side` of a `position`."""

    position: Annotated[float, quantity("m", "rad")] = 0.0
    """Position of the surface."""
    side: Side = "below"
    """Where the wall is solid: below its position, or above it."""

    @property
    def is_below(self) -> bool:
        """Whether the wall is solid below its position."""
        return self.side == "below"

    def contact(self, position: float) -> int:
        """Return 1 inside the wall, 0 outside (eq. 12)."""
        if self.is_below:
            return 1 if position < self.position else 0
        return 1 if position > self.position else 0

    def true_state(self, position: float, displacement: float, previous: float) -> float:
        """Return x = q - q_w [m or rad] (eq. 14): negative in a wall below, positive in a wall above."""
        return position - self.position

    def admissible(self, state: float, true: float) -> float:
        """Return the state, or 0 if it lies outside the wall."""
        return state if state * true >= 0.0 else 0.0

    def rests(self) -> tuple[float, float]:
        """Return the positions at which nothing is stored, from and to [m or rad]."""
        return (self.position, inf) if self.is_below else (-inf, self.position)


class LinearSpring(Everywhere, Parameters):
    """A spring with the stored energy k x^2 / 2, and a damper in parallel."""

    stiffness: Annotated[float, quantity("N/m", "N*m/rad", ge=0.0, le=1e9)]
    """Stiffness of the spring."""
    damping: Annotated[float, quantity("N*s/m", "N*m*s/rad", ge=0.0, le=1e7)] = 0.0
    """Coefficient of the damper in parallel with the spring; it acts in contact only."""

    @property
    def linear_stiffness(self) -> float:
        """Stiffness k [N/m or N*m/rad]."""
        return self.stiffness

    def stored_energy(self, state: float) -> float:
        """Return k x^2 / 2 [J]."""
        return 0.5 * self.stiffness * state * state

    def effort(self, state: float) -> float:
        """Return k x [N or N*m]."""
        return self.stiffness * state

    def state_of_energy(self, energy: float, like: float) -> float:
        """Return the state that stores H: sqrt(2 H / k) with the sign of `like` (eq. 18 prints only the positive)."""
        if self.stiffness == 0.0:
            return 0.0
        return copysign(sqrt(2.0 * energy / self.stiffness) if energy > 0.0 else 0.0, like)
