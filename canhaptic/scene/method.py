"""One line on the method and accuracy of a simulated run."""

from collections.abc import Sequence

from canhaptic.scene.models import Scene
from canhaptic.scene.plant_price import PlantPrice
from canhaptic.sim.plant.plant import Plant


def method_line(scene: Scene, plants: Sequence[Plant] = (), periods: int = 0, prices: Sequence[PlantPrice] = ()) -> str:
    """Return the line that every run prints under `method`; empty with real drives.

    Args:
        scene: Scene that ran.
        plants: Plants of its axes after the run, with their counts of events and products.
        periods: Number of sample times they were moved for.
        prices: Time and estimated error of each plant.
    """
    if not scene.simulated:
        return ""
    orders = {
        effect.name: getattr(effect.parameters, "order", None)
        for axis in scene.axes
        if axis.simulation is not None
        for effect in axis.simulation.effects
    }
    for hand in (axis.simulation.user for axis in scene.axes if axis.simulation is not None):
        orders[f"hand {type(hand).__name__}"] = getattr(hand, "order", None)
    for mechanism in (of.mechanism for of in scene.mechanisms):
        orders[mechanism.name] = getattr(mechanism.parameters, "order", None)
    approximate = {name: order for name, order in orders.items() if order is not None}
    acts = "at its own SYNC" if scene.bus.rpdo == "event" else "one sample late"
    plant = "plant exact between SYNCs"
    if approximate:
        parts = ", ".join(f"{name} of order {order}" for name, order in sorted(approximate.items()))
        plant = f"plant exact between SYNCs but for {parts}"
    if plants and periods:
        plant = f"{plant}, {_spent(plants, periods)}"
    if prices:
        plant = f"{plant}, {_priced(prices)}"
    bus = "" if scene.bus_effects is None else f"; bus with {', '.join(scene.bus_effects.named)}"
    return f"{plant}; torque acts {acts}{bus}"


def _priced(prices: Sequence[PlantPrice]) -> str:
    """Return time per period of all plants together and the largest estimated error."""
    text = f"{sum(price.microseconds for price in prices):.3g} us per period"
    errors = [(price.error, price.unit) for price in prices if price.error is not None]
    if not errors:
        return f"{text}, exact to rounding"
    (error, _, doubt), unit = max(errors, key=lambda one: (bool(one[0].doubt), one[0].size))
    periods = min(price.periods for price in prices)
    if doubt:
        return f"{text}, ERROR NOT KNOWN over {periods} periods: {doubt}"
    return f"{text}, estimated error {error:.1g} {unit} over {periods} periods"


def _spent(plants: Sequence[Plant], periods: int) -> str:
    """Events and products of all plants together; products are those of one plant on average."""
    events, products = sum(plant.events for plant in plants), sum(plant.products for plant in plants)
    return f"{events} event{'' if events == 1 else 's'}, {products / len(plants) / periods:.2g} products per period"
