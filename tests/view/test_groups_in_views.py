"""A log with a group of axes in every view: account with the group, position and torque with the axes."""

import re
from pathlib import Path

import numpy as np
import pytest

from canhaptic.audit.inspection import inspect
from canhaptic.cycle import run
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.scene.build import build
from canhaptic.scene.load import load_scene
from canhaptic.view import html_page
from canhaptic.view.run_picture import energy_figure
from canhaptic.view.series import task_plane

CONFIG = Path(__file__).resolve().parents[2] / "configs" / "xy_box.yaml"


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("groups") / "run.h5"
    with build(load_scene(CONFIG), "free", path) as experiment:
        run(experiment.cycle, 800)
    return path


@pytest.mark.slow
def test_inspection_gives_the_account_to_the_group_and_counts_frames_once(path: Path) -> None:
    with EnergyLog.open(path) as log:
        result = inspect(log)
        assert result["ports"]["stage"]["axes"] == ["x", "y"]
        assert result["ports"]["x"]["group"] == "stage"
        assert "margin" not in result["ports"]["x"]
        assert set(result["contacts"]) == {"stage"}
        assert result["link"]["missing"] == 0
        log_rows = log.rows
    assert result["cycles"] == log_rows == 803  # with those of the stop


@pytest.mark.slow
@pytest.mark.parametrize("port", ["x", "stage"])
def test_the_truths_of_the_parts_of_a_run_add_up_to_that_of_the_whole(path: Path, port: str) -> None:
    with EnergyLog.open(path) as log:
        split = (np.abs(log.ports["x"]["h_i"]).argmax() - 0.5) * log.sample_time  # behind it the hold that moved most
        whole, first, second = (inspect(log, *span)["truth"][port] for span in ((), (None, split), (split, None)))
    assert first["interaction"] + second["interaction"] == pytest.approx(whole["interaction"], abs=1e-15)
    assert max(part["accounted_error"] for part in (first, second)) <= 2.0 * whole["accounted_error"]


@pytest.mark.slow
def test_the_picture_has_one_column_for_the_group(path: Path) -> None:
    with EnergyLog.open(path) as log:
        panels = energy_figure(log).axes
    assert [panel.get_title(loc="left") for panel in panels[:3]] == ["stage: path", "stage: position", "force"]
    assert [line.get_label() for line in panels[1].lines] == ["x", "y"]
    assert {panel.get_subplotspec().colspan.start for panel in panels} == {0}


@pytest.fixture(scope="module")
def page(path: Path) -> str:
    """The page that `inspect --html` writes."""
    pytest.importorskip("matplotlib")
    with EnergyLog.open(path) as log:
        html_page.write_html(log, path.with_suffix(".html"), inspect(log))
    return path.with_suffix(".html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_page_has_the_account_of_the_group_and_the_force_of_each_axis(page: str) -> None:
    heads = re.findall(r"<th[^>]*>([^<]*)</th>", page)
    assert heads[:4] == ["energy account", "stage", "x", "y"]
    assert page.count("passive at the motor: yes") == 1
    motion = page[page.index(">force over position</text>") :]
    assert all(f">{name}</text>" in motion for name in ("x", "y"))
    assert "around the smallest margin" in page


@pytest.mark.slow
def test_the_page_shows_path_and_room(page: str) -> None:
    assert all(f">{title}</text>" in page for title in ("stage: path", "surface"))


@pytest.mark.slow
def test_a_coupling_without_a_surface_has_no_path(tmp_path: Path) -> None:
    with build(load_scene(CONFIG.with_name("two_handles.yaml")), "free", tmp_path / "run.h5") as experiment:
        run(experiment.cycle, 20)
    with EnergyLog.open(tmp_path / "run.h5") as log:
        assert [task_plane(log, name, slice(0, log.rows)) for name in log.groups] == [None]
