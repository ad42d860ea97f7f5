"""What a real rig does to the proof of an ideal hold, each with and without the declaration that mends it.

Eleven ways on which certified torques gave out energy before the hold was declared as it is.
"""

from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np

from canhaptic.control.environments.detents import Detents
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.environments.two_sided_wall import TwoSidedWall
from canhaptic.control.passivity import LoopProperties
from canhaptic.control.passivity.guarded import GuardedParameters
from tools.attack.climb import Attack
from tools.attack.plant import Hand, Rig
from tools.chance import EXACT, Chance


class Hole(NamedTuple):
    """One way out, at one loop."""

    name: str
    what: str
    rig: Rig
    wall: dict[str, float]
    hand: Hand
    mend: dict[str, float]  # what is declared in addition to mass, damping and hand force
    wrong: dict[str, float]  # what takes its place without the mend; a key that is not named is left out
    kind: type[Any] = SpringDamperWall


_HAND: Final = Hand(pull=5.0, push=20.0, speed=0.5)
_STIFF: Final = {"stiffness": 2000.0}
_PUSHES: Final = Hand(5.0, 60.0, 0.5)
_SNAP: Final = {"peak": 20.0, "pitch": 0.004}
_SLOT: Final = {"stiffness": 1e4, "lower": 0.0019, "upper": 0.002}
_WIDE: Final = {"stiffness": 1e4, "lower": -0.0005, "upper": 0.0045}
_BRAKES: Final = {"device_friction_bound": 2.0, "device_cogging_bound": 0.0}

