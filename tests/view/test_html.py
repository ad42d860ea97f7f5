import re
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from canhaptic.audit.extent import contacts
from canhaptic.cli.main import main
from canhaptic.errors import InputError
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.view import html_report
from canhaptic.view.run_picture import energy_figure
from canhaptic.view.series import PortSeries
from tests.view import typed
from tests.view.chromium import chromium
from tests.view.hour_run import SPIKE, write_hour
from tests.view.synthetic_run import write_run, write_troubled_run

ROOT = Path(__file__).parents[2]
READY = "window.Bokeh && Bokeh.documents.length && Bokeh.documents[0].is_idle"


@pytest.mark.slow
def test_what_is_drawn_keeps_spikes_and_every_row_around_worst_margin_and_faults(tmp_path: Path) -> None:
    write_hour(tmp_path / "run.h5", rows=200_000)
    with EnergyLog.open(tmp_path / "run.h5") as log:
        series = PortSeries(log, "handle", slice(0, log.rows))
    time, position = series.columns["time"], series.columns["position"]
    assert len(time) < 12_000
    assert np.all(np.diff(time) > 0)
    assert position.max() == np.float32(SPIKE)
    assert series.columns["margin"].min() == series.columns["margin"][np.searchsorted(time, series.worst)]
    for place in (series.worst, series.faults[0].time):
        around = time[(time > place - 0.2) & (time < place + 0.2)]
        assert len(around) in (399, 400)
    touching = position < -0.02
    assert abs(len(series.contacts["start"]) - 100) <= 1
    assert touching.any()


def test_contacts_are_drawn_with_their_peak_and_energy_and_faults_with_their_port(tmp_path: Path) -> None:
    write_run(tmp_path / "run.h5", cycles=3000, ports=("handle", "knob"))
    with EnergyLog.open(tmp_path / "run.h5") as log:
        handle, knob = (PortSeries(log, name, slice(0, log.rows)) for name in ("handle", "knob"))
        port, found = log.ports["handle"], contacts(log.ports["handle"]["branch"])
        assert len(found) == 2
        for place, (first, last) in enumerate(found):
            rows = slice(first, last + 1)
            assert handle.contacts["start"][place] == pytest.approx(first * 1e-3)
            assert handle.contacts["end"][place] == pytest.approx(last * 1e-3)
            assert handle.contacts["peak"][place] == pytest.approx(np.abs(port["torque_applied"][rows]).max(), rel=1e-6)
            assert handle.contacts["energy"][place] == pytest.approx(port["h_i"][rows].sum(), abs=1e-7)
    shown = ("time", "position", "command", "applied", "damping", "margin", "surplus")
    assert [handle.facts.units[name] for name in shown] == ["s", "m", "N", "N", "N*s/m", "J", "J"]
    assert [knob.facts.units[name] for name in shown] == ["s", "rad", "N*m", "N*m", "N*m*s/rad", "J", "J"]
    assert [(fault.event.sync_index, fault.time) for fault in handle.faults] == [(1500, pytest.approx(1.5))]
    assert knob.faults == []


