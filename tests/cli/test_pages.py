"""The pages of `scope` and `touch`: no other page of the same browser reads or drives what they show."""

import contextlib
import http.client
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import SimpleNamespace

import pytest

from canhaptic.cli.scope import _Door
from tests.logs.patience import wait_for
from tests.view.chromium import chromium

ROOT = Path(__file__).parents[2]
STIFF = ROOT / "configs" / "hard" / "stiff_wall.yaml"
UPGRADE = {
    "Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==", "Sec-WebSocket-Protocol": "bokeh, none",
}  # fmt: skip
HERE = "127.0.0.1:PORT"
FORGED: tuple[Mapping[str, str], ...] = (
    {"Host": "evil.com:PORT"},
    {"Host": "evil.com:PORT", "Origin": "http://evil.com:PORT"},
    {"Host": "evil.com:PORT", "Origin": "http://127.0.0.1:PORT"},
    {"Host": HERE, "Origin": "http://evil.com:PORT"},
    {"Host": HERE, "Origin": "http://localhost:PORT"},
    {"Host": HERE, "Origin": "http://127.0.0.1:1"},
    {"Host": HERE, "Origin": "https://127.0.0.1:PORT"},
    {"Host": HERE, "Origin": "null"},
    {"Host": HERE, "Origin": ""},
    {"Host": "127.0.0.1.evil.com:PORT"},
    {"Host": "localhost.evil.com"},
    {"Host": "127.0.0.1@evil.com:PORT"},
    {"Host": "evil.com:127.0.0.1:PORT"},
    {"Host": "localhost:PORT,evil.com"},
    {"Host": "localhost."},
    {"Host": "2130706433:PORT"},
    {"Host": "[::1]:PORT"},
    {"Host": ""},
)
RIGHT: tuple[Mapping[str, str], ...] = (
    {"Host": HERE},
    {"Host": HERE, "Origin": "http://127.0.0.1:PORT"},
    {"Host": "localhost:9000", "Origin": "http://localhost:9000"},  # through a tunnel of ssh
    {"Host": "localhost"},
)
OTHER_PATHS = ("/", "", "/ws", "/autoload.js", "/metadata", "/favicon.ico", "/none", "TOKEN/autoload.js",
               "TOKEN/autoload.js?bokeh-autoload-element=1", "TOKEN/metadata", "TOKEN/../TOKEN", "TOKENx", "TOKEN//",
               "/static/extensions/none.js", "/static/../scope.py", "http://evil.com/TOKEN", "/static/js/",
               "/static/js/%00", "/static/js/..", "/static/js/../../application.py", "/static/js//etc/passwd",
               "/static/js/..%2f..%2f..%2f..%2fetc%2fpasswd")  # fmt: skip


def test_a_request_comes_in_only_by_the_name_of_this_host_and_from_the_page_itself() -> None:
    for given in (*FORGED, *RIGHT):
        headers = {name: value.replace("PORT", "5006") for name, value in given.items()}
        for path in ("/secret", "/secret/", "/secret/ws", "/static/js/bokeh.min.js"):
            request = SimpleNamespace(path=path, headers=headers)
            assert _Door("/secret").match(request) == (None if given in FORGED else {}), (path, headers)
        for path in OTHER_PATHS:
            request = SimpleNamespace(path=path.replace("TOKEN", "/secret").partition("?")[0], headers=headers)
            assert _Door("/secret").match(request) is None, path


