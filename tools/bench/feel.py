"""What does a hand feel of a wall? `python -m tools.bench.feel [ALGORITHM ...]`: every algorithm, or some.

One plant (0.25 kg, 0.5 N*s/m at 1 kHz and 0.1 below) moved exactly, an ideal encoder, energies of the plant.

    held       largest stiffness within 5 % at rest, ripple below 5 %, at least -1 uJ, under a push of 5 N that rises in
               0.3 s from 0.5 mm in front of the wall; by bisection, against what the hand-force certificate holds
    slow hand  a spring of 300 N/m whose far end goes 50 mm through free space and 30 mm into the wall: depth at rest
               against that at the certified stiffness, and the largest force in front of the wall
    entry      1e4 N/m, 20 N*s/m, 1 kHz, one sample late, user S: largest rise of the torque from hold to hold within 5
               holds of a contact's beginning (of the continuous wall: of its mean over a hold), largest torque towards
               the wall (of the continuous wall: at any instant), and total variation
    friction   a device with 0.5 N of Coulomb friction for certain: alone, with its damping, and with the hand's speed

Algorithms that rest on the damping of the device know it; `guarded` knows the mass and the hand's force alone.
"""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from canhaptic.control.certificates.scalar_bounds import (
    DisplacementResponse,
    displacement_response,
    renderable_by_hand_force,
    start_energy,
)
from canhaptic.control.environments.spring_damper_wall import SpringDamperWall
from canhaptic.control.passivity import ALGORITHMS
from canhaptic.control.passivity.guarded import GuardedParameters
from canhaptic.lab.batch.scalar import render
from canhaptic.lab.loop.axis_loop import Array, LoopCase, LoopRun
from canhaptic.lab.studies.design.contact_quality import (
    Bench,
    Leaning,
    SlowHand,
    enter,
    largest_held,
    settling_time,
)
from canhaptic.sim.plant.effects.coulomb_friction import CoulombFriction
from canhaptic.sim.plant.plant import PlantParameters
from tools.bench.feel_best import rows_of
from tools.bench.report import Row, publish
from tools.bench.standard_cases import USER_S, standard_case, standard_reference

MASS: Final = 0.25  # [kg]
PUSH: Final = 5.0  # [N]
SOFTEST: Final = 15.0  # [N/m]
BEYOND: Final = 1.3  # stiffest wall tried, over what the certificate holds
LOOPS: Final = {
    "1 kHz, one late, b 0.5": (1000.0, 1, 0.5),
    "100 Hz, delay 0, b 0.1": (100.0, 0, 0.1),
    "100 Hz, one late, b 0.1": (100.0, 1, 0.1),
    "40 Hz, delay 0, b 0.1": (40.0, 0, 0.1),
}
REACH: Final = {
    ("1 kHz, one late, b 0.5", 0.0): 38_000.0,
    ("1 kHz, one late, b 0.5", 20.0): 7_900.0,
    ("100 Hz, one late, b 0.1", 0.0): 390.0,
    ("100 Hz, one late, b 0.1", 5.0): 198.0,
    ("100 Hz, one late, b 0.1", 20.0): 70.0,
}
"""Stiffness to be held [N/m]."""
EARNED: Final = {("1 kHz, one late, b 0.5", 20.0): 10_000.0, ("100 Hz, one late, b 0.1", 5.0): 250.0}
"""The same with energy that was earned before."""
DRAG: Final = 0.1  # largest that is earned by [N]
APPROACH: Final = 1.25
"""Way in front of a wall, over the one in which the drag earns the energy of a start."""
HAND_FORCES: Final = (0.0, 5.0, 20.0)  # [N]
STIFF_WALL: Final = SpringDamperWall(stiffness=1e4, damping=20.0)
PRESS: Final = 20.0  # largest push of the hand that is declared [N]
PUSHES: Final[tuple[dict[str, Any], ...]] = ({}, {"hand_push": PRESS})
ENTRY_HOLDS: Final = 5
FRICTION: Final = 0.5  # [N]
FRICTION_WALLS: Final = (2500.0, 10_000.0)  # [N/m]
KNOWN: Final[dict[str, dict[str, float]]] = {
    "alone": {},
    "and b 0.5": {"device_damping": 0.5},
    "and a hand below 2 m/s": {"hand_speed": 2.0},
}
"""What is certain next to the friction; 'alone' and with b the promise is for every hand."""
WHY: Final = (
    "a hand without a bound may move any way within one hold, where a torque F gives out F D and friction takes f_c D: "
    "beyond f_c nothing is certified for it, however much is stored"
)


