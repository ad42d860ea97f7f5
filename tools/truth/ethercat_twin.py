"""A scene of a CAN bus, built on a line of EtherCAT drives: the same controllers, plants and account on another bus."""

from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

from canhaptic.canopen.esi import read_esi
from canhaptic.cycle import Cycle, run
from canhaptic.drive.clock import VirtualClock
from canhaptic.drive.cycle_parameters import CycleParameters
from canhaptic.drive.ethercat.bus_cycle import EthercatBusCycle
from canhaptic.drive.ethercat.parameters import EthercatAxisParameters, EthercatBusParameters
from canhaptic.drive.ethercat.servo_drive import EthercatDrive as MasterDrive
from canhaptic.drive.ethercat.thin_master import ThinMaster
from canhaptic.drive.profile.torque_axis_parameters import TorqueAxisParameters
from canhaptic.drive.rig import Rig
from canhaptic.scene.build import Experiment, build_loss_meters
from canhaptic.scene.far_side import build_plant
from canhaptic.scene.models import AxisScene, Scene
from canhaptic.scene.parts import build_axis_meters, build_ports
from canhaptic.sim.drive.ethercat.cable import Cable, CableEffects
from canhaptic.sim.drive.ethercat.drive_node import ClockParameters, EthercatDrive

ESI: Final = Path(__file__).resolve().parents[2] / "eds" / "ethercat_servo.xml"
_SETTLED: Final = 3.0
_PPB: Final = 1e9
_PERIODS_WATCHED: Final = 10
_EPOCH: Final = 123_456_789  # [ns] by which the local times of neighbouring drives differ


class TwinExperiment(Experiment):
    """An experiment whose drives are on a simulated EtherCAT line.

    Args:
        scene: A simulated scene of one CAN bus with synchronous RPDOs.
        effects: Faults of frames; None: none.
        frames: Frames in a cycle.
        seed: Seed of the faults.
    """

    def __init__(self, scene: Scene, effects: CableEffects | None = None, frames: int = 2, seed: int = 0) -> None:
        self.scene, self.pace, self._log_failure = scene, "free", ""
        self.config_hash = scene.config_hash()
        self.energy_log = self.bus_log = self.code = None
        self.faulty_buses = {}
        period, drift = scene.bus.sample_time_ns, 0.0 if effects is None else effects.drift
        drives = [self._drive(axis, period, round(drift * _PPB * (-1) ** n), n) for n, axis in enumerate(scene.axes)]
        self.far_side: Any = Cable(drives, period, effects, seed)
        self.clock = clock = VirtualClock((self.far_side,))
        self.far_side.use(clock)
        shared = {key: getattr(scene.bus, key) for key in CycleParameters.model_fields}
        watchdog = max(0.01, _PERIODS_WATCHED * scene.bus.sample_time)
        bus = EthercatBusParameters(**shared, type="ethercat", frames=frames, watchdog=watchdog)
        self.line = EthercatBusCycle(ThinMaster(self.far_side, clock), clock, bus)
        axes = [self._axis(axis, n) for n, axis in enumerate(scene.axes)]
        for axis, of in zip(axes, scene.axes, strict=True):
            axis.hold = scene.hold_of(of)
        self.rig = Rig([self.line], axes, bus, scene.group_places)
        known = build_axis_meters(scene), build_loss_meters(scene)
        jitters = [axis.loop.sync_jitter or 0.0 for axis in scene.axes]
        readers = [drive.truth for drive in drives]
        self.cycle = Cycle(self.rig, build_ports(scene), None, lambda: [read() for read in readers], *known, jitters)
        self._stack = ExitStack()

    def _drive(self, axis: AxisScene, period: int, drift: int, place: int) -> EthercatDrive:
        clock = ClockParameters(drift, _EPOCH * place)
        assert axis.simulation is not None
        plant = build_plant(axis.simulation, period)
        return EthercatDrive(read_esi(ESI), plant, axis.simulation.drive, period, clock)

    def _axis(self, axis: AxisScene, place: int) -> MasterDrive:
        known = axis.parameters.model_copy(update={"torque_limit": axis.loop.torque_limit})
        given = {key: getattr(known, key) for key in TorqueAxisParameters.model_fields}
        of = EthercatAxisParameters.model_construct(**given, position=place, esi=ESI)
        late = (axis.loop.torque_window or 0.0) + _SETTLED * (axis.loop.current_lag or 0.0)
        return MasterDrive(self.line, of, read_esi(ESI), lateness=late)


def torques_of(experiment: Experiment, cycles: int) -> list[tuple[float, ...]]:
    """Runs an experiment without closing it, and returns the torques that were written in each cycle [N or N*m]."""
    torques, rig = list[tuple[float, ...]](), experiment.rig
    write = rig.write_torques

    def noted(given: Any) -> None:
        torques.append(tuple(given))
        write(given)

    setattr(rig, "write_torques", noted)  # noqa: B010
    run(experiment.cycle, cycles)
    return torques


def true_energies(experiment: Experiment) -> list[float]:
    """Returns the energies of the plants of a simulated experiment [J]."""
    far: Any = experiment.far_side
    return [energy for drive in far.drives for energy in drive.truth().energy]
