"""The first difference of a replay as text: both frames decoded, and the bus traffic before them."""

from typing import Final, TypedDict

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


class _FramePlace(TypedDict):
    number: int  # line of a text, or frame of a binary log
    time: float  # since the beginning of the log [s]


class FrameWords(TypedDict):
    """A frame, decoded."""

    channel: str
    id: int
    data: str
    kind: str
    node: str
    text: str


class FrameBefore(_FramePlace, FrameWords):
    """One of the last frames that were still equal."""

    direction: str


class FirstDifference(_FramePlace):
    """The first frame in which master and recording differ."""

    recorded: FrameWords
    sent: FrameWords | None  # None: the master sent nothing any more
    gap: float | None  # silence of a recording that lacks frames [s]
    before: list[FrameBefore]


def describe(recording: Recording, side: RecordedSide, scene: Scene) -> FirstDifference | None:
    """Return the first difference; None when the master sent all that was recorded."""
    departure = side.departure
    index = side.unsent if departure is None else departure.place
    if index < 0:
        return None
    frames = recording.frames
    nodes = describe_nodes(scene)
    decoders = [BusDecoder([node for node in nodes if node.bus == place]) for place in range(len(scene.buses))]
    before: list[FrameBefore] = []
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
    """Return the longest silence of the recording in the two cycles before a frame [s]; None for an ordinary one.

    A difference after such a silence means that frames are missing from the recording: SYNCs that the master itself
    skipped are skipped again in the replay.
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


def _place(recording: Recording, frame: Frame) -> _FramePlace:
    return {"number": frame.number, "time": (frame.timestamp_ns - recording.frames[0].timestamp_ns) * 1e-9}


def _words(frame: Frame, decoder: BusDecoder) -> FrameWords:
    kind, node, text = decoder.decode(frame.can_id, frame.data)
    data = frame.data.hex().upper()
    return {"channel": frame.channel, "id": frame.can_id, "data": data, "kind": kind, "node": node, "text": text}
