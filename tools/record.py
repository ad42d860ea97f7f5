"""Records the bus logs under tests/recordings anew and shows what changed: `python tools/record.py [NAME ...]`.

`make test` replays them: the master must send today what it sent then. Record anew after a change that is meant to
alter what is sent, look at what this prints, and commit the recordings with the change.
"""

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final, NamedTuple

import can
from can.interfaces.virtual import VirtualBus

from canhaptic.cycle import Cycle, run
from canhaptic.drive.can.bus_cycle import can_buses
from canhaptic.drive.can.door import private_channel
from canhaptic.drive.can.link import Link
from canhaptic.drive.clock import VirtualClock
from canhaptic.drive.rig import Rig
from canhaptic.errors import CanHapticError
from canhaptic.logs.bus_reader import Frame, read_bus_log
from canhaptic.logs.decoder import BusDecoder
from canhaptic.logs.writer_process import BusLogWriter
from canhaptic.scene.build import build
from canhaptic.scene.buses import can_bus
from canhaptic.scene.far_side import build_far_end
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import Scene
from canhaptic.scene.parts import build_ports, build_servo_drive
from canhaptic.scene.scene_logs import describe_nodes

ROOT: Final = Path(__file__).resolve().parent.parent
FOLDER: Final = ROOT / "tests" / "recordings"
_IN_CONTACT: Final = ("environment.side=above",)  # the hand of the demo begins inside the wall
_EMCY_CYCLE: Final = 150
_TPDO: Final = 0x181  # of node 1
_HARDWARE_FAULT: Final = 0x5000  # EMCY error code


def _keeps(_number: int) -> bool:
    return False


class Plan(NamedTuple):
    """One recording."""

    config: str
    duration: float  # [s]
    overrides: tuple[str, ...] = ()
    loses: Callable[[int], bool] = _keeps
    """Whether the bus loses the TPDO with this number, counted from 0."""
    fault_cycle: int = 0  # after which the drive faults; 0: never


def _lost(number: int) -> bool:
    """Single TPDOs, a few in a row that the link policy bridges, at last more than it tolerates."""
    return number % 37 == 30 or 200 <= number < 208 or number >= 330


_AT_A_BOUND: Final = (  # a hand that knocks twice a second on a wall stiffer than 250 Hz can hold
    "bus.rate=250",
    "environment={type: spring_damper_wall, stiffness: 5000, damping: 5, position: 0}",
    "simulation.user.motion={type: sinusoid, amplitude: 30 mm, frequency: 2 Hz}",
)
_WITHOUT_FORCE: Final = ("passivity.hand_force=null", "passivity.hand_push=null")
_WITH_FRICTION: Final = (
    "passivity.device_friction_bound=0.6",
    "simulation.effects=[{type: coulomb_friction, kinetic: 0.5, static: 0.5}]",
)
_LATE: Final = {"sync_jitter": "0.02", "torque_window": "400 us", "current_lag": "300 us"}
_LIGHT_DISPLAY: Final = (  # lighter than the drive carries safely
    *("bus.rate=250", "environment.mass=0.3", "axes.0.admittance.handle_acceleration=20"),
    "simulation.admittance.grip={mass: 0.3, stiffness: 500, damping: 0}",
)


def _at_a_bound(*changes: str, loses: Callable[[int], bool] = _keeps) -> Plan:
    """Returns a plan of the demo at a bound."""
    return Plan("configs/demo.yaml", 0.8, (*_AT_A_BOUND, *changes), loses)


def _group(*changes: str, duration: float = 1.4, loses: Callable[[int], bool] = _keeps) -> Plan:
    """Returns a plan of a group at a bound."""
    at_a_bound = ("bus.rate=250", "groups.0.network.stiffness=6000", "groups.0.passivity.hand_force=1")
    return Plan("configs/xy_box.yaml", duration, (*at_a_bound, *changes), loses)


def _display(*changes: str) -> Plan:
    """Returns a plan of a light display."""
    return Plan("configs/admittance/virtual_mass.yaml", 0.8, (*_LIGHT_DISPLAY, *changes))


