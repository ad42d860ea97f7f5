"""Runs the real master and controllers of a scene against a recording, and compares every frame that they send."""

from contextlib import ExitStack
from pathlib import Path
from typing import Final, Literal, TypedDict

import can

from canhaptic.canopen import objects as od
from canhaptic.cycle import Cycle, run
from canhaptic.drive.can.link import Link
from canhaptic.drive.can.servo_drive import ServoDrive
from canhaptic.drive.clock import WallClock
from canhaptic.drive.rig import Rig
from canhaptic.errors import InputError, RigError
from canhaptic.logs.bus_reader import SkippedKind
from canhaptic.replay.difference import FirstDifference, describe
from canhaptic.replay.joined_rig import JoinedRig
from canhaptic.replay.recorded_clock import RecordedClock
from canhaptic.replay.recorded_side import RecordedSide, ReplayOverError
from canhaptic.replay.recording import Recording
from canhaptic.replay.roles import roles_of
from canhaptic.result import RunResult, run_result
from canhaptic.scene.bus import open_bus, private_channel
from canhaptic.scene.channels import Channels
from canhaptic.scene.loss_limits import build_loss_meters
from canhaptic.scene.models import Scene
from canhaptic.scene.parts import (
    build_axis_controllers,
    build_axis_groups,
    build_axis_meters,
    build_servo_drive,
    group_places,
)

_BUS: Final[dict[str, object]] = {"interface": "virtual", "channel": None, "options": {}}


class ReplayedFrames(TypedDict):
    """Numbers of frames."""

    recorded: int
    played: int
    compared: int


class ReplayResult(TypedDict):
    """Result of a replay; times in [s]."""

    status: Literal["identical", "different"]
    recording: str
    start: Literal["boot", "sync"]
    skipped: dict[SkippedKind, int]  # frames left out
    reads_left_out: list[str]  # `axis: object` that the start reads or writes today and the recorded master did not
    frames: ReplayedFrames
    cycles: int
    duration: float
    elapsed: float
    speed: float
    ended: str
    difference: FirstDifference | None
    account: RunResult


def replay_bus_log(
    bus_log: str | Path, scene: Scene, *, realtime: bool = False, from_sync: bool = False, dry_run: bool = False
) -> ReplayResult:
    """Replay a recording and report whether the master sends the same frames today.

    Boot, SDO answers, TPDOs, heartbeats and EMCYs come from the recording, on python-can's virtual bus; rig,
    controllers and accounts are those of the scene. A recording without the start of the drives is replayed from the
    first SYNC that found every axis enabled, with the maps of the scene and controllers at rest.

    Args:
        bus_log: candump text, BLF, TRC or ASC.
        scene: Scene of the run; its bus is replaced by a virtual one and nothing is simulated.
        realtime: Keeps the pace of the recording instead of going as fast as the machine allows.
        from_sync: Leaves the start out even if it was recorded.
        dry_run: Whether the recorded run was a dry run.

    Raises:
        InputError: The recording cannot be read, does not fit the scene, has no SYNC to begin with, or no whole cycle.
    """
    recording = Recording(bus_log, roles_of(scene), Channels(scene))
    joins = from_sync or not recording.has_boot
    if joins and recording.first_sync < 0:
        raise InputError(
            f"{bus_log}: the log has no bring-up and no SYNC that every axis of {scene.source} "
            "answered in OPERATION ENABLED; replay needs one of them"
        )
    with ExitStack() as stack:
        return _Replay(recording, scene, joins, realtime, dry_run, stack).run()