class Served(SimpleNamespace):
    """A page that is served by a process of its own."""

    port: int
    path: str
    process: "subprocess.Popen[str]"

    def ask(self, path: str, headers: Mapping[str, str], method: str = "GET") -> http.client.HTTPResponse:
        """The answer to a request with exactly these headers."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        connection.putrequest(method, path.replace("TOKEN", self.path), skip_host=True, skip_accept_encoding=True)
        for name, value in headers.items():
            connection.putheader(name, value.replace("PORT", str(self.port)))
        connection.endheaders()
        answer = connection.getresponse()
        if answer.status != 101:
            answer.read()
        connection.close()
        return answer


@contextlib.contextmanager
def served(*words: str) -> Iterator[Served]:
    pytest.importorskip("bokeh", reason="Bokeh is not installed (pip install 'canhaptic[report]')")
    command = [sys.executable, "-m", "canhaptic", *words, "--port", "0"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT, start_new_session=True
    ) as process:
        assert process.stdout is not None
        try:
            address = process.stdout.readline().split(" at http://127.0.0.1:")[1].split()[0]
            port, _, path = address.partition("/")
            assert len(path) >= 22  # 16 random bytes
            yield Served(port=int(port), path=f"/{path}", process=process)
        finally:
            with contextlib.suppress(ProcessLookupError):  # a test may have ended it
                os.killpg(process.pid, signal.SIGKILL)


@pytest.mark.slow
def test_no_forged_request_reaches_a_page_and_no_answer_is_for_other_origins(tmp_path: Path) -> None:
    with served("scope", str(tmp_path / "run.h5")) as page:
        for headers in FORGED:
            for path in ("TOKEN", "TOKEN/ws", "/static/js/bokeh.min.js"):
                answer = page.ask(path, {**headers, **(UPGRADE if path.endswith("ws") else {})})
                assert answer.status in {400, 404}, (path, headers)
        for path in OTHER_PATHS:
            for method in ("GET", "OPTIONS", "POST"):
                answer = page.ask(path or "*", {"Host": HERE}, method)
                assert answer.status in {400, 404}, (path, method)
                assert answer.getheader("Location") is None
                assert answer.getheader("Access-Control-Allow-Origin") is None
        for headers in RIGHT:
            for path, status in (("TOKEN", 200), ("TOKEN/ws", 101), ("/static/js/bokeh.min.js", 200)):
                answer = page.ask(path, {**headers, **(UPGRADE if path.endswith("ws") else {})})
                assert answer.status == status, (path, headers)
                assert answer.getheader("Access-Control-Allow-Origin") is None


STATUS = "[...Bokeh.documents[0]._all_models.values()].find(m => m.name == 'status').text"


@pytest.mark.campaign
def test_the_hand_stays_with_its_visitor_until_another_comes_with_the_address() -> None:
    with chromium(width=1200, height=760) as visitor, served("touch", str(STIFF)) as page:
        visitor.open(f"http://127.0.0.1:{page.port}{page.path}")
        visitor.wait_for("window.Bokeh && Bokeh.documents.length")
        visitor.wait_for(f"{STATUS}.includes('cycles')", 60.0)
        for path in ("/", "/?bokeh-session-id=1", "/ws", "/autoload.js?bokeh-autoload-element=1"):
            page.ask(path, {"Host": HERE})
        page.ask("TOKEN", {"Host": "evil.com:PORT"})
        cycles = visitor.value(STATUS)
        visitor.wait_for(f"{STATUS} != {json.dumps(cycles)}", 60.0)
        assert "taken" not in visitor.value(STATUS)
        assert page.ask("TOKEN", {"Host": HERE}).status == 200
        visitor.wait_for(f"{STATUS}.includes('another page has taken the hand')", 60.0)


@pytest.mark.slow
def test_a_visitor_who_left_does_not_shut_the_page_for_the_next() -> None:
    with served("touch", str(STIFF)) as page:
        for _ in range(3):
            assert page.ask("TOKEN", {"Host": HERE}).status == 200
            threading.Event().wait(18.0)  # Bokeh ends a session that was not used for 15 s


@pytest.mark.slow
def test_the_command_line_of_the_browser_does_not_tell_the_secret(tmp_path, monkeypatch) -> None:
    """Every user of a computer reads the command lines of all the others."""
    browser, told = tmp_path / "browser", tmp_path / "told"
    browser.write_text(f'#!/bin/sh\nprintf %s "$1" > {told}.new\nmv {told}.new {told}\n')
    browser.chmod(0o700)
    monkeypatch.setenv("BROWSER", f"{browser} %s")
    with served("scope", str(tmp_path / "run.h5"), "--open") as page:
        wait_for(told.exists)
        file = Path(told.read_text().removeprefix("file://"))
        assert page.path not in told.read_text()
        assert f"url=http://127.0.0.1:{page.port}{page.path}" in file.read_text()
        assert file.parent.stat().st_mode & 0o077 == 0
        page.process.send_signal(signal.SIGINT)
        assert page.process.wait(60) == 130
        assert not file.parent.exists()


@pytest.mark.campaign
@pytest.mark.timeout(600)
def test_visitors_who_never_come_leave_nothing_behind(tmp_path: Path) -> None:
    with served("scope", str(tmp_path / "run.h5")) as page:
        process = Path(f"/proc/{page.process.pid}")

        def memory() -> int:
            """Pages of 4 KiB."""
            return int((process / "statm").read_text().split()[1])

        for _ in range(60):
            assert page.ask("TOKEN", {"Host": HERE}).status == 200
        open_before, before = len(list((process / "fd").iterdir())), memory()
        for _ in range(600):
            assert page.ask("TOKEN", {"Host": HERE}).status == 200
        assert len(list((process / "fd").iterdir())) <= open_before + 2
        assert memory() < before + 5000  # 20 MB; a page that stays takes 0.3 MB
