"""Pictures of the pages in a browser: 800 and 1,600 pixels wide, light and dark. They lie in the test's folder."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

import canhaptic
from tests.view.chromium import Page, chromium

MODEL = "Bokeh.documents[0].get_model_by_name"
READY = f"window.Bokeh && Bokeh.documents.length && {MODEL}('status')?.text.includes('cycle')"
LAID = f"{MODEL}('back') && Bokeh.documents[0].is_idle"
OUTSIDE = """[...document.querySelectorAll('div.table')].every(of => of.scrollWidth <= of.clientWidth)
    && document.documentElement.scrollWidth <= innerWidth"""
SHADE = "getComputedStyle(document.body).backgroundColor.match(/\\d+/g).slice(0, 3).reduce((a, b) => a + Number(b), 0)"
TIME = "[...Bokeh.documents[0]._all_models.values()].find(of => of.type == 'DataRange1d' && of.follow_interval)"


def picture_of(page: Page, path: Path) -> int:
    """Takes a picture, and returns how many different grey values it has: a blank page has one."""
    image = pytest.importorskip("matplotlib.image")
    page.screenshot(path)
    return len({round(float(value), 2) for row in image.imread(path)[::7, ::7, :3] for value in row.mean(axis=1)})


def looks_made(page: Page, path: Path) -> None:
    for width in (800, 1600):
        page.call("Emulation.setDeviceMetricsOverride", width=width, height=1000, deviceScaleFactor=1, mobile=False)
        for scheme in ("light", "dark"):
            features = [{"name": "prefers-color-scheme", "value": scheme}]
            page.call("Emulation.setEmulatedMedia", features=features)
            page.wait_for(f"{SHADE} {'>' if scheme == 'light' else '<'} 382")
            page.value("new Promise(done => setTimeout(done, 1500))")  # Bokeh draws again with its next data
            assert page.value(OUTSIDE), (width, scheme)
            assert picture_of(page, path / f"{path.name}_{width}_{scheme}.png") > 8
    assert page.faults == []


@contextmanager
def served(*words: str) -> Iterator[str]:
    pytest.importorskip("bokeh", reason="Bokeh is not installed (pip install 'canhaptic[report]')")
    command: list[Any] = [sys.executable, "-m", "canhaptic", *words, "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True) as process:
        assert process.stdout is not None
        try:
            yield process.stdout.readline().split(" at ")[1].split()[0]
        finally:
            process.kill()


@pytest.mark.campaign
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("scene", "x", "y"), [("demo", -0.1, 0.0), ("rotary_knob", 0.6, 0.0), ("five_bar_sphere", 0.02, 0.26)]
)
def test_the_page_of_touch_looks_made_and_stands_still_while_it_is_paused(
    scene: str, x: float, y: float, tmp_path: Path
) -> None:
    with chromium() as page, served("touch", scene) as address:
        page.open(address)
        page.wait_for(f"{READY} && {LAID}", 120.0)
        page.value(f"{MODEL}('pointer').data = {{x: [{x}], y: [{y}], token: [1]}}")
        looks_made(page, tmp_path)
        page.value(f"{MODEL}('back').value = 1.0")
        page.wait_for(f"{MODEL}('pause').active")
        first = page.value(f"{TIME}.end")
        page.value("new Promise(done => setTimeout(done, 1000))")
        assert page.value(f"{TIME}.end") == first
        page.value(f"{MODEL}('pause').active = false")
        assert page.value(f"{MODEL}('back').value") == 0.0
        page.wait_for(f"{TIME}.end > {first}")


@pytest.mark.campaign
@pytest.mark.timeout(600)
@pytest.mark.parametrize("scene", ["demo", "rotary_knob", "five_bar_sphere"])
def test_the_page_of_scope_looks_made(scene: str, tmp_path: Path) -> None:
    log = canhaptic.simulate(scene, duration=2.0, progress=False).save(tmp_path / "run.h5")
    with chromium() as page, served("scope", str(log)) as address:
        page.open(address)
        page.wait_for(f"{READY} && {LAID}", 120.0)
        looks_made(page, tmp_path)


@pytest.mark.campaign
@pytest.mark.timeout(600)
def test_the_page_of_accuracy_has_a_title_and_a_table_that_fits(tmp_path: Path) -> None:
    path = tmp_path / "accuracy.html"
    command = [sys.executable, "-m", "canhaptic", "accuracy", "demo", "--duration", "0.3", "--budget", "0"]
    subprocess.run([*command, "--html", str(path)], check=True, capture_output=True)
    with chromium() as page:
        page.open(path.as_uri())
        page.wait_for("document.readyState == 'complete'")
        looks_made(page, tmp_path)
        assert page.value("document.title") == page.value("document.querySelector('h1').innerText") == "demo - accuracy"
