"""`canhaptic.simulate`: what a program gets from a simulated scene."""

import gc
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

import canhaptic
from canhaptic.errors import InputError, SceneError

ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / "configs" / "demo.yaml"
INTO_THE_WALL = 2.0  # [s]


@pytest.fixture(scope="module")
def stiff() -> canhaptic.SimulationResult:
    return canhaptic.simulate(DEMO, {"environment.stiffness": "500 N/m"}, duration=INTO_THE_WALL)


@pytest.mark.slow
def test_the_account_agrees_with_the_samples_and_with_the_plant(stiff: canhaptic.SimulationResult) -> None:
    samples, account = stiff.to_numpy(), stiff.account["handle"]
    energy = samples["handle.h_i"]
    assert account.energy_in == pytest.approx(energy[energy > 0].sum())
    assert account.energy_in - account.energy_out == pytest.approx(energy.sum())
    assert account.least_interaction == pytest.approx(min(0.0, np.cumsum(energy).min()), abs=1e-12)
    assert account.true_least_interaction >= -1e-9
    assert (account.passive, stiff.account.passive, account.certificate) == ("yes", "yes", "hand_force")
    assert account.energy_in > 1e-3  # the hand was in the wall


@pytest.mark.slow
def test_a_log_has_the_account_of_its_run_and_its_columns(stiff: canhaptic.SimulationResult) -> None:
    with stiff.log() as log:
        for key in ("energy_in", "least_interaction", "certificate", "verdict", "first_active"):
            assert getattr(log.account["handle"], key) == getattr(stiff.account["handle"], key), key
        assert (log.first_active, stiff.account.first_active) == (None, None)
        assert log.to_numpy().keys() == stiff.to_numpy().keys()


@pytest.mark.slow
def test_a_table_of_pandas_names_the_units(stiff: canhaptic.SimulationResult) -> None:
    pytest.importorskip("pandas")
    table = stiff.to_pandas()
    assert table.attrs["units"]["handle.position"] == "m"
    assert table.shape == (stiff.time.size, len(stiff.to_numpy()))


@pytest.mark.slow
def test_two_results_share_a_figure_and_a_notebook_sees_verdict_and_picture(stiff: canhaptic.SimulationResult) -> None:
    bare = canhaptic.simulate(DEMO, {"environment.damping": 0.0}, duration=INTO_THE_WALL)
    alone, both = (len(figure.axes[0].lines) for figure in (stiff.plot(), stiff.plot(bare)))
    assert both > alone
    page = stiff._repr_html_()
    assert ">yes</td>" in page
    assert "data:image/png;base64," in page
    assert "passive yes" in repr(stiff)


def test_a_run_that_stops_by_itself_raises_or_carries_its_error() -> None:
    changes = {"axes.0.speed_limit": 0.01}
    with pytest.raises(canhaptic.CanHapticError, match="speed"):
        canhaptic.simulate(DEMO, changes)
    result = canhaptic.simulate(DEMO, changes, check=False)
    assert isinstance(result.error, canhaptic.CanHapticError)
    assert result.status.startswith("failed: ")
    assert 0 < result.time.size < 10_000


def test_what_cannot_be_simulated_is_refused_with_the_remedy() -> None:
    with pytest.raises(InputError, match="`canhaptic run`"):
        canhaptic.simulate(ROOT / "configs" / "interfaces" / "socketcan.yaml")
    with pytest.raises(SceneError, match="stiffnes"):
        canhaptic.simulate(DEMO, {"environment.stiffnes": 1.0})
    with pytest.raises(InputError, match="changes"):
        canhaptic.simulate(canhaptic.load_scene(DEMO), {"environment.stiffness": 1.0})


@pytest.mark.slow
def test_no_temporary_file_is_left_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    result = canhaptic.simulate(DEMO, duration=0.05)
    assert list(tmp_path.iterdir())
    del result
    gc.collect()
    with pytest.raises(canhaptic.CanHapticError):
        canhaptic.simulate(DEMO, {"axes.0.speed_limit": 0.01})
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_typed_program_of_a_user_meets_no_any(tmp_path: Path) -> None:
    (tmp_path / "user.py").write_text(
        "import canhaptic\n\n"
        "result = canhaptic.simulate('demo.yaml', {'environment.stiffness': '500 N/m'})\n"
        "account = result.account['handle']\n"
        "margin: float = account.margin\n"
        "verdict: str = result.account.passive\n"
        "depth = result.to_numpy()['handle.position'].size\n"
        "for name, port in result.account.items():\n"
        "    print(name, port.energy_in, port.passive, depth, margin, verdict)\n"
    )
    command = [sys.executable, "-m", "mypy", "--strict", "--disallow-any-expr", "user.py"]
    installed = {**os.environ, "PYTHONPATH": str(ROOT)}  # mypy does not follow the hook of an editable installation
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=110, env=installed)
    assert done.returncode == 0, done.stdout
