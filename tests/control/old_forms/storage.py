from dataclasses import dataclass
from typing import Final

from canhaptic.control.balance import Branch
from canhaptic.control.environments.environment import Environment
from canhaptic.kernels import new
from tests.control.old_forms.hold_account import HoldAccount

_START, _FALLBACK, _DEPLETED = (Branch.START.value, Branch.FALLBACK.value, Branch.DEPLETED.value)
_EXIT = Branch.EXIT.value
_ROUNDING: Final = 1e-12
UNTOUCHED: Final = HoldAccount(Branch.FREE.value, 0.0, 0.0, 0.0, 0.0)


@dataclass(slots=True)
class Storage:
    zone: int = 0
    true: float = 0.0
    state: float = 0.0
    velocity: float = 0.0
    h_s: float = 0.0


def empty(storage: Storage) -> None:
    storage.state = storage.velocity = storage.h_s = 0.0


def is_deadlocked(storage: Storage) -> bool:
    return storage.h_s == 0.0 and storage.velocity == 0.0


def begin_storage(environment: Environment, storage: Storage, position: float) -> None:
    empty(storage)
    storage.zone = zone = environment.contact(position)
    storage.true = environment.true_state(position, 0.0, 0.0) if zone else 0.0


def follow(environment: Environment, storage: Storage, position: float, displacement: float, elapsed: float) -> bool:
    zone = environment.contact(position)
    changed = zone != storage.zone
    storage.zone = zone
    if zone:
        true = environment.true_state(position, displacement, 0.0 if changed else storage.true)
        storage.true = environment.relaxed(true, elapsed) if environment.relaxes else true
    return changed


def pushed_inward(environment: Environment, storage: Storage, displacement: float) -> bool:
    effort = environment.effort(storage.true)
    return effort * displacement > 0.0 or (effort == 0.0 and displacement != 0.0)


def entered_by(environment: Environment, storage: Storage, displacement: float) -> float:
    return storage.true - environment.admissible(storage.true - displacement, storage.true)


def start(environment: Environment, storage: Storage, change: float, elapsed: float, h_m: float) -> HoldAccount:
    storage.velocity = change / elapsed
    available = storage.h_s + h_m
    storage.state = state = storage.true
    storage.h_s = h_s = environment.stored_energy(state)
    return new(HoldAccount, (_START, 0.0, max(0.0, h_s - available), 0.0, max(0.0, available - h_s)))


def move(
    environment: Environment, storage: Storage, change: float, elapsed: float, h_r: float, h_m: float, limited: bool
) -> tuple[float, float]:
    before = storage.h_s
    moved = storage.state + change
    state = environment.admissible(moved, storage.true)
    h_s = environment.stored_energy(state)
    storage.velocity = change / elapsed
    leak = rest_of(before + h_m, h_r + h_s) if limited or state != moved else 0.0
    return (relax(environment, storage, state, h_s, elapsed, h_r), leak)


def approximate(
    environment: Environment, storage: Storage, elapsed: float, dissipation: float, h_m: float
) -> HoldAccount:
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
    if environment.relaxes:
        strained = h_s
        state = environment.relaxed(state, elapsed)
        h_s = environment.stored_energy(state)
        h_r += strained - h_s
    storage.state, storage.h_s = (state, h_s)
    return h_r


def rest_of(available: float, used: float) -> float:
    rest = available - used
    return rest if rest > _ROUNDING * available else 0.0


def leave(storage: Storage, account: HoldAccount) -> HoldAccount:
    _, h_r, gen, deficit, leak = account
    leak += storage.h_s
    empty(storage)
    return new(HoldAccount, (_EXIT, h_r, gen, deficit, leak))
