"""Files that somebody else made: none hangs a command, fills the memory, ends in a traceback or steers the terminal."""

import os
import random
import re
import shutil
import signal
import struct
import subprocess
import sys
import threading
import unicodedata
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from canhaptic.cli.main import main
from canhaptic.errors import InputError, ParameterError
from canhaptic.lab.batch import chosen_engine
from canhaptic.logs import bus_reader
from canhaptic.view.picture_style import require_matplotlib
from tools.campaign import Outcome, Session, run_case

ROOT = Path(__file__).parents[2]
DEMO = ROOT / "configs" / "demo.yaml"
EDS = ROOT / "eds" / "cia402_servo.eds"
RECORDING = ROOT / "tests" / "recordings" / "demo.log"
STEERING = "\x1b]0;taken\x07\x1b[31mACME\x9b2J\r\u202e[/b][red]"
"""Title, colour, cleared screen, start of the line, order of letters; and markup of tables that was never opened."""


def a_pipe(path: Path) -> Path:
    os.mkfifo(path)
    return path


def a_folder(path: Path) -> Path:
    path.mkdir()
    return path


def a_device(path: Path) -> Path:
    path.symlink_to("/dev/zero")
    return path


def nothing(path: Path) -> Path:
    return path


def endless(path: Path) -> Path:
    """Three gigabytes of zeros that take no room."""
    with path.open("wb") as file:
        file.truncate(3_000_000_000)
    return path


def uses(file: Path, log: Path) -> list[Sequence[str]]:
    """Commands that read a file, in every place where one can be named; `log` is an energy log."""
    return [
        ["check-eds", f"{file}"],
        ["new", f"{file}"],
        ["inspect", "--frames", f"{file}"],
        ["inspect", "--frames", f"{RECORDING}", "--config", f"{file}"],
        ["replay", f"{file}", "--config", f"{DEMO}"],
        ["replay", f"{RECORDING}", "--config", f"{file}"],
        ["replay", f"{RECORDING}", "--config", f"{DEMO}", "--energy-log", f"{file}"],
        ["inspect", f"{file}"],
        ["inspect", f"{log}", "--compare", f"{file}"],
        ["inspect", f"{log}", "--recompute", "--config", f"{file}"],
        ["inspect", f"{log}", "--bus-log", f"{file}"],
        ["inspect", f"{log}", "--overlay", f"{file}", "--html", f"{log.with_suffix('.html')}"],
        ["inspect", f"{file}", "--repair", f"{log.with_name('repaired.h5')}"],
        ["sweep", "--map", f"{file}"],
        *([command, f"{file}"] for command in ("check", "run", "compare", "accuracy", "design", "touch")),
        ["check", "--host", f"{file}"],
        ["check", f"{DEMO}", "--set", f"axes.0.eds={file}"],
        ["check", f"{DEMO}", "--set", f"axes.0.drive={file.with_suffix('.yaml')}"],
        ["run", f"{DEMO}", "--allow-code", "--set", f"axes.0.environment.type={file.with_suffix('.py')}:Wall"],
        ["scope", "--config", f"{file}"],
    ]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("foreign") / "run.h5"
    assert main(["run", f"{DEMO}", "--duration", "0.1", "--pace", "free", "--log", f"{path}", "--json"]) == 0
    return path


@pytest.mark.slow
@pytest.mark.parametrize("made", [a_pipe, a_folder, a_device, nothing])
def test_what_is_no_regular_file_is_refused_at_once_in_every_place(made: Callable[[Path], Path], log, tmp_path, capsys):
    for suffix in (".yaml", ".py"):  # what the profile and the program file are called
        made(tmp_path / f"file{suffix}")
    for words in uses(made(tmp_path / "file"), log):
        assert main(words) == 2, words
        assert "\n" not in capsys.readouterr().err.strip().removeprefix("canhaptic: errors:\n"), words
    for suffix in (".blf", ".trc", ".asc"):
        assert main(["inspect", "--frames", f"{made(tmp_path / f'bus{suffix}')}"]) == 2


def outside(name: str, pipe: Path, log: Path) -> None:
    """Puts the column of a log into another file: a pipe."""
    with h5py.File(log, "r+") as file:
        group = file["ports/handle"]
        shape = group["position"].shape
        del group["position"]
        if name == "external storage":
            group.create_dataset("position", shape, "f8", external=[(f"{pipe}", 0, h5py.h5f.UNLIMITED)])
        elif name == "virtual":
            layout = h5py.VirtualLayout(shape, "f8")
            layout[:] = h5py.VirtualSource(f"{pipe}", "x", shape)
            group.create_virtual_dataset("position", layout)
        else:
            group["position"] = h5py.ExternalLink(f"{pipe}", "/x") if name == "link" else h5py.SoftLink("/ports/handle")


