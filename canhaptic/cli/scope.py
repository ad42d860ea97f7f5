"""`canhaptic scope LOG`: a live page of a log that is still being written, and the server of every live page.

The page is drawn by a process that only reads the log. It is served on this host only, until SIGINT or SIGTERM, and the
printed address contains a secret. Other web pages in the same browser can send requests to this host, and under DNS
rebinding read the answers. A request is therefore admitted only if its Host header names this host, its Origin is the
page itself or absent, and its path is a static script or contains the secret.
"""

import argparse
import logging
import re
import secrets
import signal
import socket
import webbrowser
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory
from traceback import walk_tb
from typing import Any, Final

from canhaptic.cli.main import say_interrupted
from canhaptic.errors import InputError, cause_of
from canhaptic.extras import install_hint
from canhaptic.host.stop_signal import SHELL_OFFSET
from canhaptic.scene.load import load_scene
from canhaptic.view.run_lines import make_console
from canhaptic.view.series import LiveLog

_PERIOD: Final = 0.2  # [s] between two looks, about what the writer puts into one chunk


def execute(arguments: argparse.Namespace) -> int:
    """Serve the page until the process is interrupted; return 130 after SIGINT and 143 after SIGTERM.

    Raises:
        InputError: No log is named, Bokeh is not installed, the port is taken, or no package offers the display.
    """
    path = _log_of(arguments)
    if arguments.display is not None:
        from canhaptic.registry import function_of

        function_of("display", arguments.display)(path)
        return 0
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


_HOST: Final = "127.0.0.1"  # no other computer may read, or load, what runs here
_NAMES: Final = (_HOST, "localhost")
_OURS: Final = re.compile(rf"({'|'.join(map(re.escape, _NAMES))})(:[0-9]{{1,5}})?")
_SCRIPT: Final = re.compile(r"/static/js/[\w-][\w.-]*")
_SECRET: Final = 16  # [B]
_WAITING: Final = 2  # visitors whose browser has not come yet; those before them are ended
_ACCEPTING: Final = "_accept_connection"  # of tornado's websockets
_CHECK: Final = 1000  # [ms] between two looks for visitors to end


class _Door:
    """Matcher for tornado's router that admits only the requests of the served page; others get 404."""

    def __init__(self, path: str) -> None:
        self._paths = (path, f"{path}/", f"{path}/ws")

    def match(self, request: Any) -> dict[str, Any] | None:
        """Return an empty mapping for an admitted request, None for any other.

        Any port is accepted, since the page may be reached through an ssh tunnel.
        """
        host = request.headers.get("Host", "")
        is_ours = _OURS.fullmatch(host)
        is_same_origin = request.headers.get("Origin", f"http://{host}") == f"http://{host}"
        is_known = request.path in self._paths or _SCRIPT.fullmatch(request.path)
        return {} if is_ours and is_same_origin and is_known else None


def _in_one_line(record: logging.LogRecord) -> bool:
    """Cut the record of a websocket that was not accepted, as with a bad or old token, to one line."""
    error = record.exc_info[1] if record.exc_info else None
    if error is not None and _ACCEPTING in (frame.f_code.co_name for frame, _ in walk_tb(error.__traceback__)):
        record.msg, record.args, record.exc_info = f"a browser was refused: {cause_of(error)}", (), None
    return True


def _usable_port(arguments: argparse.Namespace) -> int:
    """Return the requested port, or a free one for port 0; check that Bokeh is installed."""
    try:
        import bokeh.server.server  # noqa: F401 - what serves every live page
    except ImportError as error:
        raise InputError(f"a live page needs Bokeh; install it with: {install_hint('report')}") from error
    try:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((_HOST, arguments.port))
            return int(probe.getsockname()[1])
    except (OSError, OverflowError) as error:
        raise InputError(f"port {arguments.port}: cannot be used ({error}); choose another with --port") from error


def serve_page(page: Callable[[Any], object], arguments: argparse.Namespace, title: str) -> int:
    """Serve a page until the process is interrupted; return 130 after SIGINT and 143 after SIGTERM.

    Args:
        page: Function that fills the Bokeh document of a visitor.
        arguments: Parsed options `--port` (0: any free one) and `--open`.
        title: Title of the page, printed before its address.

    Raises:
        InputError: Bokeh is not installed, or the port is taken.
    """
    port = _usable_port(arguments)
    from bokeh.server.server import BaseServer
    from bokeh.server.tornado import BokehTornado
    from tornado.httpserver import HTTPServer
    from tornado.ioloop import IOLoop
    from tornado.routing import Rule, RuleRouter
    from tornado.web import OutputTransform

    class Unframed(OutputTransform):  # type: ignore[misc]
        def transform_first_chunk(self, status_code: int, headers: Any, chunk: bytes, finishing: bool) -> Any:
            headers["X-Frame-Options"] = "DENY"
            headers["Content-Security-Policy"] = "frame-ancestors 'none'; base-uri 'none'; object-src 'none'"
            return status_code, headers, chunk

    path = f"/{secrets.token_urlsafe(_SECRET)}"

    def visit(document: object) -> None:
        for session in pages.get_sessions(path)[:-_WAITING]:
            if session.connection_count == 0:
                session.request_expiration()
        page(document)

    origins = [f"{name}:*" for name in _NAMES]
    pages = BokehTornado({path: visit}, extra_websocket_origins=origins, check_unused_sessions_milliseconds=_CHECK)
    pages.add_transform(Unframed)
    logging.getLogger("tornado.application").addFilter(_in_one_line)
    http = HTTPServer(RuleRouter([Rule(_Door(path), pages)]))
    http.listen(port, _HOST)
    server = BaseServer(IOLoop.current(), pages, http)
    ended_by = _stop_on_signals(server.io_loop)
    make_console().print(f" {title} at http://{_HOST}:{port}{path}   Ctrl-C ends", soft_wrap=True)
    _serve(server, f"http://{_HOST}:{port}{path}", opens=arguments.open)
    if ended_by[0] == signal.SIGINT:
        say_interrupted()
    return SHELL_OFFSET + ended_by[0]


def _serve(server: Any, address: str, *, opens: bool) -> None:
    """Serve until a signal stops the loop; open the address in the user's browser first if `opens`."""
    with TemporaryDirectory(prefix="canhaptic-") if opens else nullcontext("") as folder:
        if folder:
            server.io_loop.add_callback(_open_browser, address, Path(folder))
        server.start()
        server.io_loop.start()
        server.stop()


def _open_browser(address: str, folder: Path) -> None:
    """Open an address in a browser through a file in a private folder.

    The address contains the secret, and other users of the computer can read the command line of the browser.
    """
    page = folder / "open.html"
    page.write_text(f'<meta http-equiv="refresh" content="0; url={address}">', encoding="ascii")
    webbrowser.open(page.as_uri())


def _stop_on_signals(loop: Any) -> list[int]:
    """Let SIGINT and SIGTERM stop the loop; return a list to which the signal is appended.

    A KeyboardInterrupt could be swallowed by the callback that it interrupts.
    """
    ended_by: list[int] = []

    def end(number: int) -> None:
        ended_by.append(number)
        loop.stop()

    for number in (signal.SIGINT, signal.SIGTERM):
        loop.asyncio_loop.add_signal_handler(number, end, number)
    return ended_by
