"""`internal_dissipation`: the paper's algorithm, whose state change balances stored and dissipated energy (eq. 8).

Flow of one step (Fig. 6): out of contact the axis is free, or a contact has just ended. In contact without stored
energy the axis is deadlocked (no torque) until a first-order start (eq. 14). Otherwise the exact solution (eqs. 15-17)
is used, or the approximate one (eq. 18) if there is none. Surplus energy is recovered by the modulated damper (eq. 19).

Departures from the printed equations, and their reasons:

- eq. 18 takes the state on the side of the contact; the printed sign is positive, but contact has x < 0.
- eq. 16 is solved for the root nearest zero: the printed one or, when sticking, the other (below).
- eq. 15 uses the damper effort inside the torque that was applied in the hold. Without delay this is the printed
  effort; with delay the printed one is unstable.
- a motion that reverses would make H_R of eq. 15 negative, a damper that generates energy: the balance is then solved
  without H_R.
- eq. 14 takes the velocity from the displacement, and starts only when the user pushes inward: switched on deep inside
  a wall, x / T is not a velocity. A store emptied in contact is the same deadlock and restarts in the same way.
- the state never crosses to the other side of the contact, because a wall does not pull.
- the hold in which the contact ends, and those whose torque was still queued, are booked; the rest is leaked.

Kept as printed: every start creates k x^2 / 2, and the state creeps away from the true penetration under tremor.

`a_priori_dissipation` shares this step, but has its own `touch` and `exchange`. Such a function changes the state of
the storage for one hold, and returns the energies of the hold.

**Solution of eq. 8** for the state change: closed for a linear spring, iterative in a bracket for any other. Eq. 16
prints dx = (-b - sqrt(b^2 - 4 a c)) / 2 a. That loses all digits if k or the displacement is small, divides by zero at
k = 0, and needs the other sign for the sticky rule. The root nearest zero in the form

    dx = 2 H / (b + sgn(b) sqrt(b^2 + 2 k H)),    b = k x + f_d,    H = energy received

has none of these faults and covers the sticky rule. Near the double root the discriminant cancels, so it is formed from
exact products (Dekker 1971) and an exact sum.
"""

from dataclasses import dataclass, field
from math import copysign, isnan, nan, sqrt
from typing import Annotated, Any, Final, NamedTuple, TypeAlias

from canhaptic.control.balance import AT_REST, Branch, Certificate, EnergyBalance
from canhaptic.control.damping import Alpha, DamperVelocity, damping_cap, modulated_damping
from canhaptic.control.environments import Environment, plain
from canhaptic.control.passivity import LoopProperties, stepped
from canhaptic.control.passivity.stepped import Hold, HoldAccount, begin, close_hold, open_hold, surplus_after
from canhaptic.kernels import OFTEN_ZERO, Kernel, Run, new

_SPLITTER: Final = 134217729.0  # 2^27 + 1 (Veltkamp)
_ITERATIONS: Final = 80  # bisection alone reaches the last bit of any bracket of one binade in 53
_SMALLEST_STEP: Final = 1e-16  # of the root: below half a unit in its last place


def discriminant(effort: float, product: float, energy: float) -> float:
    """Return effort^2 + product * energy, accurate to its last bits although the two terms may cancel."""
    square = effort * effort
    other = product * energy
    total = square + other
    if total > 0.125 * abs(other):
        return total  # three bits lost at most: no help needed, and this is nearly every hold
    high = _SPLITTER * effort
    high -= high - effort
    low = effort - high
    square_error = ((high * high - square) + 2.0 * high * low) + low * low
    part = total - square
    sum_error = (square - (total - part)) + (other - part)
    return total + (sum_error + (square_error + _product_error(product, energy, other)))


def _product_error(a: float, b: float, product: float) -> float:
    a_high = _SPLITTER * a
    a_high -= a_high - a
    b_high = _SPLITTER * b
    b_high -= b_high - b
    a_low, b_low = a - a_high, b - b_high
    return ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


