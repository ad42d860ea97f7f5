"""One line on how a scene is computed, and how exact that is."""

from canhaptic.scene.models import Scene


def method_line(scene: Scene) -> str:
    """Returns the line that every run prints under `method`; empty with real drives."""
    if not scene.simulated:
        return ""
    orders = {
        effect.name: getattr(effect.parameters, "order", None)
        for axis in scene.axes
        if axis.simulation is not None
        for effect in axis.simulation.effects
    }
    approximate = {name: order for name, order in orders.items() if order is not None}
    acts = "at its own SYNC" if scene.bus.rpdo == "event" else "one sample late"
    plant = "plant exact between SYNCs"
    if approximate:
        parts = ", ".join(f"{name} of order {order}" for name, order in sorted(approximate.items()))
        plant = f"plant exact between SYNCs but for {parts}"
    bus = "" if scene.bus_effects is None else f"; bus with {', '.join(scene.bus_effects.named)}"
    return f"{plant}; torque acts {acts}{bus}"
