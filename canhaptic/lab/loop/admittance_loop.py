"""Admittance displays in a loop without a bus: plants, sensors, encoders, a controller, and the energies of the plants.

One axis, or one group of axes with one account. Encoder and force are whole counts, commands whole quanta, with the
same delay as on the bus of the scene; an error that would stop the rig ends the run.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from canhaptic.control.balance import RANKS, Certificate, EnergyBalance
from canhaptic.drive.profile.admittance_parameters import ForceChannel
from canhaptic.errors import CanHapticError, InputError
from canhaptic.lab.loop.axis_loop import FURTHEST, Array
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.scene.parts import build_axis_controller, build_group, build_plant
from canhaptic.scene.torque_history import simulation_of
from canhaptic.sim.plant.velocity_drive import AdmittancePlant

Mask = NDArray[np.bool_]
_CUTS: Final = (
    Certificate.VELOCITY_LOOP.value, Certificate.LARGEST_HAND_FORCE.value, Certificate.DECLARED_HAND.value
)  # fmt: skip
_NONE: Final = Certificate.NONE.value
_STILL: Final = 1e-9  # command that counts as none [m/s or rad/s]
_COLUMNS: Final = 3  # of one axis in `AdmittanceRun.motion`
_FREE_MASS: Final = "virtual_mass"
_FIRST: Final = 20  # SYNCs at the beginning that are left out of the mass felt
_BRAKING: Final = 10e-3  # time that a drive takes to stop at a wall, at most [s]
_FEWEST: Final = 30  # SYNCs from which the felt mass is computed


def is_display(scene: Scene) -> bool:
    """Whether the axes of a scene with a single part are admittance displays."""
    return all(axis.parameters.admittance is not None for axis in scene.axes)


@dataclass
class AdmittanceRun:
    """Result of one run; energies in [J], of all axes together."""

    cycles: int = 0  # SYNCs done
    ended: str = ""  # why it ended early; "" where it did not
    diverged: bool = False
    interaction: float = 0.0  # true, through all sensors
    least_interaction: float = 0.0  # true, after any hold
    believed: float = 0.0
    believed_error: float = 0.0
    resolution: float = 0.0  # uncertainty of the energy [J]
    surplus: float = 0.0  # at the end
    moving: int = 0  # holds with a command, or with one that was cut to nothing
    cut: int = 0  # holds that a certificate cut
    uncertified: int = 0
    certificate: int = Certificate.EXACT.value  # weakest, in the order of `WEAKEST_LAST`
    motion: list[float] = field(default_factory=list)  # position, velocity, force of each axis, by SYNC
    held: list[float] = field(default_factory=list)  # velocity that acted in the hold before each SYNC, of each axis
    energies: list[float] = field(default_factory=list)  # true interaction at each SYNC [J]
    axes: int = 1

    def columns(self) -> Array:
        """Return true positions [m or rad], velocities and forces of the hand, shape (cycles, axes, 3)."""
        return np.array(self.motion).reshape(-1, self.axes, _COLUMNS)


class _Motor(NamedTuple):
    """One axis: its simulation, and its readings."""

    plant: AdmittancePlant
    counts: float  # of the encoder, per m or rad
    channel: ForceChannel
    per_count: float
    offset: float
    fastest: float  # displacement in one hold that stops the rig [m or rad]
    name: str

    def position(self) -> float:
        """Encoder reading [m or rad]."""
        return round(self.plant.encoder_position * self.counts) / self.counts

    def force(self) -> float:
        """Sensor reading [N or N*m]."""
        return self.channel.take(round(self.plant.read_force() / self.per_count + self.offset))


_JUMP: Final = 2.0  # of the speed limit, as in the drive's link policy


def run_display(scene: Scene, cycles: int) -> AdmittanceRun:
    """Result of a run of one axis, or of one group.

    Args:
        scene: Simulated scene of that axis or group alone.
        cycles: SYNCs.

    Raises:
        InputError: An axis is not simulated, or is no admittance display.
        ParameterError: The controller cannot be built.
    """
    motors = [_motor(axis, scene) for axis in scene.axes]
    found = AdmittanceRun(axes=len(motors))
    controller, step = _stepped(scene)
    try:
        _walk(motors, step, scene, cycles, found)
    except CanHapticError as error:
        found.ended = str(error).splitlines()[0]
    found.resolution = float(controller.energy_resolution)
    return found


def _motor(axis: AxisScene, scene: Scene) -> _Motor:
    given, display = axis.parameters, axis.parameters.admittance
    if display is None:
        raise InputError(f"{given.name}: is no admittance display, expected one")
    simulation = simulation_of(axis)
    plant = cast(AdmittancePlant, build_plant(simulation, scene.bus.sample_time_ns))
    channel = ForceChannel(display.force, scene.bus.sample_time)
    own = simulation.drive.display
    if own is not None:
        per_count, offset = own.force_per_count, own.force_offset_counts
    else:
        per_count, offset = display.force.per_count, display.force.offset_counts
    fastest = _JUMP * given.largest_speed * scene.bus.sample_time
    return _Motor(plant, given.counts_per_unit, channel, per_count, offset, fastest, given.name)


_Step = Callable[[list[float], list[float]], tuple[list[float], EnergyBalance]]


def _stepped(scene: Scene) -> tuple[Any, _Step]:
    """The controller, and a function from (positions, forces shown) to (commands, account)."""
    if scene.groups:
        group: Any = build_group(scene, scene.groups[0])

        def together(positions: list[float], forces: list[float]) -> tuple[list[float], EnergyBalance]:
            balance = group.step(positions, [-force for force in forces])
            return list(balance.torques), balance.account

        return group, together
    controller: Any = build_axis_controller(scene.axes[0])

    def alone(positions: list[float], forces: list[float]) -> tuple[list[float], EnergyBalance]:
        balance = controller.step(positions[0], -forces[0])
        return [balance.torque], balance

    return controller, alone


def _walk(motors: list[_Motor], step: _Step, scene: Scene, cycles: int, found: AdmittanceRun) -> None:
    period = scene.bus.sample_time_ns
    under_way = deque([[0.0] * len(motors) for _ in range(scene.bus.delay)])
    held, before = [0.0] * len(motors), [0.0] * len(motors)
    for motor in motors:
        motor.plant.begin(0)
    for k in range(cycles):
        if k:
            for motor, command in zip(motors, held, strict=True):
                motor.plant.advance_to(k * period, command)
        positions = [motor.position() for motor in motors]
        forces = [motor.force() for motor in motors]
        for motor, now, last in zip(motors, positions, before, strict=True):
            if motor.channel.is_wrong:
                found.ended = f"{motor.name}: the force sensor is beyond its range, or frozen"
            elif k and abs(now - last) > motor.fastest:
                found.ended = f"{motor.name}: the position moved faster than the speed limit"
            found.diverged |= not -FURTHEST < now < FURTHEST
        commands, account = step(positions, forces)
        found.held += held
        _take(motors, commands, account, found)
        if RANKS[account.certificate] > RANKS[found.certificate]:
            found.certificate = account.certificate
        if found.ended or found.diverged:
            return
        before = positions
        under_way.append(commands)
        held = under_way.popleft()


def _take(motors: list[_Motor], commands: list[float], account: EnergyBalance, found: AdmittanceRun) -> None:
    true = 0.0
    for motor in motors:
        plant = motor.plant
        true -= plant.energy().motor
        found.motion.extend((plant.position, plant.velocity, plant.force))
    found.cycles += 1
    found.energies.append(true)
    found.interaction, found.least_interaction = true, min(found.least_interaction, true)
    found.believed += account.h_i
    found.believed_error = max(found.believed_error, abs(found.believed - true))
    found.surplus = account.h_dis
    is_cut = account.certificate in _CUTS
    if is_cut or any(abs(command) > _STILL for command in commands):
        found.moving += 1
        found.cut += is_cut
    found.uncertified += account.certificate == _NONE


def felt(run: AdmittanceRun, scene: Scene) -> tuple[float, float]:
    """Mass [kg or kg*m^2] and damping [N*s/m or N*m*s/rad] that best fit true forces and velocities.

    F - k (q - rest) = m v' + b v + F_0, m and b the same for all axes; away from walls and limits of the position. NaN
    where there is too little motion, and on a path, across which a hand feels another mass.
    """
    if scene.groups and scene.groups[0].network.name != _FREE_MASS:
        return float("nan"), float("nan")
    motion, time = run.columns()[_FIRST:], scene.bus.sample_time
    if len(motion) < _FEWEST or not np.isfinite(motion).all() or np.ptp(motion[:, :, 1]) < _STILL:
        return float("nan"), float("nan")
    environment = (scene.groups[0].network if scene.groups else scene.axes[0].environment).parameters
    rows, forces = [], []
    for place in range(run.axes):
        position, speed, force = motion[1:-1, place, :].T
        rise = (motion[2:, place, 1] - motion[:-2, place, 1]) / (2.0 * time)
        spring = getattr(environment, "stiffness", 0.0) * (position - getattr(environment, "rest", 0.0))
        is_free = _is_free(scene, place, position, float(np.abs(speed).max()) * (3.0 * time + _BRAKING))
        rows.append(np.column_stack([rise, speed, np.tile(np.eye(run.axes)[place], (len(rise), 1))])[is_free])
        forces.append((force - spring)[is_free])
    every = np.concatenate(rows)
    if len(every) < _FEWEST:
        return float("nan"), float("nan")
    fit = np.linalg.lstsq(every, np.concatenate(forces), rcond=None)[0]
    return float(fit[0]), float(fit[1])


def _is_free(scene: Scene, place: int, position: Array, near: float) -> Mask:
    """SYNCs at which every axis is farther than a distance from its walls and limits."""
    environment: Any = (scene.groups[0].network if scene.groups else scene.axes[0].environment).parameters
    environment = environment.of_axis(place) if scene.groups else environment
    display = scene.axes[place].parameters.admittance
    low, high = getattr(display, "position_low", None), getattr(display, "position_high", None)
    low = max(environment.lower_wall, -np.inf if low is None else low)
    high = min(environment.upper_wall, np.inf if high is None else high)
    return np.asarray((position > low + near) & (position < high - near))
