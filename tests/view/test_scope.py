import contextlib
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.client import HTTPConnection
from pathlib import Path
from subprocess import PIPE, Popen
from urllib.parse import urlsplit

import numpy as np
import pytest

from canhaptic.cli.main import main
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.writer_process import EnergyLogWriter
from canhaptic.view import series
from canhaptic.view.series import LiveLog
from tests.view.chromium import chromium
from tests.view.synthetic_run import PORTS, append, write_run, write_troubled_run

DEMO = Path(__file__).parents[2] / "configs" / "demo.yaml"


@pytest.mark.slow
def test_looks_at_a_growing_log_add_up_to_the_whole_run(tmp_path: Path) -> None:
    live = LiveLog(tmp_path / "run.h5")
    assert live.look() is None
    write_run(tmp_path / "run.h5", cycles=3000)
    looks = [live.look() for _ in range(2)]
    first, second = looks
    assert first is not None
    assert second is not None
    assert (first.rows, len(first.time), len(second.time)) == (3000, 3000, 0)
    with EnergyLog.open(tmp_path / "run.h5") as log:
        assert np.allclose(first.ports["handle"]["taken_in"], np.cumsum(log.ports["handle"]["h_i"]), rtol=1e-12)
        assert first.status == log.status
    write_run(tmp_path / "run.h5", cycles=300)  # another run in the same file
    again = live.look()
    assert again is not None
    assert again.restarted
    assert len(again.time) == 300
    assert again.ports["handle"]["taken_in"][0] == 0.0


@pytest.mark.slow
def test_a_viewer_that_comes_late_takes_the_past_in_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(series, "_MOST_AT_ONCE", 1300)
    write_run(tmp_path / "run.h5", cycles=3000)
    live = LiveLog(tmp_path / "run.h5")
    looks = [news for _ in range(4) if (news := live.look()) is not None]
    assert [len(news.time) for news in looks] == [1300, 1300, 400, 0]
    assert {news.rows for news in looks} == {3000}
    with EnergyLog.open(tmp_path / "run.h5") as log:
        for drawn, column in (("taken_in", "h_i"), ("dissipated", "h_r")):
            pieces = np.concatenate([news.ports["handle"][drawn] for news in looks])
            assert np.allclose(pieces, np.cumsum(log.ports["handle"][column]), rtol=1e-12)