class Taken:
    """Replaces the panels and keeps what they are given."""

    def timing(self, columns: dict[str, np.ndarray], period: float) -> dict[str, np.ndarray]:
        assert period == 1e-3  # [s]
        return columns

    def link(self, columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return columns


@pytest.mark.slow
def test_late_cycles_and_lost_frames_are_drawn(tmp_path: Path) -> None:
    write_troubled_run(tmp_path / "run.h5")
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        file["timing/dropped_before"][60] = 4
    with EnergyLog.open(tmp_path / "run.h5") as log:
        rows = slice(0, log.rows)
        timing, link = html_report._timing(log, rows, Taken()), html_report._link(log, rows, Taken())  # type: ignore[arg-type]
    assert timing["wakeup_lateness"].max() == pytest.approx(950e-6)  # [s]
    assert timing["time"][timing["wakeup_lateness"].argmax()] == pytest.approx(0.030)
    missed, dropped = link["handle: TPDOs missed"], link["cycles not in the log"]
    steps = np.searchsorted(link["time"], [0.0095, 0.0105, 0.0115, 0.1015]) - 1  # each lasts until the next
    assert missed[steps].tolist() == [0.0, 1.0, 2.0, 3.0]
    assert (dropped[0], dropped[-1]) == (0.0, 4.0)
    assert link["time"][dropped.argmax()] == pytest.approx(0.062)


@pytest.mark.slow
def test_a_part_of_a_run_can_be_drawn_and_an_empty_log_cannot(tmp_path: Path) -> None:
    pytest.importorskip("bokeh", reason="Bokeh is not installed (pip install 'canhaptic[report]')")
    write_run(tmp_path / "run.h5", cycles=600, ports=("handle", "knob"))
    assert (
        typed.inspect(tmp_path / "run.h5", "--html", tmp_path / "part.html", "--from", "0.1", "--to", "0.3", "--json")
        == 0
    )
    page = (tmp_path / "part.html").read_text()
    assert len(page) < 6_000_000
    assert not re.search(r"<script[^>]+src=|<link[^>]+href=", page)  # nothing is fetched from anywhere
    write_run(tmp_path / "empty.h5", cycles=0)
    with pytest.raises(InputError, match="no cycle"):
        typed.inspect(tmp_path / "empty.h5", "--html", tmp_path / "empty.html")
    with pytest.raises(InputError, match="no such folder"):
        typed.inspect(tmp_path / "run.h5", "--html", tmp_path / "missing" / "run.html")


@pytest.mark.slow
def test_two_runs_are_drawn_over_each_other(tmp_path: Path) -> None:
    write_run(tmp_path / "run.h5", cycles=3000, ports=("handle", "knob"))
    with EnergyLog.open(tmp_path / "run.h5") as log:
        panels = energy_figure(log, others=[log], labels=["second"]).axes
    over = [line for panel in panels for line in panel.lines if line.get_color() == "black" and line.is_dashed()]
    assert len(over) == 2 * 5  # position, torque, in, dissipated, surplus
    assert sum(line.get_label() == "second" for line in over) == 2 * 4  # once in each legend


APART = """
import sys
from canhaptic.cli.main import main
assert main(["inspect", *sys.argv[1:]]) == 0
peak = next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(int(peak) / 1000.0, file=sys.stderr)
"""


def inspect_apart(*words: str | Path) -> float:
    """Megabytes that `inspect` takes in its own process."""
    program = [sys.executable, "-c", APART, *map(str, words), "--json"]
    done = subprocess.run(program, check=True, capture_output=True, cwd=ROOT, text=True)
    return float(done.stderr)


@pytest.mark.slow
def test_an_hour_is_inspected_in_little_memory_and_opens_in_a_browser(tmp_path: Path) -> None:
    pytest.importorskip("bokeh", reason="Bokeh is not installed (pip install 'canhaptic[report]')")
    log, page_file = tmp_path / "hour.h5", tmp_path / "hour.html"
    write_hour(log)
    assert inspect_apart(log, "--html", page_file) < 500.0
    assert page_file.stat().st_size < 6_000_000
    with chromium() as page:
        page.open(page_file.as_uri())
        page.wait_for(READY)
        page.screenshot(tmp_path / "hour.png")
        assert page.faults == []
        assert (tmp_path / "hour.png").stat().st_size > 20_000


@pytest.mark.slow
def test_the_page_zooms_to_the_worst_margin_and_hovers_with_units(tmp_path: Path) -> None:
    pytest.importorskip("bokeh", reason="Bokeh is not installed (pip install 'canhaptic[report]')")
    write_run(tmp_path / "run.h5", cycles=4000, ports=("handle", "knob"))
    assert typed.inspect(tmp_path / "run.h5", "--html", tmp_path / "run.html", "--json") == 0
    with chromium() as page:
        page.open((tmp_path / "run.html").as_uri())
        page.wait_for(READY)
        models = "[...Bokeh.documents[0]._all_models.values()]"
        time = f"{models}.filter(m => m.type == 'Figure')[0].x_range"
        ranges = f"new Set({models}.filter(m => m.type == 'Figure').map(m => m.x_range.id)).size"
        assert page.value(ranges) == 1 + 2  # one time axis for all panels over time; one of position for each port
        assert page.value(f"{time}.end - {time}.start") == pytest.approx(3.999)
        click = f"{models}.find(m => m.type == 'Button' && m.label.endsWith('worst margin')).trigger_event"
        assert page.value(f"typeof ({click})") == "function"
        page.value("""(() => {
            const view = (function find(v) {
                if (v.model && v.model.type == 'Button' && v.model.label == 'handle: worst margin') return v;
                for (const c of (v.children ? v.children() : [])) { const f = find(c); if (f) return f; }
            })(Object.values(Bokeh.index)[0] || [...Bokeh.index.roots][0]);
            view.click(); })()""")
        assert 0.2 < page.value(f"{time}.end - {time}.start") <= 0.51
        pointers = f"{models}.filter(m => m.type == 'CustomJSHover')"
        units = page.value(f"[...new Set({pointers}.map(m => m.args.unit))]")
        assert {"m", "rad", "N", "N*m", "J", "s", "N*s/m"} <= set(units)
        metres = f"{models}.find(m => m.type == 'CustomJSTickFormatter' && m.args.unit == 'm')"
        ticks = page.value(f"{metres}.doFormat([0, 0.05, 0.1], {{}})")
        assert ticks == ["0 mm", "50 mm", "100 mm"]
        page.screenshot(tmp_path / "zoomed.png")
        assert page.faults == []


@pytest.mark.slow
def test_a_run_of_other_ports_is_not_laid_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("bokeh", reason="Bokeh is not installed (pip install 'canhaptic[report]')")
    write_run(tmp_path / "run.h5", cycles=200)
    write_run(tmp_path / "again.h5", cycles=200)
    assert typed.inspect(tmp_path / "run.h5", "--overlay", tmp_path / "again.h5", "--svg", tmp_path / "both.svg") == 0
    assert "<!-- again.h5 -->" in (tmp_path / "both.svg").read_text()
    write_run(tmp_path / "other.h5", cycles=200, ports=("knob",))
    words = ["inspect", str(tmp_path / "run.h5"), "--html", str(tmp_path / "run.html")]
    assert main([*words, "--overlay", str(tmp_path / "other.h5")]) == 2
    assert "has the ports knob and none of handle" in capsys.readouterr().err
