"""Output of a command: results go to standard output, notes and errors to standard error."""

import json
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from canhaptic.errors import CanHapticError, InputError, SceneError
from canhaptic.view.terminal import visible


def write_json(value: Any) -> None:
    """Write one JSON object to standard output; numbers that JSON lacks (inf, nan) become null."""
    sys.stdout.write(json.dumps(_finite(value), indent=2, allow_nan=False) + "\n")


def write_line(text: str = "") -> None:
    """Write one line to standard output, with control characters escaped."""
    sys.stdout.write(visible(text) + "\n")


def write_note(text: str) -> None:
    """Write one line to standard error, with control characters escaped."""
    sys.stderr.write(visible(text) + "\n")
    sys.stderr.flush()


def note_file(what: str, path: Path) -> None:
    """Note on standard error that a file was written."""
    write_note(f"  {what:<10}  {path}")


def write_file(path: Path, text: str) -> None:
    """Write a text as UTF-8.

    Raises:
        InputError: The file cannot be written.
    """
    from canhaptic.host.output_files import replacing

    try:
        with replacing(path) as file:
            file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); name another file") from error


def write_failure(error: CanHapticError) -> None:
    """Write an error to standard error: one line, or one line per fault."""
    text = str(error)
    write_note(f"canhaptic: errors:\n{text}" if "\n" in text else f"canhaptic: error: {text}")


def failure(error: CanHapticError) -> dict[str, Any]:
    """Return an error as plain values."""
    faults = list(error.faults) if isinstance(error, SceneError) else [str(error)]
    return {"status": "error", "error": type(error).__name__, "exit_status": error.exit_status, "faults": faults}


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
