"""Admittance displays in a loop without a bus: plants, sensors, encoders, a controller, and the energies of the plants.

One axis, or one group of axes with one account. Encoder and force are whole counts, commands whole quanta, with the
same delay as on the bus of the scene; an error that would stop the rig ends the run.
"""

from collections import deque
from dataclasses import dataclass, field
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from canhaptic.control.balance import RANKS, Certificate
from canhaptic.drive.profile.admittance_parameters import ForceChannel
from canhaptic.errors import CanHapticError, InputError
from canhaptic.lab.loop.axis_loop import EVERYWHERE, FURTHEST, Array, LoopRun, Recorder, finished
from canhaptic.scene.far_side import build_plant
from canhaptic.scene.method import simulation_of
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.scene.parts import build_axis_controller, build_group
from canhaptic.sim.plant.velocity_drive import AdmittancePlant

_STILL: Final = 1e-9  # command that counts as none [m/s or rad/s]
_FEWEST: Final = 30  # SYNCs from which the felt mass is computed


def is_display(scene: Scene) -> bool:
    """Whether the axes of a scene with a single part are admittance displays."""
    return all(axis.parameters.admittance is not None for axis in scene.axes)


@dataclass(frozen=True)
class AdmittanceRun(LoopRun):
    """Result of one run; energies are of all axes together, and a torque is a velocity that acted [m/s or rad/s]."""

    motion: Array = field(default_factory=lambda: np.empty((0, 1, 3)))  # true positions, velocities and forces
    resolution: float = 0.0  # uncertainty of the energy [J]

    def shares(self) -> tuple[float, float, int]:
        """Return the shares of cut holds among those with a command, and of uncertified ones; weakest certificate."""
        certificate = self.booked.certificate.astype(int)
        cuts = Certificate.VELOCITY_LOOP, Certificate.LARGEST_HAND_FORCE, Certificate.DECLARED_HAND
        cut = np.isin(certificate, [of.value for of in cuts])
        moving = np.count_nonzero(cut | (np.abs(self.booked.torque) > _STILL))
        weakest = max(certificate.tolist(), key=RANKS.__getitem__, default=Certificate.EXACT.value)
        cycles = max(1, len(certificate))
        return cut.sum() / max(1, moving), np.count_nonzero(certificate == Certificate.NONE.value) / cycles, weakest


class _Motor:
    """One axis: its simulation, and its readings."""

    def __init__(self, axis: AxisScene, scene: Scene) -> None:
        given, display, simulation = axis.parameters, axis.parameters.admittance, simulation_of(axis)
        if display is None:
            raise InputError(f"{given.name}: is not an admittance display, expected one")
        self.name, self._counts = given.name, given.counts_per_unit
        self.plant = cast(AdmittancePlant, build_plant(simulation, scene.bus.sample_time_ns))
        self.channel = ForceChannel(display.force, scene.bus.sample_time)
        own, self._per_count, self._offset = (
            simulation.drive.display,
            display.force.per_count,
            display.force.offset_counts,
        )
        if own is not None:
            self._per_count, self._offset = own.force_per_count, own.force_offset_counts
        self.fastest = 2.0 * given.largest_speed * scene.bus.sample_time  # [m or rad] in a hold, as in the link policy

    def position(self) -> float:
        """Encoder reading [m or rad]."""
        return round(self.plant.encoder_position * self._counts) / self._counts

    def force(self) -> float:
        """Sensor reading [N or N*m]."""
        return self.channel.take(round(self.plant.read_force() / self._per_count + self._offset))


def run_display(scene: Scene, cycles: int) -> AdmittanceRun:
    """Result of a run of one axis, or of one group.

    Args:
        scene: Simulated scene of that axis or group alone.
        cycles: SYNCs.

    Raises:
        InputError: An axis is not simulated, or is no admittance display.
        ParameterError: The controller cannot be built.
    """
    motors, groups = [_Motor(axis, scene) for axis in scene.axes], scene.groups
    controller: Any = build_group(scene, groups[0]) if groups else build_axis_controller(scene.axes[0])
    recorder, motion, reason = Recorder(len(motors)), list[list[float]](), ""
    try:
        reason = _walk(motors, controller, scene, cycles, recorder, motion)
    except CanHapticError as error:
        reason = str(error).splitlines()[0]
    run = finished(recorder.run("stopped" if reason else "", reason), cycles, EVERYWHERE)
    moved = np.array(motion).reshape(-1, len(motors), 3)
    return AdmittanceRun(run.rows, run.axes, run.ended, run.reason, run.engine, moved, controller.energy_resolution)


