import json
import math
import re
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

import h5py
import numpy as np
import pytest

from canhaptic.cli.main import main
from canhaptic.errors import InputError
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.view import html_page
from canhaptic.view.html_page import words, write_page
from canhaptic.view.table import Table
from tests.view import typed
from tests.view.chromium import chromium
from tests.view.hour_run import write_hour
from tests.view.synthetic_run import write_run, write_troubled_run

ROOT = Path(__file__).parents[2]
READY = "document.readyState == 'complete'"


@pytest.mark.slow
def test_late_cycles_and_lost_frames_are_drawn(tmp_path: Path) -> None:
    write_troubled_run(tmp_path / "run.h5")
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        file["timing/dropped_before"][60] = 4
    with EnergyLog.open(tmp_path / "run.h5") as log:
        panels, idle = html_page._further(log, slice(0, log.rows))
    assert idle == ["handle: damping rendered"]
    time, lateness = panels["timing"][1]["wakeup lateness"]
    assert lateness.max() == pytest.approx(950e-6)  # [s]
    assert time[lateness.argmax()] == pytest.approx(0.030)
    (time, missed), (_, dropped) = (
        panels["lost"][1][name] for name in ("handle: TPDOs missed", "cycles not in the log")
    )
    steps = np.searchsorted(time, [0.0095, 0.0105, 0.0115, 0.1015]) - 1  # each lasts until the next
    assert missed[steps].tolist() == [0.0, 1.0, 2.0, 3.0]
    assert (dropped[0], dropped[-1]) == (0.0, 4.0)
    assert time[dropped.argmax()] == pytest.approx(0.062)


@pytest.mark.slow
def test_a_part_of_a_run_can_be_drawn_and_an_empty_log_cannot(tmp_path: Path) -> None:
    write_run(tmp_path / "run.h5", cycles=600, ports=("handle", "knob"))
    assert (
        typed.inspect(tmp_path / "run.h5", "--html", tmp_path / "part.html", "--from", "0.1", "--to", "0.3", "--json")
        == 0
    )
    page = (tmp_path / "part.html").read_text()
    assert len(page) < 6_000_000
    assert not re.search(r"<script[^>]+src=|<link[^>]+href=", page)  # nothing is fetched from anywhere
    write_run(tmp_path / "empty.h5", cycles=0)
    with pytest.raises(InputError, match="no cycle"):
        typed.inspect(tmp_path / "empty.h5", "--html", tmp_path / "empty.html")
    with pytest.raises(InputError, match="no such folder"):
        typed.inspect(tmp_path / "run.h5", "--html", tmp_path / "missing" / "run.html")


APART = """
import sys
from canhaptic.cli.main import main
assert main(["inspect", *sys.argv[1:]]) == 0
peak = next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(int(peak) / 1000.0, file=sys.stderr)
"""


def inspect_apart(*words: str | Path) -> float:
    """Megabytes that `inspect` takes in its own process."""
    program = [sys.executable, "-c", APART, *map(str, words), "--json"]
    done = subprocess.run(program, check=True, capture_output=True, cwd=ROOT, text=True)
    return float(done.stderr.splitlines()[-1])  # a page that is written is named before


@pytest.mark.campaign
def test_an_hour_is_inspected_in_little_memory_and_opens_in_a_browser(tmp_path: Path) -> None:
    log, page_file = tmp_path / "hour.h5", tmp_path / "hour.html"
    write_hour(log)
    assert inspect_apart(log, "--html", page_file) < 550.0
    assert page_file.stat().st_size < 6_000_000
    with chromium() as page:
        page.open(page_file.as_uri())
        page.wait_for(READY)
        page.screenshot(tmp_path / "hour.png")
        assert page.faults == []
        assert (tmp_path / "hour.png").stat().st_size > 20_000


@pytest.mark.slow
def test_worst_margin_and_faults_are_drawn_once_more_larger(tmp_path: Path) -> None:
    write_run(tmp_path / "run.h5", cycles=4000, ports=("handle", "knob"))
    assert typed.inspect(tmp_path / "run.h5", "--html", tmp_path / "run.html", "--json") == 0
    titles = re.findall("<summary>(.*?)</summary>", (tmp_path / "run.html").read_text(encoding="utf-8"))
    assert [title.split(",")[0] for title in titles[:2]] == [
        f"{n}: around the smallest margin" for n in ("handle", "knob")
    ]
    assert titles[2] == "around emcy 0x8130 heartbeat lost at 2 s"
    assert titles[3:] == ["damping, timing, losses"]


