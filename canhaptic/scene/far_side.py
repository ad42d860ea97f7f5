"""The simulated side of a scene: plants, mechanisms and drives, the effects of a bus, bounds of simulated devices.

A scene without a simulation loads nothing of it.
"""

from collections.abc import Callable
from functools import partial
from math import inf
from typing import TYPE_CHECKING, Any, Final, Literal, cast

import can

from canhaptic.errors import InputError, ParameterError
from canhaptic.registry import load
from canhaptic.scene.components import ComponentSpec
from canhaptic.scene.models import AxisScene, AxisSimulation, MechanismScene, Scene

if TYPE_CHECKING:
    from canhaptic.sim.bus.faulty_bus import FaultyBus
    from canhaptic.sim.drive.can.drive_node import DriveGroup, Drives, SimulatedDrive
    from canhaptic.sim.drive.drive_parameters import SimulatedDriveParameters
    from canhaptic.sim.drive.profile.servo import Motor
    from canhaptic.sim.plant.effects import Effect
    from canhaptic.sim.plant.mechanism import Mechanism, MechanismParameters
    from canhaptic.sim.plant.mechanism.shared_mechanism import MechanismMotor
    from canhaptic.sim.plant.plant import Plant

_SEEDS_APART: Final = 1_000_003  # from one bus to the next
_BOUNDS: Final = ("device_damping_bound", "device_friction_bound")
_NO_LAG: Final = 1.0
"""Lag of a torque without a declared bound [s]: the largest accepted, with which nothing is certified."""
_CHOICES: Final = {"auto": "canhaptic.lab.studies.accuracy.accuracy_choice:with_chosen_accuracy"}
"""Automatic accuracy -> "module:function" that chooses it; the laboratory, loaded only for a scene that asks for it."""


def build_plant(simulation: AxisSimulation, sample_time_ns: int) -> "Plant":
    """Return the motor and user of one axis, at rest until the first SYNC with the drive enabled.

    Args:
        simulation: Plant, user and effects.
        sample_time_ns: Time between two SYNCs [ns].
    """
    effects = [effect_of(effect) for effect in simulation.effects]
    given = simulation.user, effects, sample_time_ns, simulation.seed, simulation.accuracy
    if simulation.admittance is not None:
        from canhaptic.sim.plant.velocity_drive import AdmittancePlant

        return AdmittancePlant(simulation.plant, simulation.admittance, *given)
    from canhaptic.sim.plant.plant import Plant

    return Plant(simulation.plant, *given)


def effect_of(effect: ComponentSpec) -> "Effect":
    """Object of an effect's parameters."""
    return cast("Effect", effect.parameters)  # every class of EFFECTS is one


def build_mechanism(of: MechanismScene, sample_time_ns: int) -> "Mechanism":
    """Return a simulated mechanism, at rest until the last of its drives is enabled.

    Raises:
        ParameterError: It cannot be in the pose of its parameters.
    """
    parameters = cast("MechanismParameters", of.mechanism.parameters)  # every class of MECHANISMS is one
    return parameters.build(of.hand, sample_time_ns, of.substeps)


def build_simulated_drive(
    axis: AxisScene, parameters: "SimulatedDriveParameters", motor: "Motor", bus: can.BusABC, sample_time_ns: int
) -> "SimulatedDrive":
    """Return the drive of one axis with its motor; it reads its dictionary itself."""
    from canhaptic.sim.drive.can.drive_node import SimulatedDrive

    return SimulatedDrive(bus, axis.parameters.node_id, axis.parameters.eds, motor, parameters, sample_time_ns)


def shared_motors(scene: Scene) -> "dict[str, MechanismMotor]":
    """Return the motors of all simulated mechanisms, by the name of their axis."""
    from canhaptic.sim.plant.mechanism.shared_mechanism import SharedMechanism

    motors: dict[str, MechanismMotor] = {}
    for of in scene.mechanisms:
        shared = SharedMechanism(build_mechanism(of, scene.bus.sample_time_ns), len(of.axes))
        motors.update(zip(of.axes, shared.motors, strict=True))
    return motors


def with_effects(bus: can.BusABC, scene: Scene, side: Literal["master", "drive"], index: int = 0) -> "FaultyBus":
    """Return a connection with the effects that a scene names on its buses.

    Args:
        bus: Opened connection.
        scene: Scene with `bus_effects`.
        side: Side that owns the connection.
        index: Index of the bus in the scene.
    """
    from canhaptic.sim.bus.faulty_bus import FaultyBus

    if scene.bus_effects is None or scene.simulation is None:
        raise InputError(f"{scene.source}: names no effect on its bus (simulation.bus)")
    bitrate, seed = scene.buses[index].parameters.bitrate, scene.simulation.seed + _SEEDS_APART * index
    return FaultyBus(bus, scene.bus_effects, bitrate=bitrate, seed=seed, side=side)


