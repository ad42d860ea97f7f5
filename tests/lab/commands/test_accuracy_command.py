"""`canhaptic accuracy` and `tools/accuracy.py`."""

import json
import os
import pty
import re
import runpy
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from canhaptic.cli.main import main
from canhaptic.lab.studies.accuracy import timing
from canhaptic.lab.studies.accuracy.accuracy_table import price_lines, wrapped
from canhaptic.lab.studies.accuracy.studied_port import length_of
from canhaptic.lab.studies.accuracy.study import AccuracyStudy
from canhaptic.scene.load import load_scene
from canhaptic.scene.method import torque_history

REPOSITORY = Path(__file__).resolve().parents[3]
SCENE = str(REPOSITORY / "configs" / "accuracy" / "delayed_bus.yaml")
SHORT = ["--duration", "0.03 s", "--budget", "0"]

Captured = pytest.CaptureFixture[str]


@pytest.mark.slow
def test_a_rate_that_a_line_cannot_have_is_named_and_the_others_are_studied(capsys: Captured, tmp_path: Path) -> None:
    words = ["--duration", "0.6 s", "--budget", "0", "--html", str(tmp_path / "a.html"), "--json"]
    assert main(["accuracy", "ethercat", *words]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [text[:30] for text in found["remarks"] if "rate" in text] == ["left out: sample rate 250 Hz ("]
    loads = {row["setting"]: row["bus_load"] for row in found["loop"] if row["group"] == "sample rate"}
    assert loads == {"500 Hz": None, "2 kHz": None, "4 kHz": None}  # that of a line of EtherCAT is not computed
    assert "bus " not in " ".join(price_lines(found))


@pytest.mark.slow
def test_json_is_one_object_and_page_and_tables_are_written(
    capsys: Captured, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(timing, "_TURNS", 1)
    files = {kind: tmp_path / f"a.{kind}" for kind in ("html", "markdown")}
    words = [word for kind, path in files.items() for word in (f"--{kind}", str(path))]
    words += ["--duration", "0.01 s", "--budget", "0.001", "--tolerance", "1 um", "--json"]
    assert main(["accuracy", SCENE, *words]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["status"], result["holds"], result["tolerance"]) == ("completed", 5, 1e-6)
    assert result["workload"]["seconds"] > 0.0
    assert result["advice"]["chosen"]["position_error"] <= 1e-6
    timed = [row for row in result["loop"] if row["largest_torque"]]  # what sends no torque has no price
    assert len(timed) > 5
    assert all(row["control_thread_us"] > row["controller_us"] > 0.0 for row in timed)
    assert {row["effect"] for row in result["advice"]["effects"]} == {"cogging", "torque_ripple", "current_loop"}
    page = files["html"].read_text(encoding="utf-8")
    assert "semi-implicit Euler" in page
    assert "<script src=" not in page
    assert "<link" not in page
    assert "| canhaptic | 1 substep |" in files["markdown"].read_text(encoding="utf-8").replace("*", "")


@pytest.mark.slow
def test_the_answer_comes_first_with_a_line_that_a_scene_takes(capsys: Captured, tmp_path: Path) -> None:
    picture = tmp_path / "a.png"
    assert main(["accuracy", SCENE, *SHORT, "--tolerance", "1e-7", "--tables", "--png", str(picture)]) == 0
    assert picture.stat().st_size > 30_000
    shown = capsys.readouterr().out
    assert shown.lstrip().startswith("cheapest within 100 nm: ")
    assert "now " in shown
    assert shown.index("accuracy: {event_bits") < shown.index("Pareto front")
    [text] = [line.strip() for line in shown.splitlines() if line.strip().startswith("accuracy: {event_bits")]
    scene = load_scene(
        SCENE, [f"accuracy={yaml.safe_dump(yaml.safe_load(text)['accuracy'], default_flow_style=True).strip()}"]
    )
    assert scene.axes[0].simulation.accuracy.substeps == yaml.safe_load(text)["accuracy"]["substeps"]
    assert main(["accuracy", SCENE, *SHORT, "--tolerance", "1e-7"]) == 0
    brief = capsys.readouterr().out
    assert "Pareto front" not in brief
    assert text in brief


@pytest.mark.slow
def test_a_rate_beyond_the_bus_is_studied_where_it_is_asked_for(capsys: Captured) -> None:
    words = ["accuracy", SCENE, "--duration", "5 ms", "--budget", "0", "--set", "bus.rate=8 kHz"]
    assert main(words) == 2
    assert "fit" in capsys.readouterr().err
    assert main([*words, "--beyond-bus", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["status"] == "completed"
    assert not any(row["bus_fits"] for row in result["loop"] if row["is_scene"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "idle"),
    [
        ("{type: hard_stop, position: 0.9, stiffness: 1e6, damping: 30}", True),
        ("{type: cogging, amplitude: 0 N, pitch: 5 mm}", True),
        ("{type: viscous_friction, damping: 0.5}", False),
    ],
)
def test_an_effect_that_did_nothing_is_worth_nothing(capsys: Captured, effect: str, idle: bool) -> None:
    demo = str(REPOSITORY / "configs" / "demo.yaml")
    words = ["--duration", "0.02 s", "--budget", "0", "--set", f"simulation.effects=[{effect}]"]
    assert main(["accuracy", demo, *words, "--json"]) == 0
    [row] = json.loads(capsys.readouterr().out)["advice"]["effects"]
    assert (row["position_error"] == 0.0) is idle
    assert main(["accuracy", demo, *words]) == 0
    assert ("changed nothing in this time" in capsys.readouterr().out) is idle


@pytest.mark.slow
def test_a_time_in_which_nothing_is_felt_is_no_comparison_and_nothing_is_cut_off(capsys: Captured) -> None:
    demo = str(REPOSITORY / "configs" / "demo.yaml")
    assert main(["accuracy", demo, "--duration", "0.02 s", "--budget", "0"]) == 0
    shown = capsys.readouterr().out
    printed = " ".join(shown.split())
    assert "sample rate" not in shown  # no row of a loop that was not compared
    assert "the hand does not reach the wall within " in printed
    assert "bring it closer" not in printed
    assert "…" not in printed


def test_every_line_fits_80_columns_and_a_setting_starts_with_what_the_scene_has_now() -> None:
    row = {"status": "ok", "method": "canhaptic", "position_error": 8.2e-9, "us_per_period": 1100.0}
    rows: list[dict[str, Any]] = [
        {**row, "accuracy": {"event_bits": 24, "substeps": 1}},
        {**row, "accuracy": {"event_bits": 12, "substeps": 1}, "position_error": 2.8e-6, "us_per_period": 610.0},
    ]
    loop: dict[str, Any] = {
        "status": "ok",
        "group": "sample rate",
        "is_scene": False,
        "bus_load": 1.14,
        "bus_fits": False,
    }
    loop |= {"position_error": 1e-4, "control_thread_us": 14.0, "largest_torque": 1.0, "fineness": 4.0}
    result: dict[str, Any] = {
        "unit": "m", "plant": rows, "tolerance": 1e-7, "workload": {"seconds": 1.0}, "reference": {"travel": 0.1},
        "loop": [{**loop, "group": "as it is", "is_scene": True},
                 *({**loop, "setting": f"{n} kHz"} for n in (2, 4, 8))],
        "now": {"accuracy": {"event_bits": 24, "substeps": 1}, "sample rate": "1 kHz"}, "advice": None,
    }  # fmt: skip
    lines = price_lines(result)
    assert lines[1] == "event bits\tnow 24: 1,100 us, 8.20 nm · 12: 610 us, 2.80 um"
    assert lines[-1].startswith("sample rate\tnow 1 kHz: 14 us, bus 114 %, cycle too long, 100 um · 2 kHz: 14 us")
    shown = [part for line in lines for part in wrapped(line)]
    assert max(map(len, shown)) < 80
    assert not any(part.lstrip().startswith("·") for part in shown)
    assert "".join(lines).replace("\t", "").replace(" ", "") == "".join(shown).replace(" ", "")
    still = {**result, "loop": [{**of, "largest_torque": 0.0} for of in result["loop"]]}
    assert not any("sample rate" in line for line in price_lines(still))


@pytest.mark.slow
def test_a_loop_without_torque_is_judged_with_unprotected_until_its_second_contact(capsys: Captured) -> None:
    demo = str(REPOSITORY / "configs" / "demo.yaml")
    held = ["--set", "passivity.moving_mass=1e-6", "--set", "passivity.hand_force=100", "--budget", "0"]
    scene = load_scene(demo, held[1::2][:2])
    length = length_of(scene, None)
    torques = torque_history(length.scene.axes[0], length.scene, length.holds)
    begins = [k for k, t in enumerate(torques) if t and not (k and torques[k - 1])]
    assert len(begins) == 2
    assert not any(torque_history(scene.axes[0], scene, length.holds))
    assert main(["accuracy", demo, *held]) == 0
    captured = capsys.readouterr()
    assert "loop: this loop gives no torque; judged with unprotected" in " ".join(captured.out.split())
    assert "now unprotected" in captured.out
    assert "exact: " in captured.err  # a first row, before any reference


@pytest.mark.slow
def test_a_shaft_under_backlash_has_a_price(capsys: Captured) -> None:
    shaft = "{type: shaft_compliance, stiffness: 1e4, damping: 1, load_mass: 0.1}, {type: backlash, gap: 1 mm}"
    words = ["--duration", "0.05 s", "--budget", "0", "--set", f"simulation.effects=[{shaft}]", "--json"]
    assert main(["accuracy", str(REPOSITORY / "configs" / "demo.yaml"), *words]) == 0
    rows = {row["effect"]: row for row in json.loads(capsys.readouterr().out)["advice"]["effects"]}
    assert set(rows) == {"backlash", "shaft_compliance with backlash"}
    assert all(row["position_error"] > 0.0 for row in rows.values())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--axis", "knee"], "got axis 'knee', expected one of: handle"),
        (["--png", "/no/such/folder/a.png"], "no such folder"),
        (["--png", "picture.bmp"], "expected a name that ends in"),
        (["--html", "/no/such/folder/a.html"], "no such folder"),
        (["--set", "simulation=null", "--set", "bus.channel=x"], "is not simulated"),
    ],
)
def test_bad_arguments_end_with_2(capsys: Captured, arguments: list[str], message: str) -> None:
    assert main(["accuracy", SCENE, *SHORT, *arguments]) == 2
    assert message in capsys.readouterr().err


def test_a_bad_tolerance_ends_with_2(capsys: Captured) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["accuracy", SCENE, "--tolerance", "1 N"])
    assert ended.value.code == 2
    assert "unit 'N' does not fit" in capsys.readouterr().err


@pytest.fixture(scope="module")
def whole() -> dict[str, Any]:
    """A study that nothing stopped."""
    return AccuracyStudy(load_scene(SCENE), duration=0.01, budget=0.0).run()


@pytest.mark.slow
@pytest.mark.parametrize("calls", [0, 3, 10, 40])
def test_a_study_that_is_stopped_keeps_what_it_measured(calls: int, whole: dict[str, Any]) -> None:
    asked: list[None] = []

    def stop() -> bool:
        asked.append(None)
        return len(asked) > calls

    result = AccuracyStudy(load_scene(SCENE), duration=0.01, budget=0.0, stop=stop).run()
    assert result["status"] == "stopped"
    assert whole["status"] == "completed"
    differ = {"pareto", "cpu_per_second"}  # the first depends on all rows, the second is a time
    kept, every = (
        [{key: value for key, value in row.items() if key not in differ} for row in study["plant"] + study["loop"]]
        for study in (result, whole)
    )
    assert kept == every[: len(kept)]
    assert max(0, min(calls - 12, 10)) <= len(kept) < len(every)
    assert result["advice"] is None  # what was not measured might be the better choice


@pytest.mark.slow
def test_ctrl_c_prints_what_was_measured_and_ends_with_130() -> None:
    words = ["accuracy", SCENE, "--duration", "0.02 s", "--budget", "600", "--tables"]
    screen, terminal = pty.openpty()  # a terminal, so that there is a progress bar to wait for
    with subprocess.Popen(
        [sys.executable, "-m", "canhaptic", *words], stdout=subprocess.PIPE, stderr=terminal, text=True
    ) as process:
        os.close(terminal)
        try:
            seen = ""
            while not any(int(part) > 71 for part in re.findall(r"(\d+) %", seen)):  # the times are being measured
                seen += os.read(screen, 4096).decode(errors="replace")
            process.send_signal(signal.SIGINT)
            out = process.communicate(timeout=60)[0]
        finally:
            process.kill()
            os.close(screen)
    assert process.returncode == 130
    assert "stopped" in out
    assert "semi-implicit Euler" in out
    assert "no advice: the study was stopped before its end" in out
    assert "accuracy: {" not in out


def test_the_tool_says_the_same(capsys: Captured, monkeypatch: pytest.MonkeyPatch) -> None:
    tool = str(REPOSITORY / "tools" / "accuracy.py")
    monkeypatch.setattr(sys, "argv", [tool, SCENE, *SHORT, "--axis", "knee"])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(tool, run_name="__main__")
    assert ended.value.code == 2
    assert "got axis 'knee'" in capsys.readouterr().err


@pytest.mark.parametrize("config", ["two_handles", "five_bar_sphere"])
def test_axes_that_are_not_their_own_have_no_accuracy_chosen(capsys: Captured, config: str) -> None:
    path = str(REPOSITORY / "configs" / f"{config}.yaml")
    assert main(["run", path, "--set", "accuracy={auto: 1 um}", "--duration", "0.01 s"]) == 2
    assert "instead of auto" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("config", "name", "words"),
    [
        ("two_handles", "coupling", "exact"),
        ("xy_box", "stage", "exact"),
        ("five_bar_sphere", "stylus", r"\d+ substeps?"),
    ],
)
def test_a_group_is_studied_as_an_axis_is(capsys: Captured, config: str, name: str, words: str) -> None:
    path = str(REPOSITORY / "configs" / f"{config}.yaml")
    assert main(["accuracy", path, "--budget", "0", "--duration", "0.02 s", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["axis"], result["is_group"], result["status"]) == (name, True, "completed")
    assert re.fullmatch(words, result["advice"]["chosen"]["setting"])
    assert result["advice"]["chosen"]["position_error"] <= result["tolerance"]
    changed = {row["group"] for row in result["loop"]}
    assert {"as it is", "sample rate", "RPDO", "algorithm", "torque step", "encoder count"} == changed
    assert all(row["status"] == "ok" for row in result["loop"])
    assert main(["accuracy", path, "--axis", "nothing"]) == 2
    assert f"expected one of: {name}" in capsys.readouterr().err
