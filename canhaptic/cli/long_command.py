"""Notes of commands that move a rig, shown before any torque.

They are reduced torque limits, the check list, and the positions of the walls.
"""

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Final

from canhaptic.axis_units import effort_unit
from canhaptic.scene.models import CHECK_LIST, AxisScene, CheckItem, Scene
from canhaptic.view.terminal import write_note

if TYPE_CHECKING:
    from canhaptic.scene.build import Experiment

NOT_PASSIVE: Final = 1
"""Exit status of --strict."""
KEPT: Final = ("yes", "no contact", "dry run")
"""Verdicts that --strict accepts."""


def notes(scene: Scene) -> Iterator[str]:
    """Yield notes: no passivity controller, a program that is awaited, reduced limits, check list, slow simulations."""
    yield from unguarded(scene)
    if scene.far is not None and scene.far.world is not None:
        own, world = ("{}:{}".format(*place) for place in scene.far.places)
        text = f"far: {scene.far.axis} waits at {own} for a program at {world} that iterates over canhaptic.World"
        yield f"{text}(scene={str(scene.source)!r}); until it comes, and after it has gone, the handle is free"
    for axis in scene.axes:
        given, limit = axis.parameters, axis.loop.torque_limit or 0.0
        if limit < given.torque_limit and not given.causality.holds:
            text = f"{given.name}: torque scale not verified (torque_verified: no), so the torque is limited to"
            yield f"{text} {limit:.3g} {effort_unit(given.unit)}, 1 % of torque_limit; canhaptic commission verifies it"
    if scene.simulation is None:
        yield from check_list(scene.run.confirmed)
        asked = scene.bus.realtime.model_dump()
        if missing := [key for key in ("priority", "lock_memory", "freeze_garbage") if not asked[key]]:
            text = f"bus.realtime: without {', '.join(missing)}: other programs, swapping or the garbage collector may"
            yield f"{text} delay SYNCs; add them where `canhaptic check` says that the system grants them"
    if scene.simulated:  # real drives load nothing of it
        from canhaptic.scene.method import dear_holds

        yield from dear_holds(scene)


def unguarded(scene: Scene) -> Iterator[str]:
    """Yield a warning for each real axis without passivity controller."""
    for axis in scene.axes:
        if not scene.simulated and scene.port_of(axis).passivity.name == "unprotected":
            text = f"{axis.parameters.name}: NO PASSIVITY CONTROLLER (algorithm: unprotected): the drive may give out"
            yield f"{text} energy to the hand; only the limits of torque, power and speed protect it"


def check_list(confirmed: Mapping[CheckItem, str]) -> Iterator[str]:
    """Yield a line for each item of the check list, with the time of its confirmation."""
    for key, text in CHECK_LIST.items():
        yield f"{'x' if key in confirmed else ' '} {key}: {text}; {confirmed.get(key, 'not confirmed')}"


def walls_first(experiment: "Experiment", stop_requested: Callable[[], bool]) -> Callable[[], bool]:
    """Return `stop_requested`, wrapped: its first call, with enabled drives and before any torque, prints the walls."""
    walls = _walls(experiment)

    def requested() -> bool:
        for text in walls:  # empty after the first call
            write_note(f"  {text}")
        return stop_requested()

    return requested


def _walls(experiment: "Experiment") -> Iterator[str]:
    for axis, drive in zip(experiment.scene.axes, experiment.rig.drives, strict=True):
        if axis.parameters.position_reference != "at_start":
            continue
        at, unit = drive.scaling.position(drive.position_counts), axis.parameters.unit
        ways = [f"{key}: {place:.4g} {unit} ({place - at:+.4g} {unit} from here)" for key, place in _places(axis)]
        where = f"the handle is {at:.4g} {unit} from its position at power-on"
        yield f"{axis.parameters.name}: {'; '.join([where, *ways])}"


def _places(axis: AxisScene) -> Iterator[tuple[str, float]]:
    """Yield key and position of the walls and limits of an axis."""
    for key in ("position", "lower_wall", "upper_wall", "position_low", "position_high"):
        for of in (axis.environment.parameters, axis.parameters.admittance):
            if isinstance(place := getattr(of, key, None), float):
                yield key, place
