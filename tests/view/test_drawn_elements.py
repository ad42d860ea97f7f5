"""What the page of a run and the live page are made of: lines, areas, units, panels; of logs whose content is known."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from canhaptic.audit.inspection import inspect
from canhaptic.control.balance import AT_REST, Branch
from canhaptic.cycle import run
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.writer_process import EnergyLogWriter
from canhaptic.quantities import ALARM, GREY
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from canhaptic.signals import CycleTiming, Sample
from canhaptic.view import html_page
from canhaptic.view.run_picture import PortPicture
from canhaptic.view.series import LiveLog
from tests.view.synthetic_run import PORTS, write_run

CONFIGS = Path(__file__).parents[2] / "configs"
bokeh = pytest.importorskip("bokeh", reason="Bokeh is not installed (pip install 'canhaptic[report]')")


def page_of(path: Path) -> str:
    """The page that `inspect --html` writes."""
    with EnergyLog.open(path) as log:
        html_page.write_html(log, path.with_suffix(".html"), inspect(log))
    return path.with_suffix(".html").read_text(encoding="utf-8")


def scope_of(path: Path) -> Any:
    """The document that `scope` shows after one look."""
    from bokeh.document import Document

    from canhaptic.view.scope_page import ScopePage

    document = Document()
    ScopePage(document, LiveLog(path), 100.0, 0.2).update()
    return document


def figures(content: Any) -> list[Any]:
    from bokeh.plotting import figure

    return [panel for panel in content.select({"type": figure}) if panel.visible]


def titles(content: Any) -> list[str]:
    return [panel.yaxis[0].axis_label for panel in figures(content)]


def panel_of(content: Any, word: str) -> Any:
    return next(
        panel for panel in figures(content) if panel.yaxis[0].axis_label.endswith(f": {word}") or panel.name == word
    )


def glyphs(panel: Any) -> list[Any]:
    return [renderer.glyph for renderer in panel.renderers if hasattr(renderer, "glyph")]


def write_debt(path: Path) -> None:
    """200 cycles in which energy goes out: the margin falls to -1 J; 7 SYNCs are skipped in the middle."""
    attributes: dict[str, Any] = {"handle.wall_position": -0.02, "handle.wall_side": "below"}
    writer = EnergyLogWriter(path, PORTS, attributes, sample_time_ns=1_000_000, pace="free")
    for k in range(200):
        index = k + (7 if k >= 100 else 0)
        balance = AT_REST._replace(h_i=-0.005, h_r=0.0, branch=(Branch.EXACT if 20 <= k < 40 else Branch.FREE).value)
        writer.append(index, [Sample(index, 0.001, 1.0, 0x1237, True)], [balance], CycleTiming(1, 2, 3, 4))
    writer.close()


@pytest.fixture(scope="module")
def debt(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of the 200 cycles in debt: several tests look at it, none changes it."""
    path = tmp_path_factory.mktemp("debt") / "run.h5"
    write_debt(path)
    return path


@pytest.fixture(scope="module")
def scope(debt: Path) -> Any:
    """What `scope` shows of it."""
    return scope_of(debt)


@pytest.mark.slow
def test_panels_that_hold_only_zeros_are_left_out_and_named(tmp_path: Path) -> None:
    with build(load_scene(CONFIGS / "demo.yaml"), "free", tmp_path / "run.h5") as experiment:
        run(experiment.cycle, 1500)
    page = page_of(tmp_path / "run.h5")
    drawn = [title for title in ("position", "force", "energy", "surplus") if f">{title}</text>" in page]
    assert drawn == ["position", "force", "energy"]
    assert ">handle: damping rendered</text>" in page
    assert "zero throughout, not drawn: timing, lost" in page
    expected = [f"handle: {name}" for name in ("position", "force", "energy", "damping", "states", "spectrum")]
    assert sorted(titles(scope_of(tmp_path / "run.h5"))) == sorted(expected)