def _each(place: str, values: Mapping[str, str]) -> tuple[str, ...]:
    """Returns overrides of a section."""
    return tuple(f"{place}.{key}={value}" for key, value in values.items())


def _one_in_23(number: int) -> bool:
    return number % 23 == 11


_DECLARED_HAND: Final = _each(
    "passivity",
    {"hand_stiffness": "500", "hand_speed": "0.6 m/s", "drive_friction": "0", "drive_damping": "2"},
)
_PAPER: Final = ("paper_fig4_40hz", "paper_fig5_100hz", "paper_fig7_40hz", "paper_fig8_100hz")
_LATE_GROUP: Final = ("bus.rpdo=event", *_each("groups.0.passivity", _LATE))
_ONE_LOSS: Final = "groups.0.passivity.max_consecutive_losses=1"

RECORDINGS: Final = {
    "demo": Plan("configs/demo.yaml", 1.6),
    **{name: Plan(f"configs/{name}.yaml", 4.0) for name in _PAPER},
    "two_axes": Plan("tests/recordings/two_axes.yaml", 0.8),
    "emergency": Plan("configs/demo.yaml", 0.4, _IN_CONTACT, fault_cycle=_EMCY_CYCLE),
    "lost_frames": Plan("configs/demo.yaml", 0.6, (*_IN_CONTACT, "axes.handle.energy_uncertainty_limit=none"), _lost),
    "bound_hand_force": _at_a_bound("passivity.hand_force=2"),
    "bound_late_torque": _at_a_bound("bus.rpdo=event", *_each("passivity", _LATE)),
    "bound_device_damping": _at_a_bound(*_WITHOUT_FORCE, "passivity.device_damping=0.1"),
    "bound_hand_speed": _at_a_bound(*_WITHOUT_FORCE, "passivity.hand_speed=0.4", "passivity.energy_allowance=2 mJ"),
    "bound_lost_frames": _at_a_bound(
        "passivity.hand_force=2", "passivity.max_consecutive_losses=2", loses=lambda number: number % 23 in (11, 12)
    ),
    "bound_device_friction": _at_a_bound(*_WITHOUT_FORCE, *_WITH_FRICTION, "passivity.device_friction=0.4"),
    "bound_sum": _at_a_bound(
        *_WITH_FRICTION, *_each("passivity", {"hand_force": "2", "device_damping": "0.1", "device_friction": "0.2"})
    ),
    "bound_drag": _at_a_bound("passivity.hand_force=2", "passivity.drag=0.2", "passivity.earned_energy=5 mJ"),
    "bound_group": _group(),
    "bound_late_group": _group(*_LATE_GROUP),
    "bound_lossy_group": _group(_ONE_LOSS, loses=_one_in_23),
    "bound_late_lossy_group": _group(*_LATE_GROUP, _ONE_LOSS, duration=1.0, loses=_one_in_23),
    "bound_display": _display(),
    "bound_display_force": _display("passivity.largest_hand_force=40"),
    "bound_declared_hand": _display(*_DECLARED_HAND),
    "bound_group_of_handles": Plan("configs/two_handles.yaml", 0.4),
}