@pytest.mark.slow_but("link")
@pytest.mark.parametrize("name", ["external storage", "virtual", "link", "loop"])
def test_a_log_has_no_values_in_another_file(name: str, log: Path, tmp_path, capsys) -> None:
    """HDF5 would open a pipe and wait for ever, which takes no processor time."""
    path = tmp_path / "run.h5"
    shutil.copy(log, path)
    outside(name, a_pipe(tmp_path / "pipe"), path)
    for words in (["inspect", f"{path}"], ["inspect", f"{path}", "--repair", f"{tmp_path / 'saved.h5'}"]):
        assert main(words) == 2
        assert re.search("in another file|is a link", capsys.readouterr().err)


def test_a_container_that_unpacks_to_gigabytes_is_refused(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(bus_reader, "_UNPACKED", 1 << 20)
    content = struct.pack("<HHLLL", 2, 0, 0, 100, 0) + zlib.compress(bytes(1 << 21), 9)  # it claims 100 bytes
    path = tmp_path / "bus.blf"
    header = struct.pack("<4sL136x", b"LOGG", 144)
    path.write_bytes(header + struct.pack("<4sHHLL", b"LOBJ", 16, 1, 16 + len(content), 10) + content)
    assert main(["inspect", "--frames", f"{path}"]) == 2
    assert "unpacks to 1048576 bytes or more" in capsys.readouterr().err


def test_of_a_scene_with_hundreds_of_faults_the_first_two_hundred_are_printed(tmp_path, capsys) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text("".join(f"k{number}: 1\n" for number in range(300)))
    assert main(["check", f"{path}"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 202  # with the heading
    assert lines[-1].startswith("and 1")


def test_numba_obeys_no_file_of_the_current_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("numba")
    monkeypatch.chdir(tmp_path)
    assert chosen_engine("auto", pays=True) == "numba"
    (tmp_path / ".numba_config.yaml").write_text("disable_jit: 1\n")
    with pytest.raises(ParameterError, match=r"read \.numba_config\.yaml of this folder"):
        chosen_engine("auto", pays=True)
    assert chosen_engine("auto", pays=False) == "python"


@pytest.mark.parametrize("made", [a_pipe, a_device])
def test_a_matplotlibrc_that_never_ends_is_refused(made: Callable[[Path], Path], tmp_path, monkeypatch) -> None:
    made(tmp_path / "matplotlibrc")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"is a pipe|is a device"):
        require_matplotlib()


def outcome_of(words: Sequence[str], folder: Path) -> Outcome:
    """What comes of a command in a copy of this process; a traceback, a crash, 10 s or 300 MB are its `faults`."""

    def case(_chance: random.Random, _folder: Path, run: Session) -> str:
        run(*words)
        return ""

    return run_case(case, "0", folder)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_file_of_gigabytes_takes_neither_memory_nor_time(log: Path, tmp_path: Path) -> None:
    for suffix in (".yaml", ".py"):
        endless(tmp_path / f"file{suffix}")
    buses = [
        ["inspect", "--frames", f"{endless(tmp_path / f'bus{suffix}')}"] for suffix in (".log", ".blf", ".trc", ".asc")
    ]
    for words in (*uses(endless(tmp_path / "file"), log), *buses):
        found = outcome_of(words, tmp_path)
        assert ([status for _, status in found.statuses], found.faults()) == ([2], []), (words, found)


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("seeds", [20, pytest.param(200, marks=pytest.mark.campaign)])
def test_a_log_with_random_bytes_in_its_tables_never_hangs_inspect(seeds: int, log: Path, tmp_path: Path) -> None:
    """Most of the tables are at the start; a few seeds make HDF5 crash, and one in hundreds makes it read on and on."""
    content, path = log.read_bytes(), tmp_path / "damaged.h5"
    for seed in range(seeds):
        drawn, damaged = random.Random(seed), bytearray(content)
        for _ in range(drawn.choice((1, 4, 16))):
            damaged[drawn.randrange(8192)] = drawn.randrange(256)
        path.write_bytes(damaged)
        found = outcome_of(["inspect", f"{path}"], tmp_path)
        assert not found.faults(), (seed, found)


KILLED = """
import sys, time
from pathlib import Path
from canhaptic.logs.repair import in_own_process

def for_ever():
    import os
    print(os.getpid(), flush=True)
    while True:
        time.sleep(1)

in_own_process(Path(sys.executable), for_ever)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the copy ends by its own deadline")
def test_the_copy_dies_with_its_parent() -> None:
    pause = threading.Event()
    with subprocess.Popen([sys.executable, "-c", KILLED], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        copy = int(process.stdout.readline())
        os.kill(copy, 0)
        process.send_signal(signal.SIGKILL)
        process.wait()
    for _ in range(500):
        try:
            if "\nState:\tZ" in Path(f"/proc/{copy}/status").read_text():
                return  # dead, and waiting for the first process of the system
        except (FileNotFoundError, ProcessLookupError):
            return
        pause.wait(0.01)
    raise AssertionError(f"process {copy} is still there")


def steers(text: str) -> bool:
    """Whether a text has control characters, but for ends of lines and tabs, or turns the order of its letters."""
    return any((unicodedata.category(letter) == "Cc" and letter not in "\n\t") or letter == "\u202e" for letter in text)


def named(log: Path, tmp_path: Path) -> Path:
    """A log of a run whose port, status, units and events have names of somebody else."""
    path, port = tmp_path / "named.h5", "\x1b[31mACME\x9b2J\u202e[red]"
    shutil.copy(log, path)
    with h5py.File(path, "r+") as file:
        file.attrs["ports"] = file.attrs["ports"].replace("handle", port)
        file.attrs["status"] = file.attrs["config_hash"] = STEERING
        for group in ("ports", "truth"):
            file.move(f"{group}/handle", f"{group}/{port}")
        file[f"ports/{port}/position"].attrs["unit"] = STEERING
        for key, dataset in file["events"].items():
            dataset.resize((1,))
            dataset[0] = 3 if key == "sync_index" else np.bytes_(STEERING.encode()[: dataset.dtype.itemsize])
    return path


@pytest.mark.slow
def test_names_of_others_are_shown_and_do_not_steer_the_terminal(log: Path, tmp_path, capsys) -> None:
    text = EDS.read_text()
    for key in ("VendorName", "ProductName", "OrderCode"):
        text = text.replace(f"\n{key}=", f"\n{key}={STEERING.replace(chr(13), '')}")
    dictionary, bus = tmp_path / "drive.eds", tmp_path / "bus.log"
    dictionary.write_text(text, encoding="utf-8")
    lines = RECORDING.read_text().splitlines()[:40]
    bus.write_text("\n".join(line.replace("vcan0", "\x1b[31mcan0\x07") for line in lines) + "\n")
    path = named(log, tmp_path)
    hostile: list[Sequence[str]] = [
        ["check-eds", f"{dictionary}"],
        ["check-eds", f"{dictionary}", "--json"],
        ["new", f"{dictionary}"],
        ["inspect", "--frames", f"{bus}"],
        ["inspect", "--frames", f"{bus}", "--json"],
        ["inspect", f"{path}", "--check", "in >= 0"],
        ["inspect", f"{path}", "--check", "\x1b >= 0"],
        ["inspect", f"{path}", "--compare", f"{log}"],
        ["inspect", f"{path}", "--json"],
        ["check", f"{tmp_path}/\x1b[31m.yaml"],
        ["check", f"{DEMO}", "--set", "\x1b[31m=5"],
        ["check", f"{DEMO}", "--set", "axes.0.environment.type=\x1b[31m"],
    ]
    for words in hostile:
        main(words)
        seen = capsys.readouterr()
        assert not steers(seen.out + seen.err), words
        assert "\\x1b" in seen.out + seen.err or words[0] == "new" or "--json" in words, words


PICTURES_RC = "text.usetex: True\nfigure.facecolor: red\nfont.size: 40\nsavefig.dpi: 7\naxes.facecolor: black\n"


@pytest.mark.slow
def test_a_matplotlibrc_of_the_current_folder_changes_no_picture(log: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    drawn: list[bytes] = []
    for name, content in (("plain", ""), ("foreign", PICTURES_RC)):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "matplotlibrc").write_text(content)
        words: list[Any] = [sys.executable, "-m", "canhaptic", "inspect", log, "--svg", "run.svg", "--png", "run.png"]
        done = subprocess.run(
            words, cwd=folder, env={**os.environ, "PYTHONPATH": f"{ROOT}"}, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        drawn.append((folder / "run.png").read_bytes())
        assert (folder / "run.svg").stat().st_size > 10_000
    assert drawn[0] == drawn[1]
