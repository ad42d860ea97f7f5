"""What a user reads when something fails: words, once, with a remedy that works; and what a refused node receives."""

import json
import os
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from canhaptic import errors
from canhaptic.cli.main import main
from canhaptic.extras import install_hint

CONFIGS = Path(__file__).parents[2] / "configs"
DEMO = str(CONFIGS / "demo.yaml")
CLASSES = [name for name in vars(errors) if name.endswith("Error")]


@pytest.mark.slow_but("words3", "words5", "words6")
@pytest.mark.parametrize(
    "words",
    [
        ["run", DEMO, "--set", "simulation.drive.objects.0x1000=0x00030191"],
        ["run", DEMO, "--set", "axes.0.vendor_id=5"],
        ["run", DEMO, "--set", "bus.rate=9 kHz"],
        ["run", "absent.yaml"],
        ["inspect", "absent.h5"],
        ["scope", "--config", DEMO],
        ["design", str(CONFIGS / "admittance" / "cup_and_ball.yaml")],
    ],
)
def test_no_fault_says_its_prefix_twice_or_names_a_class(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) in {2, 3}
    text = capsys.readouterr().err
    assert not re.search(r"\b(\w[\w /.]*): \1: ", text), text
    assert [name for name in CLASSES if name in text] == []


@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("--unprotected", "; did you mean --set passivity=unprotected?"),
        ("--ressolved", "; did you mean '--resolved'?"),
        ("more", ""),
    ],
)
def test_an_unknown_option_is_refused_with_what_it_may_mean(word: str, meant: str, capsys) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["check", DEMO, word])
    assert capsys.readouterr().err.splitlines()[-1] == f"canhaptic: error: unrecognized arguments: {word}{meant}"


def test_nothing_is_written_to_a_node_that_is_no_cia_402_drive(tmp_path: Path) -> None:
    bus_log = tmp_path / "run.log"
    words = ["run", DEMO, "--bus-log", str(bus_log), "--set", "simulation.drive.objects.0x1000=0x00030191"]
    assert main(words) == 3
    frames = [line.split()[2] for line in bus_log.read_text().splitlines() if "#" in line]
    answer = next(place for place, frame in enumerate(frames) if frame.startswith("581#43001000"))
    assert not [frame for frame in frames[answer + 1 :] if frame.split("#")[0] in {"000", "080", "201", "301", "601"}]


HIDDEN = """
import builtins, sys
real = builtins.__import__
def hidden(name, *rest, **named):
    if name.split(".")[0] in sys.argv[1].split(","):
        raise ImportError(name, name=name)
    return real(name, *rest, **named)
builtins.__import__ = hidden
from canhaptic.cli.main import main
sys.exit(main(sys.argv[2:]))
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("library", "extra", "words"),
    [
        ("matplotlib", "plot", ["run", DEMO, "--duration", "1000000", "--png", "a.png"]),
        ("matplotlib", "plot", ["inspect", "absent.h5", "--html", "a.html"]),
        ("matplotlib", "plot", ["sweep", "--map", "absent.h5", "--html", "a.html"]),
        ("bokeh", "report", ["scope", "absent.h5"]),
    ],
)
def test_what_is_not_installed_is_found_before_the_work(library: str, extra: str, words: list[str], tmp_path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", HIDDEN, library, *words], cwd=tmp_path, capture_output=True, text=True, timeout=60,
        check=False, env={**os.environ, "PYTHONPATH": str(CONFIGS.parent)},
    )  # fmt: skip
    assert done.returncode == 2
    assert install_hint(extra) in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    ("origin", "hint"),
    [
        (None, "pip install 'canhaptic[plot]'"),
        ({"url": "file:///home/me/canhaptic", "dir_info": {"editable": True}},
         "pip install -e '/home/me/canhaptic[plot]'"),
        ({"url": "file:///home/me/can haptic", "dir_info": {}}, "pip install '/home/me/can haptic[plot]'"),
        ({"url": "https://host/canhaptic.git", "vcs_info": {"vcs": "git", "commit_id": "12ab"}},
         "pip install 'canhaptic[plot] @ git+https://host/canhaptic.git@12ab'"),
        ({"url": "https://host/canhaptic.whl", "archive_info": {}},
         "pip install 'canhaptic[plot] @ https://host/canhaptic.whl'"),
    ],
)  # fmt: skip
def test_the_hint_installs_from_where_the_package_came(origin: dict[str, Any] | None, hint: str, monkeypatch) -> None:
    text = None if origin is None else json.dumps(origin)
    installed = SimpleNamespace(read_text={"direct_url.json": text}.get)
    monkeypatch.setattr(metadata, "distribution", lambda _: installed)
    assert install_hint("plot") == hint


@pytest.mark.slow
def test_the_simulated_drive_asks_for_what_the_scene_says_of_its_thread(capsys: pytest.CaptureFixture[str]) -> None:
    before = os.sched_getaffinity(0)
    cpu = min(before)
    words = ["drive", DEMO, "--duration", "0.05", "--set", "bus.interface=virtual", "--set", "bus.channel=words"]
    assert main([*words, "--set", f"bus.realtime.cpus=[{cpu}]"]) == 0
    assert "bus.realtime.cpus: granted" in capsys.readouterr().err
    assert os.sched_getaffinity(0) == before
