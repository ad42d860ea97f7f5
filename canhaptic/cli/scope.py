"""`canhaptic scope LOG`: a live page on a log as it is written. A process of its own that only reads, for this host."""

import argparse
import signal
import socket
from pathlib import Path
from typing import Any, Final

from canhaptic.cli.interrupt import say_interrupted
from canhaptic.cli.stop_signal import SHELL_OFFSET
from canhaptic.errors import InputError
from canhaptic.scene.load import load_scene
from canhaptic.view.energy_table import make_console
from canhaptic.view.html_page import require_bokeh
from canhaptic.view.live_log import LiveLog

_HOST: Final = "127.0.0.1"  # no other computer may read, or load, a machine that moves
_PERIOD: Final = 0.2  # [s] between two looks, about what the writer puts into one chunk


def execute(arguments: argparse.Namespace) -> int:
    """Serves the page until the process is interrupted; returns 130 after SIGINT and 143 after SIGTERM.

    Raises:
        InputError: No log is named, Bokeh is not installed, or the port is taken.
    """
    path = _log_of(arguments)
    if not 0.0 < arguments.window <= 3600.0:
        raise InputError(f"--window {arguments.window:g}: expected 0 < seconds <= 3600")
    require_bokeh()
    from bokeh.server.server import Server

    from canhaptic.view.scope_page import ScopePage

    port = arguments.port or _free_port()
    try:
        server = Server(
            {"/": lambda document: ScopePage(document, LiveLog(path), arguments.window, _PERIOD)},
            address=_HOST,
            port=port,
            allow_websocket_origin=[f"{_HOST}:{port}", f"localhost:{port}"],
        )
    except (OSError, OverflowError) as error:
        raise InputError(f"port {port}: cannot be used ({error}); choose another with --port") from error
    ended_by = _stop_on_signals(server.io_loop)
    address = f"http://{_HOST}:{server.port}/"
    make_console().print(f" scope of {path} at {address}   Ctrl-C ends", soft_wrap=True)
    if arguments.open:
        server.io_loop.add_callback(server.show, "/")
    server.start()
    server.io_loop.start()
    server.stop()
    if ended_by[0] == signal.SIGINT:
        say_interrupted()
    return SHELL_OFFSET + ended_by[0]


def _stop_on_signals(loop: Any) -> list[int]:
    """Returns the list that takes the signal which stops the loop.

    As an exception Ctrl-C could be swallowed by the callback that it interrupts.
    """
    ended_by: list[int] = []

    def end(number: int) -> None:
        ended_by.append(number)
        loop.stop()

    for number in (signal.SIGINT, signal.SIGTERM):
        loop.asyncio_loop.add_signal_handler(number, end, number)
    return ended_by


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((_HOST, 0))
        return int(probe.getsockname()[1])


def _log_of(arguments: argparse.Namespace) -> Path:
    if arguments.log is not None:
        return Path(arguments.log)
    if arguments.config is None:
        raise InputError("scope: name the log, or a scene that names it with --config")
    energy = load_scene(arguments.config, leave_code=True).log.energy
    if energy is None:
        raise InputError(f"{arguments.config}: names no energy log; give it under log.energy, or name the log itself")
    return energy
