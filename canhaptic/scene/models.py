"""What a scene file says, validated: one object per part, made by `load_scene` and built by `build`."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from canhaptic.control.passivity.controller import LoopProperties
from canhaptic.drive.axis_parameters import AxisParameters, BusParameters
from canhaptic.logs.log_parameters import LogParameters
from canhaptic.scene.buses import FurtherBus, NamedBus
from canhaptic.sim.drive.drive_parameters import SimulatedDriveParameters
from canhaptic.sim.plant.plant import AccuracyParameters, PlantParameters
from canhaptic.sim.plant.user import UserParameters
from canhaptic.units import Parameters, quantity

if TYPE_CHECKING:
    from canhaptic.sim.bus.bus_effects import BusEffects
    from canhaptic.sim.plant.mechanism.task_hand import TaskHand


class RunParameters(Parameters):
    """Values at the top level of a scene that belong to no part."""

    duration: Annotated[float, quantity("s", gt=0.0, le=1e6)] | None = None
    """How long a run lasts; None: until it is stopped."""


class AutoAccuracy(Parameters):
    """`accuracy` of a scene that leaves the choice to the build."""

    auto: Annotated[float, quantity("m", "rad", gt=0.0, le=1.0)]
    """Largest error of the position that the simulated plant may make."""


class SimulationParameters(Parameters):
    """Values of the simulation that belong to no axis."""

    seed: Annotated[int, quantity("1", ge=0, le=1e9)] = 0
    """Of everything random in the simulation."""
    compiled: bool = False
    """Whether plants run compiled by numba (the extra `fast`); seconds of compiling, for stiff scenes."""


class ComponentSpec(NamedTuple):
    """Parameters of a thing chosen by name from a table."""

    name: str
    parameters: Parameters


@dataclass(frozen=True, slots=True)
class AxisSimulation:
    """The far side of one axis: the simulated drive, the motor, the user's hand and the effects that are named."""

    drive: SimulatedDriveParameters
    plant: PlantParameters
    user: UserParameters | None
    effects: tuple[ComponentSpec, ...]
    seed: int
    accuracy: AccuracyParameters = field(default_factory=AccuracyParameters)
    compiled: bool = False


@dataclass(frozen=True, slots=True)
class AxisScene:
    """One axis with everything that is rendered on it."""

    parameters: AxisParameters
    environment: ComponentSpec
    passivity: ComponentSpec
    loop: LoopProperties
    simulation: AxisSimulation | None
    bus: str = ""  # name of the one it is on
    group: str = ""  # name of the group that renders on it; environment and passivity then say so
    simulated_drive: SimulatedDriveParameters | None = None  # of an axis whose motor moves a simulated mechanism

    def dictionary_hash(self) -> str:
        """Returns the SHA-256 of the drive's EDS or DCF."""
        return hashlib.sha256(self.parameters.eds.read_bytes()).hexdigest()


class GroupMembership(Parameters):
    """What stands for environment and algorithm of an axis on which a group renders."""

    group: str


@dataclass(frozen=True, slots=True)
class GroupScene:
    """Axes that render one network together, with one account."""

    name: str
    axes: tuple[str, ...]
    kinematics: ComponentSpec
    network: ComponentSpec
    passivity: ComponentSpec


@dataclass(frozen=True, slots=True)
class MechanismScene:
    """A simulated mechanism that several drives move."""

    axes: tuple[str, ...]
    mechanism: ComponentSpec
    hand: "TaskHand | None"
    substeps: int = 1