def solve_balance(stiffness: float, effort: float, energy: float, displacement: float) -> float:
    """Return the state change dx with k dx^2 / 2 + b dx = H, the root nearest zero [m or rad]; NaN if none is real.

    Args:
        stiffness: k >= 0 [N/m or N*m/rad].
        effort: b, the whole effort opposing motion at the old state: k x + f_d [N or N*m].
        energy: H, energy received by the model [J].
        displacement: Measured motion of the hold [m or rad]. Its sign decides between roots equally near zero. It is
            the result if no effort opposes motion and no energy was received (k = b = H = 0).
    """
    if energy == 0.0:
        return displacement if stiffness == 0.0 and effort == 0.0 else 0.0
    if effort == 0.0:
        if stiffness == 0.0 or energy < 0.0:
            return nan
        return copysign(sqrt(2.0 * energy / stiffness), displacement)
    if stiffness == 0.0:
        return energy / effort
    under_root = discriminant(effort, 2.0 * stiffness, energy)
    if under_root < 0.0:
        return nan
    return 2.0 * energy / (effort + copysign(sqrt(under_root), effort))


class Balance(NamedTuple):
    """A nonlinear storage in its old state, and the effort of the damper in parallel: the start of eq. 8."""

    state: float  # old one [m or rad]
    stored: float  # energy there [J]
    damper: float  # effort of the damper [N or N*m]


def gain(environment: Environment, old: Balance, change: float) -> float:
    """Return the energy that storage and damper absorb in a state change [m or rad], stored and dissipated [J]."""
    return environment.stored_energy(old.state + change) - old.stored + old.damper * change


def slope(environment: Environment, old: Balance, change: float) -> float:
    """Return the derivative of `gain` with respect to the state change [N or N*m]."""
    return environment.effort(old.state + change) + old.damper


def solve_balance_nonlinear(
    environment: Environment, old: Balance, energy: float, limit: float, tolerance: float
) -> float:
    """Return the state change dx of a nonlinear storage with gain(dx) = H, the root nearest zero [m or rad], or NaN.

    The direction follows from the signs of H and of the slope at 0. In that direction the root is bracketed by the
    limit, or by the point where the slope reverses. At most 80 Newton steps find it, with bisection if a step leaves
    the bracket or does not halve the error.

    Args:
        environment: Environment with a nonlinear storage.
        old: Previous state.
        energy: H, energy received by the model [J].
        limit: Largest state change to consider [m or rad]; its sign decides if no effort opposes motion at first.
            If more was received than the limit absorbs, the result is the limit, and the caller books the rest as leak.
        tolerance: Rounding error of `gain` [J], at which the iteration ends.
    """
    if energy == 0.0 or limit == 0.0:
        return 0.0 if energy >= 0.0 else nan
    effort = slope(environment, old, 0.0)
    far = copysign(limit, energy * effort) if effort != 0.0 else limit
    if effort != 0.0 and (slope(environment, old, far) > 0.0) != (effort > 0.0):
        far = _turning_point(environment, old, far)
    gained = gain(environment, old, far)
    if abs(gained) < abs(energy) or (gained > 0.0) != (energy > 0.0):
        return far if energy > 0.0 else nan
    return _newton(environment, old, energy, far, tolerance)


def _turning_point(environment: Environment, old: Balance, far: float) -> float:
    """Return the state change, between 0 and `far`, up to which `slope` keeps its sign [m or rad]."""
    near, rising = 0.0, slope(environment, old, 0.0) > 0.0
    for _ in range(_ITERATIONS):
        middle = 0.5 * (near + far)
        if middle in (near, far):
            break
        if (slope(environment, old, middle) > 0.0) == rising:
            near = middle
        else:
            far = middle
    return near


