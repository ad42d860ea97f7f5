"""What a study of accuracy is of: one axis that renders by itself, or one group."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol

from canhaptic.drive.axis_parameters import AxisParameters
from canhaptic.errors import InputError
from canhaptic.lab.loop.scenes import parts_of
from canhaptic.lab.reference.continuous_group import continuous_group
from canhaptic.lab.studies.accuracy.accuracy_choice import require_own_axis
from canhaptic.lab.studies.accuracy.candidates import remarks
from canhaptic.lab.studies.accuracy.continuous_loop import continuous_loop
from canhaptic.lab.studies.accuracy.group_plant_side import Plants, group_side
from canhaptic.lab.studies.accuracy.group_variants import group_variants
from canhaptic.lab.studies.accuracy.loop_sensitivity import Continuous, Variant, variants
from canhaptic.lab.studies.accuracy.plant_solvers import PlantSide
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.scene.torque_history import simulation_of

Stop = Callable[[], bool]


class StudiedPart(Protocol):
    """What renders by itself."""

    is_group: ClassVar[bool]

    @property
    def name(self) -> str:
        """Name of the axis or the group."""

    @property
    def parameters(self) -> Sequence[AxisParameters]:
        """Parameters of its axes."""

    def plants(self, holds: int, stop: Stop, *, with_compiled: bool) -> Plants:
        """Return the plant side; see `PlantSide`."""

    def remarks(self) -> list[str]:
        """Return what could not be run, and why."""

    def continuous(self, step_ns: int, steps: int, stop: Stop) -> Continuous:
        """Return what is felt without sampling."""

    def variants(self) -> Sequence[Variant]:
        """Return every loop of the loop side."""


@dataclass(frozen=True, slots=True)
class _AxisPart:
    is_group: ClassVar[bool] = False
    axis: AxisScene
    scene: Scene

    @property
    def name(self) -> str:
        return self.axis.parameters.name

    @property
    def parameters(self) -> Sequence[AxisParameters]:
        return (self.axis.parameters,)

    def plants(self, holds: int, stop: Stop, *, with_compiled: bool) -> Plants:
        return PlantSide(self.axis, self.scene, holds, stop, with_compiled=with_compiled)

    def remarks(self) -> list[str]:
        return remarks(simulation_of(self.axis))

    def continuous(self, step_ns: int, steps: int, stop: Stop) -> Continuous:
        return continuous_loop(self.axis, step_ns, steps, stop)

    def variants(self) -> Sequence[Variant]:
        return variants(self.axis, self.scene)


@dataclass(frozen=True, slots=True)
class _GroupPart:
    is_group: ClassVar[bool] = True
    name: str
    scene: Scene  # of the group alone

    @property
    def parameters(self) -> Sequence[AxisParameters]:
        return tuple(self.scene.axis(name).parameters for name in self.scene.groups[0].axes)

    def plants(self, holds: int, stop: Stop, *, with_compiled: bool) -> Plants:
        return group_side(self.scene, holds, stop, with_compiled=with_compiled)

    def remarks(self) -> list[str]:
        if self.scene.mechanisms:
            return [f"MuJoCo and other methods: not run on a {self.scene.mechanisms[0].mechanism.name}"]
        return list(dict.fromkeys(line for axis in self.scene.axes for line in remarks(simulation_of(axis))))

    def continuous(self, step_ns: int, steps: int, stop: Stop) -> Continuous:
        return continuous_group(self.scene, step_ns, steps, stop)

    def variants(self) -> Sequence[Variant]:
        return group_variants(self.scene)


def chosen_part(scene: Scene, name: str | None) -> StudiedPart:
    """Return an axis or a group by name; the first axis by default, and the group of an axis that has one.

    Raises:
        InputError: There is none of that name, or it is not simulated.
    """
    axis = next((axis for axis in scene.axes if name in (None, axis.parameters.name)), None)
    parts = parts_of(scene)
    if axis is None and name not in parts:
        raise InputError(f"{scene.source}: got axis {name!r}, expected one of: {', '.join(parts)}")
    if axis is not None and not axis.group:
        require_own_axis(axis, scene)
        return _AxisPart(axis, scene)
    group = str(axis.group if axis is not None else name)
    return _GroupPart(group, parts[group])
