"""The control side of the energy log: one packed row per SYNC into a ring, a writer process behind it."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final, Literal

from canhaptic.control.balance import EnergyBalance
from canhaptic.logs.columns import EVENT_RING, EVENT_TEXT_SIZES, Attribute, LogSchema, PortDescription
from canhaptic.logs.writer_process import WriterProcess
from canhaptic.signals import CycleTiming, Measured, Sample, Truth

_RING_ROWS: Final = 16_384  # 16 s at 1 kHz, longer than a disk stalls
_FLUSH_TIME_NS: Final = 200_000_000  # a chunk holds this much of the run, at real pace
_FREE_CHUNK: Final = 4096  # rows; without a wall clock only throughput counts


class EnergyLogWriter(WriterProcess):
    """Writes one energy log (HDF5).

    At real pace `append` never waits: when the ring is full the cycle is counted as dropped and the next row says so.
    At free pace (lock-step) it waits for the writer, and nothing is lost.

    Args:
        path: The file; an existing one is replaced.
        ports: The axes, in the order of samples and balances.
        attributes: Attributes of the run: configuration text and hash, versions, clock base, bit rate, ...
        sample_time_ns: Sample time [ns].
        with_truth: Whether a simulation supplies true values.
        pace: "real" or "free".
        ring_rows: Capacity of the ring.
        on_failure: Called once, from another thread, with the reason when the log can no longer be written; cycles are
            then dropped and counted at any pace.

    Raises:
        LogWriteError: The file cannot be created.
    """

    def __init__(
        self,
        path: str | Path,
        ports: Sequence[PortDescription],
        attributes: Mapping[str, Attribute],
        *,
        sample_time_ns: int,
        with_truth: bool = False,
        pace: Literal["real", "free"] = "real",
        ring_rows: int = _RING_ROWS,
        on_failure: Callable[[str], None] | None = None,
    ) -> None:
        self._further = tuple(range(1, len(ports)))  # behind the first
        self._nothing = (Measured(0.0, 0.0, 0.0, 1, 0, 0),) * len(ports)
        self.path = Path(path).absolute()
        chunk = _FREE_CHUNK if pace == "free" else max(16, min(_FREE_CHUNK, _FLUSH_TIME_NS // sample_time_ns))
        schema = LogSchema(
            tuple(ports), sample_time_ns, with_truth, min(chunk, ring_rows // 2), pace == "real", dict(attributes)
        )
        job = {"kind": "energy", "path": str(self.path), "pace": pace, "schema": schema.to_json()}
        super().__init__(job, [schema.ring(ring_rows), EVENT_RING], on_failure)
        self._rows, self._events = self.rings
        self._push = self._rows.push
        self._unreported = 0

    def append(
        self,
        sync_index: int,
        samples: Sequence[Sample],
        balances: Sequence[EnergyBalance],
        timing: CycleTiming,
        truths: Sequence[Truth] | None = None,
        deadline: int | None = None,
        measured: Sequence[Measured] = (),
    ) -> None:
        """Take one cycle.

        Args:
            sync_index: Index k of the SYNC.
            samples: Samples, one per port.
            balances: Balances, one per port.
            timing: Timing of this cycle.
            truths: True values, one per port when the log was made with truth.
            deadline: Sample times since the first SYNC; None: none was skipped.
            measured: Figures, one per port; none where only the balances are known.

        Raises:
            LogStoppedError: At free pace and without `on_failure` only: the writer has failed and its ring is full.
        """
        due = sync_index if deadline is None else deadline
        known = measured or self._nothing
        row: list[float] = [self._unreported, sync_index, *timing, due, *samples[0], *balances[0], *known[0]]
        for port in self._further:
            row += (*samples[port], *balances[port], *known[port])
        if truths is not None:
            for position, energy in truths:
                row += (position, *energy)
        if self._push(row) or self.insist(self._rows, row):
            self._unreported = 0
        else:
            self._unreported += 1

    def event(self, sync_index: int, kind: str, port: str, text: str) -> None:
        """Record an event: a fault, an EMCY, a lost frame, a stop. Long texts are cut.

        Args:
            sync_index: Index k of the SYNC.
            kind: Kind of the event, one word.
            port: Name of the axis; empty for the whole rig.
            text: Description of the event.
        """
        texts = zip((kind, port, text), EVENT_TEXT_SIZES.values(), strict=True)
        self._events.push((sync_index, *(_cut(words, size) for words, size in texts)))


def _cut(text: str, size: int) -> bytes:
    return text.encode()[:size].decode("utf-8", "ignore").encode()