class LossyBus(VirtualBus):
    """A virtual bus that loses some of the TPDOs sent through it."""

    def __init__(self, channel: str, loses: Callable[[int], bool]) -> None:
        super().__init__(channel=channel, preserve_timestamps=True)
        self._loses = loses
        self._number = 0

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Sends a frame unless it is to be lost."""
        if msg.arbitration_id == _TPDO:
            self._number += 1
            if self._loses(self._number - 1):
                return
        super().send(msg, timeout)


def record(plan: Plan, path: Path) -> str:
    """Runs a scene with simulated drives in lock-step, records its bus, and returns how it ended."""
    scene = load_scene(ROOT / plan.config, plan.overrides)
    if scene.groups or any(axis.parameters.admittance is not None for axis in scene.axes):
        with build(scene, "free", bus_log=path) as experiment:
            run(experiment.cycle, round(plan.duration / scene.bus.sample_time))
        return "completed"
    channel = private_channel()
    writer = BusLogWriter(path, "vcan0", pace="free")
    with LossyBus(channel, plan.loses) as far_bus, VirtualBus(channel=channel, preserve_timestamps=True) as near_bus:
        group = build_far_end(scene, None, far_bus)[0]
        link = Link(near_bus, VirtualClock([group]), writer)
        drives = [build_servo_drive(axis, link, scene.bus) for axis in scene.axes]
        rig = Rig(can_buses(link, drives, can_bus(scene.bus)), drives, scene.bus)

        def inject(cycles: int) -> None:
            if cycles == plan.fault_cycle:
                group.drives[0].inject_fault(_HARDWARE_FAULT)

        try:
            run(Cycle(rig, build_ports(scene)), round(plan.duration / scene.bus.sample_time), progress=inject)
            ended = "completed"
        except CanHapticError as error:
            ended = f"{type(error).__name__}: {error}"
        finally:
            writer.close()
    return ended


def changes(old: Path, new: Path, scene: Scene) -> list[str]:
    """Returns what differs between two recordings, as lines; none when nothing does."""
    if not old.is_file():
        return ["new"]
    if old.read_bytes() == new.read_bytes():
        return []
    before, after = list(read_bus_log(old)), list(read_bus_log(new))
    unequal = [n for n, (a, b) in enumerate(zip(before, after, strict=False)) if a[:4] != b[:4]]
    contents = [Counter((frame.can_id, frame.data) for frame in frames) for frames in (before, after)]
    gone, new_ones = (contents[0] - contents[1]).total(), (contents[1] - contents[0]).total()
    lines = [
        f"{len(before)} frames before, {len(after)} now: {gone} are gone, {new_ones} are new; the first that differ:"
    ]
    first = unequal[0] if unequal else min(len(before), len(after))
    for label, frames in (("before", before), ("now", after)):
        lines.append(f"  {label:<7} {_decoded(frames, first, scene)}")
    return lines


def _decoded(frames: list[Frame], place: int, scene: Scene) -> str:
    if place >= len(frames):
        return "no such frame"
    decoder = BusDecoder(describe_nodes(scene))
    for frame in frames[:place]:
        decoder.decode(frame.can_id, frame.data)
    frame = frames[place]
    words = decoder.decode(frame.can_id, frame.data)
    data = frame.data.hex().upper()
    return f"line {frame.number}: {frame.can_id:03X}#{data} {words.kind} {words.node}: {words.text}".rstrip(" :")


def main(words: list[str] | None = None) -> int:
    """Returns the exit status: 0; with --check 1 when a recording would change."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(RECORDINGS)}; all by default")
    parser.add_argument("--check", action="store_true", help="change nothing; exit with 1 if a recording would change")
    arguments = parser.parse_args(words)
    unknown = set(arguments.names) - set(RECORDINGS)
    if unknown:
        parser.error(f"no such recording: {', '.join(sorted(unknown))}")
    changed = 0
    for name in arguments.names or RECORDINGS:
        changed += _renew(name, RECORDINGS[name], keep=arguments.check)
    return 1 if arguments.check and changed else 0


def _renew(name: str, plan: Plan, keep: bool) -> bool:
    """Records one anew, prints what changed, and returns whether anything did."""
    old = FOLDER / f"{name}.log"
    with tempfile.TemporaryDirectory() as folder:
        new = Path(folder) / f"{name}.log"
        ended = record(plan, new)
        lines = changes(old, new, load_scene(ROOT / plan.config, plan.overrides))
        print(f"{name}: {new.stat().st_size / 1000:.0f} kB, {ended}")
        for line in lines or ["unchanged"]:
            print(f"  {line}")
        if lines and not keep:
            old.write_bytes(new.read_bytes())
    return bool(lines)


if __name__ == "__main__":
    sys.exit(main())
