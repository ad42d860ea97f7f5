"""Lanes of states and the spectrum: of a run that buzzes in its page, of every run in the scope."""

from pathlib import Path
from random import Random

import numpy as np
import pytest

import canhaptic
from canhaptic.audit.inspection import inspect
from canhaptic.audit.recompute import scene_of
from canhaptic.audit.why.causes import why
from canhaptic.audit.why.ripple import spectrum
from canhaptic.control.balance import Branch, Certificate
from canhaptic.view.html_page import write_html
from canhaptic.view.state_lanes import codes_of, spans
from tests.view.test_scope_page import page_of
from tools import buzzing


def test_each_lane_shows_when_its_state_began_and_ended() -> None:
    branch = np.array([Branch.FREE, Branch.EXACT, Branch.EXACT, Branch.STICKY, Branch.EXIT])
    certificate = np.full(5, Certificate.HAND_FORCE)
    command = np.array([0.0, 5.0, 10.0, 10.0, 0.0])
    codes = codes_of(branch, certificate, command, 10.0, np.array([1, 1, 1, 3, 1]))
    found = {(span.lane, span.state): (span.start, span.end) for span in spans(np.arange(5.0), 1.0, codes)}
    assert found == {
        ("contact", "contact"): (0.0, 3.0),
        ("branch", "exact"): (0.0, 2.0),
        ("branch", "sticky"): (2.0, 3.0),
        ("branch", "exit"): (3.0, 4.0),
        ("certificate", "hand force"): (0.0, 3.0),
        ("at the limit", "at the limit"): (1.0, 3.0),
        ("SYNCs skipped", "SYNCs skipped"): (2.0, 3.0),
    }


def test_the_spectrum_has_the_amplitude_at_the_frequency() -> None:
    time = np.arange(2000) * 1e-3
    lines, sizes = spectrum(1e-3, 3.0 * np.sin(2.0 * np.pi * 50.0 * time))
    assert lines[sizes.argmax()] == pytest.approx(50.0)
    assert sizes.max() == pytest.approx(3.0, rel=0.02)


@pytest.mark.slow
def test_page_and_scope_show_what_buzzes(tmp_path: Path) -> None:
    _, scene = buzzing.pair("damping", Random(3))
    scene["duration"] = 1.0
    buzzing.simulated(scene, tmp_path / "run")
    with canhaptic.EnergyLog(tmp_path / "run.h5") as log:
        result = inspect(log)
        result["why"] = found = why(log, scene_of(log))
        write_html(log, tmp_path / "page.html", result)
    page = (tmp_path / "page.html").read_text()
    assert "spectrum and states" in page
    assert "damping above its limit" in page
    live, document = page_of(tmp_path / "run.h5")
    live.update()
    panel = document.select_one({"name": "handle: spectrum"})
    lines = panel.renderers[0].data_source.data
    place = np.asarray(lines["amplitude"])[2:].argmax() + 2
    assert lines["frequency"][place] == pytest.approx(found["handle"]["frequency"], abs=4.0)
    states = document.select_one({"name": "states"}).data_source.data
    assert {"contact", "branch", "at the limit"} <= set(states["lane"])
