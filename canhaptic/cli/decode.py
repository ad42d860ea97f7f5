"""`canhaptic inspect --frames BUSLOG`: every frame of a bus log as text, one line each."""

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from canhaptic.errors import LogFormatError
from canhaptic.logs.bus_reader import Remarks, is_capture, read_bus_log
from canhaptic.logs.decoder import BusDecoder
from canhaptic.logs.text_lines import UNTIMED
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import Scene
from canhaptic.scene.scene_logs import Channels, describe_nodes
from canhaptic.view.terminal import write_line, write_note


def execute(arguments: argparse.Namespace) -> int:
    """Print the frames and return 0.

    Raises:
        InputError: The log or the scene cannot be used.
    """
    if is_capture(arguments.bus_log):
        return _print_capture(arguments)
    scene = None if arguments.config is None else load_scene(arguments.config, leave_code=True)
    remarks, seen = Remarks(), dict[str, None]()
    only = {kind.lower() for kind in arguments.only or ()}
    for frame in _decode_log(arguments.bus_log, scene, arguments.start, arguments.stop, remarks):
        seen[frame["kind"]] = None
        if not only or frame["kind"].lower() in only:
            write_line(json.dumps(frame) if arguments.json else line(frame))
    if only.isdisjoint(kind.lower() for kind in seen) and only:
        write_note(f"  no frame matches --only {', '.join(arguments.only)}; it has {', '.join(seen) or 'no frame'}")
    for remark in remarks.lines():
        write_note(f"  {remark}")
    return 0


def _print_capture(arguments: argparse.Namespace) -> int:
    """Print the datagrams of a capture of Ethernet, one line each; return 0."""
    from canhaptic.drive.ethercat.segment import al_text
    from canhaptic.logs.ethercat_frames import command_name, datagram_text, datagrams_of, read_capture

    frames = read_capture(arguments.bus_log)
    first, others, unknown = frames[0].time if frames else 0, 0, 0
    for number, (time, content) in enumerate(frames, 1):
        found, seconds = datagrams_of(content), (time - first) * 1e-9
        others += found is None
        if (arguments.start or 0.0) > seconds or (arguments.stop is not None and seconds >= arguments.stop):
            continue
        for of in found or ():
            name, text = command_name(of.command), datagram_text(of, al_text)
            unknown += name == "unknown"
            told = {"time": seconds, "frame": number, "command": name, "address": of.address, "offset": of.offset,
                    "data": of.data.hex(), "counter": of.counter, "text": text}  # fmt: skip
            place = f"{of.address:#06x} {of.offset:#06x}"
            plain = f"{seconds:>14.6f} {number:>6} {name:<4} {place} wkc {of.counter} {text}".rstrip()
            write_line(json.dumps(told) if arguments.json else plain)
    for count, what in ((others, "frames are not EtherCAT, or damaged"), (unknown, "commands are unknown")):
        if count:
            write_note(f"  {count} {what}")
    return 0


def _decode_log(
    path: Path,
    scene: Scene | None = None,
    start: float | None = None,
    stop: float | None = None,
    remarks: Remarks | None = None,
) -> Iterator[dict[str, Any]]:
    """Yield `{time, channel, direction, id, data, kind, node, text}` of every frame between two times [s].

    Frames before `start` are decoded too, since the PDO maps are learnt from the bring-up. Each bus has its own
    decoder: the same node ID on two buses means two nodes. The time of a frame is None if the log has none.

    Raises:
        LogFormatError: The log cannot be read, or `start` or `stop` is given and a frame has no time.
    """
    nodes = [] if scene is None else describe_nodes(scene)
    place_of = None if scene is None else Channels(scene).place_of
    decoders: dict[str, BusDecoder] = {}
    for frame in read_bus_log(path, remarks):
        decoder = decoders.get(frame.channel)
        if decoder is None:
            of_bus = [node for node in nodes if place_of is None or node.bus == place_of(frame)]
            decoder = decoders[frame.channel] = BusDecoder(of_bus)
        decoded = decoder.decode(frame.can_id, frame.data)
        time = None if frame.timestamp_ns == UNTIMED else frame.timestamp_ns / 1e9
        if time is None and (start is not None or stop is not None):
            raise LogFormatError(f"{path}:{frame.number}: has no time; leave --from and --to out")
        if stop is not None and (time or 0.0) >= stop:
            return
        if start is None or (time or 0.0) >= start:
            yield {
                "time": time,
                "channel": frame.channel,
                "direction": "R" if frame.is_rx else "T",
                "id": frame.can_id,
                "data": frame.data.hex().upper(),
                **decoded._asdict(),
            }


def line(frame: dict[str, Any]) -> str:
    """Return one decoded frame as a line of text."""
    time = "-" if frame["time"] is None else f"{frame['time']:.6f}"
    return (
        f"{time:>14} {frame['channel']} {frame['direction']} {frame['id']:03X} {frame['data']:<16} "
        f"{frame['kind']:<9} {frame['node']:<10} {frame['text']}"
    ).rstrip()