def bench_of(algorithm: str, loop: str, *, hand_force: float = 0.0, **options: Any) -> Bench:
    """Returns a device under an algorithm in one of `LOOPS`."""
    rate, delay, damping = LOOPS[loop]
    return Bench(
        _case(algorithm, rate, delay, damping, hand_force, options), PlantParameters(mass=MASS, damping=damping)
    )


def _case(
    algorithm: str, rate: float, delay: int, damping: float, hand_force: float, options: dict[str, Any]
) -> LoopCase:
    declared = None if algorithm == "guarded" else damping
    plant = PlantParameters(mass=MASS, damping=damping)
    return standard_case(
        STIFF_WALL, algorithm, rate, USER_S, delay=delay, plant=plant, hand_force=hand_force,
        declared_damping=declared, **options,
    )  # fmt: skip


def certified(loop: str, hand_force: float, push: float = PUSH) -> float:
    """Returns the stiffness [N/m] that the hand-force certificate holds at a push [N]: m F / (2 T^2 (F + F_h)), ..."""
    rate, delay, damping = LOOPS[loop]
    response = displacement_response(1.0 / rate, MASS, hand_force, 0.0, damping)
    return renderable_by_hand_force(response, delay, push)


def held_rows(algorithms: Sequence[str]) -> Iterator[Row]:
    """Static stiffness of every algorithm in every loop."""
    for loop, (_, _, damping) in LOOPS.items():
        leaning = Leaning(push=PUSH, duration=settling_time(MASS, damping))
        stiffest = BEYOND * certified(loop, 0.0)
        for algorithm in algorithms:
            for hand_force in HAND_FORCES if algorithm == "guarded" else (0.0,):
                yield from _held_rows(algorithm, loop, hand_force, leaning, stiffest)


def energy_rows(algorithms: Sequence[str]) -> Iterator[Row]:
    """Static stiffness with the energy of a start in the account before the contact, from which none may be lost."""
    wanted = [(key, reach) for key, reach in REACH.items() if key[1]] + list(EARNED.items())
    for (loop, hand_force), reach in wanted if "guarded" in algorithms else ():
        rate, delay, damping = LOOPS[loop]
        energy = start_energy(displacement_response(1.0 / rate, MASS, hand_force, 0.0, damping), delay, reach)
        leaning = Leaning(push=PUSH, duration=settling_time(MASS, damping))
        bench = bench_of("guarded", loop, hand_force=hand_force, energy_allowance=energy)
        found = largest_held(bench, leaning, 0.5 * reach, BEYOND * reach)
        name = f"held with energy, {loop}, F_h {hand_force:g} N, for {reach:g} N/m"
        yield Row(f"{name}: energy", 1e3 * energy, "mJ")
        met = found.stiffness >= reach
        yield _earned_row(loop, hand_force, energy, leaning, reach)
        yield Row(name, found.stiffness, "N/m", target=f">= {reach:g}", met=met, note="least true sum(h_i) >= -1 uJ")


def _earned_row(loop: str, hand_force: float, energy: float, leaning: Leaning, reach: float) -> Row:
    """The same with the energy earned by a drag over a way in front of the wall."""
    approach = APPROACH * energy / DRAG
    bench = bench_of("guarded", loop, hand_force=hand_force, drag=DRAG, earned_energy=energy)
    found = largest_held(bench, replace(leaning, clearance=approach), 0.5 * reach, BEYOND * reach)
    name = f"held by {DRAG:g} N of drag over {1e3 * approach:.1f} mm, {loop}, F_h {hand_force:g} N"
    return Row(name, found.stiffness, "N/m", target=f">= {reach:g}", met=found.stiffness >= reach)


