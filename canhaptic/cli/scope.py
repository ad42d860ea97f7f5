"""`canhaptic scope LOG`: a live page of a log that is still being written, from a process that only reads."""

import argparse
from pathlib import Path
from typing import Final

from canhaptic.cli.page_server import serve_page
from canhaptic.errors import InputError
from canhaptic.scene.load import load_scene
from canhaptic.view.series import LiveLog

_PERIOD: Final = 0.2  # [s] between two looks, about what the writer puts into one chunk


def execute(arguments: argparse.Namespace) -> int:
    """Serve the page until the process is interrupted; return 130 after SIGINT and 143 after SIGTERM.

    Raises:
        InputError: No log is named, Bokeh is not installed, or the port is taken.
    """
    path = _log_of(arguments)
    if not 0.0 < arguments.window <= 3600.0:
        raise InputError(f"--window {arguments.window:g}: expected 0 < seconds <= 3600")

    def visit(document: object) -> None:
        from canhaptic.view.scope_page import ScopePage

        ScopePage(document, LiveLog(path), arguments.window, _PERIOD)

    return serve_page(visit, arguments, f"scope of {path}")


def _log_of(arguments: argparse.Namespace) -> Path:
    if arguments.log is not None:
        return Path(arguments.log)
    if arguments.config is None:
        raise InputError("scope: got no log; name it, or with --config the scene that writes it")
    energy = load_scene(arguments.config, leave_code=True).log.energy
    if energy is None:
        raise InputError(f"{arguments.config}: has no log.energy; add it, or name the energy log itself")
    return energy
