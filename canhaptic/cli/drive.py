"""`canhaptic drive CONFIG`: the simulated drives of a scene alone, at wall-clock pace, for a master elsewhere."""

import argparse
from contextlib import ExitStack

import can

from canhaptic.cli.arguments import add_scene, scene_of, seconds
from canhaptic.cli.output import write_note
from canhaptic.cli.stop_signal import StopSignal
from canhaptic.drive.clock import WallClock
from canhaptic.errors import InputError, LinkError
from canhaptic.scene.build import build_drive_group
from canhaptic.scene.bus import open_bus, with_effects
from canhaptic.scene.models import Scene
from canhaptic.sim.drive_group import DriveGroup

_LONGEST_WAIT = 50_000_000  # [ns] between two looks at the stop signal


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments of `drive`."""
    add_scene(parser)
    parser.add_argument("--duration", metavar="S", type=seconds, help="how long to live [s]; by default until stopped")


def execute(arguments: argparse.Namespace) -> int:
    """Lives until the duration is over (0) or a signal comes (130, 143)."""
    scene = scene_of(arguments)
    if scene.bus.interface == "virtual" and scene.bus.channel is None:
        raise InputError(
            f"{scene.source}: bus.interface 'virtual' ends inside this process, no master can reach the drive; "
            "name a bus that both use, as --set bus.interface=udp_multicast --set bus.channel=239.74.163.21"
        )
    with ExitStack() as stack:
        stop = stack.enter_context(StopSignal())
        bus = open_bus(scene.bus, scene.bus.channel)
        stack.callback(bus.shutdown)
        if scene.bus_effects is not None:
            bus = faulty_bus = with_effects(bus, scene, "drive")
            stack.callback(faulty_bus.shutdown)
            faulty_bus.use(WallClock(spin_margin=0.0))
        group = build_drive_group(scene, bus)
        write_note(f"{_names(scene)} on {scene.bus.interface} {scene.bus.channel or ''}: powered, Ctrl-C ends")
        _live(group, bus, arguments.duration, stop)
    return stop.exit_status


def _names(scene: Scene) -> str:
    return ", ".join(f"{axis.parameters.name} (node {axis.parameters.node_id})" for axis in scene.axes)


def _live(group: DriveGroup, bus: can.BusABC, duration: float | None, stop: StopSignal) -> None:
    """Hands every frame to the drives as it comes, and lets their timers run."""
    clock = WallClock(spin_margin=0.0)
    now = clock.now()
    end = None if duration is None else now + round(duration * 1e9)
    group.process(now)
    while not stop.requested() and (end is None or now < end):
        try:
            message = clock.receive(bus, min(group.next_due(), now + _LONGEST_WAIT))
        except (can.CanError, OSError) as error:
            raise LinkError(f"the bus cannot be read: {error}; check cable and interface") from error
        now = clock.now()
        if message is not None:
            for drive in group.drives:
                drive.take(message, now)
        group.process(now)
