"""What a newcomer reads of a run, in the terminal and from Python: shares, failures, two logs, a second save."""

from pathlib import Path

import h5py
import pytest

import canhaptic
from canhaptic.cli.main import main
from canhaptic.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
SPENT = {"passivity.device_damping": 0.0, "passivity.energy_allowance": "20 uJ"}


@pytest.mark.slow
def test_a_knob_whose_allowance_is_spent_says_when_its_torque_ended_and_a_share_that_is_not_negative(tmp_path, capsys):
    result = canhaptic.simulate("rotary_knob", {**SPENT, "passivity.current_lag": "500 us"}, duration=1.0)
    port, samples = result.account.raw["ports"]["knob"], result.to_numpy()
    acted = result.time[abs(samples["knob.torque_command"]).nonzero()[0][-1]]
    assert port["contact"]["no_torque_after"] == pytest.approx(acted, abs=2e-3)
    assert 0.0 <= (port["rendered"]["stiffness"] or 0.0) <= 0.25
    assert main(["inspect", str(result.save(tmp_path / "knob.h5"))]) == 0
    assert f"no torque after {acted:.4g} s" in " ".join(capsys.readouterr().out.split())


@pytest.mark.slow
def test_a_knob_that_gives_energy_back_is_rendered_as_requested() -> None:
    result = canhaptic.simulate("rotary_knob", duration=1.0)
    port = result.account.raw["ports"]["knob"]
    assert port["rendered"]["stiffness"] == pytest.approx(1.0, abs=0.01)
    assert "no_torque_after" not in port["contact"]


@pytest.mark.slow
def test_check_says_what_is_rendered_of_a_detent_once_the_allowance_is_spent() -> None:
    wall = canhaptic.check("rotary_knob", SPENT)["wall"]
    assert "while any of the energy_allowance of 20.0 uJ is left" in wall
    assert "once it is spent, 0% and 0%" in wall


@pytest.mark.slow
def test_the_log_of_a_failed_run_says_so_first_and_ends_with_1(tmp_path, capsys) -> None:
    path = canhaptic.simulate("demo", duration=0.1).save(tmp_path / "run.h5")
    assert main(["inspect", str(path)]) == 0
    with h5py.File(path, "r+") as file:
        file.attrs["status"] = "failed: LinkError"
    capsys.readouterr()
    assert main(["inspect", str(path)]) == 1
    assert capsys.readouterr().out.startswith(" FAILED: ")


@pytest.mark.slow
def test_two_logs_show_the_contacts_of_both(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = (
        canhaptic.simulate("rotary_knob", {"environment.peak": f"{of} mN*m"}, duration=0.1).save(tmp_path / f"{of}.h5")
        for of in (20, 40)
    )
    main(["inspect", str(first), str(second)])
    text = capsys.readouterr().out
    assert " 20.h5 knob: " in text
    assert " 40.h5 knob: " in text


@pytest.mark.slow
def test_a_second_save_is_one_clear_error_unless_overwrite_is_given(tmp_path: Path) -> None:
    result, path = canhaptic.simulate("demo", duration=0.05), tmp_path / "run.h5"
    result.save(path)
    with pytest.raises(InputError, match=r"run\.h5: exists; choose another name, or .*overwrite=True") as caught:
        result.save(path)
    assert caught.value.__suppress_context__
    result.save(path, overwrite=True)
    with canhaptic.EnergyLog(path) as log:
        assert log.rows == 50


SCENES = sorted(
    path
    for path in (ROOT / "configs").rglob("*.yaml")
    if path.parent.name not in ("drives", "interfaces")
    and path.stem != "socketcan_example"  # real buses
    and not path.stem.startswith("far_")  # two rigs run together
)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_inspect_fits_on_a_screen_and_tells_the_rest_when_asked(path: Path, tmp_path, capsys) -> None:
    run = canhaptic.simulate(path, duration=1.0 if path.stem != "two_axes" else 0.1, progress=False, allow_code=True)
    log = str(run.save(tmp_path / "run.h5"))
    assert main(["inspect", log]) == 0
    lines = [line.rstrip() for line in capsys.readouterr().out.replace(log, "run.h5").splitlines()]
    assert len(lines) <= 40
    assert max(map(len, lines)) <= 100
    assert main(["inspect", log, "--full"]) == 0
    assert len(capsys.readouterr().out.splitlines()) > len(lines)
