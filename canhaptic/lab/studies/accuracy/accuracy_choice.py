"""`accuracy: auto`: the cheapest accuracy of a simulated plant that keeps its position within a tolerance.

The controller of the scene is run once on a finely solved plant. Under the torques of that run, settings from coarse to
fine are compared with a reference solution by DOP853 with event location (`canhaptic.lab.judge`). The setting with the
fewest matrix-vector products wins; their number is the same on every machine.
"""

from dataclasses import replace

from canhaptic.errors import InputError
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.accuracy.accuracy_table import advice
from canhaptic.lab.studies.accuracy.plant_solvers import OURS, PlantSide, holds_of, ladder
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import AxisScene, Scene


def with_chosen_accuracy(scene: Scene) -> Scene:
    """Return the scene with a chosen accuracy for every simulated plant; a scene without `auto` is unchanged.

    Raises:
        InputError: scipy is missing, or no setting keeps the tolerance.
    """
    if scene.accuracy_tolerance is None or scene.accuracy_choices or scene.simulation is None:
        return scene
    axes, choices, holds = [], {}, holds_of(scene)
    for axis in scene.axes:
        require_own_axis(axis, scene)
        chosen, simulation = choose(axis, scene, scene.accuracy_tolerance), simulation_of(axis)
        accuracy = simulation.accuracy.model_copy(update=chosen["accuracy"])
        axes.append(replace(axis, simulation=replace(simulation, accuracy=accuracy)))
        choices[axis.parameters.name] = {
            "tolerance": scene.accuracy_tolerance,
            "holds": holds,
            **{key: chosen[key] for key in ("position_error", "force_error", "energy_error")},
            "products_per_period": chosen["evaluations_per_period"],
        }
    return replace(scene, axes=tuple(axes), accuracy_choices=choices)


def choose(axis: AxisScene, scene: Scene, tolerance: float) -> Row:
    """Return the row of the cheapest accuracy that keeps the position of one axis within a tolerance [m or rad].

    Raises:
        InputError: scipy is missing, no setting keeps the tolerance, or the errors do not fall as declared.
    """
    settings = ladder(simulation_of(axis), scene.bus.sample_time_ns)
    side = PlantSide(axis, scene, holds_of(scene), lambda: False, settings=settings)
    side.candidates = [candidate for candidate in side.candidates if candidate.method == OURS]
    list(side.measure())
    found = advice(side.rows, [], tolerance, side.orders())
    where = f"{scene.source}: accuracy: auto of axis {axis.parameters.name}"
    if found["doubt"]:
        raise InputError(f"{where}: {found['doubt']} instead of auto")
    if found["chosen"] is None:
        finest = side.rows[-1]["position_error"]
        raise InputError(
            f"{where} with tolerance {tolerance:g}: the finest setting "
            + ("is unstable" if finest is None else f"errs by {finest:.2g} in position")
            + "; allow at least that, or a higher rate"
        )
    chosen: Row = found["chosen"]
    return chosen


def require_own_axis(axis: AxisScene, scene: Scene) -> None:
    """Refuse an axis without its own plant and its own controller.

    Raises:
        InputError: The axis belongs to a group, or moves a mechanism together with others.
    """
    if axis.group or axis.simulated_drive is not None:
        what = f"group {axis.group} renders on it" if axis.group else "it moves a mechanism with other drives"
        raise InputError(
            f"{scene.source}: axis {axis.parameters.name}: {what}, expected an axis with its own plant and "
            "algorithm; to run the scene, give accuracy: {event_bits, substeps} instead of auto"
        )
