"""A headless Chromium for tests, spoken to through its debugging port; skips, visibly, where there is none.

On Debian and Ubuntu: apt-get install chromium.
"""

import asyncio
import base64
import json
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")


class Page:
    """One page of the browser."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._loop = asyncio.new_event_loop()
        self._socket: Any = self._loop.run_until_complete(self._connect())
        self._number = 0
        self.faults: list[str] = []
        """What the page wrote as errors."""

    async def _connect(self) -> Any:
        from tornado.httpclient import AsyncHTTPClient
        from tornado.websocket import websocket_connect

        answer = await AsyncHTTPClient().fetch(
            f"http://127.0.0.1:{self._port}/json/new?about:blank", method="PUT", body=""
        )
        address = json.loads(answer.body)["webSocketDebuggerUrl"]
        return await websocket_connect(address, max_message_size=100_000_000)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        return self._loop.run_until_complete(self._call(self._number, method, parameters))

    async def _call(self, number: int, method: str, parameters: dict[str, Any]) -> dict[str, Any]:
        await self._socket.write_message(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            message = json.loads(await asyncio.wait_for(self._socket.read_message(), 60.0))
            if message.get("method") == "Runtime.exceptionThrown":
                self.faults.append(json.dumps(message["params"]["exceptionDetails"])[:500])
            if message.get("id") == number:
                assert "error" not in message, message
                return dict(message["result"])

    def open(self, address: str) -> None:
        self.call("Runtime.enable")
        self.call("Page.enable")
        self.call("Page.navigate", url=address)

    def value(self, expression: str) -> Any:
        """The value of a JavaScript expression; promises are awaited."""
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in result, result
        return result["result"].get("value")

    def wait_for(self, expression: str, seconds: float = 30.0) -> None:
        pause = threading.Event()
        for _ in range(int(seconds / 0.02)):
            if self.value(f"Boolean({expression})"):
                return
            pause.wait(0.02)
        raise AssertionError(f"waited in vain for {expression}")

    def screenshot(self, path: Path) -> None:
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))

    def close(self) -> None:
        self._socket.close()
        self._loop.run_until_complete(asyncio.sleep(0.05))
        self._loop.close()


@contextmanager
def chromium(width: int = 1300, height: int = 1250) -> Iterator[Page]:
    """A page of a fresh browser."""
    program = next((found for name in NAMES if (found := shutil.which(name))), None)
    if program is None:
        pytest.skip("Chromium is not installed (apt-get install chromium)")
    pytest.importorskip("tornado", reason="Bokeh is not installed (pip install 'canhaptic[report]')")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        words = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--remote-debugging-port=0"]
        words += [f"--window-size={width},{height}", f"--user-data-dir={folder}", "--hide-scrollbars", "about:blank"]
        process = subprocess.Popen([program, *words], stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
        try:
            assert process.stderr is not None
            line = next(line for line in process.stderr if "DevTools listening on" in line)
            page = Page(int(line.split(":")[-1].split("/")[0]))
            yield page
            page.close()
        finally:
            process.terminate()
            process.wait(20)
            if process.stderr is not None:
                process.stderr.close()
