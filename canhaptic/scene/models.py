"""The model of a scene: dataclasses that pydantic validates in one pass, made by `load_scene` and built by `build`.

The JSON schema, the resolved configuration and the configuration page follow from these fields and from the parameter
models that they name. `layout` maps a scene file (shared sections, profiles, sections of an axis) to them.

`values_to_set` finds the values that real drives still need: missing ones, and those marked as guesses.
"""

import hashlib
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, NamedTuple, TypeVar

from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    SerializeAsAny,
    TypeAdapter,
    WrapValidator,
    model_validator,
)
from pydantic import ValidationInfo as Info
from pydantic_core import PydanticCustomError

from canhaptic.axis_units import counted
from canhaptic.canopen.eds import dictionary_content
from canhaptic.control import admittance as displays
from canhaptic.control.environments import ENVIRONMENTS
from canhaptic.control.mechanisms import KINEMATICS
from canhaptic.control.multi_axis import GROUP_ALGORITHMS, NETWORKS
from canhaptic.control.passivity import ALGORITHMS, LoopProperties
from canhaptic.control.verdict import BY_CONSTRUCTION, NOT_CHECKED
from canhaptic.drive.axis_parameters import AxisParameters, CanBusParameters
from canhaptic.drive.cycle_parameters import CycleParameters
from canhaptic.drive.profile.causality import ADMITTANCE
from canhaptic.drive.profile.quirks import quirks_of
from canhaptic.errors import InputError
from canhaptic.scene.buses import DICTIONARIES, BusParameters, kind_of, read_axis, read_bus
from canhaptic.scene.components import READY, ComponentOf, ComponentSpec, SceneContext
from canhaptic.scene.document import MarkedMapping
from canhaptic.sim.plant import AccuracyParameters
from canhaptic.sim.plant.effects import EFFECTS
from canhaptic.sim.plant.mechanism import MECHANISMS
from canhaptic.units import Name, OnDemand, OwnModel, Parameters, PrintablePath, PrintableText, quantity

BusName = Annotated[Name, Field(pattern=r"^\S+$")]


class FurtherBus(Parameters):
    """Keys of the second and later buses; rate, link policy and the rest come from the first bus."""

    name: BusName
    """Name used in an axis's `bus`."""
    interface: PrintableText | None = None
    """python-can interface; None: as the first bus."""
    channel: PrintableText | int | None = None
    """Channel of the interface; None: a private one for `virtual`."""
    bitrate: Annotated[int, quantity("bit/s", ge=10_000, le=1_000_000)] | None = None
    """Bit rate of classic CAN; None: as the first bus."""
    options: dict[str, Any] | None = None
    """Further keyword arguments of `can.Bus`; None: as the first bus."""

    def over(self, first: BusParameters) -> CanBusParameters:
        """Return all parameters of this bus; those that it lacks are the first bus's, where that is a CAN bus too."""
        own = {key: value for key, value in self.model_dump(exclude={"name"}).items() if value is not None}
        if not isinstance(first, CanBusParameters):
            cycle = first.model_dump(include=set(CycleParameters.model_fields))
            return CanBusParameters(**{**cycle, "interface": first.interface, **own})
        return first.model_copy(update={"channel": None, **own})


class NamedBus(NamedTuple):
    """One bus with the parameters in effect on it."""

    name: str  # empty where the scene has one bus without a name
    parameters: BusParameters


_OF_ITSELF: Final = ComponentSpec("identity", Parameters())  # kinematics of an axis that renders alone


class LogParameters(Parameters):
    """Paths of the logs, relative to the current folder, and what happens when a log cannot be written."""

    energy: PrintablePath | None = None
    """Energy log (HDF5)."""
    bus: PrintablePath | None = None
    """Bus log: candump text; BLF, TRC or ASC by its suffix."""
    file_size: Annotated[int, quantity("1", ge=0, le=1e12)] = 0
    """Bytes after which the bus log is put aside and a new one begun; 0 for one file without limit."""
    files: Annotated[int, quantity("1", ge=2, le=100_000)] = 10
    """Largest number of bus logs when `file_size` is given; the oldest is deleted."""
    last: Annotated[float, quantity("s", ge=0.0, le=3600.0)] = 0.0
    """Above 0: the bus log is written only after a bad end, and holds this much of the run before it."""
    on_failure: Literal["stop", "continue"] = "stop"
    """Whether a run stops when one of its logs can no longer be written, or continues without it."""

    @model_validator(mode="after")
    def _check(self) -> "LogParameters":
        if self.last and self.file_size:
            raise ValueError("last and file_size exclude each other: keep the last seconds, or a series of files")
        return self


