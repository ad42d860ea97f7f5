"""One line on the method of a simulated run: its price, and the estimated error of its plants.

The scene's own controller drives a fresh plant without a bus, over the first periods of the run. The plant is timed
there, and its error is estimated under the same torques (`sim.plant.direct_rig`).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

from canhaptic.axis_units import counted
from canhaptic.drive.clock import WallClock
from canhaptic.errors import CanHapticError, InputError
from canhaptic.scene.far_side import build_plant
from canhaptic.scene.models import AxisScene, AxisSimulation, Scene
from canhaptic.scene.parts import build_axis_controller
from canhaptic.sim.plant import AccuracyParameters, direct_rig
from canhaptic.sim.plant.plant import Plant
from canhaptic.sim.plant.user import RecordedMotion, UserParameters

_PRODUCTS: Final = 6_000
"""Matrix products for which the plant is timed: about 25 ms; the halved steps cost six times that."""
_FEWEST, _MOST = 50, 1000  # periods
_LOOKED_AT: Final = 300  # periods, for figures of many loops
_NS_PER_US: Final = 1e3
_FINE: Final = AccuracyParameters(substeps=16)


def torque_history(axis: AxisScene, scene: Scene, holds: int, accuracy: AccuracyParameters = _FINE) -> list[float]:
    """Return the torque of each hold [N or N*m] of the scene's own controller on a simulated plant, without a bus.

    Args:
        axis: Simulated axis.
        scene: Scene of the axis, for rate, delay and quantisation.
        holds: Number of holds.
        accuracy: Accuracy of the plant; fine by default.
    """
    simulation, period = simulation_of(axis), scene.bus.sample_time_ns
    plant = build_plant(replace(simulation, accuracy=accuracy), period)
    given, quantum = axis.parameters, axis.loop.torque_quantum or None
    step = build_axis_controller(axis).step
    rig = direct_rig.DirectRig(plant, step, period, scene.bus.delay, given.counts_per_unit, quantum, given.torque_limit)
    held: list[float] = rig.run(holds + 1).torque_applied[1:].tolist()
    return held


def declared_order(simulation: AxisSimulation) -> int | None:
    """Return the lowest order of convergence of any effect or user-defined hand; None if all are exact."""
    return min(_orders(simulation).values(), default=None)


def _orders(simulation: AxisSimulation) -> dict[str, int]:
    """Return the order of each effect, and of a user-defined hand, that is not exact."""
    parts = {effect.name: effect.parameters for effect in simulation.effects}
    named = [*parts.items(), (f"hand {type(simulation.user).__name__}", simulation.user)]
    return {name: order for name, part in named if (order := getattr(part, "order", None)) is not None}


def simulation_of(axis: AxisScene) -> AxisSimulation:
    """Return the simulation of an axis.

    Raises:
        InputError: The axis is not simulated.
    """
    if axis.simulation is None:
        raise InputError(f"{axis.parameters.name}: is not simulated, expected a plant and a user; add `simulation`")
    return axis.simulation


LONG_SWING: Final = 1_200.0
"""Phase of an oscillation in one sample time from which a run is announced as slow [rad]: some 5000 products, 20 ms."""
_PER_RADIAN: Final = 4.0  # products
_PER_PRODUCT: Final = 5e-6  # [s], interpreted


def dear_holds(scene: Scene) -> list[str]:
    """Return a warning for each plant that may be slow to simulate, and notes on the motions of hands.

    Events are searched in every oscillation of a fast mode, so that the cost per sample time is known beforehand. A
    mode at rest costs nothing.
    """
    lines = []
    for axis in scene.axes:
        if axis.simulation is None or axis.simulated_drive is not None:
            continue
        if isinstance(motion := getattr(axis.simulation.user, "motion", None), RecordedMotion):
            lines += [f"{axis.parameters.name}: {text}" for text in _of_recorded(motion, axis, scene)]
        lines += [f"{axis.parameters.name}: {text}" for text in _of_detents(axis, axis.simulation.user)]
        phase, mode = build_plant(axis.simulation, scene.bus.sample_time_ns).scene.fastest_swing()
        if phase > LONG_SWING:
            products = _PER_RADIAN * phase
            cost = f"up to {round(products, -3):.0f} matrix products, about {products * _PER_PRODUCT:.1g} s, for each"
            text = f"SLOW while it oscillates: {phase:.0f} rad in one sample time ({mode}), {cost}"
            lines.append(f"{axis.parameters.name}: {text}; give it damping or more mass, or less stiffness")
    return lines


def _of_recorded(motion: RecordedMotion, axis: AxisScene, scene: Scene) -> list[str]:
    """Return notes on a recorded motion that is faster than its axis may be, or that ends before the run does."""
    lines, unit, limit = [], axis.parameters.unit, axis.parameters.largest_speed
    speed, step, time = motion.fastest
    if speed > limit:
        lines.append(
            f"{motion.file.name}, column {motion.column}: moves {step:.4g} {unit} from one row to the next at "
            f"{time:.4g} s, {speed:.4g} {unit}/s, faster than the speed limit of the axis, {limit:g} {unit}/s; "
            f"without a unit in the heading a position is in {unit}: write it as in position "
            f"[{'mm' if unit == 'm' else 'deg'}]"
        )
    if scene.run.duration is None or scene.run.duration > motion.end + scene.bus.sample_time:
        end = f"{motion.rows[-1][1]:.4g} {unit}"
        lines.append(f"{motion.file.name} ends after {motion.end:.4g} s; the hand then stays at {end}")
    return lines


def _of_detents(axis: AxisScene, user: object) -> list[str]:
    """Return a note on a hand whose motion is too small for the pitch of its detents, so that it passes none."""
    detents: Any = axis.environment.parameters
    unit, is_alone = axis.parameters.unit, axis.environment.name == "detents" and not axis.group
    if not is_alone or not isinstance(user, UserParameters) or user.motion is None or user.push:
        return []
    middle, far = user.rest + user.motion.offset, user.motion.amplitude
    low, high = middle - far, middle + far
    if round((low - detents.position) / detents.pitch) != round((high - detents.position) / detents.pitch):
        return []
    text = f"the hand moves from {low:.3g} to {high:.3g} {unit} and passes no notch: environment.pitch is"
    return [f"{text} {detents.pitch:.3g} {unit}; figures of the notch force are those of one slope"]


class PlantPrice(NamedTuple):
    """Cost and error of the plant of one axis."""

    unit: str
    microseconds: float  # per period, of the plant alone
    error: direct_rig.ErrorEstimate | None  # None: exact, to rounding
    periods: int  # from which both were estimated


def plant_prices(scene: Scene, plants: Sequence[Plant], periods: int) -> list[PlantPrice]:
    """Return cost and estimated error of each simulated plant of a torque; no entries if nothing ran.

    Args:
        scene: The scene that ran.
        plants: Plants of its axes after the run.
        periods: Number of sample times for which they ran.
    """
    own = all(axis.simulation and not axis.group and not axis.parameters.admittance for axis in scene.axes)
    if not periods or not scene.simulated or not own or len(plants) != len(scene.axes):
        return []
    try:
        return [_price(axis, scene, plant, periods) for axis, plant in zip(scene.axes, plants, strict=True)]
    except CanHapticError:  # the loop cannot run without what ended the run over the bus, either
        return []


def _price(axis: AxisScene, scene: Scene, plant: Plant, periods: int) -> PlantPrice:
    simulation, period = simulation_of(axis), scene.bus.sample_time_ns
    each = max(1.0, plant.products / periods)
    holds = min(periods, max(_FEWEST, min(_MOST, round(_PRODUCTS / each))))
    torques = torque_history(axis, scene, holds, simulation.accuracy)
    timed = build_plant(simulation, period)
    _step(timed, torques)  # its modes are compiled at the first time
    timed.reset()
    clock = WallClock()
    begin = clock.now()
    _step(timed, torques)
    spent = clock.now() - begin
    error = estimated_error(simulation, torques, period)
    return PlantPrice(axis.parameters.unit, spent / holds / _NS_PER_US, error, holds)


def estimated_error(
    simulation: AxisSimulation, torques: Sequence[float], sample_time_ns: int
) -> direct_rig.ErrorEstimate | None:
    """Return the estimated largest error of the position at any SYNC; None if the plant is exact to rounding.

    Args:
        simulation: Plant, effects and the accuracy to estimate.
        torques: Torque of each hold [N or N*m].
        sample_time_ns: Length of a hold [ns].
    """

    def plant_of(accuracy: AccuracyParameters, period: int) -> Plant:
        return build_plant(replace(simulation, accuracy=accuracy), period)

    order = declared_order(simulation) or 1
    return direct_rig.estimated_error(plant_of, simulation.accuracy, order, torques, sample_time_ns)


def plant_errors(scene: Scene) -> list[str]:
    """Return one line for each plant that is not exact: its estimated error, or ERROR NOT KNOWN and why.

    Studies that vary a scene show it; the error is that of the unmodified scene.
    """
    lines = []
    for axis in scene.axes:
        if scene.unread or axis.simulation is None or declared_order(axis.simulation) is None:
            continue
        lines.append(f"plant of {axis.parameters.name}: {_error_of(axis, axis.simulation, scene)}")
    return lines


def _error_of(axis: AxisScene, simulation: AxisSimulation, scene: Scene) -> str:
    if axis.group or axis.parameters.admittance is not None:
        return "not exact, ERROR NOT KNOWN: it is estimated only for axes outside groups"
    whole = _MOST if scene.run.duration is None else round(scene.run.duration / scene.bus.sample_time)
    holds = max(2, min(_LOOKED_AT, whole))
    try:
        torques = torque_history(axis, scene, holds, simulation.accuracy)
        error = estimated_error(simulation, torques, scene.bus.sample_time_ns)
    except CanHapticError as problem:
        return f"not exact, ERROR NOT KNOWN: {problem}"
    if error is None or error.doubt:
        return f"not exact, ERROR NOT KNOWN over {holds} periods: {error.doubt if error else ''}"
    share = f"{error.size / error.travel:.1g} of its travel"
    return f"not exact, estimated error {error.size:.1g} {axis.parameters.unit}, {share}, over {holds} periods"


def _step(plant: Plant, torques: Sequence[float]) -> None:
    plant.begin(0)
    now, period, move = 0, plant.sample_time_ns, plant.advance_to
    for torque in torques:
        now += period
        move(now, torque)


def method_line(scene: Scene, plants: Sequence[Plant] = (), periods: int = 0, prices: Sequence[PlantPrice] = ()) -> str:
    """Return the line that every run prints under `method`; empty with real drives.

    Args:
        scene: Scene that ran.
        plants: Plants of its axes after the run, with their counts of events and products.
        periods: Number of sample times for which they ran.
        prices: Time and estimated error of each plant.
    """
    if not scene.simulated:
        return ""
    approximate = {
        name: order for axis in scene.axes if axis.simulation for name, order in _orders(axis.simulation).items()
    }
    for mechanism in (of.mechanism for of in scene.mechanisms):
        if (order := getattr(mechanism.parameters, "order", None)) is not None:
            approximate[mechanism.name] = order
    acts = "at its own SYNC" if scene.bus.rpdo == "event" else "one sample late"
    plant, cost = "plant exact between SYNCs", ""
    if approximate:
        parts = ", ".join(f"{name} of order {order}" for name, order in sorted(approximate.items()))
        plant = f"plant exact between SYNCs but for {parts}"
    if plants and periods:  # products are per plant on average
        events, products = sum(of.events for of in plants), sum(of.products for of in plants) / len(plants) / periods
        cost = f"; {counted(f'{products:.2g}', 'matrix product')} per period, {counted(events, 'event')}"
    if prices:
        plant = f"{plant}, {_accuracy(prices)}"
        cost = f"{cost or ';'}, {sum(price.microseconds for price in prices):.3g} us per period".replace(";,", ";")
    bus = "" if scene.bus_effects is None else f"; bus with {', '.join(scene.bus_effects.named)}"
    return f"{plant}; torque acts {acts}{bus}{cost}"


def _accuracy(prices: Sequence[PlantPrice]) -> str:
    """Return the largest estimated error of all plants."""
    errors = [(price.error, price.unit) for price in prices if price.error is not None]
    if not errors:
        return "exact to rounding"
    (error, _, doubt), unit = max(errors, key=lambda one: (bool(one[0].doubt), one[0].size))
    periods = min(price.periods for price in prices)
    if doubt:
        return f"ERROR NOT KNOWN over {periods} periods: {doubt}"
    return f"estimated error {error:.1g} {unit} over {periods} periods"
