"""`canhaptic touch`: the process in which both sides run, the command, and the page in a browser."""

import contextlib
import math
import os
import signal
import subprocess
import sys
import threading
import urllib.parse
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from canhaptic.cli.main import main
from canhaptic.errors import InputError
from canhaptic.lab.touch.hand_process import TouchHand, TouchNews
from canhaptic.scene.load import load_scene
from tests.view.chromium import Page, chromium

ROOT = Path(__file__).parents[3]
STIFF = ROOT / "configs" / "hard" / "stiff_wall.yaml"


def news_of(hand: TouchHand, wanted: int, token: float = 0.0) -> TouchNews:
    """At least so many rows in one piece, computed since the pointer came with a token, and the last status."""
    pause, parts, status = threading.Event(), [], None
    for _ in range(3000):
        found = hand.look()
        since = found.rows["token"] == token
        parts.append({name: column[since] for name, column in found.rows.items()})
        status = found.status or status
        if sum(len(rows["time"]) for rows in parts) >= wanted:
            break
        pause.wait(0.02)
    rows = {name: np.concatenate([rows[name] for rows in parts]) for name in parts[0]}
    return TouchNews(rows, status)


@pytest.mark.slow
def test_the_hand_follows_the_pointer_and_freezes_where_it_stops() -> None:
    hand = TouchHand(load_scene(STIFF))
    try:
        hand.begin({})
        news_of(hand, 10)
        hand.move((-0.02,), 7.0)
        rows, status = news_of(hand, 500, 7.0)
        assert status is not None
        assert status.ended == ""
        assert status.skipped == 0
        still = rows["hand.x"][-100:]
        assert still == pytest.approx(-0.02, abs=1e-6)  # the pointer sends no more: the hand stays
        assert rows["time"] == pytest.approx(rows["time"][0] + 1e-3 * np.arange(len(rows["time"])))
        held = abs(rows["1.force.x"][-200:].mean())  # one sample is a few encoder counts of a stiff wall away from it
        assert held == pytest.approx(300.0 * 0.02, rel=0.05)  # the hand's spring on the wall
        hand.move((5.0,), 8.0)
        rows, _ = news_of(hand, 300, 8.0)
        assert rows["hand.x"].max() == pytest.approx(hand.touched.shown[0][1], abs=1e-4)
        with pytest.raises(InputError, match="stiffness"):
            hand.begin({"environment.stiffness": "-1"})
        rows, status = news_of(hand, 20, 8.0)
        assert status is not None
        assert status.run == 1  # what is refused leaves the run as it is
        hand.begin({"environment.stiffness": "200", "bus.rate": "500"})
        rows, status = news_of(hand, 20, 8.0)
        assert status is not None
        assert status.run == 2
        assert np.diff(rows["time"]) == pytest.approx(2e-3)
        hand._process.kill()
        hand._process.join()
        status = None
        while status is None or not status.ended:
            status = hand.look().status
        assert "exit code -9" in status.ended
        with pytest.raises(InputError, match="start canhaptic touch again"):
            hand.begin({})
    finally:
        hand.close()


def test_a_scene_for_real_drives_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["touch", str(ROOT / "configs" / "socketcan_example.yaml")]) == 2
    assert "must not move a real drive" in capsys.readouterr().err


@contextlib.contextmanager
def touch(*words: str) -> Iterator[tuple[str, "subprocess.Popen[str]"]]:
    pytest.importorskip("bokeh", reason="Bokeh is not installed (pip install 'canhaptic[report]')")
    command = [sys.executable, "-m", "canhaptic", "touch", *words]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT, start_new_session=True
    ) as process:
        assert process.stdout is not None
        try:
            yield process.stdout.readline().split(" at ")[1].split()[0], process
        finally:
            process.kill()


@pytest.mark.slow
def test_ctrl_c_ends_it_with_130_and_a_taken_port_is_said() -> None:
    with touch(str(STIFF), "--port", "0") as (address, process):
        assert address.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(address) as page:  # the first visit starts the drives
            assert b"bokeh" in page.read()
        taken = str(urllib.parse.urlsplit(address).port)
        assert main(["touch", str(STIFF), "--port", taken]) == 2
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does: every process of the command gets it
        assert process.wait(20) == 130
        assert process.stderr is not None
        assert process.stderr.read() == "canhaptic: interrupted\n"