if TYPE_CHECKING:
    from canhaptic.drive.profile.causality import Impedance
    from canhaptic.drive.profile.motion_parameters import MotionParameters
    from canhaptic.far.parameters import FarParameters
    from canhaptic.sim.bus.faulty_bus import BusEffects
    from canhaptic.sim.drive import SimulatedDriveParameters
    from canhaptic.sim.drive.ethercat.cable import CableEffects
    from canhaptic.sim.network import NetworkParameters
    from canhaptic.sim.plant.mechanism.task_hand import TaskHand
    from canhaptic.sim.plant.plant import PlantParameters
    from canhaptic.sim.plant.user import UserParameters
    from canhaptic.sim.plant.velocity_drive import AdmittanceSimulation
else:  # a scene without them loads nothing of them
    BusEffects = CableEffects = SimulatedDriveParameters = TaskHand = PlantParameters = UserParameters = (
        AdmittanceSimulation
    ) = FarParameters = NetworkParameters = Any

LOOP_KEYS: Final = (
    *("moving_mass", "device_damping", "device_damping_bound", "device_friction", "device_friction_bound"),
    *("device_cogging_bound", "presliding_stiffness"),
    *("sync_jitter", "torque_window", "current_lag", "delay", "sample_time"),
)
"""Keys of `passivity` that describe the loop, not the algorithm; `delay` and `sample_time` follow from the bus."""
DISPLAY_LOOP_KEYS: Final = ("sync_jitter",)
"""Loop keys in `passivity` of an admittance display; its other loop properties are in `admittance`."""
_MOVES_IN_METRES: Final = ("planar_2r", "five_bar")
"""Kinematics whose task space is in metres, for linear and rotary motors."""

FAR: Final = "far"
"""`AxisScene.guard` of an axis that is coupled to a far side."""
_REQUIRED: Final = ("torque_verified", "position_reference")
"""Keys of an axis that have no default and that real drives need."""
_UNVERIFIED: Final = 0.01
"""Fraction of `torque_limit` that is sent while the torque scale is not verified."""
UnitT = TypeVar("UnitT", bound=str | None)
_Drive = Annotated[SimulatedDriveParameters, OnDemand("canhaptic.sim.drive:SimulatedDriveParameters")]
_Hand = Annotated[TaskHand, OnDemand("canhaptic.sim.plant.mechanism.task_hand:TaskHand")]
_LOOP, _DISPLAY_LOOP = ("algorithm", LOOP_KEYS), ("algorithm", DISPLAY_LOOP_KEYS)
_OF_SEVERAL = "of several admittance displays"
_ENVIRONMENT_OF_DISPLAY = ComponentOf(displays.DISPLAY_ENVIRONMENTS, f"environment of {ADMITTANCE}")
_ALGORITHM_OF_DISPLAY = ComponentOf(displays.DISPLAY_ALGORITHMS, f"algorithm of {ADMITTANCE}", *_DISPLAY_LOOP)
_ALGORITHM_OF_DISPLAYS = ComponentOf(displays.DISPLAY_ALGORITHMS, f"algorithm {_OF_SEVERAL}", *_DISPLAY_LOOP)
_NETWORK_OF_DISPLAYS = ComponentOf(displays.DISPLAY_NETWORKS, f"network {_OF_SEVERAL}")
_ENVIRONMENT = ComponentOf(
    ENVIRONMENTS,
    "environment",
    of_kinds={ADMITTANCE: _ENVIRONMENT_OF_DISPLAY},
    others=(NETWORKS, "a network of a group"),
)
ALGORITHM = ComponentOf(ALGORITHMS, "passivity algorithm", *_LOOP, of_kinds={ADMITTANCE: _ALGORITHM_OF_DISPLAY})
_GROUP_ALGORITHM = ComponentOf(
    GROUP_ALGORITHMS, "group algorithm", *_LOOP, of_kinds={ADMITTANCE: _ALGORITHM_OF_DISPLAYS}
)
_NETWORK = ComponentOf(
    NETWORKS,
    "network",
    of_kinds={ADMITTANCE: _NETWORK_OF_DISPLAYS},
    others=(ENVIRONMENTS, "an environment of one axis"),
)


SCALING_KEYS: Final = ("counts_per_unit", "rated_torque", "direction")
"""Keys of an axis that its simulated drive takes over unless `simulation.drive` has its own."""
SIMULATION_PARTS: Final = ("drive", "plant", "user", "effects", "admittance")
"""Parts of `simulation` that `simulation.axes.NAME` can replace for one axis."""