HOLES: Final = (
    Hole("A", "limit of 2.5 N, 100 Hz", Rig(0.01, 0.25, 0.1, limit=2.5, delay=1), _STIFF, Hand(20.0, 20.0, 0.5),
         {"torque_limit": 2.5}, {}),
    Hole("A", "limit of 1 N, 40 Hz", Rig(0.025, 0.25, 0.1, limit=1.0, delay=1), _STIFF, Hand(20.0, 20.0, 2.0),
         {"torque_limit": 1.0}, {}),
    Hole("A", "rate limit of 50 N/s, 40 Hz", Rig(0.025, 0.25, 0.1, rate_limit=50.0, delay=1), _STIFF, _HAND,
         {"torque_rate_limit": 50.0}, {}),
    Hole("K", "damped wall, pushed, 100 Hz", Rig(0.01, 0.25, 0.1), {"stiffness": 2000.0, "damping": 20.0},
         Hand(0.0, 60.0, 0.5), {"hand_push": 60.0}, {"hand_push": 0.0}),
    Hole("K", "the same one sample late", Rig(0.01, 0.25, 0.1, delay=1), {"stiffness": 2000.0, "damping": 20.0},
         Hand(0.0, 60.0, 0.5), {"hand_push": 60.0}, {"hand_push": 0.0}),
    Hole("C", "jitter of 2 %, 100 Hz", Rig(0.01, 0.25, 0.1, jitter=0.02), _STIFF, _HAND, {"sync_jitter": 0.02}, {}),
    Hole("C", "jitter of 10 %, 100 Hz", Rig(0.01, 0.25, 0.1, jitter=0.1), _STIFF, _HAND, {"sync_jitter": 0.1}, {}),
    Hole("D", "torque 0.1 T late, 100 Hz", Rig(0.01, 0.25, 0.1, window=1e-3), {"stiffness": 1000.0}, _HAND,
         {"torque_window": 1e-3}, {}),
    Hole("D", "torque 0.3 T late, 100 Hz", Rig(0.01, 0.25, 0.1, window=3e-3), {"stiffness": 1000.0}, _HAND,
         {"torque_window": 3e-3}, {}),
    Hole("F", "current loop of 50 us, 1 kHz", Rig(1e-3, 0.25, 0.1, lag=5e-5), {"stiffness": 1e4}, _HAND,
         {"current_lag": 5e-5}, {}),
    Hole("F", "current loop of 300 us, 1 kHz", Rig(1e-3, 0.25, 0.1, lag=3e-4), {"stiffness": 1e4}, _HAND,
         {"current_lag": 3e-4}, {}),
    Hole("U", "damping of 2 N s/m, 100 Hz", Rig(0.01, 0.25, 2.0), _STIFF, _HAND, {"device_damping_bound": 2.0},
         {"device_damping_bound": 0.0}),
    Hole("B", "dry friction of 2 N, 100 Hz", Rig(0.01, 0.25, 0.1, friction=2.0), _STIFF, _HAND,
         {"device_friction_bound": 2.0}, {}),
    Hole("O", "current that overshoots by half for 0.3 T, 100 Hz", Rig(0.01, 0.25, 0.1, window=3e-3, overshoot=0.5),
         _STIFF, _HAND, {"torque_window": 3e-3}, {}),
    Hole("S", "dry friction of 2 N that springs back, 100 Hz", Rig(0.01, 0.25, 0.1, friction=2.0, bristles=500.0),
         {"stiffness": 1000.0}, Hand(0.0, 20.0, 0.5), {**_BRAKES, "presliding_stiffness": 500.0},
         {**_BRAKES, "presliding_stiffness": 1e9}),
    Hole("S", "the same by Dahl, one sample late",
         Rig(0.01, 0.25, 0.1, friction=2.0, delay=1, bristles=500.0, creeps=True), {"stiffness": 300.0},
         Hand(0.0, 20.0, 0.5), {**_BRAKES, "presliding_stiffness": 500.0}, {**_BRAKES, "presliding_stiffness": 1e9}),
    Hole("G", "rotor of 0.1 kg on a shaft, 100 Hz",
         Rig(0.01, 0.1, 0.1, load=0.126, shaft_stiffness=5000.0, shaft_damping=1.0), {"stiffness": 200.0}, _HAND,
         {"hand_force": 100.0}, {"moving_mass": 0.226}),  # the torque of the shaft is the hand of the rotor
    Hole("T", "detents, 1 kHz", Rig(1e-3, 0.25, 0.1, turns=True), _SNAP, _PUSHES, {"hand_push": 60.0}, {}, Detents),
    Hole("T", "the same one sample late", Rig(1e-3, 0.25, 0.1, delay=1, turns=True), _SNAP, _PUSHES,
         {"hand_push": 60.0}, {}, Detents),
    Hole("T", "detents, late torques, 100 Hz", Rig(0.01, 0.25, 0.1, lag=1e-3, window=1e-3, turns=True), _SNAP, _PUSHES,
         {"hand_push": 60.0, "current_lag": 1e-3, "torque_window": 1e-3}, {}, Detents),
    Hole("T", "slot of 0.1 mm, 100 Hz", Rig(0.01, 0.25, 0.1, turns=True), _SLOT, _PUSHES, {"hand_push": 60.0}, {},
         TwoSidedWall),
    Hole("T", "slot of 5 mm one sample late, 100 Hz", Rig(0.01, 0.25, 0.1, delay=1, turns=True), _WIDE, _PUSHES,
         {"hand_push": 60.0}, {}, TwoSidedWall),
)  # fmt: skip


def attack_on(hole: Hole, *, mended: bool) -> Attack:
    """Returns the attack on a loop that declares the mend of a hole, or does not."""
    rig, declared = hole.rig, {**(hole.mend if mended else hole.wrong)}
    loop: dict[str, Any] = {
        "sample_time": rig.sample_time, "delay": rig.delay, "moving_mass": rig.mass, "device_damping_bound": rig.damping
    }  # fmt: skip
    of_algorithm: dict[str, Any] = {"hand_force": hole.hand.pull}
    for key, value in declared.items():
        if key in LoopProperties.model_fields:
            loop[key] = value
        elif key in GuardedParameters.model_fields:
            of_algorithm[key] = value  # hand force that is declared too, for a shaft
    wall = hole.kind(**({"position": 0.0} if hole.kind is SpringDamperWall else {}), **hole.wall)
    attack = Attack(rig, wall, LoopProperties(**loop), GuardedParameters(**of_algorithm), hole.hand)
    if rig.turns and not mended:
        attack.ignore_turns()
    return attack


