"""The committed figures and pictures of the paper are those of today, and are judged by other means as well."""

import json
import struct
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.control.reference_loop import continuous, user_f, variation
from tools.paper_figures import FIGURES, IMAGES, RESULT, draw, run_all
from tools.paper_runs import Record, figures_of
from tools.paper_traps import traps

COMMITTED = json.loads(RESULT.read_text(encoding="utf-8"))


@cache
def runs(name: str) -> Mapping[str, Record]:
    return run_all(name)


def close_to(value: Any) -> Any:
    """A tenth of a per cent, for what differs between machines in the last bits; counts are equal."""
    if isinstance(value, dict):
        return {key: close_to(entry) for key, entry in value.items()}
    return value if isinstance(value, int) else pytest.approx(value, rel=1e-3, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", FIGURES)
def test_the_figures_of_today_are_the_committed_ones(name: str) -> None:
    found = {label: figures_of(taken) for label, taken in runs(name).items()}
    assert found == close_to(COMMITTED[name])


@pytest.mark.slow
def test_the_figures_of_the_traps_of_today_are_the_committed_ones() -> None:
    assert traps() == close_to(COMMITTED["traps"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "damping", "wall", "amplitude"), [("fig4", 5.0, 0.0, 0.1), ("fig8", 10.0, -0.05, 0.15)]
)
def test_the_continuous_wall_of_the_pictures_is_that_of_an_ode_solver(name, damping, wall, amplitude) -> None:
    taken = runs(name)["no_delay"]
    times = taken.reference.fine_time
    position, torque = continuous(user_f(amplitude), 100.0, damping, wall, times)
    assert taken.reference.position == pytest.approx(np.interp(taken.time, times, position), abs=1e-7)
    assert taken.reference.variation == pytest.approx(variation(torque), rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["fig5", "fig8"])
def test_the_energy_of_a_record_is_that_of_its_torques_and_motions(name: str) -> None:
    taken = runs(name)["no_delay"]
    booked = -taken.torque[1:] * np.diff(taken.position)
    assert taken.h_i[1:] == pytest.approx(booked, abs=1e-15)
    counts = 1e-6 * (0.5 * np.abs(np.diff(taken.torque, prepend=0.0)).sum() + 0.5 * abs(taken.torque[-1]))
    assert np.abs(np.cumsum(taken.h_i) - taken.true).max() <= counts


def test_every_figure_of_the_paper_has_its_scene_picture_and_runs() -> None:
    assert list(FIGURES) == ["fig4", "fig5", "fig7", "fig8", "fig9"]
    for name, figure in FIGURES.items():
        assert figure.config.startswith(f"paper_{name}_")
        assert set(COMMITTED[name]) == set(figure.runs)
        assert {label for label, _ in figure.drawn} <= set(figure.runs)


def test_figure_9_is_the_run_of_figure_8() -> None:
    assert COMMITTED["fig9"] == {label: COMMITTED["fig8"][label] for label in COMMITTED["fig9"]}


@pytest.mark.parametrize("name", ["fig4", "fig5", "fig7", "fig8"])
def test_without_delay_the_plain_wall_is_nearer_as_the_page_says(name: str) -> None:
    found = COMMITTED[name]
    assert found["unprotected"]["position_rms_error"] < found["no_delay"]["position_rms_error"]
    assert found["unprotected"]["least_interaction_of_the_plant"] == 0.0


def test_a_stiffer_wall_tells_the_algorithms_apart_as_the_page_says() -> None:
    least = {label: found["least_interaction_of_the_plant"] for label, found in COMMITTED["fig7"].items()}
    assert least["stiffer"] < least["stiffer_unprotected"] < -0.1
    assert least["stiffer_guarded"] == 0.0
    assert least["one_sample_late_unprotected"] < -1.0


@pytest.mark.slow
@pytest.mark.parametrize("name", FIGURES)
def test_the_committed_picture_has_the_size_of_one_drawn_today(name: str, tmp_path: Path) -> None:
    committed = IMAGES / FIGURES[name].picture
    drawn = tmp_path / committed.name
    draw(name, runs(name), drawn)
    assert size_of(committed) == size_of(drawn)
    assert 0.5 < drawn.stat().st_size / committed.stat().st_size < 2.0
    assert committed.stat().st_size < 150_000


def size_of(picture: Path) -> tuple[int, ...]:
    """Width and height of a PNG, from its header."""
    head = picture.read_bytes()[:24]
    assert head[:8] == b"\x89PNG\r\n\x1a\n"
    return struct.unpack(">II", head[16:24])