def _newton(environment: Environment, old: Balance, energy: float, far: float, tolerance: float) -> float:
    """Return the root of gain(dx) = H between 0 and `far` [m or rad], where |gain| rises from 0 to at least |H|."""
    effort = slope(environment, old, 0.0)
    near, gain_far = 0.0, gain(environment, old, far)
    guess = energy / effort if effort != 0.0 else far
    step = abs(far)
    for _ in range(_ITERATIONS):
        if not min(near, far) < guess < max(near, far):
            guess = _between(near, far, energy, gain_far)
            step = abs(far - near)
            if guess in (near, far):
                break
        gained = gain(environment, old, guess)
        missing = energy - gained
        if abs(missing) <= tolerance:
            break
        if (missing > 0.0) == (energy > 0.0):
            near = guess
        else:
            far, gain_far = guess, gained
        steep = slope(environment, old, guess)
        halving = abs(2.0 * missing) <= step * abs(steep)
        following = guess + missing / steep if halving else _between(near, far, energy, gain_far)
        step = abs(following - guess)
        if step <= _SMALLEST_STEP * abs(guess):
            break
        guess = following
    return guess


def _between(near: float, far: float, energy: float, gain_far: float) -> float:
    """Return the next estimate of the root [m or rad]: the bracket's middle or, if it begins at 0, a parabola's root.

    Halving alone would take too many steps from a motion of a millimetre to the root of a vanishing energy.
    """
    if near == 0.0 and gain_far != 0.0:
        return far * min(0.5, sqrt(energy / gain_far))
    return 0.5 * (near + far)


_START, _FALLBACK, _DEPLETED = Branch.START.value, Branch.FALLBACK.value, Branch.DEPLETED.value
_EXIT = Branch.EXIT.value
_ROUNDING: Final = 1e-12  # of the energy at hand: below it a rest is rounding, not a leak

UNTOUCHED: Final = HoldAccount(Branch.FREE.value, 0.0, 0.0, 0.0, 0.0)


@dataclass(slots=True)
class Storage:
    """Rendered state of an environment, its velocity and energy, and the state of the continuous environment."""

    zone: int = 0  # of contact, 0 out of contact
    true: float = 0.0  # state of the continuous environment [m or rad]
    state: float = 0.0  # displacement of the storage [m or rad]
    velocity: float = 0.0  # of the state over the last hold [m/s or rad/s]
    h_s: float = 0.0  # energy stored at `state` [J], computed from it


def empty(storage: Storage) -> None:
    """Empty the storage: no energy, no velocity, and so no torque until the user pushes inward (deadlock)."""
    storage.state = storage.velocity = storage.h_s = 0.0


def is_deadlocked(storage: Storage) -> bool:
    """Return whether the storage is empty and its velocity 0, so that it gives no torque."""
    return storage.h_s == 0.0 and storage.velocity == 0.0


def follow(environment: Environment, storage: Storage, position: float, displacement: float, elapsed: float) -> bool:
    """Update contact zone and true state to the end of a hold of `elapsed` [s]; return whether the zone changed."""
    zone = environment.contact(position)
    changed = zone != storage.zone
    storage.zone = zone
    if zone:
        true = environment.true_state(position, displacement, 0.0 if changed else storage.true)
        storage.true = environment.relaxed(true, elapsed) if environment.relaxes else true
    return changed


def pushed_inward(environment: Environment, storage: Storage, displacement: float) -> bool:
    """Return whether the motion [m or rad] is against the environment's torque or, if that is 0, not zero."""
    effort = environment.effort(storage.true)
    return effort * displacement > 0.0 or (effort == 0.0 and displacement != 0.0)


def entered_by(environment: Environment, storage: Storage, displacement: float) -> float:
    """Return the part of a motion that lies inside the contact [m or rad]."""
    return storage.true - environment.admissible(storage.true - displacement, storage.true)


