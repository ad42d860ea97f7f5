"""What a person looks at first: notches, force over position, two logs at once, and the moment of a NO."""

import io
import math
import re
import sys
from contextlib import closing
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

import canhaptic
from canhaptic.audit.inspection import walls_of
from canhaptic.cli.main import main
from canhaptic.view.picture_style import overlaid
from canhaptic.view.run_picture import energy_figure
from canhaptic.view.series import notches_of
from canhaptic.view.terminal import RunProgress, run_progress
from tests.view.synthetic_run import write_run

pytest.importorskip("matplotlib")
WALL = {"passivity": {"algorithm": "unprotected"}}


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("logs")
    bare = canhaptic.simulate("hard/stiff_wall", WALL, duration=0.6).save(folder / "bare.h5")
    return bare, canhaptic.simulate("hard/stiff_wall", duration=0.6).save(folder / "guarded.h5")


@pytest.mark.slow
def test_detents_are_drawn_as_notches_and_not_as_a_wall(tmp_path: Path) -> None:
    path = canhaptic.simulate("rotary_knob", duration=0.5).save(tmp_path / "knob.h5")
    with canhaptic.EnergyLog(path) as log:
        pitch = math.radians(15.0)
        assert notches_of(log, "knob", -0.6 * pitch, 2.1 * pitch) == pytest.approx([0.0, pitch, 2.0 * pitch])
        assert notches_of(log, "knob", 0.0, 1e3) == []
        position = energy_figure(log).axes[0]
    labels = [line.get_label() for line in position.lines]
    assert "notch" in labels
    assert "wall" not in labels


@pytest.mark.slow
def test_the_last_panel_is_the_force_over_the_position_of_both_runs_in_the_scales_of_the_first(
    logs: tuple[Path, Path],
) -> None:
    with canhaptic.EnergyLog(logs[0]) as bare, canhaptic.EnergyLog(logs[1]) as guarded:
        panels = energy_figure(bare, others=[guarded]).axes
        depth, force = 1e3 * bare.ports["handle"]["position"], bare.ports["handle"]["torque_applied"]
    motion = panels[-1]
    assert motion.get_title(loc="left") == "force over position"
    assert (motion.get_xlabel(), motion.get_ylabel()) == ("position [mm]", "[N]")
    first, second = motion.lines
    assert (first.get_label(), second.get_label()) == ("applied", "guarded.h5")
    assert np.asarray(first.get_xdata()).max() == pytest.approx(depth.max())
    assert np.asarray(first.get_ydata()).max() == pytest.approx(force.max())
    assert [panel.get_xlabel() for panel in panels].count("time [s]") == 1


@pytest.mark.slow
@pytest.mark.parametrize("words", [[], ["--overlay"]])
def test_two_logs_show_two_accounts(
    logs: tuple[Path, Path], words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["inspect", str(logs[0]), *words, str(logs[1]), "--full"]) == 0
    out = capsys.readouterr().out
    assert out.index("bare.h5") < out.index("passive: NO") < out.index("guarded.h5") < out.index("passive: yes")
    assert re.search(r"^ *bare\.h5 +guarded\.h5 *\n *energy account +handle +handle *$", out, re.MULTILINE)
    assert re.search(r"^ *passive at the motor +\S.* yes *$", out, re.MULTILINE)


@pytest.mark.slow
def test_the_page_of_a_run_that_became_active_has_a_button_to_that_moment(logs: tuple[Path, Path]) -> None:
    page = logs[0].with_suffix(".html")
    assert main(["inspect", *map(str, logs), "--html", str(page), "--json"]) == 0
    text = page.read_text(encoding="utf-8")
    assert "getElementById('moment0')" in text
    assert ">handle: first below zero at 0.507 s (contact 1)</button>" in text
    assert '<details id="moment0"><summary>handle: first below zero at 0.507 s (contact 1)</summary>' in text
    assert '<th class="">bare.h5 handle</th><th class="">guarded.h5 handle</th>' in text


@pytest.mark.slow
def test_the_contact_of_that_moment_has_its_number_in_the_table(
    logs: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["inspect", str(logs[0]), "--full"]) == 0
    out = capsys.readouterr().out
    assert "at 0.507 s (contact 1)" in " ".join(out.split())
    [start] = re.findall(r"^ +1 +(0\.\d+) s ", out, re.MULTILINE)
    assert float(start) <= 0.507


@pytest.mark.slow
def test_a_run_that_stayed_passive_has_no_button(tmp_path: Path) -> None:
    write_run(tmp_path / "run.h5", cycles=300)
    assert main(["inspect", str(tmp_path / "run.h5"), "--html", str(tmp_path / "run.html"), "--json"]) == 0
    assert "<button" not in (tmp_path / "run.html").read_text(encoding="utf-8")


def test_a_piped_run_writes_plain_lines_and_one_at_real_pace_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", StringIO())
    with run_progress(1000, 1e-3, "real") as progress:
        assert progress is None
    with run_progress(1000, 1e-3, "free") as progress:
        assert isinstance(progress, RunProgress)


def test_progress_ends_no_run_whose_standard_error_is_no_file(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    with closing(RunProgress(4096, 1e-3, "free", is_piped=True)) as progress:
        progress._next = 0
        progress(1024)
    assert progress._next > 0  # it was due, and is due again later


def test_a_plain_line_says_the_share(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with (tmp_path / "piped").open("w+") as piped:
        monkeypatch.setattr(sys, "stderr", piped)
        with closing(RunProgress(4096, 1e-3, "free", is_piped=True)) as progress:
            progress(64)
            progress._next = 0
            progress(1024)
        monkeypatch.undo()
    assert (tmp_path / "piped").read_text() == "   25 %   1024 of 4096 cycles\n"


def test_every_overlaid_run_has_a_colour_of_its_own() -> None:
    assert len(set(overlaid(12))) == 12
    assert overlaid(2) == overlaid(12)[:2]


@pytest.mark.slow
def test_the_wall_of_an_admittance_display_is_drawn() -> None:
    result = canhaptic.simulate("admittance/wall", duration=0.1, progress=False)
    with result.log() as log:
        assert [(place, side) for place, side in walls_of(log, next(iter(log.ports)))] == [(-0.05, "below")]
        assert "wall" in [line.get_label() for line in log.plot(panels=["position"]).axes[0].lines]