@pytest.mark.campaign
def test_a_click_on_a_heading_sorts_values_with_their_prefixes_and_puts_blanks_last(tmp_path: Path) -> None:
    cells = [["b", "12 mm"], ["a", "3 m"], ["d", ""], ["c", "900 um"], ["e", "-"]]
    write_page(tmp_path / "page.html", "a page", [Table("", ("name", "size"), cells, keys=1)])
    with chromium() as page:
        page.open((tmp_path / "page.html").as_uri())
        page.wait_for("document.readyState == 'complete'")
        names = "[...document.querySelectorAll('tbody tr')].map(row => row.cells[0].textContent).join('')"
        page.value("document.querySelectorAll('th')[1].click()")
        assert page.value(names) == "cbade"
        page.value("document.querySelectorAll('th')[1].click()")
        assert page.value(names) == "abcde"
        page.value("document.querySelectorAll('th')[0].click()")
        assert page.value(names) == "abcde"
        assert page.faults == []


@pytest.mark.campaign
def test_pictures_follow_the_colours_of_the_page_by_day_and_by_night(tmp_path: Path) -> None:
    write_run(tmp_path / "run.h5", cycles=200)
    assert typed.inspect(tmp_path / "run.h5", "--html", tmp_path / "run.html", "--json") == 0
    with chromium() as page:
        lightness = {}
        for scheme in ("light", "dark"):
            page.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
            page.open((tmp_path / "run.html").as_uri())
            page.wait_for("document.readyState == 'complete'")
            colours = (
                "[document.body, document.querySelector('#patch_1 path'), document.querySelector('#ytick_1 use')]"
                ".map((part, i) => getComputedStyle(part)[i ? 'fill' : 'backgroundColor'])"
            )
            lightness[scheme] = [min(map(float, re.findall(r"[\d.]+", text)[:3])) for text in page.value(colours)]
            assert page.faults == []
    assert lightness["light"][0] == 255.0
    assert lightness["dark"][0] < 40.0
    assert lightness["light"][1] > 0.9  # the paper of the picture, 0 to 1
    assert lightness["dark"][1] < 0.2


def test_a_page_is_valid_text_without_network_and_takes_its_tables_along(tmp_path: Path) -> None:
    table = Table("walls <1>", ("name", "k [N/m]"), [["soft & warm", 12.5], ["hard", math.nan]], keys=1)
    write_page(tmp_path / "page.html", "a <page>", [words("one & two"), table])
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "a &lt;page&gt;" in text
    assert "one &amp; two" in text
    assert not re.search(r"(src|href)=\"(?!data:)", text)
    links = dict(re.findall(r'href="data:([^;]+);charset=utf-8,([^"]*)"', text))
    assert unquote(links["text/csv"]) == table.csv()
    assert json.loads(unquote(links["application/json"])) == [
        {"name": "soft & warm", "k [N/m]": 12.5}, {"name": "hard", "k [N/m]": None},
    ]  # fmt: skip
    write_page(tmp_path / "page.html", "of \udcff", [Table("", ("name",), [["es\x1bcape"]])])  # a path that is no UTF-8
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "of \\udcff" in text
    assert "es\\x1bcape" in text
    with pytest.raises(InputError, match="cannot be written"):
        write_page(tmp_path / "missing" / "page.html", "a page", [])


@pytest.mark.slow
def test_a_run_of_other_ports_is_not_laid_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_run(tmp_path / "run.h5", cycles=200)
    write_run(tmp_path / "again.h5", cycles=200)
    assert typed.inspect(tmp_path / "run.h5", "--overlay", tmp_path / "again.h5", "--svg", tmp_path / "both.svg") == 0
    assert ">again.h5</text>" in (tmp_path / "both.svg").read_text()
    write_run(tmp_path / "other.h5", cycles=200, ports=("knob",))
    words = ["inspect", str(tmp_path / "run.h5"), "--html", str(tmp_path / "run.html")]
    assert main([*words, "--overlay", str(tmp_path / "other.h5")]) == 2
    assert "got the ports knob, expected one of handle" in capsys.readouterr().err
