"""The page of the scope without a browser: what it takes from the log, and what it says."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from canhaptic.cycle import run
from canhaptic.logs.columns import Event
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from canhaptic.view.series import LiveLog, MarkedEvent
from tests.view.synthetic_run import write_run

pytest.importorskip("bokeh", reason="Bokeh is not installed (pip install 'canhaptic[report]')")
_STATES = ("states", "spectrum")
CONFIGS = Path(__file__).parents[2] / "configs"


def page_of(path: Path, window: float = 1.0) -> tuple[Any, Any]:
    """A page and the document of its visitor."""
    from bokeh.document import Document

    from canhaptic.view.scope_page import ScopePage

    document = Document()
    return ScopePage(document, LiveLog(path), window, 0.2), document


def status_of(document: Any) -> str:
    return str(document.select_one({"name": "status"}).text)


def columns_of(document: Any) -> list[dict[str, Any]]:
    from bokeh.models import ColumnDataSource

    return [dict(source.data) for source in document.select({"type": ColumnDataSource})]


def titles_of(document: Any) -> list[str]:
    from bokeh.plotting import figure

    return [panel.name for panel in document.select({"type": figure})]


@pytest.mark.slow
def test_a_page_waits_for_its_log_and_then_shows_the_last_seconds(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    page, document = page_of(path)
    page.update()
    assert "waiting for" in status_of(document)
    path.write_bytes(b"no <b>log</b>")
    page.update()
    assert "not a readable HDF5 file" in status_of(document)  # why it still waits
    write_run(path, cycles=3000, ports=("handle", "knob"))
    page.update()
    parts = {"handle": ("position", "force"), "knob": ("position", "torque")}
    expected = [
        f"{name}: {what}"
        for name, whats in parts.items()
        for what in (*whats, "energy", "surplus", "damping", *_STATES)
    ]
    assert sorted(titles_of(document)) == sorted([*expected, "knob: knob", "timing", "lost"])
    for columns in columns_of(document):
        if "time" not in columns:
            continue
        assert columns["time"][-1] == 2.999
        assert 1.999 <= columns["time"][0] < 2.01
        assert np.all(np.diff(columns["time"]) > 0.0)
    assert "complete" in status_of(document)
    assert "3000 cycles" in status_of(document)
    assert "SYNC 1500 emcy handle: 0x8130 heartbeat lost" in status_of(document)


@pytest.mark.slow
def test_detents_are_notches_that_leave_the_scale_to_the_position(tmp_path: Path) -> None:
    scene = load_scene(CONFIGS / "rotary_knob.yaml")
    with build(scene, energy_log=tmp_path / "run.h5") as experiment:
        run(experiment.cycle, 20)
    page, document = page_of(tmp_path / "run.h5")
    page.update()
    panel = document.select_one({"name": "knob: position"})
    notches = np.array(document.select_one({"name": "notches"}).data_source.data["y"])
    assert np.allclose(np.diff(notches), np.radians(15.0))
    assert panel.y_range.renderers == [document.select_one({"name": "position"})]
    assert document.select_one({"name": "wall"}) is None


@pytest.mark.slow
def test_a_page_looks_again_in_its_period(tmp_path: Path) -> None:
    write_run(tmp_path / "run.h5", cycles=10)
    _, document = page_of(tmp_path / "run.h5")
    assert [callback.period for callback in document.session_callbacks] == [200]  # ms


@pytest.mark.slow
def test_a_group_has_the_energy_and_its_axes_the_positions(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    with build(load_scene(CONFIGS / "xy_box.yaml"), "free", path) as experiment:
        run(experiment.cycle, 50)
    page, document = page_of(path)
    page.update()
    of_axes = [f"{name}: {what}" for name in ("x", "y") for what in ("force", "position", *_STATES)]
    of_group = [f"stage: {what}" for what in ("damping", "energy", "force", "surplus")]
    assert sorted(titles_of(document)) == sorted(["lost", "timing", "stage: plane", *of_axes, *of_group])
    assert "stage: " in status_of(document)
    assert "x: free" not in status_of(document)


@pytest.mark.slow
def test_the_status_ends_with_the_last_four_events(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    write_run(path, cycles=300)
    news = LiveLog(path).look()
    assert news is not None
    news = news._replace(
        events=[MarkedEvent(0.0, Event(number, "late", "handle", f"text {number}")) for number in range(6)]
    )
    from canhaptic.view.scope_page import _status

    lines = _status(news, news).split("<br>")
    assert lines[-4:] == [f"SYNC {number} late handle: text {number}" for number in (2, 3, 4, 5)]
    assert "text 1" not in "".join(lines)