@dataclass(frozen=True, slots=True)
class Scene:
    """A whole scene: validated, cross-checked, ready to build."""

    source: str  # the file as given, for messages
    text: str  # the file as read, for the log
    overrides: tuple[str, ...]
    bus: BusParameters
    axes: tuple[AxisScene, ...]
    log: LogParameters
    run: RunParameters
    simulation: SimulationParameters | None
    bus_effects: "BusEffects | None" = None  # what the simulated bus does to its frames
    bus_name: str = ""  # of the first bus, or of the only one
    further_buses: tuple[FurtherBus, ...] = ()
    accuracy_tolerance: float | None = None  # of `accuracy: {auto: ...}` [m or rad]; None where accuracy is given
    accuracy_choices: Mapping[str, Any] = field(default_factory=dict)  # axis -> what was chosen for it, and why
    groups: tuple[GroupScene, ...] = ()
    mechanisms: tuple[MechanismScene, ...] = ()

    @property
    def buses(self) -> tuple[NamedBus, ...]:
        """All buses of the rig; rate, link policy and the rest are those of the first."""
        further = (NamedBus(bus.name, bus.beside(self.bus)) for bus in self.further_buses)
        return (NamedBus(self.bus_name, self.bus), *further)

    def axis(self, name: str) -> AxisScene:
        """Returns the axis of that name."""
        return next(axis for axis in self.axes if axis.parameters.name == name)

    def axes_on(self, bus: str) -> tuple[AxisScene, ...]:
        """Returns the axes on one bus, by its name."""
        return tuple(axis for axis in self.axes if axis.bus == bus)

    @property
    def simulated(self) -> bool:
        """Whether the drives are simulated inside the process of the master."""
        return self.bus.interface == "virtual" and self.simulation is not None

    def resolved(self) -> dict[str, Any]:
        """Returns the configuration in effect, defaults and overrides included, as plain values."""
        return {
            "bus": self._buses(),
            "axes": {axis.parameters.name: _axis(axis) for axis in self.axes},
            "log": _plain(self.log),
            "run": _plain(self.run),
            "simulation": self.simulation and {**_plain(self.simulation), **self._bus_effects(), **self._mechanisms()},
            **self._groups(),
            **self._accuracy(),
        }

    def _buses(self) -> dict[str, Any] | list[dict[str, Any]]:
        first = _plain(self.bus)
        if not self.bus_name:
            return first
        return [{"name": self.bus_name, **first}, *(_plain(bus) for bus in self.further_buses)]

    def _groups(self) -> dict[str, Any]:
        return {"groups": {group.name: _group(group) for group in self.groups}} if self.groups else {}

    def _mechanisms(self) -> dict[str, Any]:
        return {"mechanisms": [_mechanism(of) for of in self.mechanisms]} if self.mechanisms else {}

    def _accuracy(self) -> dict[str, Any]:
        if self.accuracy_tolerance is None:
            return {}
        return {"accuracy": {"auto": self.accuracy_tolerance, "chosen": dict(self.accuracy_choices)}}

    def _bus_effects(self) -> dict[str, Any]:
        return {} if self.bus_effects is None else {"bus": _plain(self.bus_effects)}

    def config_hash(self) -> str:
        """Returns the SHA-256 of the configuration in effect, dictionaries by content.

        Comments, the order of keys, log paths and the folder of the dictionaries do not change it, nor does it matter
        whether an automatic accuracy was chosen yet: it follows from the rest.
        """
        resolved = self.resolved()
        del resolved["log"]
        for axis in self.axes:
            resolved["axes"][axis.parameters.name]["eds"] = axis.dictionary_hash()
            if self.accuracy_tolerance is not None and axis.simulation is not None:
                del resolved["axes"][axis.parameters.name]["simulation"]["accuracy"]
        if self.accuracy_tolerance is not None:
            del resolved["accuracy"]["chosen"]
        canonical = json.dumps(resolved, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(canonical.encode()).hexdigest()


def _plain(parameters: Parameters) -> dict[str, Any]:
    return parameters.model_dump(mode="json")


def _typed(selector: str, typed: ComponentSpec) -> dict[str, Any]:
    return {selector: typed.name, **_plain(typed.parameters)}


def _group(group: GroupScene) -> dict[str, Any]:
    return {
        "axes": list(group.axes),
        "kinematics": _typed("type", group.kinematics),
        "network": _typed("type", group.network),
        "passivity": _typed("algorithm", group.passivity),
    }


def _mechanism(of: MechanismScene) -> dict[str, Any]:
    return {
        "axes": list(of.axes),
        **_typed("type", of.mechanism),
        "hand": of.hand and _plain(of.hand),
        "substeps": of.substeps,
    }


def _axis(axis: AxisScene) -> dict[str, Any]:
    return {
        **_plain(axis.parameters),
        "environment": _typed("type", axis.environment),
        "passivity": _typed("algorithm", axis.passivity),
        "loop": _plain(axis.loop),
        "simulation": _far_side(axis),
        **({"bus": axis.bus} if axis.bus else {}),
    }


def _far_side(axis: AxisScene) -> dict[str, Any] | None:
    if axis.simulated_drive is not None:
        return {"drive": _plain(axis.simulated_drive)}
    simulation = axis.simulation
    if simulation is None:
        return None
    return {
        "drive": _plain(simulation.drive),
        "plant": _plain(simulation.plant),
        "user": simulation.user and _plain(simulation.user),
        "effects": [_typed("type", effect) for effect in simulation.effects],
        "seed": simulation.seed,
        "accuracy": _plain(simulation.accuracy),
    }