def task_unit(kinematics: str, motor_unit: UnitT) -> UnitT | Literal["m"]:
    """Return the unit of task space, from the name of the kinematics and the unit of the motor axes."""
    return "m" if kinematics in _MOVES_IN_METRES else motor_unit


def rests_on_hand_force(passivity: ComponentSpec) -> bool:
    """Whether an algorithm certifies torques for a hand of bounded force."""
    return getattr(passivity.parameters, "hand_force", None) is not None


CheckItem = Literal["motor_data", "dry_run", "torque", "zero", "limits", "brake", "sto", "emergency_stop"]
CHECK_LIST: Final[Mapping[CheckItem, str]] = {
    "motor_data": "motor data and current limit are set with the vendor's tool",
    "dry_run": "the handle was moved in a dry run (--no-torque), and the withheld torques were read",
    "torque": "the scale of the torque is verified",
    "zero": "the counts begin where position_reference says, and the walls lie where they should",
    "limits": "torque_limit and speed_limit are safe for the hand",
    "brake": "the brake holds, and releases before any torque; or there is none",
    "sto": "STO takes the torque away",
    "emergency_stop": "the emergency stop is in reach and takes the power away",
}
"""Items that a person confirms before a real rig is used."""


class RunParameters(Parameters):
    """Top-level values of a scene that belong to no section."""

    duration: Annotated[float, quantity("s", gt=0.0, le=1e6)] | None = None
    """How long a run lasts; None: until it is stopped."""
    confirmed: dict[CheckItem, PrintableText] = Field(default_factory=dict)
    """Items of the check list of a real rig that a person confirmed, and when (`canhaptic commission`)."""
    unfinished: PrintableText | None = None
    """What `canhaptic commission` left open, by which a scene is not run until it is commissioned again."""
    guard: Literal["certificates", "none"] | None = None
    """Set for a program (`canhaptic.open_rig`), which requests the torques in place of environment and algorithm.
    `certificates`: each torque is reduced to what is certified as passive. `none`: torques are sent as requested; a
    real rig requires `guard="none"` in the call too. None: the environment is rendered."""
    code_runs_in: Literal["process", "cycle"] | None = None
    """Where user-defined environments and algorithms run: in a separate process, one hold later, or in the cycle,
    which they may stall. None: in the process with real drives, in the cycle in a simulation."""
    late_holds: Annotated[int, quantity("count", ge=1, le=100_000)] = 20
    """Consecutive holds without an answer from that process after which the run ends."""


class AutoAccuracy(Parameters):
    """`accuracy: {auto: ...}`: `build` chooses an accuracy that keeps the plant within a tolerance."""

    auto: Annotated[float, quantity("m", "rad", gt=0.0, le=1.0)]
    """Largest error of the position that the simulated plant may make."""


class SimulationParameters(Parameters):
    """Values of the simulation that belong to no axis."""

    seed: Annotated[int, quantity("1", ge=0, le=1e9)] = 0
    """Seed of everything random in the simulation."""


class GroupMembership(Parameters):
    """Placeholder for the environment and the algorithm of an axis in a group."""

    group: str


def _axis(value: object, read: Callable[[object], object], info: Info[SceneContext]) -> object:
    """Read an axis in its unit; the context notes the kind of its causality."""
    written = value.get("parameters") if isinstance(value, MarkedMapping) else None
    info.context.kind = ""
    if isinstance(written, MarkedMapping) and written.get("admittance") is not None:
        info.context.kind = info.context.kinds[str(written.get("name"))] = ADMITTANCE
    return _in_its_unit(value, read, info)


def _in_its_unit(value: object, read: Callable[[object], object], info: Info[SceneContext]) -> object:
    with info.context.moving(value.motion if isinstance(value, MarkedMapping) else None):
        return read(value)


@dataclass(frozen=True, slots=True)
class AxisSimulation:
    """Simulation of one axis: the simulated drive, the motor, the user's hand and the named effects."""

    drive: _Drive
    plant: Annotated[PlantParameters, OnDemand("canhaptic.sim.plant.plant:PlantParameters")]
    user: Annotated[UserParameters, OwnModel("canhaptic.sim.plant.user:UserParameters", "hand")] | None = None
    effects: tuple[Annotated[ComponentSpec, ComponentOf(EFFECTS, "effect")], ...] = ()
    seed: int = 0
    accuracy: AccuracyParameters = field(default_factory=AccuracyParameters)
    admittance: (
        Annotated[AdmittanceSimulation, OnDemand("canhaptic.sim.plant.velocity_drive:AdmittanceSimulation")] | None
    ) = None


