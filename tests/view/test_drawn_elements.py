"""What a page and a live page are made of: lines, areas, units, panels; of logs whose content is known."""

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from canhaptic.audit.inspection import inspect
from canhaptic.control.balance import AT_REST, Branch
from canhaptic.cycle import run
from canhaptic.logs.energy_log import EnergyLogWriter
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from canhaptic.signals import CycleTiming, Sample
from canhaptic.view import html_report
from canhaptic.view.live_log import LiveLog
from canhaptic.view.port_picture import PortPicture
from canhaptic.view.series import PortSeries
from tests.view.synthetic_run import PORTS, write_run

CONFIGS = Path(__file__).parents[2] / "configs"
bokeh = pytest.importorskip("bokeh", reason="Bokeh is not installed (pip install 'canhaptic[report]')")


def page_of(path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The layout that `inspect --html` would write."""
    written: list[Any] = []
    monkeypatch.setattr(html_report, "write_page", lambda content, *_: written.append(content))
    with EnergyLog.open(path) as log:
        html_report.write_html(log, path.with_suffix(".html"), inspect(log))
    return written[0]


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


def kinds(panel: Any) -> set[str]:
    return {type(glyph).__name__ for glyph in glyphs(panel)}


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
def debt(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Any]:
    """Page and scope of the 200 cycles in debt: several tests look at them, none changes them."""
    path = tmp_path_factory.mktemp("debt") / "run.h5"
    write_debt(path)
    with pytest.MonkeyPatch.context() as patch:
        return page_of(path, patch), scope_of(path)


@pytest.mark.slow
def test_a_decimated_torque_is_a_plain_line_and_a_whole_one_a_stair(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_run(tmp_path / "long.h5", cycles=3000)
    assert kinds(panel_of(page_of(tmp_path / "long.h5", monkeypatch), "force")) == {"Line", "VStrip", "VSpan"}
    write_run(tmp_path / "short.h5", cycles=300)
    stairs = glyphs(panel_of(page_of(tmp_path / "short.h5", monkeypatch), "force"))
    modes = {glyph.y: glyph.mode for glyph in stairs if type(glyph).__name__ == "Step"}
    assert modes == {"command": "after", "applied": "before"}  # a command acts behind its SYNC, a measured torque did


def test_commanded_and_applied_torque_are_nowhere_drawn_further_apart_than_they_are(tmp_path: Path) -> None:
    write_run(tmp_path / "long.h5", cycles=3000)
    with EnergyLog.open(tmp_path / "long.h5") as log:
        port, series = log.ports["handle"], PortSeries(log, "handle", slice(0, log.rows))
        apart = np.abs(port["torque_command"] - port["torque_applied"]).max()
    assert not series.is_whole
    assert np.abs(series.columns["command"] - series.columns["applied"]).max() <= apart * (1.0 + 1e-6)


@pytest.mark.slow
def test_panels_that_hold_only_zeros_are_left_out_and_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with build(load_scene(CONFIGS / "demo.yaml"), "free", tmp_path / "run.h5") as experiment:
        run(experiment.cycle, 1500)
    page = page_of(tmp_path / "run.h5", monkeypatch)
    expected = [f"handle: {name}" for name in ("position", "force", "energy", "damping")]
    assert sorted(titles(page)) == sorted([*expected, "handle: force over position"])
    heading = page.select_one({"name": "heading"}).text
    assert "not drawn: handle: surplus, lost" in heading
    assert sorted(titles(scope_of(tmp_path / "run.h5"))) == sorted(expected)


@pytest.mark.slow
def test_axes_and_pointer_carry_units_with_a_prefix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_run(tmp_path / "run.h5", cycles=1500, ports=("handle", "knob"))
    for content in (page_of(tmp_path / "run.h5", monkeypatch), scope_of(tmp_path / "run.h5")):
        units = {panel.yaxis[0].axis_label: panel.yaxis[0].formatter.args for panel in figures(content)}
        assert units["handle: position"]["unit"] == "m"
        assert (1e-3, "m") in units["handle: position"]["prefixes"]
        assert units["handle: force"]["unit"] == "N"
        assert units["handle: energy"]["unit"] == "J"
        assert units["knob: position"]["unit"] == "rad"
        assert units["knob: position"]["prefixes"] == [(1.0, "")]
        assert units["knob: torque"]["unit"] == "N*m"


@pytest.mark.slow
def test_scope_and_page_have_the_same_panels_lines_and_colours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_run(tmp_path / "run.h5", cycles=6000)
    page, scope = page_of(tmp_path / "run.h5", monkeypatch), scope_of(tmp_path / "run.h5")
    assert sorted(set(titles(page)) - {"handle: force over position"}) == sorted(titles(scope))

    def drawn(content: Any, title: str) -> set[tuple[str, str, str]]:
        parts = set()
        for glyph in glyphs(panel_of(content, title)):
            kind = type(glyph).__name__
            if kind != "Scatter":  # the least margin is marked when a run is over
                parts.add((kind, str(getattr(glyph, "line_color", "")), str(getattr(glyph, "fill_color", ""))))
        return parts

    for title in ("position", "force", "energy", "surplus", "damping", "timing"):
        assert drawn(page, title) == drawn(scope, title), title


@pytest.mark.slow
def test_a_negative_margin_is_an_area_of_its_own_in_red(debt: tuple[Any, Any]) -> None:
    for content in debt:
        panel = panel_of(content, "energy")
        areas = {glyph.fill_color: glyph for glyph in glyphs(panel) if type(glyph).__name__ == "VArea"}
        data = {name: np.asarray(v) for r in panel.renderers for name, v in r.data_source.data.items()}
        red, green = areas["#D55E00"], areas["#009E73"]
        assert np.abs(data[red.y2] - data[red.y1]).max() == pytest.approx(1.0, rel=1e-6)
        assert np.abs(data[green.y2] - data[green.y1]).max() == 0.0


@pytest.mark.slow
def test_wall_and_contacts_are_in_page_and_scope(debt: tuple[Any, Any]) -> None:
    from bokeh.models import BoxAnnotation

    for content in debt:
        panel = panel_of(content, "position")
        inside = panel.select_one({"type": BoxAnnotation, "fill_color": "#4D4D4D"})
        assert inside.top == -0.02
        assert "wall" in [item.label.value for item in panel.legend[0].items]
        strip = next(
            renderer for renderer in panel.renderers if type(getattr(renderer, "glyph", 0)).__name__ == "VStrip"
        )
        assert strip.data_source.data["start"] == pytest.approx([0.020])
        assert strip.data_source.data["end"] == pytest.approx([0.039])


@pytest.mark.slow
def test_skipped_syncs_are_counted_and_drawn(debt: tuple[Any, Any]) -> None:
    assert "SYNCs skipped 7" in debt[1].select_one({"name": "status"}).text
    for content in debt:
        data = next(r for r in panel_of(content, "lost").renderers if r.name == "SYNCs skipped").data_source.data
        assert max(data["SYNCs skipped"]) == 7
        assert data["time"][int(np.argmax(data["SYNCs skipped"]))] == pytest.approx(0.107)


@pytest.mark.slow
def test_a_fault_behind_skipped_syncs_is_marked_where_its_row_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = EnergyLogWriter(tmp_path / "run.h5", PORTS, {}, sample_time_ns=1_000_000, pace="free")
    for k in range(200):
        samples = [Sample(k, 0.001, 1.0, 0x1237, True)]
        writer.append(k, samples, [AT_REST], CycleTiming(1, 2, 3, 4), deadline=k + (70 if k >= 100 else 0))
    writer.event(150, "fault", "handle", "too hot")
    writer.close()
    page, scope = page_of(tmp_path / "run.h5", monkeypatch), scope_of(tmp_path / "run.h5")
    for content in (page, scope):
        marks = [r.data_source.data for r in panel_of(content, "force").renderers if "at" in r.data_source.data]
        assert [list(data["at"]) for data in marks] == [[pytest.approx(0.220)]]
    with EnergyLog.open(tmp_path / "run.h5") as log:
        assert PortPicture(log, "handle", slice(0, log.rows)).faults() == "\n0.22 s: fault too hot"


@pytest.mark.slow
def test_a_bar_says_the_verdict(debt: tuple[Any, Any], tmp_path: Path) -> None:
    page, scope = debt
    for text in (page.select_one({"name": "heading"}).text, scope.select_one({"name": "status"}).text):
        assert "handle: passive at the motor: NO<" in text
    write_run(tmp_path / "run.h5", cycles=3000)
    assert "handle: passive at the motor: yes<" in scope_of(tmp_path / "run.h5").select_one({"name": "status"}).text


@pytest.mark.slow
def test_several_runs_lie_over_one_page_and_two_cursors_read_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from bokeh.models import Span

    for name in ("run.h5", "second.h5", "third.h5"):
        write_run(tmp_path / name, cycles=1500)
    with ExitStack() as stack:
        log, *others = [stack.enter_context(EnergyLog.open(p)) for p in sorted(tmp_path.glob("*.h5"))]
        kept: list[Any] = []
        monkeypatch.setattr(html_report, "write_page", lambda content, _title, _path: kept.append(content))
        html_report.write_html(log, tmp_path / "page.html", inspect(log), others=others)
    [page] = kept
    for word in ("position", "force over position"):
        labels = [item.label.value for item in panel_of(page, word).legend[0].items]
        assert labels[-2:] == ["second.h5", "third.h5"]
    timed = [panel for panel in figures(page) if panel.name.split(": ")[-1] in ("position", "force", "energy")]
    cursors = [{span.name for span in panel.select({"type": Span}) if span.editable} for panel in timed]
    assert len(timed) == 3
    assert cursors == [{"cursor 1", "cursor 2"}] * 3
    span = next(span for span in timed[0].select({"type": Span}) if span.editable)
    [read] = span.js_property_callbacks["change:location"]
    assert [read.args[name].name for name in ("first", "second")] == ["cursor 1", "cursor 2"]
