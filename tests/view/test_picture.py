import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_run import write_run

from canhaptic.audit.extent import contacts
from canhaptic.errors import InputError
from canhaptic.logs.columns import PortDescription
from canhaptic.logs.energy_log import EnergyLogWriter
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.view.decimate import decimate
from canhaptic.view.run_picture import draw_energy


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=400), st.integers(1, 50))
@settings(max_examples=60, deadline=None)
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


def test_a_spike_of_one_sample_in_an_hour_is_drawn() -> None:
    values = np.zeros(3_600_000)
    values[1_234_567] = 1.0
    assert 1_234_567 in decimate(values, 2000)


def test_contacts_are_the_stretches_not_booked_as_free() -> None:
    assert contacts(np.array([0, 1, 2, 0, 0, 6, 2])) == [(1, 2), (5, 6)]
    assert contacts(np.array([0, 0])) == []


@pytest.mark.parametrize(("ports", "suffix"), [(("handle",), "png"), (("left", "right"), "svg")])
def test_a_run_is_drawn_into_the_kind_of_file_its_suffix_names(
    tmp_path: Path, ports: tuple[str, ...], suffix: str
) -> None:
    write_run(tmp_path / "run.h5", 1500, ports)
    picture = tmp_path / f"run.{suffix}"
    with EnergyLog.open(tmp_path / "run.h5") as log:
        draw_energy(log, picture)
    content = picture.read_bytes()
    assert content.startswith(b"\x89PNG" if suffix == "png" else b"<?xml")
    assert len(content) > 20_000


def test_a_picture_names_the_least_margin_the_wall_and_the_faults_and_shades_every_contact(tmp_path: Path) -> None:
    write_run(tmp_path / "run.h5", 3000)
    with EnergyLog.open(tmp_path / "run.h5") as log:
        draw_energy(log, tmp_path / "run.svg")
        port = log.ports["handle"]
        margin = np.cumsum(port["h_i"]) - np.cumsum(port["h_r"])
        touching = len(contacts(port["branch"]))
    text = (tmp_path / "run.svg").read_text()
    least, time = 1e6 * float(margin.min()), int(margin.argmin()) * 1e-3
    for words in (f"least {least:.1f} uJ at {time:.4g} s", "wall", "1.5 s: emcy 0x8130 heartbeat lost", "applied"):
        assert f"<!-- {words} -->" in text
    assert touching == 2
    assert text.count('"fill: #4d4d4d; opacity: 0.05"') == 4 * touching  # in each of the four panels
    assert text.count('"fill: #4d4d4d; opacity: 0.1"') == 1  # inside the wall
    with EnergyLog.open(tmp_path / "run.h5") as log:
        draw_energy(log, tmp_path / "part.svg", 0.0, 0.5)
    assert "emcy" not in (tmp_path / "part.svg").read_text()


def test_a_run_without_contact_is_drawn_too(tmp_path: Path) -> None:
    write_run(tmp_path / "run.h5", 300)
    with EnergyLog.open(tmp_path / "run.h5") as log:
        draw_energy(log, tmp_path / "run.png")
    assert (tmp_path / "run.png").stat().st_size > 20_000


def test_an_empty_log_is_refused_with_one_message(tmp_path: Path) -> None:
    EnergyLogWriter(tmp_path / "e.h5", [PortDescription("a", "m")], {}, sample_time_ns=1_000_000).close()
    with EnergyLog.open(tmp_path / "e.h5") as log, pytest.raises(InputError, match="nothing to draw"):
        draw_energy(log, tmp_path / "e.png")


def test_the_view_does_not_import_matplotlib_until_it_draws() -> None:
    program = (
        "import sys, canhaptic.view.run_picture, canhaptic.view.energy_table; sys.exit('matplotlib' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