def _loop_of(section: object, info: Info[SceneContext]) -> object:
    """Return the loop properties declared for an axis, with those that follow from bus and drive."""
    if not isinstance(section, MarkedMapping):
        return section
    axis: AxisParameters | None = info.data.get("parameters")
    bus = info.context.bus
    derived: dict[str, object] = {"sample_time": bus.sample_time_ns * 1e-9 if bus else 1e-3}
    if bus is not None:
        derived["delay"] = bus.delay + (quirks_of(axis.quirks).syncs_late if axis is not None else 0)
    if axis is not None:
        derived["encoder_count"] = 1.0 / abs(axis.counts_per_unit)
        is_unverified = axis.torque_verified == "no" and not info.context.simulated
        derived["torque_limit"] = axis.torque_limit * (_UNVERIFIED if is_unverified else 1.0)
        derived["torque_rate_limit"], derived["power_limit"] = axis.torque_rate_limit, axis.power_limit
        if axis.rated_torque is not None:
            derived["torque_quantum"] = axis.rated_torque * quirks_of(axis.quirks).torque_scale / 1000.0
    return derived | {key: value for key, value in section.items() if value is not None}


@dataclass(frozen=True, slots=True)
class AxisScene:
    """One axis with everything that is rendered on it."""

    parameters: Annotated[SerializeAsAny[AxisParameters], WrapValidator(read_axis)]
    environment: Annotated[ComponentSpec, _ENVIRONMENT]
    passivity: Annotated[ComponentSpec, ALGORITHM]
    loop: Annotated[LoopProperties, BeforeValidator(_loop_of)]
    simulation: AxisSimulation | None
    bus: str = ""  # name of the one it is on
    group: str = ""  # name of the group that renders on it; environment and passivity then say so
    simulated_drive: _Drive | None = None  # of an axis whose motor moves a simulated mechanism
    guard: str = ""  # of the torque that a program asks for on it; empty where an environment is rendered

    def as_port(self, place: int = 0) -> "Port":
        """Return the axis as a port by itself; `place` is its index in the scene."""
        return Port(self.parameters.name, (self,), (place,), self.environment, _OF_ITSELF, self.passivity, "")

    @property
    def port(self) -> str:
        """Name of the port that the axis is in: its own, or its group's."""
        return self.group or self.parameters.name

    @property
    def is_read(self) -> bool:
        """Whether environment, algorithm and effects are known: False if one is user code that was left unread."""
        parts = (self.environment, self.passivity, *(self.simulation.effects if self.simulation else ()))
        return all(part.is_read for part in parts)

    @property
    def is_own(self) -> bool:
        """Whether its environment or its algorithm is user code that was loaded."""
        return self.environment.own is not None or self.passivity.own is not None

    def dictionary_hash(self) -> str:
        """Return the SHA-256 of the drive's EDS or DCF."""
        return hashlib.sha256(dictionary_content(self.parameters.dictionary_path)).hexdigest()


