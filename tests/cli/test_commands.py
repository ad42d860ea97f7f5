"""The `canhaptic` command: what it prints, where, and its exit statuses."""

import json
import sys
import threading
from contextlib import ExitStack, closing
from pathlib import Path

import pytest

from canhaptic.cli import drive as drive_command
from canhaptic.cli.main import main
from canhaptic.cli.options import seconds
from canhaptic.cycle import run
from canhaptic.drive.can.door import open_bus
from canhaptic.logs.energy_reader import EnergyLog
from canhaptic.scene.build import build
from canhaptic.scene.buses import can_bus, kind_of
from canhaptic.scene.far_side import build_far_end
from canhaptic.scene.load import load_scene
from canhaptic.view.terminal import RunProgress

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
DEMO = str(CONFIGS / "demo.yaml")
TWO_BUSES = str(CONFIGS / "two_buses.yaml")
SHORT = [DEMO, "--duration", "0.2"]

Captured = pytest.CaptureFixture[str]


# --- main ---------------------------------------------------------------------------------------------------------


def test_nothing_unknown_is_accepted(capsys: Captured) -> None:
    for words in (["walk"], ["run"], ["run", DEMO, "--pace", "fast"], ["run", DEMO, "--duration", "-1"]):
        with pytest.raises(SystemExit) as caught:
            main(words)
        assert caught.value.code == 2
    assert "expected 0 < duration" in capsys.readouterr().err


def test_a_duration_may_carry_its_unit() -> None:
    assert [seconds(text) for text in ("10", "10 s", "500 ms", "2 min", "1e-3")] == [10.0, 10.0, 0.5, 120.0, 1e-3]


# --- run ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_run_prints_the_energy_account(capsys: Captured) -> None:
    assert main(["run", *SHORT, "--full"]) == 0
    out = capsys.readouterr().out
    for words in ("completed", "200 cycles", "smallest margin", "largest error of the account", "timing", "link"):
        assert words in out
    assert main(["run", *SHORT]) == 0
    assert len(capsys.readouterr().out.splitlines()) <= 12


