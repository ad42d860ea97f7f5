"""An axis under another algorithm: common parameters are kept, and undeclared properties are taken from the plant."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

from canhaptic.control.admittance import DISPLAY_ALGORITHMS, DISPLAY_GROUP_ALGORITHMS
from canhaptic.control.multi_axis import GROUP_ALGORITHMS
from canhaptic.control.passivity import ALGORITHMS
from canhaptic.errors import ParameterError
from canhaptic.lab.loop.scenes import loop_case
from canhaptic.registry import load
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.models import AxisScene, GroupScene, Scene
from canhaptic.scene.torque_history import simulation_of
from canhaptic.units import Parameters

PLANT_OF: Final = {"moving_mass": "mass", "device_damping": "damping", "device_damping_bound": "damping"}
"""Property of the loop -> parameter of the simulated plant that is its true value."""


class _AbleAxis(NamedTuple):
    """An axis completed with the properties that its algorithm needs."""

    axis: AxisScene
    from_plant: tuple[str, ...] = ()  # properties of its loop that the scene does not declare, taken from the plant

    @property
    def remark(self) -> str:
        """Properties taken from the plant, in words; "" for none."""
        shown = [f"{key} {getattr(self.axis.loop, key):g}" for key in self.from_plant if key != "device_damping_bound"]
        return f"from the plant: {', '.join(shown)}" if self.from_plant else ""


def own_algorithms(scene: Scene) -> list[str]:
    """Names of the user's own algorithms in a scene."""
    return list(dict.fromkeys(axis.passivity.name for axis in scene.axes if axis.passivity.own is not None))


def chosen_algorithms(algorithms: Sequence[str] | None, own: Sequence[str] = ()) -> list[str]:
    """Requested names, each known; for None all of them, the one for real rigs first.

    Args:
        algorithms: Requested names.
        own: Names of the user's own algorithms, also permitted; for None they come first.

    Raises:
        ParameterError: One is unknown.
    """
    chosen = list(dict.fromkeys(algorithms or (*own, "guarded", *ALGORITHMS)))
    for name in chosen:
        if name in own:
            continue
        load(ALGORITHMS, name, "passivity algorithm")
    return chosen


def with_algorithm(axis: AxisScene, name: str) -> AxisScene:
    """An axis under another algorithm, with the common parameters (alpha, velocity, ...) kept."""
    if axis.passivity.name == name:
        return axis
    model: type[Parameters] = load(ALGORITHMS, name, "passivity algorithm").parameters_type
    given = axis.passivity.parameters
    common = {key: getattr(given, key) for key in model.model_fields if key in type(given).model_fields}
    return replace(axis, passivity=ComponentSpec(name, model().model_copy(update=common)))


def group_under(group: GroupScene, name: str) -> GroupScene:
    """A group under another algorithm, with the common parameters kept."""
    if group.passivity.name == name:
        return group
    model = load(GROUP_ALGORITHMS, name, "group algorithm").parameters_type
    given = group.passivity.parameters
    common = {key: getattr(given, key) for key in model.model_fields if key in type(given).model_fields}
    return replace(group, passivity=ComponentSpec(name, model().model_copy(update=common)))


def display_under(axis: AxisScene, name: str) -> AxisScene:
    """An admittance display under another algorithm, with defaults where it differs from the scene's.

    Raises:
        ParameterError: The algorithm needs parameters that the scene does not give.
    """
    if axis.passivity.name == name:
        return axis
    model = load(DISPLAY_ALGORITHMS, name, "admittance algorithm").parameters_type
    return replace(axis, passivity=_with_defaults(name, model, "compare a scene with it"))


def display_group_under(group: GroupScene, name: str) -> GroupScene:
    """Return a group of admittance displays under another algorithm; see `display_under`."""
    if group.passivity.name == name:
        return group
    model = load(DISPLAY_GROUP_ALGORITHMS, name, "algorithm of several admittance displays").parameters_type
    return replace(group, passivity=_with_defaults(name, model, "study a scene with it"))


def _with_defaults(name: str, model: type[Parameters], remedy: str) -> ComponentSpec:
    try:
        return ComponentSpec(name, model())
    except ValueError as error:
        raise ParameterError(f"{name}: needs parameters that the scene does not give; {remedy}") from error


def _with_known_plant(axis: AxisScene) -> _AbleAxis:
    """An axis with undeclared properties of its algorithm taken from the simulated plant."""
    plant = simulation_of(axis).plant
    from_plant = tuple(key for key in PLANT_OF if getattr(axis.loop, key) is None)
    values = {key: getattr(plant, PLANT_OF[key]) for key in from_plant}
    return _AbleAxis(replace(axis, loop=axis.loop.model_copy(update=values)), from_plant)


def able_under(axis: AxisScene, name: str, scene: Scene) -> _AbleAxis:
    """An axis under an algorithm, with indispensable properties taken from the plant where undeclared.

    Raises:
        ParameterError: It cannot be built even so.
    """
    chosen = _AbleAxis(with_algorithm(axis, name))
    try:
        loop_case(chosen.axis, scene).controller()
    except ParameterError:
        chosen = _with_known_plant(chosen.axis)
        loop_case(chosen.axis, scene).controller()
    return chosen