def _held_rows(
    algorithm: str, loop: str, hand_force: float, leaning: Leaning, stiffest: float, **options: Any
) -> tuple[Row, Row]:
    found = largest_held(bench_of(algorithm, loop, hand_force=hand_force, **options), leaning, SOFTEST, stiffest)
    limit, reach = certified(loop, hand_force), REACH.get((loop, hand_force)) if algorithm == "guarded" else None
    words = f", F_h {hand_force:g} N" if algorithm == "guarded" else ""
    name = f"{loop}: {algorithm}{words}" + "".join(f", {key} {value:g}" for key, value in options.items())
    target, met = (f">= {reach:g}", found.stiffness >= reach) if reach else ("", None)
    certificate = ("certificate", limit, found.stiffness / limit)
    uneven = ("0", found.failing == 0) if algorithm == "guarded" else ("", None)
    return (
        Row(f"held, {name}", found.stiffness, "N/m", *certificate, target=target, met=met),
        Row(f"softer and not held, {name}", found.failing, f"of {found.softer}", target=uneven[0], met=uneven[1]),
    )


def slow_rows(algorithms: Sequence[str]) -> Iterator[Row]:
    """The slow hand, and what drags it at 0.15 m/s."""
    if "guarded" not in algorithms:
        return
    for loop, (rate, delay, damping) in list(LOOPS.items())[:3]:
        for drag in (0.0, DRAG):
            for hand_force in HAND_FORCES[1:]:
                response = displacement_response(1.0 / rate, MASS, hand_force, 0.0, damping)
                stiffness = certified_rest(response, delay, SlowHand(0.02))[1]
                if drag and not stiffness:
                    continue
                earned = {"drag": drag, "earned_energy": start_energy(response, delay, stiffness)} if drag else {}
                bench = bench_of("guarded", loop, hand_force=hand_force, **earned)
                where = f"{loop}, F_h {hand_force:g} N" + (f", drag {drag:g} N" if drag else "")
                for speed in (0.02, 0.19):
                    yield from _slow_row(bench, SlowHand(speed), response, delay, f"{where}, {speed:g} m/s")
                felt = enter(bench, SpringDamperWall(stiffness=certified(loop, hand_force)), SlowHand(0.15)).drag
                most = 0.1 * (1.0 + 1e-9)
                yield Row(f"drag, {where}, 0.15 m/s", felt, "N", target="<= 0.1", met=felt <= most)


def _slow_row(bench: Bench, hand: SlowHand, response: Any, delay: int, where: str) -> Iterator[Row]:
    depth, stiffness = certified_rest(response, delay, hand)
    wall = SpringDamperWall(stiffness=stiffness or renderable_by_hand_force(response, delay, 1e9))
    found = enter(bench, wall, hand)
    note = f"asked {wall.stiffness:.4g} N/m" if stiffness else "a hand this weak is not held by the certificate"
    yield Row(
        f"slow hand, {where}: depth", 1e3 * found.depth, "mm", "certificate", 1e3 * depth, found.depth / depth,
        target="<= 1.1 times", met=found.depth <= 1.1 * depth, note=note,
    )  # fmt: skip
    yield Row(f"slow hand, {where}: least sum(h_i)", found.least, "J", target=">= 0", met=found.least >= -1e-12)
    if stiffness and "drag" not in where:
        yield from _with_energy(bench, wall, hand, start_energy(response, delay, stiffness), depth, where)


def _with_energy(
    bench: Bench, wall: SpringDamperWall, hand: SlowHand, energy: float, depth: float, where: str
) -> Iterator[Row]:
    """What a drag would have to earn, and the depth where that much is allowed."""
    yield Row(f"slow hand, {where}: way of 0.1 N of drag that would reach it", 1e3 * energy / 0.1, "mm")
    assert bench.case.parameters is not None
    parameters = bench.case.parameters.model_copy(update={"energy_allowance": energy})
    found = enter(replace(bench, case=replace(bench.case, parameters=parameters)), wall, hand).depth
    name = f"slow hand, {where}: depth with so much energy"
    certificate = ("certificate", 1e3 * depth, found / depth)
    yield Row(name, 1e3 * found, "mm", *certificate, target="<= 1.1 times", met=found <= 1.1 * depth)


