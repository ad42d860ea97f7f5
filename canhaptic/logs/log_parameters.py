"""Paths of the logs of a run, and its reaction when they cannot be written."""

from typing import Annotated, Literal

from pydantic import model_validator

from canhaptic.units import Parameters, PrintablePath, quantity


class LogParameters(Parameters):
    """Paths of the logs; relative to the current folder, and options of `run` win over them."""

    energy: PrintablePath | None = None
    """Energy log (HDF5)."""
    bus: PrintablePath | None = None
    """Bus log: candump text; BLF, TRC or ASC by its suffix."""
    file_size: Annotated[int, quantity("1", ge=0, le=1e12)] = 0
    """Bytes after which the bus log is put aside and a new one begun; 0 for one file without limit."""
    files: Annotated[int, quantity("1", ge=2, le=100_000)] = 10
    """Largest number of bus logs when `file_size` is given; the oldest is deleted."""
    last: Annotated[float, quantity("s", ge=0.0, le=3600.0)] = 0.0
    """Above 0: the bus log is written only after a bad end, and holds this much of the run before it."""
    on_failure: Literal["stop", "continue"] = "stop"
    """Whether a run stops when one of its logs can no longer be written, or goes on without it."""

    @model_validator(mode="after")
    def _check(self) -> "LogParameters":
        if self.last and self.file_size:
            raise ValueError("last and file_size exclude each other: keep the last seconds, or a series of files")
        return self