def start(environment: Environment, storage: Storage, change: float, elapsed: float, h_m: float) -> HoldAccount:
    """Start a contact to first order (eq. 14): set the state to the true one, and book the energy missing as created.

    Args:
        environment: The rendered environment.
        storage: Storage; its state is updated.
        change: State change from which the velocity is computed [m or rad].
        elapsed: Time of the hold [s].
        h_m: Energy received in this hold [J].
    """
    storage.velocity = change / elapsed
    available = storage.h_s + h_m
    storage.state = state = storage.true
    storage.h_s = h_s = environment.stored_energy(state)
    return new(HoldAccount, (_START, 0.0, max(0.0, h_s - available), 0.0, max(0.0, available - h_s)))


def move(
    environment: Environment, storage: Storage, change: float, elapsed: float, h_r: float, h_m: float, limited: bool
) -> tuple[float, float]:
    """Apply a state change found by eq. 8; return (h_r including dissipation by relaxation, leak) [J].

    Args:
        environment: The rendered environment.
        storage: Storage; its state is updated.
        change: Change of the state [m or rad].
        elapsed: Time of the hold [s].
        h_r: Energy that the damper dissipates in this change [J].
        h_m: Energy received [J].
        limited: Whether the change may absorb less energy than was received; the remainder is booked as leak.
    """
    before = storage.h_s
    moved = storage.state + change
    state = environment.admissible(moved, storage.true)
    h_s = environment.stored_energy(state)
    storage.velocity = change / elapsed
    leak = rest_of(before + h_m, h_r + h_s) if limited or state != moved else 0.0
    return relax(environment, storage, state, h_s, elapsed, h_r), leak


def approximate(
    environment: Environment, storage: Storage, elapsed: float, dissipation: float, h_m: float
) -> HoldAccount:
    """Dissipate a given energy, as far as it is available, and set the state that stores the rest (eqs. 6, 7, 18).

    Args:
        environment: The rendered environment.
        storage: Storage; its state is updated.
        elapsed: Time of the hold [s].
        dissipation: Energy to dissipate: T d v^2, with d v the damper's part of the applied torque [J].
        h_m: Energy received [J].
    """
    available = storage.h_s + h_m
    if available <= 0.0:
        empty(storage)
        return new(HoldAccount, (_DEPLETED, 0.0, 0.0, -available, 0.0))
    h_r = min(dissipation, available)
    before = storage.state
    state = environment.state_of_energy(available - h_r, before if before != 0.0 else storage.true)
    h_s = environment.stored_energy(state)
    leak = rest_of(available, h_r + h_s)
    storage.velocity = (state - before) / elapsed
    return new(HoldAccount, (_FALLBACK, relax(environment, storage, state, h_s, elapsed, h_r), 0.0, 0.0, leak))


def relax(environment: Environment, storage: Storage, state: float, h_s: float, elapsed: float, h_r: float) -> float:
    """Relax a state over one hold, and store it with its energy; return h_r plus the energy so dissipated [J]."""
    if environment.relaxes:
        strained = h_s
        state = environment.relaxed(state, elapsed)
        h_s = environment.stored_energy(state)
        h_r += strained - h_s
    storage.state, storage.h_s = state, h_s
    return h_r


def rest_of(available: float, used: float) -> float:
    """Return the available energy less the used energy [J]; 0 if that is negative or a rounding error."""
    rest = available - used
    return rest if rest > _ROUNDING * available else 0.0


def leave(storage: Storage, account: HoldAccount) -> HoldAccount:
    """Empty the storage at the end of a contact; return the last hold's account, with the stored energy as leak."""
    _, h_r, gen, deficit, leak = account
    leak += storage.h_s
    empty(storage)
    return new(HoldAccount, (_EXIT, h_r, gen, deficit, leak))


class StoredModelParameters(DamperVelocity):
    """Parameters of an algorithm whose storage has a state of its own: damper velocity, and removal of the surplus."""

    alpha: Alpha = 0.0
    """Modulated damping per joule of surplus (eq. 19), always with its unit; 0: the surplus is not removed."""


