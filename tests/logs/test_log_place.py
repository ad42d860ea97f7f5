"""Where a log may be: one run at a time, on a regular file that stays where it is, from a trusted import path."""

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from canhaptic.cli.main import main
from canhaptic.errors import InputError, LogWriteError
from canhaptic.files import replacing
from canhaptic.logs import writer_process
from canhaptic.logs.bus_reader import read_bus_log
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.logs.writer_process import BusLogWriter, EnergyLogWriter
from tests.logs.log_rows import PORTS, SAMPLE_TIME_NS, append
from tests.logs.patience import wait_for

REPOSITORY = Path(__file__).resolve().parents[2]
DEMO = str(REPOSITORY / "configs" / "demo.yaml")
Log = BusLogWriter | EnergyLogWriter


def bus_log(path: Path, on_failure: Callable[[str], None] | None = None) -> BusLogWriter:
    return BusLogWriter(path, "can0", on_failure=on_failure)


def energy_log(path: Path, on_failure: Callable[[str], None] | None = None) -> EnergyLogWriter:
    return EnergyLogWriter(path, PORTS[:1], {}, sample_time_ns=SAMPLE_TIME_NS, with_truth=True, on_failure=on_failure)


def write(log: Log, begin: int, count: int) -> None:
    for k in range(begin, begin + count):
        if isinstance(log, BusLogWriter):
            log(k * 1_000_000, 0x181, b"\1\2", True)
        else:
            append(log, k)


BOTH = pytest.mark.parametrize("make", [bus_log, energy_log])


# --- one run at a time ------------------------------------------------------------------------------------------------


@pytest.mark.slow_for("energy_log")
@BOTH
def test_a_second_run_into_one_log_is_refused(tmp_path: Path, make: Callable[[Path], Log]) -> None:
    path = tmp_path / "run.log"
    first = make(path)
    write(first, 0, 100)
    with pytest.raises(LogWriteError, match=r"run\.log: another run writes this log; name another file"):
        make(path)
    first.close()
    assert path.stat().st_size > 0
    make(path).close()
    assert [file.name for file in tmp_path.iterdir()] == ["run.log"]


@pytest.mark.slow
def test_two_logs_of_one_run_on_one_file_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(tmp_path / "run.h5")
    assert main(["run", DEMO, "--duration", "0.1", "--log", path, "--bus-log", path]) == 2
    assert "another run writes this log" in capsys.readouterr().err


# --- a file that goes away --------------------------------------------------------------------------------------------


def replaced(path: Path) -> None:
    path.rename(path.with_suffix(".old"))
    path.write_text("mine")


HARM: dict[str, list[Callable[[Path], object]]] = {
    "deleted or replaced": [Path.unlink, replaced],
    "truncated": [lambda path: os.truncate(path, 5)],
}


@pytest.mark.slow_but("*bus_log")
@BOTH
@pytest.mark.parametrize(("word", "harm"), [(word, harm) for word, harms in HARM.items() for harm in harms])
def test_a_log_that_is_harmed_while_it_is_written_is_noticed_before_it_is_closed(tmp_path, make, word, harm):
    path = tmp_path / "run.log"
    told: list[str] = []
    log = make(path, on_failure=told.append)
    write(log, 0, 2000)
    sizes = [0]

    def is_settled() -> bool:
        sizes.append(path.stat().st_size)
        return len(sizes) > 20 and min(sizes[-20:]) == sizes[-1] > 1000

    wait_for(is_settled)
    harm(path)
    wait_for(lambda: bool(told))
    assert f"run.log: was {word}" in told[0]
    with pytest.raises(LogWriteError, match=f"was {word}"):
        log.close()


@pytest.mark.slow_for("--bus-log")
@pytest.mark.parametrize("option", ["--log", "--bus-log"])
def test_a_run_whose_log_is_deleted_stops_and_says_so(tmp_path, option: str, capsys) -> None:
    path = tmp_path / "run.log"

    def delete() -> None:
        wait_for(path.exists)
        threading.Event().wait(1.0)  # by then the writer has opened it for good
        path.unlink()

    thread = threading.Thread(target=delete)
    thread.start()
    assert main(["run", DEMO, "--duration", "20", "--pace", "real", option, str(path), "--json"]) == 3
    thread.join()
    captured = capsys.readouterr()
    assert captured.err.count("was deleted or replaced") == 1
    assert json.loads(captured.out)["result"]["cycles"] < 20_000  # of 20 s


