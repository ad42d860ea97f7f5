"""The control side of the bus log: every frame sent or received goes into a ring, a writer process formats it."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, Literal

from canhaptic.errors import ParameterError
from canhaptic.logs.bus_sink import FRAME_RING
from canhaptic.logs.log_file import CONVERTIBLE
from canhaptic.logs.ring import Record, Recorder
from canhaptic.logs.writer_process import WriterProcess

_MOST_BUSES: Final = 256  # one byte in each record


class BusLogWriter(WriterProcess):
    """Writes frames as candump text. Call it as a recorder: `recorder(timestamp_ns, can_id, data, is_rx)`.

    The same frames give the same bytes. At real pace a full ring drops frames and counts them; at free pace it waits.

    Args:
        path: The file; an existing one is replaced. With the suffix .blf, .trc or .asc the run is recorded as candump
            text next to it (PATH.log), which survives a kill, and converted on closing.
        channel: Name of the bus in every line; one for each bus where there are several.
        pace: "real" or "free".
        file_size: Bytes after which the file is renamed to NAME.00001.log, ...; 0 for one file without limit.
        files: Number of files kept in all when `file_size` is given.
        last: If above 0, nothing is written during a good run; after a bad end, the frames of this final period are
            written [s].
        on_failure: Called once, from another thread, with the reason when the log can no longer be written; frames are
            then dropped and counted at any pace.

    Raises:
        LogWriteError: The file cannot be created.
    """

    def __init__(
        self,
        path: str | Path,
        channel: str | Sequence[str],
        *,
        pace: Literal["real", "free"] = "real",
        file_size: int = 0,
        files: int = 10,
        last: float = 0.0,
        on_failure: Callable[[str], None] | None = None,
    ) -> None:
        self.path = Path(path).absolute()
        convert = self.path.suffix.lower() in CONVERTIBLE
        channels = [channel] if isinstance(channel, str) else list(channel)
        _check_channels(channels)
        if convert and (file_size or last):
            raise ParameterError(f"{path}: only candump text (.log) can be a series of files or the last seconds")
        job = {
            "kind": "bus",
            "pace": pace,
            "path": f"{self.path}.log" if convert else str(self.path),
            "channels": channels,
            "file_size": file_size,
            "files": files,
            "convert_to": str(self.path) if convert else "",
            "last_ns": round(last * 1e9),
        }
        super().__init__(job, [FRAME_RING], on_failure)
        [self._frames] = self.rings
        self._record = self._frames.recorder(0, self._insist)
        self._channels = len(channels)

    def __call__(self, timestamp_ns: int, can_id: int, data: bytes | bytearray, is_rx: bool) -> None:
        """Take one frame of classic CAN (at most 8 bytes of data).

        Raises:
            LogStoppedError: At free pace and without `on_failure` only: the writer has failed and its ring is full.
        """
        self._record(timestamp_ns, can_id, data, is_rx)

    def on(self, bus: int) -> Recorder:
        """Recorder of one bus, by its index among the channels; the log itself records the first bus.

        Raises:
            ParameterError: There is no such bus.
        """
        if not 0 <= bus < self._channels:
            raise ParameterError(f"bus {bus}: the log has {self._channels}, counted from 0")
        return self._frames.recorder(bus, self._insist)

    def _insist(self, frame: Record) -> None:
        self.insist(self._frames, frame)


def _check_channels(channels: Sequence[str]) -> None:
    for name in channels:
        if not name or any(letter.isspace() for letter in name):
            raise ParameterError(f"channel {name!r}: expected a name without spaces, since every line repeats it")
    if not 0 < len(channels) <= _MOST_BUSES or len(set(channels)) < len(channels):
        raise ParameterError(f"channels {channels}: expected 1 to {_MOST_BUSES} names, all different")
