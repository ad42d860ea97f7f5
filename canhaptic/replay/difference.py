"""The first difference of a replay in words: both frames decoded, and what was on the bus before them."""

from typing import Any, Final

from canhaptic.canopen.objects import SYNC_FRAME_COB_ID
from canhaptic.logs.bus_reader import Frame
from canhaptic.logs.decoder import BusDecoder
from canhaptic.replay.recorded_side import RecordedSide
from canhaptic.replay.recording import Recording
from canhaptic.scene.models import Scene
from canhaptic.scene.node_names import describe_nodes

_SHOWN_BEFORE: Final = 6  # frames
_CYCLES_BACK: Final = 2
_LONGEST_SILENCE: Final = 1.5  # sample times within a recording without gaps


def describe(recording: Recording, side: RecordedSide, scene: Scene) -> dict[str, Any] | None:
    """Returns `{number, time, recorded, sent, before}`; None when the master sent all that was recorded.

    `number` is the line of a text, or the frame of a binary log; `time` counts from the beginning of the log [s]. Each
    frame is `{channel, id, data, kind, node, text}`; `sent` is None when the master sent nothing any more. `gap` is the
    silence [s] of a recording that lacks frames, else None. `before` are
    the last frames that were still equal, each with its number, time and direction.
    """
    departure = side.departure
    index = side.unsent if departure is None else departure.place
    if index < 0:
        return None
    frames = recording.frames
    nodes = describe_nodes(scene)
    decoders = [BusDecoder([node for node in nodes if node.bus == place]) for place in range(len(scene.buses))]
    before = []
    for number, (frame, bus) in enumerate(zip(frames[:index], recording.buses, strict=False)):
        words = _words(frame, decoders[bus])  # of all of them: the maps are learnt from the start
        if number >= index - _SHOWN_BEFORE:
            direction = "T" if recording.is_master[number] else "R"
            before.append({**_place(recording, frame), "direction": direction, **words})
    recorded, bus = frames[index], recording.buses[index]
    sent = None
    if departure is not None:
        channel = recorded.channel if departure.bus == bus else scene.buses[departure.bus].name
        other = recorded._replace(can_id=departure.can_id, data=departure.data, channel=channel)
        sent = _words(other, decoders[departure.bus])
    return {
        **_place(recording, recorded),
        "recorded": _words(recorded, decoders[bus]),
        "sent": sent,
        "gap": _gap(recording, index, scene.bus.sample_time),
        "before": before,
    }


def _gap(recording: Recording, index: int, sample_time: float) -> float | None:
    """Returns the longest silence of the recording in the two cycles before a frame [s]; None for an ordinary one.

    Where a master departs after it, frames are missing from the recording: after SYNCs that it skipped itself, it sends
    today what it sent then.
    """
    if recording.first_sync < 0:
        return None
    frames, syncs, silence = recording.frames, 0, 0.0
    for place in range(index, recording.first_sync, -1):
        silence = max(silence, (frames[place].timestamp_ns - frames[place - 1].timestamp_ns) * 1e-9)
        syncs += frames[place].can_id == SYNC_FRAME_COB_ID
        if syncs == _CYCLES_BACK:
            break
    return silence if silence > _LONGEST_SILENCE * sample_time else None


def _place(recording: Recording, frame: Frame) -> dict[str, Any]:
    return {"number": frame.number, "time": (frame.timestamp_ns - recording.frames[0].timestamp_ns) * 1e-9}


def _words(frame: Frame, decoder: BusDecoder) -> dict[str, Any]:
    decoded = decoder.decode(frame.can_id, frame.data)._asdict()
    return {"channel": frame.channel, "id": frame.can_id, "data": frame.data.hex().upper(), **decoded}
