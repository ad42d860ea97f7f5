"""`canhaptic decode BUSLOG`: every frame of a bus log as text, one line each."""

import argparse
import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from canhaptic.logs.bus_reader import SkippedKind, describe_skipped, read_bus_log
from canhaptic.logs.decoder import BusDecoder
from canhaptic.scene.load import load_scene
from canhaptic.scene.models import Scene
from canhaptic.scene.scene_logs import Channels, describe_nodes
from canhaptic.view.terminal import write_line, write_note


def execute(arguments: argparse.Namespace) -> int:
    """Print the frames and return 0.

    Raises:
        InputError: The log or the scene cannot be used.
    """
    scene = None if arguments.config is None else load_scene(arguments.config, leave_code=True)
    skipped, seen = Counter[SkippedKind](), dict[str, None]()
    only = {kind.lower() for kind in arguments.only or ()}
    for frame in _decode_log(arguments.bus_log, scene, arguments.start, arguments.stop, skipped):
        seen[frame["kind"]] = None
        if not only or frame["kind"].lower() in only:
            write_line(json.dumps(frame) if arguments.json else line(frame))
    if only.isdisjoint(kind.lower() for kind in seen) and only:
        write_note(f"  no frame matches --only {', '.join(arguments.only)}; it has {', '.join(seen) or 'no frame'}")
    if skipped:
        write_note(f"  frames left out: {describe_skipped(skipped)}")
    return 0


def _decode_log(
    path: Path,
    scene: Scene | None = None,
    start: float | None = None,
    stop: float | None = None,
    skipped: Counter[SkippedKind] | None = None,
) -> Iterator[dict[str, Any]]:
    """Yield `{time, channel, direction, id, data, kind, node, text}` of every frame between two times [s].

    Frames before `start` are decoded too, since the PDO maps are learnt from the bring-up. Each bus has its own
    decoder: the same node ID on two buses means two nodes.
    """
    nodes = [] if scene is None else describe_nodes(scene)
    place_of = None if scene is None else Channels(scene).place_of
    decoders: dict[str, BusDecoder] = {}
    for frame in read_bus_log(path, skipped):
        decoder = decoders.get(frame.channel)
        if decoder is None:
            of_bus = [node for node in nodes if place_of is None or node.bus == place_of(frame)]
            decoder = decoders[frame.channel] = BusDecoder(of_bus)
        decoded = decoder.decode(frame.can_id, frame.data)
        time = frame.timestamp_ns / 1e9
        if stop is not None and time >= stop:
            return
        if start is None or time >= start:
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
    return (
        f"{frame['time']:14.6f} {frame['channel']} {frame['direction']} {frame['id']:03X} {frame['data']:<16} "
        f"{frame['kind']:<9} {frame['node']:<10} {frame['text']}"
    ).rstrip()
