"""Pages that live in a browser: one server for this host, until SIGINT or SIGTERM."""

import argparse
import signal
import socket
from collections.abc import Callable
from typing import Any, Final

from canhaptic.cli.interrupt import say_interrupted
from canhaptic.cli.stop_signal import SHELL_OFFSET
from canhaptic.errors import InputError
from canhaptic.view.energy_table import make_console
from canhaptic.view.html_page import require_bokeh

_HOST: Final = "127.0.0.1"  # no other computer may read, or load, what runs here


def usable_port(arguments: argparse.Namespace) -> int:
    """Returns the port that was asked for, or one that nothing uses; with Bokeh installed, a page can be served there.

    Raises:
        InputError: Bokeh is not installed, or the port is taken.
    """
    require_bokeh()
    try:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((_HOST, arguments.port))
            return int(probe.getsockname()[1])
    except (OSError, OverflowError) as error:
        raise InputError(f"port {arguments.port}: cannot be used ({error}); choose another with --port") from error


def serve_page(page: Callable[[Any], object], port: int, title: str, *, show: bool) -> int:
    """Serves a page until the process is interrupted; returns 130 after SIGINT and 143 after SIGTERM.

    Args:
        page: Fills the Bokeh document of a visitor.
        port: From `usable_port`.
        title: What is served, for the line that gives the address.
        show: Whether to open it in a browser.
    """
    from bokeh.server.server import Server

    origins = [f"{_HOST}:{port}", f"localhost:{port}"]
    server = Server({"/": page}, address=_HOST, port=port, allow_websocket_origin=origins)
    ended_by = _stop_on_signals(server.io_loop)
    make_console().print(f" {title} at http://{_HOST}:{port}/   Ctrl-C ends", soft_wrap=True)
    if show:
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