def _walk(
    motors: list[_Motor], controller: Any, scene: Scene, cycles: int, recorder: Recorder, motion: list[list[float]]
) -> str:
    """Record every SYNC; return why the rig was stopped."""
    period = scene.bus.sample_time_ns
    under_way = deque([[0.0] * len(motors) for _ in range(scene.bus.delay)])
    held, before, reason = [0.0] * len(motors), [0.0] * len(motors), ""
    for motor in motors:
        motor.plant.begin(0)
    for k in range(cycles):
        for motor, command in zip(motors if k else (), held, strict=False):
            motor.plant.advance_to(k * period, command)
        positions, forces = [motor.position() for motor in motors], [motor.force() for motor in motors]
        for motor, now, last in zip(motors, positions, before, strict=True):
            if motor.channel.is_wrong:
                reason = f"{motor.name}: the force sensor is beyond its range, or frozen"
            elif k and abs(now - last) > motor.fastest:
                reason = f"{motor.name}: the position moved faster than the speed limit"
        if scene.groups:
            balance = controller.step(positions, [-force for force in forces])
            commands, account = list(balance.torques), balance.account
        else:
            account = controller.step(positions[0], -forces[0])
            commands = [account.torque]
        plants = [motor.plant for motor in motors]
        true, received = [plant.position for plant in plants], 0.0 - sum(plant.energy().motor for plant in plants)
        recorder.take(received, positions, true, held, account)
        motion.append([value for plant in plants for value in (plant.position, plant.velocity, plant.force)])
        if reason or not all(-FURTHEST < now < FURTHEST for now in positions):
            return reason
        before = positions
        under_way.append(commands)
        held = under_way.popleft()
    return ""


def felt(run: AdmittanceRun, scene: Scene) -> tuple[float, float]:
    """Mass [kg or kg*m^2] and damping [N*s/m or N*m*s/rad] that best fit true forces and velocities.

    F - k (q - rest) = m v' + b v + F_0, m and b the same for all axes; away from walls and limits of the position. NaN
    where there is too little motion, and on a path, across which a hand feels another mass.
    """
    if scene.groups and scene.groups[0].network.name != "virtual_mass":
        return float("nan"), float("nan")
    motion, time = run.motion[20:], scene.bus.sample_time
    if len(motion) < _FEWEST or not np.isfinite(motion).all() or np.ptp(motion[:, :, 1]) < _STILL:
        return float("nan"), float("nan")
    environment = (scene.groups[0].network if scene.groups else scene.axes[0].environment).parameters
    rows, forces = [], []
    axes = motion.shape[1]
    for place in range(axes):
        position, speed, force = motion[1:-1, place, :].T
        rise = (motion[2:, place, 1] - motion[:-2, place, 1]) / (2.0 * time)
        spring = getattr(environment, "stiffness", 0.0) * (position - getattr(environment, "rest", 0.0))
        near = float(np.abs(speed).max()) * (3.0 * time + 10e-3)  # in which a drive stops
        is_free = _is_free(scene, place, position, near)
        rows.append(np.column_stack([rise, speed, np.tile(np.eye(axes)[place], (len(rise), 1))])[is_free])
        forces.append((force - spring)[is_free])
    every = np.concatenate(rows)
    if len(every) < _FEWEST:
        return float("nan"), float("nan")
    fit = np.linalg.lstsq(every, np.concatenate(forces), rcond=None)[0]
    return float(fit[0]), float(fit[1])


def _is_free(scene: Scene, place: int, position: Array, near: float) -> NDArray[np.bool_]:
    """SYNCs at which every axis is farther than a distance from its walls and limits."""
    environment: Any = (scene.groups[0].network if scene.groups else scene.axes[0].environment).parameters
    environment = environment.of_axis(place) if scene.groups else environment
    display = scene.axes[place].parameters.admittance
    low, high = getattr(display, "position_low", None), getattr(display, "position_high", None)
    low = max(environment.lower_wall, -np.inf if low is None else low)
    high = min(environment.upper_wall, np.inf if high is None else high)
    return np.asarray((position > low + near) & (position < high - near))