def suffers(scene: Scene, name: str) -> bool:
    """Whether a scene names effects on the bus of this name."""
    effects = scene.bus_effects
    return effects is not None and (effects.buses is None or name in effects.buses)


def build_drive_group(scene: Scene, bus: can.BusABC, name: str | None = None) -> "DriveGroup":
    """Return the simulated drives of a scene on one connection to the bus.

    Args:
        scene: Scene with a `simulation`.
        bus: Connection to the bus.
        name: Name of that bus; None for the only one.

    Raises:
        InputError: The scene has no `simulation`.
    """
    from canhaptic.sim.drive.can.drive_node import DriveGroup

    scene = with_accuracy(scene)
    period, drives = scene.bus.sample_time_ns, []
    axes = [axis for axis in scene.axes if name in (None, axis.bus)]
    motors = shared_motors(scene) if any(axis.simulated_drive is not None for axis in axes) else {}
    for axis in axes:
        try:
            if axis.simulation is not None:
                plant = build_plant(axis.simulation, period)
                drives.append(build_simulated_drive(axis, axis.simulation.drive, plant, bus, period))
            elif axis.simulated_drive is not None:
                motor = motors[axis.parameters.name]
                drives.append(build_simulated_drive(axis, axis.simulated_drive, motor, bus, period))
                motor.connect(partial(getattr, drives[-1].servo, "torque"))
        except ParameterError as error:
            raise ParameterError(f"{scene.source}: simulation.drive of {axis.parameters.name}: {error}") from error
    if not drives:
        raise InputError(f"{scene.source}: has no `simulation`, so there is no drive to simulate; add one")
    return DriveGroup(bus, drives)


def with_accuracy(scene: Scene) -> Scene:
    """Scene with its automatic accuracy chosen; without one, nothing is imported."""
    if scene.accuracy_tolerance is None:
        return scene
    chosen: Scene = load(_CHOICES, "auto", "choice of accuracy")(scene)
    return chosen


def all_drives(scene: Scene, groups: "list[DriveGroup]") -> "Drives | None":
    """Return all simulated drives in the order of the axes; None with real ones."""
    if len(groups) < 2:
        return groups[0] if groups else None
    from canhaptic.sim.drive.can.drive_node import AllDrives

    drives = {bus.name: iter(group.drives) for bus, group in zip(scene.buses, groups, strict=True)}
    return AllDrives(tuple(next(drives[axis.bus]) for axis in scene.axes))


def device_bounds(scene: Scene, axis: AxisScene) -> dict[str, float]:
    """Upper bounds of an axis's simulated device; none for a real one, or one in another process."""
    if axis.simulation is not None:
        effects = [effect.parameters for effect in axis.simulation.effects]
        damping = axis.simulation.plant.damping + sum(map(_damping, effects))
        return dict(zip(_BOUNDS, (damping, sum(map(_friction, effects))), strict=True))
    for of in scene.mechanisms:
        if axis.parameters.name in of.axes:
            return _bounds_of_mechanism(of, of.axes.index(axis.parameters.name))
    return {}


def _damping(effect: Any) -> float:
    """Return the largest damping of an effect on the body at the encoder; a stop's and a shaft's are not the device's.

    The bristles of LuGre friction damp as well until they slide.
    """
    kind = getattr(effect, "type", "")  # own code has none
    if kind == "viscous_friction":
        return float(effect.damping)
    return float(effect.viscous + effect.bristle_damping) if kind == "lugre_friction" else 0.0


def _friction(effect: Any) -> float:
    """Return the largest force of an effect at any speed: dry friction, cogging."""
    if getattr(effect, "type", "") == "cogging":
        return float(effect.amplitude)
    return float(max(getattr(effect, "static", 0.0), getattr(effect, "kinetic", 0.0)))


def _bounds_of_mechanism(of: MechanismScene, place: int) -> dict[str, float]:
    """The same for one motor of a mechanism: its bearing, or its guide."""
    given: Any = of.mechanism.parameters
    guide = f"_{'xy'[place]}" if of.mechanism.name == "xy_stage" else ""
    friction = getattr(given, f"friction{guide}", None)
    static = 0.0 if friction is None else float(max(friction.static, friction.kinetic))
    return dict(zip(_BOUNDS, (float(getattr(given, f"damping{guide}", 0.0)), static), strict=True))


def lag_of(axis: AxisScene) -> float:
    """Largest time constant from the commanded torque to the motor's [s]; `_NO_LAG` where it may not follow at all."""
    effects = {of.name: of.parameters for of in axis.simulation.effects} if axis.simulation is not None else {}
    lag = float(getattr(effects.get("current_loop"), "time_constant", 0.0))
    slowest: Callable[..., float] | None = getattr(effects.get("voltage_limit"), "slowest_lag", None)
    if slowest is None:
        return lag
    return min(slowest(lag, axis.parameters.torque_limit or inf, axis.parameters.largest_speed), _NO_LAG)