@dataclass(frozen=True, slots=True)
class StoredModelSettings:
    """Constants, during a run, of an algorithm whose storage has a state of its own."""

    given: Any  # parameters of the algorithm; a kernel reads their numbers alone
    cap: float  # of the damping [N*s/m or N*m*s/rad]
    damping: float  # of the model [N*s/m or N*m*s/rad]
    is_linear: bool  # whether the storage is k x^2 / 2
    stiffness: float  # k, where it is [N/m or N*m/rad]
    hold: stepped.HoldSettings
    by_place: Annotated[bool, OFTEN_ZERO] = False  # whether it is a sum, whose damping depends on the place


@dataclass(slots=True)
class StoredModelState:
    """State, from SYNC to SYNC, of an algorithm whose storage has a state of its own; an algorithm adds its fields."""

    axis: stepped.Axis = field(default_factory=stepped.Axis)
    storage: Storage = field(default_factory=Storage)


StoredModelRun: TypeAlias = Run[StoredModelSettings, Any, stepped.HoldMemory]
"""Settings, state and memory of an algorithm."""


def stored_model_settings(
    environment: Environment, parameters: StoredModelParameters, loop: LoopProperties
) -> StoredModelSettings:
    """Return the constants of an algorithm whose storage has a state of its own.

    Raises:
        ParameterError: `velocity` is `windowed`, but the encoder count is not declared.
    """
    cap = damping_cap(loop.delay, loop.moving_mass, loop.sample_time)
    stiffness = environment.linear_stiffness
    return StoredModelSettings(
        given=plain(parameters),
        cap=cap,
        damping=min(environment.damping, cap),
        is_linear=stiffness is not None,
        stiffness=stiffness or 0.0,
        hold=stepped.hold_settings(parameters, loop, Certificate.NONE),
        by_place=getattr(environment, "damps_by_place", False),
    )


def damping_of(environment: Environment, settings: StoredModelSettings, storage: Storage) -> float:
    """Return the damping of the model where the axis is [N*s/m or N*m*s/rad]."""
    if settings.by_place:
        return min(settings.damping, environment.damping_at(storage.true))
    return settings.damping


def dissipation(damping: float, hold: Hold) -> float:
    """Return the damper's dissipation in a hold, T d v^2, with d v its effort inside the torque [J] (eqs. 6, 18)."""
    return hold.elapsed * (hold.damper * hold.damper) / damping if damping != 0.0 else 0.0


def step(environment: Environment, run: StoredModelRun, position: float, torque_applied: float) -> EnergyBalance:
    """Book the hold that ended, and compute the next torque; see `Controller.step`."""
    settings, state, memory = run.settings, run.state, run.memory.axis
    axis, storage = state.axis, state.storage
    if not axis.started:
        begin(axis, memory, position)
        storage.zone = zone = environment.contact(position)  # a deadlock, as the user has not pushed in
        storage.true = environment.true_state(position, 0.0, 0.0) if zone else 0.0
        return AT_REST
    hold = open_hold(settings.hold, axis, memory, position, torque_applied)
    changed = follow(environment, storage, position, hold.displacement, hold.elapsed)
    if storage.zone:
        account = touch(environment, settings, state, hold, changed)
    elif changed or hold.h_i != 0.0:
        account = leave(storage, exchange(environment, settings, storage, hold))
    else:
        account = UNTOUCHED
    return close(environment, run, hold, account)


