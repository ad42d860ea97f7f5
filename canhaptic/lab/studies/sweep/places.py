"""Where a varied key belongs in a scene: `environment.stiffness` means every axis, also one that has its own.

A key that names its place in full (`axes.0.environment.stiffness`, `bus.rate`) is that place alone.
"""

from canhaptic.scene.diagnostics import Diagnostics
from canhaptic.scene.document import MarkedList, MarkedMapping, parse_yaml
from canhaptic.scene.layout import OWN_SECTIONS, SIMULATION_PARTS
from canhaptic.scene.models import Scene
from canhaptic.scene.overrides import apply_overrides


def places_of(scene: Scene, keys: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Return the override paths of each key.

    Args:
        scene: Loaded without a fault, from text.
        keys: As given to `--vary`.
    """
    faults = Diagnostics()
    document = parse_yaml(scene.text, scene.source, faults)
    apply_overrides(document, scene.overrides, faults)
    return {key: _places(document, key) for key in keys}


def batch_key(key: str, axis: int, name: str) -> str | None:
    """Return what a key is called in a scene of one axis alone; None when it does not touch that axis.

    Args:
        key: As given to `--vary`.
        axis: Index of the axis.
        name: Name of the axis.
    """
    head, _, rest = key.partition(".")
    if head == "axes":
        which, _, below = rest.partition(".")
        if which not in (str(axis), name):
            return None
        return below if below.partition(".")[0] in OWN_SECTIONS else f"axes.0.{below}"
    if key.startswith("simulation.axes."):
        which, _, below = key.removeprefix("simulation.axes.").partition(".")
        return f"simulation.{below}" if which == name else None
    return key


def _places(document: MarkedMapping, key: str) -> tuple[str, ...]:
    head, _, rest = key.partition(".")
    if not rest:
        return (key,)
    if head in OWN_SECTIONS:
        entries = document.get("axes")
        own = [f"axes.{i}.{key}" for i, entry in enumerate(_entries(entries)) if _has(entry, head)]
        return (*_shared(document, head, key, own), *own)
    part = rest.partition(".")[0]
    if head == "simulation" and part in SIMULATION_PARTS:
        simulation = document.get("simulation")
        axes = simulation.get("axes") if isinstance(simulation, MarkedMapping) else None
        named = axes if isinstance(axes, MarkedMapping) else {}
        own = [f'simulation.axes."{name}".{rest}' for name, parts in named.items() if _has(parts, part)]
        return (*_shared(simulation, part, key, own), *own)
    return (key,)


def _shared(owner: object, name: str, key: str, own: list[str]) -> tuple[str, ...]:
    """Return the shared place where there is one, or where no axis has one of its own."""
    return (key,) if _has(owner, name) or not own else ()


def _entries(value: object) -> list[object]:
    return list(value) if isinstance(value, MarkedList) else []


def _has(value: object, name: str) -> bool:
    return isinstance(value, MarkedMapping) and isinstance(value.get(name), MarkedMapping)
