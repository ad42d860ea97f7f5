"""Run an admittance display without a bus: plants, sensors, encoders, controller, and the energies of the plants.

A run has one axis, or one group of axes with a common account. Encoder and force are read in whole counts, commands are
whole quanta, and the delay is that of the scene's bus. An error that would stop the rig ends the run.
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

_STILL: Final = 1e-9  # smallest command that counts as motion [m/s or rad/s]
_FEWEST: Final = 30  # fewest SYNCs for a fit of the apparent mass


def is_display(scene: Scene) -> bool:
    """Return whether all axes of a scene are admittance displays."""
    return all(axis.parameters.admittance is not None for axis in scene.axes)


@dataclass(frozen=True)
class AdmittanceRun(LoopRun):
    """Result of one run; energies are sums over all axes, and `torque` holds velocity commands [m/s or rad/s]."""

    motion: Array = field(default_factory=lambda: np.empty((0, 1, 3)))  # true position, velocity, force of each axis
    resolution: float = 0.0  # uncertainty of the energy [J]

    def shares(self) -> tuple[float, float, int]:
        """Return how often a certificate limited a command, how often no certificate held, and the weakest one.

        Returns:
            Share of the holds with a command in which a certificate limited it; share of all holds without a
            certificate; and the weakest certificate.
        """
        certificate = self.booked.certificate.astype(int)
        cuts = Certificate.VELOCITY_LOOP, Certificate.LARGEST_HAND_FORCE, Certificate.DECLARED_HAND
        cut = np.isin(certificate, [of.value for of in cuts])
        moving = np.count_nonzero(cut | (np.abs(self.booked.torque) > _STILL))
        weakest = max(certificate.tolist(), key=RANKS.__getitem__, default=Certificate.EXACT.value)
        cycles = max(1, len(certificate))
        return cut.sum() / max(1, moving), np.count_nonzero(certificate == Certificate.NONE.value) / cycles, weakest


class _Motor:
    """One simulated axis, with its encoder and force sensor."""

    def __init__(self, axis: AxisScene, scene: Scene) -> None:
        given, display, simulation = axis.parameters, axis.parameters.admittance, simulation_of(axis)
        if display is None:
            raise InputError(f"{given.name}: is not an admittance display, expected one")
        self.name, self._counts = given.name, given.counts_per_unit
        self.plant = cast(AdmittancePlant, build_plant(simulation, scene.bus.sample_time_ns))
        self.channel = ForceChannel(display.force, scene.bus.sample_time)
        own = simulation.drive.display
        self._per_count = own.force_per_count if own else display.force.per_count
        self._offset = own.force_offset_counts if own else display.force.offset_counts
        self.fastest = 2.0 * given.largest_speed * scene.bus.sample_time  # [m or rad] in a hold, as in the link policy

    def position(self) -> float:
        """Encoder reading [m or rad]."""
        return round(self.plant.encoder_position * self._counts) / self._counts

    def force(self) -> float:
        """Sensor reading [N or N*m]."""
        return self.channel.take(round(self.plant.read_force() / self._per_count + self._offset))


def run_display(scene: Scene, cycles: int) -> AdmittanceRun:
    """Run one axis or one group of admittance displays.

    Args:
        scene: Simulated scene with only that axis or group.
        cycles: Number of SYNCs.

    Raises:
        InputError: An axis is not simulated, or is not an admittance display.
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
    """Run and record every SYNC; return "", or why the rig was stopped."""
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
    """Return the apparent mass [kg or kg*m^2] and damping [N*s/m or N*m*s/rad], by least squares.

    F - k (q - rest) = m v' + b v + F_0 is fitted to true forces and velocities, with one m and b for all axes, away
    from walls and position limits. NaN where there is too little motion, and for a path, because its mass depends on
    the direction.
    """
    if scene.groups and scene.groups[0].network.name != "virtual_mass":
        return float("nan"), float("nan")
    motion, time = run.motion[20:], scene.bus.sample_time
    if len(motion) < _FEWEST or not np.isfinite(motion).all() or np.ptp(motion[:, :, 1]) < _STILL:
        return float("nan"), float("nan")
    environment: Any = (scene.groups[0].network if scene.groups else scene.axes[0].environment).parameters
    rows, forces = [], []
    axes = motion.shape[1]
    for place in range(axes):
        position, speed, force = motion[1:-1, place, :].T
        rise = (motion[2:, place, 1] - motion[:-2, place, 1]) / (2.0 * time)
        part = environment.of_axis(place) if scene.groups else environment
        spring = getattr(part, "stiffness", 0.0) * (position - getattr(part, "rest", 0.0))
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
    """Return at which SYNCs an axis is farther than `near` from its walls and limits, shape (n,)."""
    environment: Any = (scene.groups[0].network if scene.groups else scene.axes[0].environment).parameters
    environment = environment.of_axis(place) if scene.groups else environment
    display = scene.axes[place].parameters.admittance
    low, high = getattr(display, "position_low", None), getattr(display, "position_high", None)
    low = max(environment.lower_wall, -np.inf if low is None else low)
    high = min(environment.upper_wall, np.inf if high is None else high)
    return np.asarray((position > low + near) & (position < high - near))