def test_run_json_is_one_object_with_the_names_of_the_design(capsys: Captured, tmp_path: Path) -> None:
    log = tmp_path / "a.h5"
    assert main(["run", DEMO, "--duration", "0.5", "--json", "--log", str(log), "--set", "environment.side=above"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert {"status", "config_hash", "cycles", "ports", "truth", "timing", "link", "method"} <= result.keys()
    assert (result["status"], result["cycles"]) == ("completed", 503)
    port = result["ports"]["handle"]
    names = "in out stored dissipated surplus recovered leaked deficit margin least_interaction certificate branches"
    assert set(names.split()) | {"damping_rendered"} <= port.keys()
    assert port["in"] > 1e-3
    with EnergyLog.open(log) as opened:
        assert opened.rows == 503
        assert sum(h for h in opened.ports["handle"]["h_i"] if h > 0) == pytest.approx(port["in"], rel=1e-12)


@pytest.mark.slow
def test_the_scene_names_its_logs_and_options_win(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["run", *SHORT, "--set", "log={energy: scene.h5, bus: scene.log}", "--log", "option.h5"]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["option.h5", "scene.log"]


def test_a_dry_run_says_in_its_first_line_what_was_not_sent(capsys: Captured) -> None:
    assert main(["run", *SHORT, "--set", "environment.side=above", "--no-torque"]) == 0
    first = capsys.readouterr().out.splitlines()[0]
    assert first.startswith("dry run: no torque was sent; the largest would have been: handle ")
    newtons, unit = first.split()[-2:]
    assert unit == "N"
    assert 0.1 < float(newtons) <= 20.0


@pytest.mark.slow
def test_a_picture_needs_no_log(tmp_path: Path) -> None:
    assert main(["run", *SHORT, "--png", str(tmp_path / "a.png")]) == 0
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]


@pytest.mark.parametrize(
    ("words", "status", "expected"),
    [
        (["--set", "bus.interface=telepathy", "--set", "bus.channel=x"], 2, "got 'telepathy', expected one of"),
        (["--log", "/nonexistent/a.h5"], 2, "/nonexistent/a.h5"),
        (["--bus-log", "/nonexistent/a.log"], 2, "/nonexistent/a.log"),
        (["--png", "/nonexistent/a.png"], 2, "no such folder /nonexistent"),
        (["--png", "a.nonsense"], 2, "expected a name that ends in .png, .svg or .pdf"),
        (["--pace", "free", "--set", "simulation=null", "--set", "bus.channel=x"], 2, "needs drives simulated"),
        (["--set", "simulation.drive.objects.0x6502=0"], 3, "0x6502"),
    ],
)
def test_a_failure_is_one_clear_message_and_its_exit_status(words, status, expected, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["run", *SHORT, "--json", *words]) == status
    captured = capsys.readouterr()
    answer = json.loads(captured.out)
    assert (answer["status"], answer["exit_status"]) == ("error", status)
    assert expected in captured.err
    assert expected in "\n".join(answer["faults"])
    assert captured.err.startswith("canhaptic: error")
    assert "Traceback" not in captured.err


def test_without_json_a_failure_leaves_standard_output_alone(capsys: Captured) -> None:
    assert main(["run", "/nonexistent.yaml"]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1


# --- progress -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("pace", "cycles"), [("real", 5000), ("free", None)])
def test_progress_is_shown_after_a_second_and_not_before(pace: str, cycles: int | None, tmp_path, monkeypatch) -> None:
    with (tmp_path / "terminal").open("w+") as terminal:
        monkeypatch.setattr(sys, "stderr", terminal)
        with closing(RunProgress(cycles, 1e-3, "real" if pace == "real" else "free")) as progress:
            progress(64)
            assert (tmp_path / "terminal").read_bytes() == b""
            progress._next = 0
            progress(2048)
        monkeypatch.undo()
    assert b"2.0 s" in (tmp_path / "terminal").read_bytes()


def test_a_bar_is_drawn_where_the_end_is_known(capsys: Captured, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")  # as on a terminal
    with closing(RunProgress(4096, 1e-3, "free")) as progress:
        progress._next = 0
        progress(2048)
        progress._next = 0
        progress(4096)
    assert "running" in capsys.readouterr().err


# --- check, drive, schema -----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["two_buses", "admittance/six_axes"])
def test_check_says_once_what_holds_for_every_axis(capsys, monkeypatch, scene: str) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["check", scene]) == 0
    out = capsys.readouterr().out
    assert len(out.splitlines()) <= 40
    assert "\n  every axis   " in out
    assert "\n  left_x" not in out


@pytest.mark.slow
def test_check_prints_configuration_bus_drives_stability_and_host(capsys: Captured) -> None:
    assert main(["check", DEMO]) == 0
    assert len(capsys.readouterr().out.splitlines()) <= 40
    assert main(["check", DEMO, "--full"]) == 0
    out = capsys.readouterr().out
    statuses = "Simulation: ready. Hardware: 8 values to set; "
    felt = "the wall is felt (half of its force or more) at approach speeds above 0.0015 m/s"
    first = out[: out.index("\nscene (checksum ")].replace("\n    ", "")
    leant = "; leaned on, it is felt as 101 N/m of 100 N/m"
    assert first == f"{statuses}{felt}{leant}, 1 drive is usable, bus load 28 %"
    for words in ("1 SYNC x 55 + 1 TPDO x 135", "0x6071 target torque", "Colgate", "processors"):
        assert words in out
    assert "stiffness: 100.0" not in out
    assert main(["check", DEMO, "--resolved"]) == 0
    assert "stiffness: 100.0" in capsys.readouterr().out


@pytest.mark.slow
def test_check_marks_limits_that_the_chosen_algorithm_does_not_rest_on(capsys: Captured) -> None:
    stiff = ["--set", "environment.stiffness=5000"]
    assert main(["check", DEMO, *stiff, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["ready"] is True
    rows = {hint["what"]: hint for hint in answer["stability"]}
    colgate = rows["stiffness, Colgate's bound 2 b / T"]
    assert (colgate["exceeded"], colgate["concerns"]) == (True, False)  # of a plain wall, and this one is guarded
    assert colgate["text"].startswith("plain wall, no algorithm: ")
    assert rows["damping, stable"]["concerns"] is True
    assert main(["check", DEMO, *stiff, "--json", "--set", "passivity={algorithm: unprotected}"]) == 0
    answer = json.loads(capsys.readouterr().out)
    rows = {hint["what"]: hint for hint in answer["stability"]}
    assert rows["stiffness, Colgate's bound 2 b / T"]["concerns"] is True
    exceeded = [what for what, hint in rows.items() if hint["exceeded"] and hint["concerns"]]
    assert f", {len(exceeded)} limits exceeded" in answer["verdict"]


def test_check_json_is_one_object(capsys: Captured) -> None:
    assert main(["check", DEMO, "--set", "environment.stiffness=500", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["bus"]["worst_cycle"] == pytest.approx(705e-6)
    assert answer["config"]["axes"]["handle"]["environment"]["stiffness"] == 500.0
    assert [hint["exceeded"] for hint in answer["stability"]][:2] == [True, True]
    assert {finding["verdict"] for finding in answer["drives"]["handle"]} == {"fit"}


def test_check_needs_no_bus(capsys: Captured) -> None:
    assert main(["check", str(CONFIGS / "socketcan_example.yaml")]) == 1  # its values are marked as guesses
    assert "socketcan" in capsys.readouterr().out


def test_drive_refuses_a_bus_that_nobody_else_can_reach(capsys: Captured) -> None:
    assert main(["drive", DEMO]) == 2
    assert "no master can reach the drive" in capsys.readouterr().err


def test_drive_lives_for_its_duration(capsys: Captured) -> None:
    assert main(["drive", DEMO, "--set", "bus.channel=alone", "--duration", "50 ms"]) == 0
    assert "handle (node 1) on virtual alone" in capsys.readouterr().err


def test_a_drive_on_its_own_is_run_by_a_master_elsewhere() -> None:
    far = load_scene(DEMO, ["bus.channel=two-sides", "bus.rate=100"])
    master = load_scene(DEMO, ["bus.channel=two-sides", "bus.rate=100", "simulation=null"])
    stop = drive_command.StopSignal()  # type: ignore[attr-defined]
    with open_bus(can_bus(far.bus), "two-sides") as bus:
        group = build_far_end(far, None, bus)[0]
        thread = threading.Thread(target=drive_command._live, args=([(bus, group)], 20.0, stop))
        thread.start()
        try:
            with build(master) as experiment:
                run(experiment.cycle, cycles=30)
                assert experiment.pace == "real"
                assert experiment.cycle.cycles - experiment.cycle.holds_of_stop == 30
        finally:
            stop.numbers.append(2)
            thread.join(5.0)
    assert not thread.is_alive()


@pytest.mark.slow
def test_drives_on_two_buses_are_run_by_a_master_elsewhere() -> None:
    overrides = ["bus.left.channel=left-side", "bus.right.channel=right-side", "environment.position=-1"]  # no contact
    overrides += ["bus.left.rate=50", "bus.left.stop_cycles=500", "bus.left.heartbeat_timeout=10 s"]  # busy machines
    far, master = load_scene(TWO_BUSES, overrides), load_scene(TWO_BUSES, [*overrides, "simulation=null"])
    stop = drive_command.StopSignal()  # type: ignore[attr-defined]
    with ExitStack() as stack:
        far_ends = [drive_command._far_end(far, place, stack) for place in range(2)]
        thread = threading.Thread(target=drive_command._live, args=(far_ends, 20.0, stop))
        thread.start()
        try:
            with build(master) as experiment:
                run(experiment.cycle, cycles=20)
                assert experiment.cycle.cycles - experiment.cycle.holds_of_stop == 20
                assert experiment.rig.link_statistics()["success_rate"] > 0.0
        finally:
            stop.numbers.append(2)
            thread.join(5.0)
    assert not thread.is_alive()


@pytest.mark.slow
def test_the_schema_knows_every_key_of_every_shipped_configuration(capsys: Captured) -> None:
    assert main(["configs", "--schema"]) == 0
    schema = json.loads(capsys.readouterr().out)
    for path in CONFIGS.glob("*.yaml"):
        scene = load_scene(path)
        properties = schema["properties"]
        *alone, several = properties["bus"]["anyOf"]
        kind = int(kind_of(scene.bus) == "ethercat")
        of_first = (several["prefixItems"][0]["anyOf"] if scene.further_buses else alone)[kind]
        assert scene.bus.model_fields_set <= of_first["properties"].keys()
        for bus in scene.further_buses:
            assert bus.model_fields_set <= several["items"]["properties"].keys()
        assert scene.axes[0].parameters.model_fields_set <= properties["axes"]["items"]["properties"].keys()
        models = [s for s in properties["environment"]["anyOf"] if s["type"] == "object"]  # else a list, their sum
        [wall] = [s for s in models if s["properties"]["type"]["const"] == "spring_damper_wall"]
        assert "stiffness" in wall["required"]
        names = [s["properties"]["algorithm"]["const"] for s in properties["passivity"]["anyOf"]]
        assert scene.axes[0].group or scene.axes[0].passivity.name in names
    text = json.dumps(schema)
    for name in schema["$defs"]:
        assert f"#/$defs/{name}" in text


def test_a_strict_run_exits_with_one_unless_it_was_passive(capsys):
    """A spring without protection at a low rate gives energy out; the same under `guarded` does not."""
    stiff = ["environment.stiffness=3000", "environment.damping=0", "bus.rate=200"]
    words = [word for override in stiff for word in ("--set", override)]
    command = ["run", DEMO, "--duration", "1.5", "--json", *words]
    active = [*command, "--set", "passivity={algorithm: unprotected}"]
    assert main(active) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["passive"], found["ports"]["handle"]["passive"]) == ("no", "no")
    assert main([*active, "--strict"]) == 1
    assert "--strict: handle: passive: NO, for certain from " in capsys.readouterr().err
    assert main([*command, "--strict"]) == 0
    assert json.loads(capsys.readouterr().out)["passive"] == "yes"
