import json
import re
from pathlib import Path

import h5py
import pytest

from canhaptic.audit.recompute import rederive
from canhaptic.cli.main import main
from canhaptic.errors import InputError
from canhaptic.scene.load import load_scene
from tests.view import typed

DEMO = Path(__file__).parents[2] / "configs" / "demo.yaml"


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("rederive")
    energy, bus = folder / "run.h5", folder / "run.log"
    words = ["run", str(DEMO), "--duration", "1.3", "--pace", "free", "--log", str(energy), "--bus-log", str(bus)]
    assert main([*words, "--json"]) == 0
    return energy, bus


def test_frames_alone_give_the_logged_account_bit_for_bit(logs: tuple[Path, Path], capsys) -> None:
    energy, bus = logs
    assert typed.inspect(energy, "--bus-log", bus, "--recompute", "--check", "in > 1 mJ") == 0
    text = capsys.readouterr().out
    assert "from the frames alone: 1303 cycles, samples and account equal bit for bit" in text
    assert "recomputed, every output equal bit for bit" in text


@pytest.mark.slow
@pytest.mark.parametrize(
    "override",
    [
        "axes.0.demand_reported=after",
        "simulation.bus={drop: 0.02, ids: [0x181, 0x201]}",
        "axes.0.read_back=actual",
    ],
)
def test_the_account_is_derived_whatever_the_drive_reports_and_the_bus_loses(override: str, tmp_path, capsys) -> None:
    energy, bus = tmp_path / "run.h5", tmp_path / "run.log"
    words = ["run", str(DEMO), "--duration", "1.3", "--pace", "free", "--log", str(energy), "--bus-log", str(bus)]
    assert main([*words, "--json", "--set", override]) == 0
    capsys.readouterr()
    assert typed.inspect(energy, "--bus-log", bus, "--recompute", "--json", "--check", "in > 1 mJ") == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["rederived"]["cycles"], result["rederived"]["differences"]) == (1303, [])
    assert result["rederived"]["ports"]["handle"]["in"] == pytest.approx(result["ports"]["handle"]["in"], rel=1e-12)


def test_one_flipped_bit_in_one_recorded_position_is_found(logs: tuple[Path, Path], tmp_path, capsys) -> None:
    energy, bus = logs
    lines = bus.read_text().splitlines(keepends=True)
    positions = [number for number, line in enumerate(lines) if " 181#" in line]
    chosen = positions[-100]
    start = lines[chosen].index("#") + 5  # the low byte of the position, behind the statusword
    flipped = f"{int(lines[chosen][start : start + 2], 16) ^ 1:02X}"
    lines[chosen] = lines[chosen][:start] + flipped + lines[chosen][start + 2 :]
    (tmp_path / "run.log").write_text("".join(lines))
    assert typed.inspect(energy, "--bus-log", tmp_path / "run.log", "--json") == 1
    (found,) = json.loads(capsys.readouterr().out)["rederived"]["differences"]
    assert found["quantity"] == "position"
    assert found["logged"] != found["rederived"]


@pytest.mark.slow
def test_a_bus_log_alone_can_be_inspected_with_its_scene(logs: tuple[Path, Path], capsys) -> None:
    assert typed.inspect(logs[1], "--config", DEMO, "--check", "deficit == 0") == 0
    shown = capsys.readouterr().out
    assert "derived from the frames of run.log" in shown
    assert re.search(r"stiffness rendered, of requested +\d", shown)
    assert typed.inspect(logs[1]) == 0  # without a scene its frames are all that can be said
    assert re.search(r"\b080 .*SYNC", capsys.readouterr().out)


@pytest.mark.slow
def test_another_scene_is_refused(logs: tuple[Path, Path], tmp_path: Path) -> None:
    other = tmp_path / "other.yaml"
    other.write_text(DEMO.read_text().replace("stiffness: ", "stiffness: 1"))
    with pytest.raises(InputError, match=r"other\.yaml: is not the scene of .*run\.h5"):
        typed.inspect(logs[0], "--recompute", "--config", other)


@pytest.mark.slow
def test_a_scene_that_is_gone_is_asked_for(logs: tuple[Path, Path], tmp_path: Path) -> None:
    moved = tmp_path / "run.h5"
    moved.write_bytes(logs[0].read_bytes())
    with h5py.File(moved, "r+") as file:
        file.attrs["config_source"] = str(tmp_path / "gone.yaml")
    with pytest.raises(InputError, match=r"its scene '.*gone\.yaml' does not exist; name it with --config"):
        typed.inspect(moved, "--recompute")


@pytest.mark.slow
def test_rows_that_are_missing_are_no_mismatch_but_counted(logs: tuple[Path, Path], tmp_path, capsys) -> None:
    """The log of a run that lost three rows, and one of a run whose SYNC was skipped for seven sample times."""
    path = tmp_path / "run.h5"

    def shown() -> str:
        assert typed.inspect(path, "--recompute") == 1
        return capsys.readouterr().out

    path.write_bytes(logs[0].read_bytes())
    with h5py.File(path, "r+") as file:
        file["timing/dropped_before"][900] = 3
        file["ports/handle/position"][900] += 1e-3
    assert typed.inspect(path, "--recompute", "--json") == 1
    [port] = json.loads(capsys.readouterr().out)["recomputed"]
    assert port == {"port": "handle", "mismatch": None, "rows": 900, "unchecked_rows": 403, "missing_rows": 3}
    assert "the first 900 cycles recomputed, equal bit for bit; then 3 rows are missing" in shown()
    with h5py.File(path, "r+") as file:
        file["timing/dropped_before"][900] = 0
        file["timing/deadline_index"][900:] += 7
    assert "900 cycles recomputed, equal bit for bit; then a SYNC was skipped" in shown()


@pytest.mark.slow
def test_the_account_is_derived_where_syncs_were_skipped_and_up_to_the_last_answer(tmp_path, capsys) -> None:
    """A log that ends with the answers to a SYNC, as that of a killed master does."""
    energy, bus = tmp_path / "run.h5", tmp_path / "run.log"
    stall = "simulation.bus={stall: [{begin: 1.05, duration: 6 ms, every: 0.0713}]}"
    words = ["run", str(DEMO), "--duration", "1.3", "--pace", "free", "--log", str(energy), "--bus-log", str(bus)]
    assert main([*words, "--json", "--set", stall, "--set", "environment.damping=20 N*s/m"]) == 0
    capsys.readouterr()
    assert typed.inspect(energy, "--bus-log", bus) == 0
    assert "from the frames alone: 1303 cycles, samples and account equal bit for bit" in capsys.readouterr().out
    lines = bus.read_text().splitlines(keepends=True)
    last = [number for number, line in enumerate(lines) if " 181#" in line][-30]
    bus.write_text("".join(lines[: last + 1]))
    scene = load_scene(DEMO, [stall, "environment.damping=20 N*s/m"])
    whole = rederive(bus, scene)["cycles"]
    bus.write_text("".join(lines[:last]))
    assert whole == rederive(bus, scene)["cycles"] + 1