@pytest.mark.slow
def test_axes_and_pointer_carry_units_with_a_prefix(tmp_path: Path) -> None:
    write_run(tmp_path / "run.h5", cycles=1500, ports=("handle", "knob"))
    live = figures(scope_of(tmp_path / "run.h5"))
    units = {panel.yaxis[0].axis_label: getattr(panel.yaxis[0].formatter, "args", {}) for panel in live}
    assert units["handle: position"]["unit"] == "m"
    assert (1e-3, "m") in units["handle: position"]["prefixes"]
    assert units["handle: force"]["unit"] == "N"
    assert units["handle: energy"]["unit"] == "J"
    assert units["knob: position"]["unit"] == "rad"
    assert units["knob: position"]["prefixes"] == [(1.0, "")]
    assert units["knob: torque"]["unit"] == "N*m"
    page = page_of(tmp_path / "run.h5")
    assert all(f">{unit}</text>" in page for unit in ("[mm]", "[N]", "[mJ]", "[mrad]", "[N*m]"))


@pytest.mark.slow
def test_a_negative_margin_is_an_area_of_its_own_and_no_alarm(scope: Any) -> None:
    panel = panel_of(scope, "energy")
    areas = {glyph.fill_color: glyph for glyph in glyphs(panel) if type(glyph).__name__ == "VArea"}
    data = {name: np.asarray(v) for r in panel.renderers for name, v in r.data_source.data.items()}
    below, green = areas[GREY], areas["#009E73"]
    assert ALARM not in areas
    assert np.abs(data[below.y2] - data[below.y1]).max() == pytest.approx(1.0, rel=1e-6)
    assert np.abs(data[green.y2] - data[green.y1]).max() == 0.0


@pytest.mark.slow
def test_wall_and_contacts_are_on_the_live_page(scope: Any) -> None:
    from bokeh.models import BoxAnnotation

    from canhaptic.view.drawn_handle import MIDDLE

    panel = panel_of(scope, "position")
    inside = panel.select_one({"type": BoxAnnotation, "fill_color": MIDDLE})
    assert inside.top == -0.02
    assert "wall" in [item.label.value for item in panel.legend[0].items]
    strip = next(renderer for renderer in panel.renderers if type(getattr(renderer, "glyph", 0)).__name__ == "VStrip")
    assert strip.data_source.data["start"] == pytest.approx([0.020])
    assert strip.data_source.data["end"] == pytest.approx([0.039])


@pytest.mark.slow
def test_skipped_syncs_are_counted_and_drawn(scope: Any) -> None:
    assert "SYNCs skipped 7" in scope.select_one({"name": "status"}).text
    data = next(r for r in panel_of(scope, "lost").renderers if r.name == "SYNCs skipped").data_source.data
    assert max(data["SYNCs skipped"]) == 7
    assert data["time"][int(np.argmax(data["SYNCs skipped"]))] == pytest.approx(0.107)


@pytest.mark.slow
def test_a_fault_behind_skipped_syncs_is_marked_where_its_row_is(tmp_path: Path) -> None:
    writer = EnergyLogWriter(tmp_path / "run.h5", PORTS, {}, sample_time_ns=1_000_000, pace="free")
    for k in range(200):
        samples = [Sample(k, 0.001, 1.0, 0x1237, True)]
        writer.append(k, samples, [AT_REST], CycleTiming(1, 2, 3, 4), deadline=k + (70 if k >= 100 else 0))
    writer.event(150, "fault", "handle", "too hot")
    writer.close()
    panel = panel_of(scope_of(tmp_path / "run.h5"), "force")
    marks = [r.data_source.data for r in panel.renderers if "at" in r.data_source.data]
    assert [list(data["at"]) for data in marks] == [[pytest.approx(0.220)]]
    with EnergyLog.open(tmp_path / "run.h5") as log:
        assert PortPicture(log, "handle", slice(0, log.rows)).faults() == "\n0.22 s: fault too hot"
    assert ">0.22 s: fault too hot</text>" in page_of(tmp_path / "run.h5")