def close(environment: Environment, run: StoredModelRun, hold: Hold, account: HoldAccount) -> EnergyBalance:
    """Queue a command of spring, damper and modulated damper (eq. 19), and return the balance of the hold that ended.

    Args:
        environment: The rendered environment.
        run: Run of the algorithm; its storage is already updated to the end of the hold.
        hold: The hold that ended, from `open_hold`.
        account: Energies of the hold as the algorithm booked them.
    """
    settings, storage = run.settings, run.state.storage
    state, h_s = storage.state, storage.h_s
    if not storage.zone:
        return close_hold(run, hold, account, (0.0, 0.0, 0.0), 0.0, state, h_s)
    measured = settings.hold.tolerance > 0.0
    if measured and is_deadlocked(storage):  # an environment that stores nothing is never deadlocked
        measured = settings.is_linear and settings.stiffness == 0.0
    rendered, modulated = damping_of(environment, settings, storage), 0.0
    damper = rendered * (hold.velocity if measured else storage.velocity)
    if settings.given.alpha > 0.0:
        surplus = surplus_after(run.state.axis, hold, account)[0]
        extra = modulated_damping(
            settings.given.alpha, surplus, rendered, settings.cap, hold.displacement, hold.elapsed
        )
        modulated = extra * hold.displacement / hold.elapsed
        rendered += extra
    efforts = environment.effort(state), damper, modulated
    return close_hold(run, hold, account, efforts, rendered, state, h_s)


_RESOLVED: Final = 2.5e-16  # of the stored energy: what a difference of two energies can resolve
_EXACT, _STICKY = Branch.EXACT.value, Branch.STICKY.value


@dataclass(slots=True)
class InternalDissipationState(StoredModelState):
    """State of `internal_dissipation`, kept from SYNC to SYNC."""

    blind: int = 0  # holds until the first torque after a start is felt


def touch(
    environment: Environment, settings: StoredModelSettings, state: InternalDissipationState, hold: Hold, entered: bool
) -> HoldAccount:
    """Update the storage after a hold that ended in contact; return the energies of the hold.

    After a start no torque acts until `delay` more holds have ended. Until then no energy can be exchanged, and the
    first-order approximation continues.
    """
    storage, displacement = state.storage, hold.displacement
    fresh = entered or is_deadlocked(storage)
    if fresh or state.blind:
        if entered or pushed_inward(environment, storage, displacement):
            state.blind = settings.hold.delay if fresh else state.blind - 1
            change = entered_by(environment, storage, displacement)
            return start(environment, storage, change, hold.elapsed, hold.h_i - hold.h_pas)
        state.blind = 0
    return exchange(environment, settings, storage, hold)


def exchange(environment: Environment, settings: StoredModelSettings, storage: Storage, hold: Hold) -> HoldAccount:
    """Update the state by the solution of eq. 8, or by eq. 18 if there is none; return the energies of the hold."""
    damper, h_m = hold.damper, hold.h_i - hold.h_pas
    change = solve(environment, settings, storage, hold.displacement, damper, h_m)
    if damper * change < 0.0:
        damper = 0.0
        change = solve(environment, settings, storage, hold.displacement, 0.0, h_m)
    if isnan(change):
        lost = dissipation(damping_of(environment, settings, storage), hold)
        return approximate(environment, storage, hold.elapsed, lost, h_m)
    furthest = 2.0 * abs(hold.displacement)
    limited = h_m > 0.0 and (abs(change) > furthest or not settings.is_linear)
    if limited and abs(change) > furthest:
        change = copysign(furthest, change)
    branch = _STICKY if h_m > 0.0 and change * storage.state < 0.0 else _EXACT
    h_r, leak = move(environment, storage, change, hold.elapsed, damper * change, h_m, limited)
    return new(HoldAccount, (branch, h_r, 0.0, 0.0, leak))


def solve(
    environment: Environment, settings: StoredModelSettings, storage: Storage, displacement: float, damper: float,
    h_m: float,
) -> float:  # fmt: skip
    """Return the state change that solves eq. 8 [m or rad]; NaN if there is no real solution (eq. 17)."""
    if settings.is_linear:
        stiffness = settings.stiffness
        return solve_balance(stiffness, stiffness * storage.state + damper, h_m, displacement)
    old = Balance(storage.state, storage.h_s, damper)
    return solve_balance_nonlinear(environment, old, h_m, 2.0 * displacement, _RESOLVED * storage.h_s)


class InternalDissipation(stepped.SteppedController):
    """The paper's algorithm for one axis."""

    parameters_type = StoredModelParameters
    kernel = Kernel(stored_model_settings, InternalDissipationState, stepped.hold_memory, step)
