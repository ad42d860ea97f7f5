"""`canhaptic scope LOG`: a live page on a log as it is written. A process of its own that only reads, for this host."""

import argparse
import signal
import socket
from pathlib import Path
from typing import Final

from canhaptic.errors import InputError
from canhaptic.scene.load import load_scene
from canhaptic.view.energy_table import make_console
from canhaptic.view.html_page import require_bokeh
from canhaptic.view.live_log import LiveLog

_HOST: Final = "127.0.0.1"  # nobody else may look at, or load, a machine that moves
_PERIOD: Final = 0.2  # [s] between two looks, about what the writer puts into one chunk


def execute(arguments: argparse.Namespace) -> int:
    """Serves the page until the process is interrupted.

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
    # As an exception Ctrl-C may be swallowed by whatever callback it falls into.
    server.io_loop.asyncio_loop.add_signal_handler(signal.SIGINT, server.io_loop.stop)
    address = f"http://{_HOST}:{server.port}/"
    make_console().print(f" scope of {path} at {address}   Ctrl-C ends", soft_wrap=True)
    if arguments.open:
        server.io_loop.add_callback(server.show, "/")
    server.run_until_shutdown()
    return 0


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((_HOST, 0))
        return int(probe.getsockname()[1])


def _log_of(arguments: argparse.Namespace) -> Path:
    if arguments.log is not None:
        return Path(arguments.log)
    if arguments.config is None:
        raise InputError("scope: name the log, or a scene that names it with --config")
    energy = load_scene(arguments.config).log.energy
    if energy is None:
        raise InputError(f"{arguments.config}: names no energy log; give it under log.energy, or name the log itself")
    return energy