@pytest.mark.slow
def test_a_good_run_keeps_the_recording_of_the_fault_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # elsewhere a scene replaces nothing
    path = tmp_path / "last.log"
    words = ["run", DEMO, "--duration", "0.3", "--set", f"log={{bus: {path}, last: 0.2 s}}"]
    assert main([*words, "--set", "axes.0.speed_limit=1e-6"]) == 3
    recorded = path.read_bytes()
    assert list(read_bus_log(path))
    assert main([*words, "--force"]) == 0
    assert path.read_bytes() == recorded


# --- what is no regular file ------------------------------------------------------------------------------------------


def odd_places(folder: Path) -> dict[str, Path]:
    (folder / "mine.txt").write_text("mine")
    (folder / "link").symlink_to(folder / "mine.txt")
    (folder / "dangling").symlink_to(folder / "nowhere")
    (folder / "folder").mkdir()
    os.mkfifo(folder / "pipe")
    names = {"link": "a symbolic link", "dangling": "a symbolic link", "folder": "a folder", "pipe": "a pipe"}
    return {**{kind + name: folder / name for name, kind in names.items()}, "a device": Path("/dev/null")}


@pytest.mark.slow_for("bus_log")
@BOTH
def test_logs_go_onto_regular_files_alone_and_never_wait_for_one(tmp_path: Path, make: Callable[[Path], Log]) -> None:
    for kind, path in odd_places(tmp_path).items():
        with pytest.raises(LogWriteError, match=f"{path.name}: is {kind.removesuffix(path.name)}, expected a regular"):
            make(path)
    assert (tmp_path / "mine.txt").read_text() == "mine"
    assert not (tmp_path / "nowhere").exists()
    assert Path("/dev/null").is_char_device()


@pytest.mark.slow
def test_pictures_pages_tables_and_scenes_go_onto_regular_files_alone(tmp_path, capsys) -> None:
    log = tmp_path / "run.h5"
    assert main(["run", DEMO, "--duration", "0.1", "--log", str(log)]) == 0
    mine = tmp_path / "mine.txt"
    mine.write_text("mine")
    for suffix, words in {
        ".html": ["inspect", str(log), "--html"],
        ".png": ["inspect", str(log), "--png"],
        ".csv": ["inspect", str(log), "--csv"],
        ".yaml": ["commission", DEMO, "--yes", "--out"],
    }.items():
        link = tmp_path / f"link{suffix}"
        link.symlink_to(mine)
        assert main([*words, str(link)]) == 2, words
        assert f"link{suffix}: is a symbolic link" in capsys.readouterr().err
        assert mine.read_text() == "mine"
        assert link.is_symlink()


def test_a_link_in_the_place_of_the_temporary_file_is_not_followed(tmp_path: Path) -> None:
    mine = tmp_path / "mine.txt"
    mine.write_text("mine")
    for name in (".run.h5.new", "run.h5.new"):
        (tmp_path / name).symlink_to(mine)
    log = energy_log(tmp_path / "run.h5")
    write(log, 0, 100)
    log.close()
    assert mine.read_text() == "mine"
    with EnergyLog.open(tmp_path / "run.h5") as read:
        assert read.rows == 100


def test_what_fails_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    path.write_text("old")
    with pytest.raises(UnicodeEncodeError), replacing(path) as file:
        file.write_text("half\ud800", encoding="utf-8")
    assert path.read_text() == "old"
    with replacing(path) as file:
        file.write_text("new")
        assert file.parent == path.parent
    assert path.read_text() == "new"
    assert [entry.name for entry in tmp_path.iterdir()] == ["page.html"]
    with pytest.raises(InputError, match="is a folder"), replacing(tmp_path):
        pass


@pytest.mark.usefixtures("fresh_writer")
def test_a_file_that_cannot_be_opened_in_time_does_not_hang_the_start(tmp_path, monkeypatch) -> None:
    """A mount that does not answer, as the writer process meets it: it never becomes ready."""
    monkeypatch.setattr(writer_process, "_PATIENCE", 0.3)
    monkeypatch.setattr(writer_process, "_PROGRAM", "import time; time.sleep(60)")
    with pytest.raises(LogWriteError, match=r"run\.log: the file could not be opened within 0\.3 s; look for a mount"):
        bus_log(tmp_path / "run.log")


# --- what the writer imports ------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", ["h5py", "json", "canhaptic"])
def test_the_writer_imports_nothing_from_the_working_folder(tmp_path: Path, name: str) -> None:
    """The controller is started so that it does not look there either."""
    (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'executed')!r}, 'w')\nraise SystemExit(7)\n")
    words = ["run", DEMO, "--duration", "0.1", "--log", "run.h5", "--bus-log", "run.log"]
    command = [sys.executable, "-P", "-m", "canhaptic", *words]
    trusted = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    done = subprocess.run(command, cwd=tmp_path, env=trusted, capture_output=True, text=True, check=False)
    assert not (tmp_path / "executed").exists(), done.stderr
    assert done.returncode == 0, done.stderr
    with EnergyLog.open(tmp_path / "run.h5") as log:
        assert log.rows == 100