@dataclass(frozen=True, slots=True)
class GroupScene:
    """Axes that render one network together, with one account."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    name: Name
    axes: tuple[str, ...]
    kinematics: Annotated[ComponentSpec, ComponentOf(KINEMATICS, "kinematics")]
    network: Annotated[ComponentSpec, _NETWORK]
    passivity: Annotated[ComponentSpec, _GROUP_ALGORITHM]


class Port(NamedTuple):
    """One part of a scene with an account of its own: axes, what is rendered on them together, and how."""

    name: str
    axes: tuple[AxisScene, ...]
    places: tuple[int, ...]  # indices of its axes in the scene
    rendered: ComponentSpec  # environment of an axis, or network of several
    kinematics: ComponentSpec
    passivity: ComponentSpec
    section: str  # path of what is rendered, for an override; empty for the environment of an axis

    @property
    def causality(self) -> "Impedance | MotionParameters":
        """What its drives are sent and what they show."""
        return self.axes[0].parameters.causality

    @property
    def algorithms(self) -> ComponentOf:
        """The algorithms that can render on its axes."""
        return (_GROUP_ALGORITHM if self.section else ALGORITHM).of(self.causality.kind)


def _as_many_as_move_it(axes: tuple[str, ...], info: Info[SceneContext]) -> tuple[str, ...]:
    of = info.data.get("mechanism")
    if of is not None and len(axes) != of.parameters.axes:
        seen = {"seen": len(axes), "axes": of.parameters.axes, "name": of.name}
        raise PydanticCustomError(READY, "got {seen} axes, expected the {axes} of a {name}", seen)
    return axes


@dataclass(frozen=True, slots=True)
class MechanismScene:
    """A simulated mechanism that several drives move."""

    mechanism: Annotated[ComponentSpec, ComponentOf(MECHANISMS, "mechanism")]
    axes: Annotated[tuple[str, ...], AfterValidator(_as_many_as_move_it)]
    hand: Annotated[_Hand | None, WrapValidator(_in_its_unit)] = None
    substeps: int = 1


def _known_bus(bus: BusParameters, info: Info[SceneContext]) -> BusParameters:
    info.context.bus = bus
    info.context.simulated = info.context.simulated and bus.interface == "virtual"
    return bus


LATER_LOOP_KEYS: Final = (
    *("device_friction", "device_friction_bound", "sync_jitter", "torque_window", "current_lag"),
    *("device_cogging_bound", "presliding_stiffness", "torque_window_least", "current_lag_least"),
    *("torque_rate_limit", "power_limit"),
)
"""Loop keys that logs of the first release do not have."""
_OF_DISPLAYS: Final = ("admittance", "simulation.admittance", "simulation.drive.display")
"""Keys of an axis that are left out where None, as releases before admittance displays did not have them."""
_LATER: Final[Mapping[str, tuple[object, ...]]] = {
    "start_timeout": (5.0,),
    "drive_objects": ({},),
    **dict.fromkeys(("restore_limits", "limit_by_master"), (False,)),
    **dict.fromkeys(
        ("energy_loss_limit", "brake", "hold_checked", "check_hold", "hold_dither", "settings_checked", *_REQUIRED),
        (None,),
    ),
    **{f"loop.{key}": (None, 0.0) for key in LATER_LOOP_KEYS},
    "settings_accepted": (None,),
    "energy_uncertainty_limit": (None,),
    "admittance.limit_in_drive": (False,),
    **dict.fromkeys(("brake.released", "simulation.drive.brake.released"), (None,)),
    "simulation.drive.acts_at_once": (False,),
    "simulation.drive.syncs_late": (0,),
    "simulation.drive.fault": ((), []),
    "simulation.drive.brake": (None,),
    "simulation.drive.mode_when_enabled": (False,),
    "admittance.force.corner": (0.0,),
    "admittance.force.node.real": (False,),
    "admittance.force.node.device_type": (None,),
    "simulation.drive.display.force_node.real": (False,),
    "simulation.drive.display.force_node.device_type": (None,),
    "passivity.hand_push": (None,),
    "passivity.earned_energy": (None,),
    "passivity.drag": (0.0,),
    "network.rest": ([],),
    "simulation.user.motion.time_column": ("",),
}
"""Key of an axis or a group added after the first release -> values that leave the configuration hash unchanged."""


@dataclass(frozen=True, slots=True)
class Scene:
    """A whole scene, validated and ready to build."""

    source: str  # the file as given, for messages
    text: str  # the file as read, for the log
    overrides: tuple[str, ...]
    run: RunParameters
    log: LogParameters
    bus: Annotated[SerializeAsAny[BusParameters], WrapValidator(read_bus), AfterValidator(_known_bus)]
    axes: tuple[Annotated[AxisScene, WrapValidator(_axis)], ...]
    simulation: SimulationParameters | None
    bus_effects: Annotated[BusEffects | None, OnDemand("canhaptic.sim.bus.faulty_bus:BusEffects")] = None
    cable_effects: Annotated[CableEffects | None, OnDemand("canhaptic.sim.drive.ethercat.cable:CableEffects")] = None
    bus_name: BusName = ""  # of the first bus; empty where the only one has no name
    further_buses: tuple[FurtherBus, ...] = ()
    accuracy: AccuracyParameters = field(default_factory=AccuracyParameters)  # of every simulated plant
    auto_accuracy: AutoAccuracy | None = None  # in its place
    accuracy_choices: Mapping[str, object] = field(default_factory=dict)  # axis -> the choice for it, and why
    groups: tuple[GroupScene, ...] = ()
    mechanisms: tuple[MechanismScene, ...] = ()
    own_code: Mapping[str, str] = field(default_factory=dict)  # file or plug-in -> SHA-256 of the code that ran
    unread: tuple[str, ...] = ()  # own code that was named and left unread; nothing is built from such a scene
    far: Annotated[FarParameters | None, OnDemand("canhaptic.far.parameters:FarParameters")] = None
    far_network: Annotated[NetworkParameters | None, OnDemand("canhaptic.sim.network:NetworkParameters")] = None
    undeclared: tuple[str, ...] = ()  # keys of holds and dry friction that real drives need and nothing declares

    def __repr__(self) -> str:
        axes = ", ".join(axis.parameters.name for axis in self.axes)
        return f"<Scene {self.source}: {axes}; {self.bus.rate:g} Hz on {self.bus.interface}>"

    @property
    def accuracy_tolerance(self) -> float | None:
        """Tolerance of `accuracy: {auto: ...}` [m or rad]; None where accuracy is given."""
        return self.auto_accuracy.auto if self.auto_accuracy else None

    @property
    def loaded_buses(self) -> list[tuple[BusParameters, int]]:
        """The parameters of each bus, and the number of drives on it."""
        return [(bus.parameters, sum(axis.bus == bus.name for axis in self.axes)) for bus in self.buses]

    @property
    def buses(self) -> tuple[NamedBus, ...]:
        """All buses of the rig; rate, link policy and the rest come from the first."""
        further = (NamedBus(bus.name, bus.over(self.bus)) for bus in self.further_buses)
        return (NamedBus(self.bus_name, self.bus), *further)

    @property
    def ports(self) -> list[Port]:
        """Every axis outside groups, then every group."""
        known = [axis.as_port(place) for place, axis in enumerate(self.axes) if not axis.group]
        at = {axis.parameters.name: place for place, axis in enumerate(self.axes)}
        for n, several in enumerate(self.groups):
            places, section = tuple(at[name] for name in several.axes), f"groups.{n}.network"
            axes, shape = tuple(self.axes[place] for place in places), several.kinematics
            known.append(Port(several.name, axes, places, several.network, shape, several.passivity, section))
        return known

    def port_of(self, axis: AxisScene) -> Port:
        """Return the port that an axis is in."""
        return next(port for port in self.ports if port.name == axis.port)

    def alone(self, port: Port) -> "Scene":
        """Return the scene with only that port, and the mechanisms that its axes move."""
        names = {axis.parameters.name for axis in port.axes}
        groups = tuple(of for of in self.groups if of.name == port.name)
        moved = tuple(of for of in self.mechanisms if not names.isdisjoint(of.axes))
        return replace(self, axes=port.axes, groups=groups, mechanisms=moved)

    def with_port(self, port: Port) -> "Scene":
        """Return the scene in which this port is in place of the one of that name."""
        name, here, by = port.name, port.rendered, port.passivity
        own = {of.parameters.name: of for of in port.axes}
        if name in own:
            own[name] = replace(own[name], environment=here, passivity=by)
        groups = (replace(of, network=here, passivity=by) if of.name == name else of for of in self.groups)
        axes = tuple(own.get(of.parameters.name, of) for of in self.axes)
        return replace(self, axes=axes, groups=tuple(groups))

    @property
    def far_axis(self) -> AxisScene | None:
        """The axis that is coupled to a far side; None without one."""
        return next((axis for axis in self.axes if axis.guard == FAR), None)

    def axis(self, name: str) -> AxisScene:
        """Return the axis of that name."""
        return next(axis for axis in self.axes if axis.parameters.name == name)

    def axes_on(self, bus: str) -> tuple[AxisScene, ...]:
        """Return the axes on one bus, by its name."""
        return tuple(axis for axis in self.axes if axis.bus == bus)

    def bus_of(self, axis: AxisScene) -> BusParameters:
        """Return the bus that an axis is on."""
        return next(bus.parameters for bus in self.buses if bus.name == axis.bus)

    def hold_of(self, axis: AxisScene) -> str:
        """Return what is known before a start of the hold in which the torques of an axis act; "" without torques."""
        given, twin = axis.parameters, axis.simulated_drive
        if axis.simulation is not None:
            twin = axis.simulation.drive
        if given.causality.holds:
            return ""
        if not self.simulated or twin is None or given.hold_checked or given.check_hold:
            return NOT_CHECKED  # so far
        quirks = quirks_of(given.quirks)
        declared = quirks.acts_at_once, quirks.syncs_late, given.demand_reported == "after"
        acts = twin.acts_at_once, twin.syncs_late, twin.torque_read_back == "after_update"
        return BY_CONSTRUCTION if acts == declared else NOT_CHECKED

    def effects_on(self, bus: str) -> BusEffects | None:
        """Return the simulated faults of a bus, by its name; None where it is ideal."""
        effects = self.bus_effects
        if bus == self.bus_name and kind_of(self.bus) != "can":
            return None
        return effects if effects is None or effects.buses is None or bus in effects.buses else None

    @property
    def has_effects(self) -> bool:
        """Whether faults of a bus are simulated."""
        return self.bus_effects is not None or self.cable_effects is not None

    @property
    def simulated(self) -> bool:
        """Whether the drives are simulated inside the process of the master."""
        return self.bus.interface == "virtual" and self.simulation is not None

    def resolved(self) -> dict[str, Any]:
        """Return the configuration in effect, defaults and overrides included, as plain values."""
        plain = scene_adapter().dump_python(self, mode="json")
        groups = {group.pop("name"): group for group in plain["groups"]}
        mechanisms = [{**of.pop("mechanism"), **of} for of in plain["mechanisms"]]
        simulation = plain["simulation"] and {
            **plain["simulation"],
            **({"bus": {**(plain["bus_effects"] or {}), **(plain["cable_effects"] or {})}} if self.has_effects else {}),
            **({"mechanisms": mechanisms} if mechanisms else {}),
            **({"far_network": plain["far_network"]} if self.far_network else {}),
        }
        bus = [{"name": self.bus_name, **plain["bus"]}, *plain["further_buses"]] if self.bus_name else plain["bus"]
        auto = self.auto_accuracy and {"auto": self.accuracy_tolerance, "chosen": dict(self.accuracy_choices)}
        own_code, far = dict(self.own_code), self.far and plain["far"]
        optional = {"groups": groups, "far": far, "accuracy": auto, "own_code": own_code}
        return {
            "bus": bus,
            "axes": {axis["parameters"]["name"]: _resolved_axis(axis) for axis in plain["axes"]},
            "log": plain["log"],
            "run": plain["run"],
            "simulation": simulation,
            **{key: section for key, section in optional.items() if section},
        }

    def config_hash(self) -> str:
        """Return the SHA-256 of the configuration in effect, dictionaries by content.

        It does not depend on comments, the order of keys, log paths, the folder of the dictionaries, or on whether an
        automatic accuracy was already chosen. Absent keys that are newer than the first release do not change it.
        """
        return hash_of(self.hashed())

    def hashed(self) -> dict[str, Any]:
        """Return the configuration in effect in the form of which `config_hash` is the hash."""
        resolved = self.resolved()
        del resolved["log"], resolved["run"]["confirmed"]
        resolved["run"] = {
            key: value
            for key, value in resolved["run"].items()
            if key == "duration" or value not in (RunParameters.model_fields[key].default, "cycle")
        }
        for axis in self.axes:
            plain = resolved["axes"][axis.parameters.name]
            plain[DICTIONARIES[kind_of(self.bus_of(axis))]] = axis.dictionary_hash()
            if axis.simulation is not None and "substeps" not in self.accuracy.model_fields_set:
                plain["simulation"]["accuracy"]["substeps"] = 1  # follows from the rest
            if self.auto_accuracy is not None and axis.simulation is not None:
                del plain["simulation"]["accuracy"]
        for owner in (*resolved["axes"].values(), *resolved.get("groups", {}).values()):
            if "rest" in owner.get("network", {}):  # the mass of a group of displays, whose spring came later
                _drop(owner, "network.stiffness", (0.0,))
            for path, unchanged in _LATER.items():
                _drop(owner, path, unchanged)
        for bus in resolved["bus"] if isinstance(resolved["bus"], list) else [resolved["bus"]]:
            _drop(bus, "loss_limit", (0.1,))
        if self.auto_accuracy is not None:
            del resolved["accuracy"]["chosen"]
        return resolved


def hash_of(configuration: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a configuration, given as plain values."""
    return hashlib.sha256(json.dumps(configuration, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def _drop(plain: dict[str, Any], path: str, values: tuple[object, ...]) -> None:
    """Remove a key, by its path in a section, if it has one of these values."""
    *owners, key = path.split(".")
    section: Any = plain
    for name in owners:
        section = (section or {}).get(name)
    if section and key in section and section[key] in values:
        del section[key]


def _resolved_axis(axis: dict[str, Any]) -> dict[str, Any]:
    parameters, bus, drive = axis.pop("parameters"), axis.pop("bus"), axis.pop("simulated_drive")
    del axis["group"], axis["guard"]
    simulation = axis["simulation"] if drive is None else {"drive": drive}
    plain = {**parameters, **axis, "simulation": simulation, **({"bus": bus} if bus else {})}
    for path in _OF_DISPLAYS:
        _drop(plain, path, (None,))
    return plain


@cache
def scene_adapter() -> TypeAdapter[Scene]:
    """Adapter that validates, serialises and describes a `Scene`."""
    return TypeAdapter(Scene)


TO_SET: Final = "TO SET"
"""Marks every value that the user has to replace."""
_MARKED: Final = re.compile(rf"^\s*(?:-\s+)?([^#\s].*?)\s#\s*{TO_SET}\b[:,]?\s*(.*)$")


_UNPROTECTED: Final = "`algorithm: unprotected` in the file itself (an override takes no protection from real drives)"


class Guess(NamedTuple):
    """One value that real drives need: marked, or missing."""

    line: int  # of the scene file, from 1; 0: missing
    key: str
    value: str  # as written
    note: str  # what the mark says of it; may be empty


def guesses_left(scene: Scene) -> list[Guess]:
    """Return the values of a scene file that are still marked as guesses."""
    found = []
    for number, line in enumerate(scene.text.splitlines(), start=1):
        if marked := _MARKED.match(line):
            key, _, value = marked[1].partition(":")
            found.append(Guess(number, key.strip(), value.strip(), marked[2].strip()))
    return found


def values_to_set(scene: Scene) -> list[Guess]:
    """Return the values that real drives still need: those marked as guesses, and undeclared ones."""
    is_virtual = any(bus.parameters.interface == "virtual" for bus in scene.buses)
    missing, marked = ["bus.interface", "bus.channel"] if is_virtual else [], guesses_left(scene)
    typed = any("unprotected" in override.partition("=")[2] for override in scene.overrides)
    if typed and not scene.simulated and any(port.passivity.name == "unprotected" for port in scene.ports):
        missing.append(_UNPROTECTED)
    verifies = "torque_verified" not in {guess.key for guess in marked}
    for axis in scene.axes:
        given = axis.parameters
        missing += [f"{given.name}.{key}" for key in _REQUIRED if getattr(given, key) is None]
        if given.causality.holds and given.torque_verified == "no" and verifies:
            missing.append(f"{given.name}.torque_verified")  # it takes the torque that it needs
    return [
        *marked,
        *(Guess(0, key, "", "missing") for key in missing),
        *(Guess(0, key, "", "missing, or 0") for key in scene.undeclared),
    ]


def refused_values(scene: Scene) -> list[Guess]:
    """Return the values without which a run on real drives is refused; none where no drive can be real."""
    if scene.simulated:
        return []
    is_udp = all(bus.parameters.interface == "udp_multicast" for bus in scene.buses)  # which carries no real CAN bus
    unset = guesses_left(scene) if scene.simulation is not None and is_udp else values_to_set(scene)
    if not unset:
        return []
    from canhaptic.host.socketcan_state import all_links_are_virtual

    return [] if all_links_are_virtual(scene.loaded_buses) else unset


def status_text(scene: Scene) -> str:
    """Return the two statuses of a scene: `Simulation: ready. Hardware: 8 values to set`."""
    count = len(values_to_set(scene))
    hardware = f"{counted(count, 'value')} to set" if count else "ready"
    return f"Simulation: {'ready' if scene.simulation else 'no section `simulation`'}. Hardware: {hardware}"


def require_no_guesses(scene: Scene) -> None:
    """Refuse a scene whose commissioning is unfinished, or for real drives one in which a value is missing or a guess.

    Raises:
        InputError: Names what is open, or the values that are missing or marked.
    """
    if scene.run.unfinished is not None:
        text = f"{scene.source}: not run, its commissioning is not finished: {scene.run.unfinished}"
        raise InputError(f"{text}; mend this, then `canhaptic commission` again, or delete the line `unfinished`")
    if not (guesses := refused_values(scene)):
        return
    marked = ", ".join(f"{guess.line} ({guess.key})" for guess in guesses if guess.line)
    missing = ", ".join(guess.key for guess in guesses if not guess.line)
    parts = (f"lines {marked}: marked {TO_SET}" if marked else "", f"missing: {missing}" if missing else "")
    text = f"{scene.source}: not run, the drives are real. {status_text(scene)}: {'; '.join(filter(None, parts))}"
    remedy = "Set each value and delete its mark; canhaptic commission measures most of them"
    raise InputError(f"{text}. {remedy}")