def entry_rows(algorithms: Sequence[str]) -> Iterator[Row]:
    """Entry step, sticky spike and variation of the force at a stiff wall."""
    cycles = 2000
    reference = standard_reference(STIFF_WALL, USER_S, 1000.0, cycles)
    step, spike = largest_rise(reference.torque, reference.position), -float(reference.fine_torque.min())
    for algorithm in algorithms:
        judged = algorithm == "guarded"
        for hand_force, options in ((f, o) for f in HAND_FORCES for o in PUSHES) if judged else ((0.0, {}),):
            run = render(_case(algorithm, 1000.0, 1, 0.1, hand_force, options), cycles)
            words = f", F_h {hand_force:g} N" + (", any push" if not options else f", push {PRESS:g} N")
            name = algorithm + (words if judged else "")
            rise, stuck = _stiff(run)
            yield _over(f"entry step: {name}", rise, step, 1.5, judged=judged)
            yield _over(f"sticky spike: {name}", stuck, spike, 1.5, judged=judged)
            yield _over(f"force variation: {name}", run.variation, reference.variation, 1.2, judged=judged)


def _stiff(run: LoopRun) -> tuple[float, float]:
    if run.ended:
        return float("inf"), float("inf")
    return largest_rise(run.torque, run.true_position), max(0.0, -float(run.torque.min()))


def largest_rise(torque: Array, position: Array) -> float:
    """Returns the largest rise of the torque from hold to hold within `ENTRY_HOLDS` of a contact's beginning."""
    begins = np.flatnonzero((position[1:] < 0.0) & (position[:-1] >= 0.0)) + 1
    rises = np.diff(torque, append=torque[-1])
    return max((float(rises[k : k + ENTRY_HOLDS].max()) for k in begins.tolist()), default=0.0)


def _over(name: str, value: float, continuous: float, limit: float, *, judged: bool) -> Row:
    ratio = value / continuous
    target, met = (f"<= {limit:g} times", ratio <= limit) if judged else ("", None)
    return Row(name, value, "N", "continuous wall", continuous, ratio, target=target, met=met)


def energy_for_any_hand(
    damping: float, friction: float, sample_time: float, delay: int, stiffness: float, push: float
) -> float:
    """Return the energy [J], >= 0, that a wall needs before a contact to hold every hand up to a push.

    Args:
        damping: Certain viscous damping of the device, > 0 [N*s/m or N*m*s/rad].
        friction: Certain dry friction of the device [N or N*m].
        sample_time: Sample time [s].
        delay: Delay in whole holds.
        stiffness: Stiffness of the wall [N/m or N*m/rad].
        push: Largest force at rest [N or N*m].
    """
    net = max(0.0, push - friction)
    needed = (1 + delay) * net * net * sample_time / (4.0 * damping)
    return max(0.0, needed - push * push / (2.0 * stiffness) - friction * push / stiffness)


def friction_rows(algorithms: Sequence[str]) -> Iterator[Row]:
    """A certificate by dry friction: stiffness rendered to a hand at a speed, and what the device covers.

    What friction takes on the way to the wall is kept. The way is as long as a wall of 2,500 N/m asks for every hand.
    """
    hand = SlowHand(0.1)
    push = hand.stiffness * hand.into * FRICTION_WALLS[0] / (FRICTION_WALLS[0] + hand.stiffness)
    energy = energy_for_any_hand(0.5, FRICTION, 1e-3, 1, FRICTION_WALLS[0], push)
    way = APPROACH * energy / FRICTION
    if "guarded" in algorithms:
        yield Row(f"friction {FRICTION:g} N and b 0.5: energy for every hand at {push:.1f} N", 1e3 * energy, "mJ")
    for words, known in KNOWN.items() if "guarded" in algorithms else ():
        for speed in (0.02, 0.1, 0.3):
            for stiffness in FRICTION_WALLS:
                name = f"friction {FRICTION:g} N {words}, {stiffness:g} N/m, {speed:g} m/s"
                bench = _friction_bench(APPROACH * energy, **known)
                yield from _friction_row(name, bench, stiffness, SlowHand(speed, free=way), known)