# --- a scene from somebody else ---------------------------------------------------------------------------------------


@pytest.mark.slow_for("energy")
@pytest.mark.parametrize("key", ["energy", "bus"])
def test_a_scene_replaces_no_file_outside_its_folder_and_says_where_it_writes(tmp_path, key: str, capsys, monkeypatch):
    (tmp_path / "scenes").mkdir()
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    target, scene = tmp_path / "mine.log", tmp_path / "scenes" / "foreign.yaml"
    eds = REPOSITORY / "eds" / "cia402_servo.eds"
    text = Path(DEMO).read_text().replace("eds: cia402_servo.eds", f"eds: {eds}")
    scene.write_text(f"{text}\nlog: {{{key}: ../mine.log}}\n")
    target.write_text("mine")
    words = ["run", str(scene), "--duration", "0.1"]
    assert main(words) == 2
    assert f"log.{key}: ../mine.log already exists, outside the folder of the scene" in capsys.readouterr().err
    assert target.read_text() == "mine"
    target.unlink()
    assert main(words) == 0
    assert "is outside its folder: ../mine.log" in capsys.readouterr().err
    assert target.exists()
    assert main([*words, "--force"]) == 2  # the scene's own name for it is not enough
    assert main([*words, "--log" if key == "energy" else "--bus-log", "../mine.log", "--force"]) == 0


# --- a second run with the same words -------------------------------------------------------------------------------


@pytest.mark.parametrize("taken", ["run.h5", "run.log"])
@pytest.mark.parametrize("named_by", ["option", "scene"])
def test_a_log_that_exists_is_kept_and_nothing_is_started(taken: str, named_by: str, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("canhaptic.cli.run.build", lambda *_: pytest.fail("something was started"))
    Path(taken).write_text("mine")
    words = ["--log", "run.h5", "--bus-log", "run.log"]
    if named_by == "scene":
        words = ["--set", "log.energy=run.h5", "--set", "log.bus=run.log"]
    assert main(["run", DEMO, *words]) == 2
    assert capsys.readouterr().err == (
        f"canhaptic: error: {taken} already exists; --force replaces it, or name another file\n"
    )
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [(taken, "mine")]


@pytest.mark.parametrize(
    "words",
    [
        ["accuracy", DEMO, "--markdown"],
        ["inspect", "run.h5", "--csv"],
        ["inspect", "run.h5", "--repair"],
        ["new", str(Path(DEMO).parents[1] / "eds" / "cia402_servo.eds"), "--out"],
    ],
)
def test_every_output_of_a_command_that_exists_is_kept(words: list[str], tmp_path, capsys) -> None:
    suffix = {"--markdown": "md", "--repair": "h5", "--out": "yaml"}.get(words[-1], words[-1].removeprefix("--"))
    taken = tmp_path / f"mine.{suffix}"
    taken.write_text("mine")
    assert main([*words, str(taken)]) == 2
    assert capsys.readouterr().err == (
        f"canhaptic: error: {taken} already exists; --force replaces it, or name another file\n"
    )
    assert taken.read_text() == "mine"


def test_what_a_killed_run_left_of_a_log_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    left = tmp_path / "run.blf.log"
    left.write_text("mine")
    assert main(["run", DEMO, "--bus-log", str(tmp_path / "run.blf")]) == 2
    assert f"{left} already exists" in capsys.readouterr().err


@pytest.mark.slow
def test_force_replaces_both_logs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    energy, bus = tmp_path / "run.h5", tmp_path / "run.log"
    for path in (energy, bus):
        path.write_text("mine")
    assert main(["run", DEMO, "--duration", "0.02", "--log", str(energy), "--bus-log", str(bus), "--force"]) == 0
    assert capsys.readouterr().out
    with EnergyLog.open(energy) as log:
        assert log.status == "completed"
    assert list(read_bus_log(bus))


def test_no_command_but_run_writes_what_a_scene_names(tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    named = [word for key in ("energy=run.h5", "bus=run.log") for word in ("--set", f"log.{key}")]
    assert main(["compare", DEMO, "--can", "--duration", "0.02", "--algorithms", "unprotected", *named]) == 0
    assert capsys.readouterr().out
    assert not list(tmp_path.iterdir())