def random_attack(seed: int) -> Attack:
    """Returns an attack on a loop of which everything is declared as it is."""
    chance = Chance(seed, 9)
    one_of, decades = chance.one_of, partial(chance.decades, digits=EXACT)
    time, jitter = one_of((1e-3, 2e-3, 4e-3, 0.01, 0.025)), one_of((0.0, 0.02, 0.1))
    window, lag = one_of((0.0, 0.0, 0.1, 0.3)) * time, one_of((0.0, 0.0, 0.05, 0.3)) * time
    friction, mass, damping = one_of((0.0, 0.0, 0.5, 2.0)), decades(0.05, 2.0), decades(0.01, 3.0)
    delay, limit = int(chance.generator.integers(2)), one_of((1.0, 5.0, 1e6))
    rig = Rig(time, mass, damping, friction, lag, window, jitter, delay=delay, limit=limit)
    hand = Hand(one_of((0.0, 0.5, 2.0, 5.0, 20.0)), one_of((5.0, 20.0, 60.0)), 1.0)
    device = damping * one_of((0.0, 0.5, 1.0)) or None, friction * one_of((0.0, 0.5, 1.0)) or None
    rig, brakes = _that_brakes(seed, rig)
    if rig.bristles:
        device = device[0], None  # what they give back no path dissipates
    loop = LoopProperties(
        sync_jitter=jitter, torque_window=window, current_lag=lag, device_friction_bound=friction,
        device_damping=device[0], device_friction=device[1], sample_time=time, delay=delay, torque_limit=limit,
        moving_mass=mass * one_of((0.6, 1.0)), device_damping_bound=damping * one_of((1.0, 3.0)),
        encoder_count=one_of((0.0, 1e-6, 2e-5)), **brakes,
    )  # fmt: skip
    more = {"hand_push": hand.push} if chance.drawn(0.5) else {}
    wall: Any = SpringDamperWall(stiffness=decades(50.0, 5e4), damping=one_of((0.0, 5.0, 20.0)), position=0.0)
    if (turning := _that_turns(seed, wall.damping)) is not None:
        wall, rig, more = turning, rig._replace(turns=True), {"hand_push": max(hand.push, hand.pull)}
    if chance.drawn(0.5):
        more |= {"earned_energy": decades(1e-4, 0.1), "drag": one_of((0.0, 0.1, 1.0))}
    if chance.drawn(0.25) and any(device):
        return Attack(rig, wall, loop, GuardedParameters(**{**more, "hand_force": None}), hand._replace(pull=60.0))
    return Attack(rig, wall, loop, GuardedParameters(hand_force=hand.pull, **more), hand)


def _that_brakes(seed: int, rig: Rig) -> tuple[Rig, dict[str, float]]:
    """Returns a rig whose friction gives way for two seeds in three, and what is declared of it; see `_that_turns`."""
    chance = Chance(seed, 37)
    kind, stiffness = int(chance.generator.integers(3)), chance.decades(3.0, 1000.0) * rig.mass / rig.sample_time**2
    if not rig.friction:
        return rig, {}
    declared = {
        "device_cogging_bound": chance.one_of((0.0, 0.0, 0.3)) * rig.friction,
        "presliding_stiffness": chance.one_of((0.7, 1.0)) * stiffness,  # of rigid ones any is an under-estimate
    }
    return (rig._replace(bristles=stiffness, creeps=kind == 2) if kind else rig), declared


def _that_turns(seed: int, damping: float) -> Any:
    """Returns detents or a slot for one seed in four, from a generator of its own: the others keep their loops."""
    random = np.random.default_rng([seed, 16])
    kind, size, stiffness = random.integers(8), 10.0 ** random.uniform(-4.0, -2.0), 10.0 ** random.uniform(2.0, 4.7)
    if kind == 0:
        return Detents(peak=0.2 * stiffness * float(size), pitch=max(1e-3, float(size)), damping=damping)
    low = 0.004 * float(random.random())
    return TwoSidedWall(stiffness=stiffness, damping=damping, lower=low, upper=low + float(size)) if kind == 1 else None