def _friction_bench(earned: float, hand_speed: float | None = None, device_damping: float = 0.0) -> Bench:
    """Returns a device with dry friction, and the friction declared."""
    case = _case("guarded", 1000.0, 1, 0.5, 0.0, {})
    loop = case.loop.model_copy(update={"device_friction": FRICTION, "device_damping": device_damping or None})
    parameters = GuardedParameters(hand_force=None, hand_speed=hand_speed, earned_energy=earned)
    return Bench(
        replace(case, parameters=parameters, loop=loop, device_friction=FRICTION, device_damping=device_damping),
        PlantParameters(mass=MASS, damping=0.5),
        (CoulombFriction(kinetic=FRICTION, static=FRICTION),),
    )


def _friction_row(
    name: str, bench: Bench, stiffness: float, hand: SlowHand, known: dict[str, float]
) -> tuple[Row, Row]:
    run = enter(bench, SpringDamperWall(stiffness=stiffness), hand).run
    moving = (run.true_position < 0.0) & (np.gradient(run.true_position) < 0.0)
    share = float(run.torque[moving].sum() / (stiffness * -run.true_position[moving].sum()))
    moved = np.diff(run.true_position, prepend=run.true_position[0])
    paid = FRICTION * np.abs(moved) + 1e3 * known.get("device_damping", 0.0) * moved**2
    least = float((run.interaction + np.cumsum(paid)).min())
    slow = known and hand.speed <= 0.1 and stiffness <= FRICTION_WALLS[0]
    target, met = (">= 0.95", share >= 0.95) if slow else ("", None)
    what = "least sum(h_i) + what the device dissipated"
    return (
        Row(f"{name}: rendered", share, "of asked", target=target, met=met, note="" if known else WHY),
        Row(f"{name}: {what}", least, "J", target=">= 0", met=least >= -1e-12),
    )


def best_rows(algorithms: Sequence[str]) -> Iterator[Row]:
    """What any law can hold without energy before the contact, where `guarded` is asked for more."""
    if "guarded" in algorithms:
        yield from rows_of(LOOPS, [key for key in REACH if key[1]], MASS, PUSH)


def certified_rest(response: DisplacementResponse, delay: int, hand: SlowHand) -> tuple[float, float]:
    """Returns depth [m or rad] and stiffness at which the hand rests on the force held by the hand-force certificate.

    The certificate holds the stiffness c F / (F + F_h) at a force F. With the force K (s - x) of a spring K that ends
    at s, the depth x has c x = F + F_h. Where it lies beyond s, the spring is too weak to be held: the depth is s, and
    the stiffness is 0.

    Args:
        response: Displacement response of the axis.
        delay: Delay in whole holds.
        hand: The hand.
    """

    def lacking(depth: float) -> float:
        force = hand.stiffness * (hand.into - depth)
        return force - renderable_by_hand_force(response, delay, force) * depth

    shallow, deep = 0.0, hand.into * (1.0 - 1e-9)
    if lacking(deep) > 0.0:
        return hand.into, 0.0
    for _ in range(60):
        middle = 0.5 * (shallow + deep)
        shallow, deep = (middle, deep) if lacking(middle) > 0.0 else (shallow, middle)
    return deep, hand.stiffness * (hand.into - deep) / deep


FIGURES: Final = (held_rows, best_rows, energy_rows, slow_rows, entry_rows, friction_rows)


def main(words: Sequence[str]) -> None:
    """Measures all of them and publishes the table."""
    from tools.bench.feel_picture import draw

    algorithms = list(words) or list(ALGORITHMS)
    draw()
    publish("feel", [row for figure in FIGURES for row in figure(algorithms)], ["canhaptic", "numpy"])


if __name__ == "__main__":
    main(sys.argv[1:])