MODEL = "[...Bokeh.documents[0]._all_models.values()].find(m => m.name == '{}')"
FRAME = """(() => {
  const find = (view, name) => view.model.name == name ? view
    : (view.child_views ?? []).map(v => find(v, name)).find(v => v) ?? null;
  const roots = Bokeh.index.values ? [...Bokeh.index.values()] : Object.values(Bokeh.index);
  const scene = find(roots[0], 'scene 0'), at = scene.canvas_view.el.getBoundingClientRect();
  const frame = scene.frame.bbox;
  return [at.x + frame.left, at.y + frame.top, frame.width, frame.height];
})()"""


def mouse(page: Page, kind: str, x: float, y: float) -> None:
    buttons = 0 if kind == "mouseReleased" else 1
    page.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=buttons, clickCount=1)


def grasp(page: Page, address: str) -> tuple[float, float, float]:
    """Opens the page and presses the pointer on the handle; returns (x, y of its middle, width of the strip) [px]."""
    page.open(address)
    page.wait_for("window.Bokeh && Bokeh.documents.length")
    page.wait_for(f"{MODEL.format('status')}.text.includes('cycles')", 60.0)
    left, top, width, height = page.value(FRAME)
    middle, across = left + 0.5 * width, top + 0.5 * height
    mouse(page, "mouseMoved", middle, across)
    mouse(page, "mousePressed", middle, across)
    return middle, across, width


@pytest.mark.campaign
def test_a_pointer_in_a_browser_drags_both_handles(tmp_path: Path) -> None:
    with chromium(width=1200, height=760) as page, touch(str(STIFF), "--port", "0") as (address, process):
        middle, across, width = grasp(page, address)
        pause = threading.Event()
        for k in range(200):
            mouse(page, "mouseMoved", middle - 0.4 * width * math.sin(0.06 * k), across)
            pause.wait(0.02)
        mouse(page, "mouseReleased", middle, across)
        verdicts = [MODEL.format(f"verdict {k}") + ".text" for k in (0, 1)]
        page.wait_for(f"{verdicts[0]}.includes('passive at the motor: NO')")
        assert "passive at the motor: yes" in page.value(verdicts[1])
        assert "gave out 0 J" in page.value(verdicts[1])
        handle = MODEL.format("handle 1") + ".data"
        last = -0.4 * 0.09 * math.sin(0.06 * 199)  # the strip shows 9 cm
        page.wait_for(f"Math.abs({handle}.hand_x[0] - {last}) < 4e-4")
        pause.wait(1.0)
        assert page.value(f"{handle}.hand_x[0]") == pytest.approx(last, abs=4e-4)  # the pointer sends no more
        assert page.value("window.answers.length") > 10
        lines, force = MODEL.format("lines 1") + ".data", MODEL.format("force")
        page.wait_for(f"{lines}.time.at(-1) - ({force}).x_range.end < 1.0")  # what is shown moves on with the run
        page.value(f"({MODEL.format('rate')}).active = 0")  # 200 Hz: begins anew
        page.wait_for(f"!{verdicts[0]}.includes('passive at the motor: NO')")
        page.screenshot(tmp_path / "touch.png")
        assert page.faults == []
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 130


@pytest.mark.campaign
def test_a_page_of_displays_shows_force_velocity_and_energy() -> None:
    words = ("--set", "environment.mass=0.5", "--set", "simulation.admittance.grip.mass=1")
    scene = str(ROOT / "configs" / "admittance" / "virtual_mass.yaml")
    with chromium(width=1200, height=980) as page, touch(scene, *words, "--port", "0") as (address, _):
        middle, across, width = grasp(page, address)
        pause = threading.Event()
        for k in range(100):
            mouse(page, "mouseMoved", middle + 0.3 * width * math.sin(0.06 * k), across)
            pause.wait(0.02)
        page.wait_for(f"{MODEL.format('verdict 1')}.text.includes('guarded: passive at the sensor: yes')")
        lines = MODEL.format("lines 1") + ".data"
        page.wait_for(f"Math.max(...({lines})['velocity x']) > 0.01")
        assert page.value(f"Math.max(...({lines})['force x'].map(Math.abs))") > 0.1
        assert page.value(f"({lines})['energy'].at(-1)") > -1e-3
        assert page.faults == []
