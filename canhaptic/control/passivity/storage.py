"""The storage of `a_priori_dissipation` and `internal_dissipation`: its state never holds energy that was not received.

What the two share is here: following the contact, the first-order start (eq. 14), the approximate step (eqs. 6, 7, 18)
and the exit. Each rule moves the storage and returns its account of the hold.
"""

from dataclasses import dataclass
from typing import Final

from canhaptic.control.balance import Branch
from canhaptic.control.environments.environment import Environment
from canhaptic.control.passivity.hold_account import HoldAccount
from canhaptic.kernels import new

_START, _FALLBACK, _DEPLETED = Branch.START.value, Branch.FALLBACK.value, Branch.DEPLETED.value
_EXIT = Branch.EXIT.value
_ROUNDING: Final = 1e-12  # of the energy at hand: below it a rest is rounding, not a leak

UNTOUCHED: Final = HoldAccount(Branch.FREE.value, 0.0, 0.0, 0.0, 0.0)


@dataclass(slots=True)
class Storage:
    """State, velocity and stored energy of one environment, and where the continuous environment would be."""

    zone: int = 0  # of contact, 0 out of contact
    true: float = 0.0  # state of the continuous environment [m or rad]
    state: float = 0.0  # displacement of the storage [m or rad]
    velocity: float = 0.0  # of the state over the last hold [m/s or rad/s]
    h_s: float = 0.0  # energy stored at `state` [J], computed from it


def empty(storage: Storage) -> None:
    """The deadlock: nothing stored, no velocity, no torque until the user pushes inward."""
    storage.state = storage.velocity = storage.h_s = 0.0


def is_deadlocked(storage: Storage) -> bool:
    """Return whether the storage is empty and at rest, so that it gives no torque."""
    return storage.h_s == 0.0 and storage.velocity == 0.0


def begin_storage(environment: Environment, storage: Storage, position: float) -> None:
    """Take the first position; in contact there it is a deadlock, for the user has not pushed in."""
    empty(storage)
    storage.zone = zone = environment.contact(position)
    storage.true = environment.true_state(position, 0.0, 0.0) if zone else 0.0


def follow(environment: Environment, storage: Storage, position: float, displacement: float, elapsed: float) -> bool:
    """Follow the contact over a hold of given time [s]; return True when a zone was entered or left in it."""
    zone = environment.contact(position)
    changed = zone != storage.zone
    storage.zone = zone
    if zone:
        true = environment.true_state(position, displacement, 0.0 if changed else storage.true)
        storage.true = environment.relaxed(true, elapsed) if environment.relaxes else true
    return changed


def pushed_inward(environment: Environment, storage: Storage, displacement: float) -> bool:
    """Return True when the motion [m or rad] stores energy, or when there is nothing to store it in."""
    effort = environment.effort(storage.true)
    return effort * displacement > 0.0 or (effort == 0.0 and displacement != 0.0)


def entered_by(environment: Environment, storage: Storage, displacement: float) -> float:
    """Part of a motion [m or rad] inside the contact."""
    return storage.true - environment.admissible(storage.true - displacement, storage.true)


def start(environment: Environment, storage: Storage, change: float, elapsed: float, h_m: float) -> HoldAccount:
    """First-order start (eq. 14): the state is the true one, and the energy for it is created.

    Args:
        environment: The environment rendered.
        storage: Moved.
        change: State change from which the velocity is taken [m or rad].
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
    """Take a state change found by eq. 8; return (h_r with what relaxation dissipates, leak) [J].

    Args:
        environment: The environment rendered.
        storage: Moved.
        change: Change of the state [m or rad].
        elapsed: Time of the hold [s].
        h_r: Energy dissipated with it [J].
        h_m: Energy received [J].
        limited: True when the change takes up less than was received; the remainder leaks.
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
    """Dissipate a given energy, as far as it is there, and take the state of what remains (eqs. 6, 7, 18).

    Args:
        environment: The environment rendered.
        storage: Moved.
        elapsed: Time of the hold [s].
        dissipation: T d v^2 with the velocity inside the torque of this hold [J].
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
    """Take a state and its energy after one hold of relaxation; return h_r with what that dissipated [J]."""
    if environment.relaxes:
        strained = h_s
        state = environment.relaxed(state, elapsed)
        h_s = environment.stored_energy(state)
        h_r += strained - h_s
    storage.state, storage.h_s = state, h_s
    return h_r


def rest_of(available: float, used: float) -> float:
    """Remainder of an energy [J]; rounding errors count as 0."""
    rest = available - used
    return rest if rest > _ROUNDING * available else 0.0


def leave(storage: Storage, account: HoldAccount) -> HoldAccount:
    """Turn the account of the last hold of a contact into that of an exit: everything left is leaked."""
    _, h_r, gen, deficit, leak = account
    leak += storage.h_s
    empty(storage)
    return new(HoldAccount, (_EXIT, h_r, gen, deficit, leak))