@pytest.mark.slow
def test_the_share_of_tpdos_that_came_is_of_all_so_far(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(series, "_MOST_AT_ONCE", 40)
    write_troubled_run(tmp_path / "run.h5")
    live = LiveLog(tmp_path / "run.h5")
    assert [news.fresh_share for _ in range(3) if (news := live.look())] == pytest.approx([38 / 40, 77 / 80, 0.97])


@pytest.mark.slow
def test_a_log_under_the_writers_hands_is_followed(tmp_path: Path) -> None:
    path, live, seen = tmp_path / "run.h5", LiveLog(tmp_path / "run.h5"), []
    writer = EnergyLogWriter(path, PORTS, {}, sample_time_ns=1_000_000, with_truth=False)
    pause = threading.Event()
    for k in range(2000):
        append(writer, k)
        if k % 200 == 0:
            pause.wait(0.05)
            news = live.look()
            if news is not None:
                seen += news.time.tolist()
    writer.close()
    news = live.look()
    assert news is not None
    assert not news.restarted
    seen += news.time.tolist()
    assert np.allclose(seen, np.arange(2000) * 1e-3)


def test_the_scope_wants_to_know_its_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scope"]) == 2
    assert main(["scope", "--config", str(DEMO)]) == 2
    assert "has no log.energy" in capsys.readouterr().err
    assert main(["scope", str(tmp_path / "run.h5"), "--window", "0"]) == 2


@contextlib.contextmanager
def scope(log: Path, number: signal.Signals = signal.SIGINT) -> Iterator[str]:
    words = ["scope", str(log), "--port", "0", "--window", "3"]  # of its own: a fork has the event loops of other tests
    with Popen([sys.executable, "-m", "canhaptic", *words], text=True, stdout=PIPE, stderr=PIPE) as process:
        assert process.stdout is not None
        try:
            line = process.stdout.readline()
            assert " at " in line
            yield line.split(" at ")[1].split()[0]
            process.send_signal(number)
            assert process.wait(20) == 128 + number
            assert process.stderr is not None
            assert process.stderr.read() == ("canhaptic: interrupted\n" if number == signal.SIGINT else "")
        finally:
            process.kill()


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_scope_with_its_own_status(number: signal.Signals, tmp_path: Path) -> None:
    pytest.importorskip("bokeh", reason="Bokeh is not installed (pip install 'canhaptic[report]')")
    with scope(tmp_path / "run.h5", number) as address:
        assert address.startswith("http://127.0.0.1:")


@pytest.mark.slow
def test_a_bad_token_is_refused_in_one_line_and_no_page_may_frame_this_one(tmp_path: Path) -> None:
    pytest.importorskip("bokeh", reason="Bokeh is not installed (pip install 'canhaptic[report]')")
    words = ["scope", str(tmp_path / "run.h5"), "--port", "0", "--window", "3"]
    with Popen([sys.executable, "-m", "canhaptic", *words], text=True, stdout=PIPE, stderr=PIPE) as process:
        try:
            assert process.stdout is not None
            address = urlsplit(process.stdout.readline().split(" at ")[1].split()[0])
            connection = HTTPConnection("127.0.0.1", address.port or 0, timeout=60)
            connection.request("GET", address.path)
            page = connection.getresponse()
            assert (page.status, page.headers["X-Frame-Options"]) == (200, "DENY")
            assert "frame-ancestors 'none'" in page.headers["Content-Security-Policy"]
            page.read()
            asked = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13"}
            asked |= {"Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==", "Sec-WebSocket-Protocol": "bokeh, e30.bad"}
            connection.request("GET", f"{address.path}/ws", headers=asked)
            with connection.getresponse() as answer, contextlib.closing(connection):
                assert answer.status == 101
        finally:
            process.send_signal(signal.SIGINT)
            _, err = process.communicate(timeout=60)
    assert "Traceback" not in err
    assert "a browser was refused: " in err


@pytest.mark.campaign
def test_a_browser_sees_a_run_while_it_goes_on(tmp_path: Path) -> None:
    pytest.importorskip("bokeh", reason="Bokeh is not installed (pip install 'canhaptic[report]')")
    log = tmp_path / "run.h5"
    words = ["run", str(DEMO), "--pace", "real", "--duration", "600", "--set", "bus.rate=200 Hz", "--log", str(log)]
    words += ["--set", "bus.heartbeat_timeout=10 s", "--set", "bus.stop_cycles=2000"]
    words += ["--set", "axes.0.energy_loss_limit=none"]  # with a busy browser
    with chromium(height=900) as page, scope(log) as address:
        assert address.startswith("http://127.0.0.1:")
        page.open(address)
        page.wait_for("window.Bokeh && Bokeh.documents.length")
        status = "[...Bokeh.documents[0]._all_models.values()].find(m => m.name == 'status').text"
        page.wait_for(f"{status}.includes('waiting for')")
        with subprocess.Popen([sys.executable, "-m", "canhaptic", *words], stdout=subprocess.DEVNULL) as run:
            try:
                page.wait_for(f"{status}.includes('running')")
                source = "[...Bokeh.documents[0]._all_models.values()].find(m => m.data && 'position' in m.data)"
                page.wait_for(f"({source}).data.position.length > 300")
                early = page.value(f"({source}).data.time.at(-1)")
                page.wait_for(f"({source}).data.time.at(-1) > {early} + 0.5")
                panel = "[...Bokeh.documents[0]._all_models.values()].find(m => m.x_range && m.x_range.follow)"
                page.wait_for(f"({panel}).x_range.end > {early} + 0.5")  # what is shown moves on with the run
                page.screenshot(tmp_path / "scope.png")
                assert run.poll() is None  # all that was while the run went on
                text = page.value(status)
                assert "operation enabled" in text
                assert "margin" in text
                run.send_signal(signal.SIGINT)
                page.wait_for(f"{status}.includes('stopped')")
            finally:
                run.kill()
        assert page.faults == []