class _Replay:
    """One replay, built."""

    def __init__(
        self, recording: Recording, scene: Scene, joins: bool, realtime: bool, dry_run: bool, stack: ExitStack
    ) -> None:
        self._recording = recording
        self._scene = scene
        self._joins = joins
        first = recording.first_sync if joins else 0
        self._start = recording.frames[first].timestamp_ns
        far_buses: list[can.BusABC] = []
        near_buses: list[can.BusABC] = []
        for _ in scene.buses:
            channel = private_channel()
            for buses in (far_buses, near_buses):
                buses.append(open_bus(scene.bus.model_copy(update=_BUS), channel))
                stack.callback(buses[-1].shutdown)
        self._left_out: list[str] = []
        self._wall = WallClock()
        self._side = RecordedSide(far_buses, recording, first)
        clock = RecordedClock(self._side, self._start, self._wall if realtime else None)
        rig = self._rig([Link(bus, clock) for bus in near_buses], dry_run)
        groups, known = build_axis_groups(scene), build_axis_meters(scene)
        meters = build_loss_meters(scene)
        self._cycle = Cycle(rig, build_axis_controllers(scene), groups=groups, axis_meters=known, loss_meters=meters)

    def _rig(self, links: list[Link], dry_run: bool) -> Rig:
        scene = self._scene
        by_name = {bus.name: (link, bus.parameters) for bus, link in zip(scene.buses, links, strict=True)}
        drives = [build_servo_drive(axis, *by_name[axis.bus], dry_run=dry_run) for axis in scene.axes]
        self._follow_older_master(drives)
        return (JoinedRig if self._joins else Rig)(links, drives, scene.bus, group_places(scene))

    def _follow_older_master(self, drives: list[ServoDrive]) -> None:
        """Leave out of the start what no recorded drive answers: older masters left 0x1006 and offsets alone."""
        if self._joins:
            return
        places = {bus.name: place for place, bus in enumerate(self._scene.buses)}
        for axis, drive in zip(self._scene.axes, drives, strict=True):
            where = places[axis.bus], drive.axis.node_id
            listed = {od.COMMUNICATION_CYCLE_PERIOD} & drive.dictionary.keys()
            drive.left_out = frozenset(
                index for index in (*listed, *drive.axis.offsets) if not self._recording.has_sdo(*where, index)
            )
            self._left_out += [f"{drive.axis.name}: 0x{index:04X}" for index in sorted(drive.left_out)]

    def run(self) -> ReplayResult:
        """Run to the end of the recording or to the first difference."""
        bus = self._scene.bus
        ramp_cycles = max(1, round(bus.stop_ramp * 1e9) // bus.sample_time_ns)
        begin, ended = self._wall.now(), "at the end of the recording"
        try:
            run(self._cycle, self._recording.operator_cycles(ramp_cycles))
            ended = "stopped by the operator, as recorded"
        except ReplayOverError:
            pass
        except RigError as error:
            ended = f"{type(error).__name__}: {error}"
        if self._cycle.cycles == 0 and self._side.departure is None and self._side.unsent < 0:
            raise InputError(
                f"{self._recording.path}: holds no whole cycle (SYNC, TPDOs, RPDOs), so that nothing was compared that "
                "a controller computed; record for longer, or from an earlier time"
            )
        return self._result(ended, (self._wall.now() - begin) * 1e-9)

    def _result(self, ended: str, elapsed: float) -> ReplayResult:
        recording, side, scene = self._recording, self._side, self._scene
        difference = describe(recording, side, scene)
        duration = (recording.frames[-1].timestamp_ns - self._start) * 1e-9
        return {
            "status": "identical" if difference is None else "different",
            "recording": str(recording.path),
            "start": "sync" if self._joins else "boot",
            "skipped": dict(recording.skipped),
            "reads_left_out": self._left_out,
            "frames": {"recorded": len(recording.frames), "played": side.played, "compared": side.compared},
            "cycles": self._cycle.cycles,
            "duration": duration,
            "elapsed": elapsed,
            "speed": duration / elapsed if elapsed else 0.0,
            "ended": "at the first difference" if side.departure is not None else ended,
            "difference": difference,
            "account": run_result(
                self._cycle,
                [(axis.parameters.name, axis.parameters.unit) for axis in scene.axes],
                status="replayed",
                config_hash=scene.config_hash(),
                sample_time=scene.bus.sample_time,
                method="",
            ),
        }
