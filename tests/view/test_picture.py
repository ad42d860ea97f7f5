from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canhaptic.audit.inspection import contacts
from canhaptic.control.balance import AT_REST
from canhaptic.cycle import run
from canhaptic.logs.columns import PortDescription
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.writer_process import EnergyLogWriter
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from canhaptic.signals import Sample
from canhaptic.view import run_picture
from canhaptic.view.picture_style import drawing, save_picture
from canhaptic.view.run_picture import PortPicture, draw_energy, energy_figure
from canhaptic.view.series import decimate
from tests.drawn import examples
from tests.view.synthetic_run import TIMING, write_run

CONFIGS = Path(__file__).parents[2] / "configs"


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=400), st.integers(1, 50))
@settings(max_examples=examples(60), deadline=None)
def test_decimation_keeps_both_ends_and_every_extreme_of_every_bucket(numbers: list[float], buckets: int) -> None:
    values = np.array(numbers)
    shown = decimate(values, buckets)
    assert shown[0] == 0
    assert shown[-1] == len(values) - 1
    assert (np.diff(shown) > 0).all()
    size = max(1, -(-len(values) // buckets))
    for start in range(0, len(values), size):
        bucket = values[start : start + size]
        inside = values[shown[(shown >= start) & (shown < start + size)]]
        assert inside.max() == bucket.max()
        assert inside.min() == bucket.min()
    assert len(shown) <= 2 * buckets + 4 or len(values) <= 2 * buckets


def test_contacts_are_the_stretches_not_booked_as_free() -> None:
    assert contacts(np.array([0, 1, 2, 0, 0, 6, 2])) == [(1, 2), (5, 6)]
    assert contacts(np.array([0, 0])) == []


@pytest.mark.slow
@pytest.mark.parametrize(("ports", "suffix"), [(("handle",), "png"), (("left", "right"), "svg")])
def test_a_run_is_drawn_into_the_kind_of_file_its_suffix_names(
    tmp_path: Path, ports: tuple[str, ...], suffix: str
) -> None:
    write_run(tmp_path / "run.h5", 300, ports)
    picture = tmp_path / f"run.{suffix}"
    with EnergyLog.open(tmp_path / "run.h5") as log:
        draw_energy(log, picture)
    content = picture.read_bytes()
    assert content.startswith(b"\x89PNG" if suffix == "png" else b"<?xml")
    assert len(content) > 20_000


@pytest.mark.slow
def test_a_picture_names_the_least_margin_the_wall_and_the_faults_and_shades_every_contact(tmp_path: Path) -> None:
    write_run(tmp_path / "run.h5", 3000)
    with EnergyLog.open(tmp_path / "run.h5") as log:
        draw_energy(log, tmp_path / "run.svg")
        port = log.ports["handle"]
        margin = np.cumsum(port["h_i"]) - np.cumsum(port["h_r"])
        touching = len(contacts(port["branch"]))
    text = (tmp_path / "run.svg").read_text()
    least = 1e6 * float(margin.min())
    for words in (
        f"smallest margin {least:.3g} uJ",
        "net energy (in - out)",
        "margin below 0",
        "wall",
        "1.5 s: emcy 0x8130 heartbeat lost",
        "applied",
    ):
        assert f">{words}</text>" in text
    assert touching == 2
    assert text.count('"fill: #4d4d4d; opacity: 0.05"') == 4 * touching + 1  # in each of the four panels, and a legend
    assert text.count('"fill: #4d4d4d; opacity: 0.1"') == 1  # inside the wall
    with EnergyLog.open(tmp_path / "run.h5") as log:
        draw_energy(log, tmp_path / "part.svg", 0.0, 0.5)
    assert "emcy" not in (tmp_path / "part.svg").read_text()


@pytest.mark.slow
def test_an_angle_is_drawn_in_degrees_where_the_scene_gives_angles_so(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    write_run(path, ports=("handle", "knob"))
    with EnergyLog.open(path) as log:
        log.attributes["config"] = "pitch: 15 deg"
        shown = {axes.get_title(loc="left"): axes for axes in energy_figure(log).axes}
        position = log.ports["knob"]["position"]
    assert shown["handle: position"].get_ylabel() == "[mm]"
    assert shown["knob: position"].get_ylabel() == "[deg]"
    drawn = np.asarray(shown["knob: position"].get_lines()[0].get_ydata(), dtype=float)
    assert drawn.max() == pytest.approx(np.degrees(position.max()))


def picture_of(path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The figure that `inspect --png` would write."""
    kept: list[Any] = []
    monkeypatch.setattr(run_picture, "save_picture", lambda figure, _: kept.append(figure))
    with EnergyLog.open(path) as log:
        run_picture.draw_energy(log, path.with_suffix(".png"))
    return kept[0]


@pytest.mark.slow
def test_a_decimated_torque_of_a_picture_is_a_plain_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for cycles, styles in ((6000, {"default"}), (300, {"steps-post", "steps-pre"})):
        write_run(tmp_path / f"{cycles}.h5", cycles=cycles)
        panels = picture_of(tmp_path / f"{cycles}.h5", monkeypatch).axes
        force = next(panel for panel in panels if panel.get_title(loc="left") == "force")
        assert {
            line.get_drawstyle() for line in force.lines if line.get_label() in ("requested, before limits", "applied")
        } == styles
    assert [panel.get_title(loc="left") for panel in panels] == ["position", "force"]  # without contact


@pytest.mark.slow
def test_a_display_has_a_panel_of_the_velocity_it_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    described = [PortDescription("a", "rad", commands_velocity=True)]
    writer = EnergyLogWriter(tmp_path / "run.h5", described, {}, sample_time_ns=1_000_000)
    for k in range(20):
        sample = Sample(k, 0.0, -3.0, 0x1237, True)
        writer.append(k, [sample], [AT_REST._replace(torque=0.5)], TIMING)
    writer.close()
    panels = {panel.get_title(loc="left"): panel for panel in picture_of(tmp_path / "run.h5", monkeypatch).axes}
    shown = {
        title: (panel.get_ylabel(), [(line.get_label(), line.get_ydata()[0]) for line in panel.lines])
        for title, panel in panels.items()
    }
    assert shown["velocity"] == ("[mrad/s]", [("commanded", 500.0)])
    assert shown["torque"] == ("[N*m]", [("on the hand", -3.0)])


@pytest.fixture(scope="module")
def five_bar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plane") / "five_bar.h5"
    with build(load_scene(CONFIGS / "five_bar_sphere.yaml"), "free", path) as experiment:
        run(experiment.cycle, 2500)
    return path


@pytest.mark.slow
def test_the_path_of_a_five_bar_is_drawn_against_its_disc(five_bar: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = next(panel for panel in picture_of(five_bar, monkeypatch).axes if panel.get_aspect() == 1)
    line = next(line for line in path.lines if line.get_label() == "path")
    x, y = 1e-3 * line.get_xdata(), 1e-3 * line.get_ydata()
    with EnergyLog.open(five_bar) as log:
        first, second = (log.ports[name]["position"][0] for name in ("left", "right"))
    elbows = [np.array([-0.05, 0.0]) + 0.15 * np.array([np.cos(first), np.sin(first)]),
              np.array([+0.05, 0.0]) + 0.15 * np.array([np.cos(second), np.sin(second)])]  # fmt: skip
    assert [np.hypot(*(np.array([x[0], y[0]]) - elbow)) for elbow in elbows] == pytest.approx([0.2, 0.2])
    surface = 1e-3 * np.concatenate([v for c in path.collections for p in c.get_paths() if (v := p.vertices).size])
    edge = surface[np.abs(np.hypot(surface[:, 0], surface[:, 1] - 0.24) - 0.03) < 1e-4]
    assert np.ptp(edge[:, 0]) == pytest.approx(0.06, rel=0.02)  # the whole disc, 30 mm round (0, 0.24)
    assert np.ptp(edge[:, 1]) == pytest.approx(0.06, rel=0.02)


@pytest.mark.slow
def test_a_surplus_of_rounding_has_no_panel_and_a_real_one_has(tmp_path: Path) -> None:
    for name, surplus, shown in (("rounding", 1e-13, False), ("real", 1e-4, True)):
        writer = EnergyLogWriter(
            tmp_path / name, [PortDescription("handle", "m")], {}, sample_time_ns=1_000_000, pace="free"
        )
        for k in range(20):
            balance = AT_REST._replace(h_i=1e-3, h_r=1e-3, h_dis=surplus)
            writer.append(k, [Sample(k, 0.0, 1.0, 0x1237, True)], [balance], TIMING)
        writer.close()
        with EnergyLog(tmp_path / name) as log:
            assert ("surplus" in PortPicture(log, "handle", slice(0, 20)).draws()) == shown


@pytest.mark.slow
def test_four_axes_are_drawn_two_by_two(tmp_path: Path) -> None:
    write_run(tmp_path / "run.h5", cycles=60, ports=("a", "b", "c", "d"))
    with EnergyLog(tmp_path / "run.h5") as log:
        panels = energy_figure(log).axes
    placed = {name: panel.get_subplotspec() for panel in panels if (name := panel.get_title(loc="left")[:1]) in "abcd"}
    assert [spec.colspan.start for spec in placed.values() if spec] == [0, 1, 0, 1]
    assert len({spec.rowspan.start for spec in placed.values() if spec}) == 2


@pytest.mark.slow
def test_powers_of_ten_are_written_plainly_and_dollars_stay(tmp_path: Path) -> None:
    with drawing() as figure_type:
        figure = figure_type()
        panel = figure.subplots()
        panel.plot([1e-6, 1.0], [1.0, 2.0])
        panel.set_xscale("log")
        panel.set_title("a $name$")
        save_picture(figure, tmp_path / "a.svg")
    drawn = (tmp_path / "a.svg").read_text(encoding="utf-8")
    assert "mathdefault" not in drawn
    assert ">1e-06</text>" in drawn
    assert ">a $name$</text>" in drawn
