"""`canhaptic drive CONFIG`: the simulated drives of a scene, in real time, for a master in another process."""

import argparse
import gc
import selectors
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Any

import can

from canhaptic.cli.options import scene_of
from canhaptic.drive.clock import WallClock
from canhaptic.errors import InputError, LinkError
from canhaptic.host.realtime import Realtime
from canhaptic.host.stop_signal import StopSignal
from canhaptic.scene.buses import PLACES, kind_of, part
from canhaptic.scene.far_side import build_far_end, with_effects
from canhaptic.scene.models import NamedBus, Scene
from canhaptic.view.terminal import write_note

_LONGEST_WAIT = 50_000_000  # [ns] between two looks at the stop signal
_POLL_PERIOD = 50_000  # [ns] between two looks at several buses that cannot be waited on together


def execute(arguments: argparse.Namespace) -> int:
    """Run the simulated drives; return 0 after the duration, 128 + n after signal n."""
    scene = scene_of(arguments)
    if any(bus.parameters.interface == "virtual" and bus.parameters.channel is None for bus in scene.buses):
        text = f"{scene.source}: bus.interface 'virtual' exists in this process only, so no master can reach the drive"
        example = "--set bus.interface=udp_multicast --set bus.channel=239.74.163.21"
        if kind_of(scene.bus) != "can":
            example = "--set bus.interface=vt1, one end of a veth pair (ip link add vt0 type veth peer name vt1)"
        raise InputError(f"{text}; use a bus that both processes can open, for example {example}")
    with ExitStack() as stack:
        stop = stack.enter_context(StopSignal(insists=True))
        realtime = Realtime(scene.bus.realtime)
        stack.callback(realtime.end)
        realtime.begin()
        for name, answer in realtime.report.items():
            write_note(f"  bus.realtime.{name}: {answer}")
        far_ends = [_far_end(scene, place, stack) for place in range(len(scene.buses))]
        stack.callback(gc.unfreeze)
        gc.collect()
        gc.freeze()  # a collection that walks everything imported would make the drives late for a SYNC
        write_note("; ".join(_names(scene, bus) for bus in scene.buses) + ": powered, Ctrl-C ends")
        _live(far_ends, arguments.duration, stop)
    return stop.exit_status


def _far_end(scene: Scene, place: int, stack: ExitStack) -> tuple[Any, Any]:
    """Open one bus of the scene; return what frames come from, and what they go to: its simulated drives."""
    name, parameters = scene.buses[place]
    if kind_of(parameters) != "can":
        cable, _ = build_far_end(scene, name)
        cable.use(WallClock(spin_margin=0.0))
        line = part(kind_of(parameters), "served")(cable, parameters.interface)
        stack.callback(line.shutdown)
        return line, line
    bus = part("can", "open")(parameters, stack)
    if (faulty_bus := with_effects(bus, scene, "drive", place)) is not None:
        bus = faulty_bus
        stack.callback(faulty_bus.shutdown)
        faulty_bus.use(WallClock(spin_margin=0.0))
    return bus, build_far_end(scene, name, bus)[0]


def _names(scene: Scene, bus: NamedBus) -> str:
    key = PLACES[kind_of(bus.parameters)]
    named = ((of.parameters.name, getattr(of.parameters, key)) for of in scene.axes_on(bus.name))
    axes = ", ".join(f"{axis} ({key.removesuffix('_id')} {place})" for axis, place in named)
    channel = bus.parameters.channel
    return f"{axes} on {bus.parameters.interface} {'' if channel is None else channel}".rstrip()


def _live(far_ends: Sequence[tuple[Any, Any]], duration: float | None, stop: StopSignal) -> None:
    """Pass each frame to the drives as it arrives, and run their timers."""
    clock = WallClock(spin_margin=0.0)
    now = clock.now()
    end = None if duration is None else now + round(duration * 1e9)
    for _, group in far_ends:
        group.process(now)
    wait = _wait_on(clock, [bus for bus, _ in far_ends])
    while not stop.requested() and (end is None or now < end):
        due = min(group.next_due() for _, group in far_ends)
        try:
            place, message = wait(min(due, now + _LONGEST_WAIT))
        except (can.CanError, OSError) as error:
            raise LinkError(f"the bus cannot be read: {error}; check cable and interface") from error
        now = clock.now()
        for number, (_, group) in enumerate(far_ends):
            group.process(now, message if number == place else None)


def _wait_on(clock: WallClock, buses: Sequence[can.BusABC]) -> Callable[[int], tuple[int, can.Message | None]]:
    """Return a function that waits until a time [ns] for a frame, and returns the index of its bus and the frame."""
    if len(buses) == 1:
        return lambda deadline: (0, clock.receive(buses[0], deadline))
    selector = _selector(buses)

    def wait(deadline: int) -> tuple[int, can.Message | None]:
        while True:
            for place, bus in enumerate(buses):
                if (message := bus.recv(0.0)) is not None:
                    return place, message
            if (now := clock.now()) >= deadline:
                return 0, None
            if selector is None:
                clock.wait_until(min(deadline, now + _POLL_PERIOD))
            else:
                selector.select((deadline - now) * 1e-9)

    return wait


def _selector(buses: Sequence[can.BusABC]) -> selectors.DefaultSelector | None:
    """Return a selector that wakes up for a frame of any bus; None if a bus has no file descriptor."""
    selector = selectors.DefaultSelector()
    try:
        for bus in buses:
            selector.register(bus.fileno(), selectors.EVENT_READ)
    except (NotImplementedError, ValueError, OSError):
        selector.close()
        return None
    return selector
