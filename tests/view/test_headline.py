"""The first line of a port in words."""

import io
import math
from collections.abc import Callable
from typing import Any

import pytest
from rich.console import RenderableType
from rich.text import Text

from canhaptic.axis_units import uses_degrees
from canhaptic.control.verdict import LATE, headline
from canhaptic.view.energy_table import energy_report
from canhaptic.view.run_lines import advice_lines, brief_report, headline_text, headlines, make_console

CERTIFIED = {"certificate": "hand_force", "certificates": ["hand_force"]}


@pytest.mark.parametrize(
    ("port", "words"),
    [
        ({"passive": "yes", **CERTIFIED}, "passive: yes"),
        ({"passive": "yes", "why": "measured", **CERTIFIED}, "passive: yes, measured"),
        ({"passive": "yes", "why": "by certificate", **CERTIFIED, "hand_force": 0.0},
         "passive: yes, by certificate: moving mass, hand never pulls"),
        ({"passive": "yes", "why": "by certificate", "energy_allowance": 1e-4, **CERTIFIED},
         "passive: yes, by certificate: hand force, within an allowance of 100 uJ"),
        ({"passive": "yes", "energy_allowance": 1e-4}, "passive: yes, within an allowance of 100 uJ"),
        ({"passive": "in doubt", "passive_at_handle": "yes", "why": "measured"},
         "passive at the handle: yes, measured"),
        ({"passive": "no", "passive_at_handle": "yes", **CERTIFIED}, "passive at the handle: yes"),
        ({"passive": "in doubt", "plant_passive": "yes", "in": 0.761, "out": 0.18, "energy_resolution": 19.4},
         "passive: yes, by the simulated plant · net energy (in - out) 581 mJ"),
        ({"passive": "in doubt", "plant_passive": "no", "least_interaction": -0.25},
         "passive: NO, by the simulated plant · lowest net energy (in - out), at the motor -250 mJ"),
        ({"passive": "in doubt", "energy_resolution": 0.5, "why": "the contact acts as if 4 counts deep, 20 needed"},
         "passive: in doubt: the contact acts as if 4 counts deep, 20 needed · uncertainty of the account +-500 mJ"),
        ({"passive": "in doubt", "energy_resolution": 0.5, "books_least": True},
         "passive: in doubt · uncertainty of the account +500 mJ, -0 J"),
        ({"passive": "no", "active_before": True}, "passive: NO, already before this part of the log"),
        ({"passive": "no", "active_since": 0.5, "first_active": 0.5, "first_active_contact": 2},
         "passive: NO, for certain from 0.5 s (contact 2) on"),
        ({"passive": "no", "active_since": 0.5, "first_active": 0.4}, "passive: NO, for certain from 0.5 s on"),
        ({"passive": "no", "first_active": 0.4}, "passive: NO, first below zero at 0.4 s"),
        ({"passive": "yes", "contact": {"holds": 0, "without_torque": 0}}, "no contact"),
        ({"passive": "yes", "unit": "m", "contact": {"holds": 0, "without_torque": 0}, "reach": [-0.012, 0.03],
          "wall": -0.05}, "no contact: the handle stayed between -12.0 mm and 30.0 mm, the wall begins at -50.0 mm"),
        ({"passive": "yes", "unit": "rad", "contact": {"holds": 0, "without_torque": 0}, "reach": [0.0, 0.5]},
         "no contact: the handle stayed between 0 rad and 0.5 rad"),
        ({"passive": "yes", "unit": "rad", "contact": {"holds": 0, "without_torque": 0}, "reach": [0.0, math.pi / 6.0],
          "wall": -math.pi / 4.0, "in_degrees": True},
         "no contact: the handle stayed between 0 deg and 30 deg, the wall begins at -45 deg"),
        ({"passive": "yes", "rendered": {"stiffness": 1.004, "damping": None}},
         "passive: yes · stiffness as requested"),
        ({"passive": "yes", "rendered": {"stiffness": 0.873, "damping": None}, "environment": "detents"},
         "passive: yes · notch force 87.3 % of requested"),
        ({"passive": "yes", "contact": {"holds": 9, "without_torque": 9}, "advice": "a lower current_lag"},
         "NOTHING RENDERED: a lower current_lag"),
        ({"passive": "yes", "in": 0.136, "out": 0.0376, "rendered": {"stiffness": 0.985, "damping": None}, **CERTIFIED},
         "passive: yes · stiffness 98.5 % of requested"),
        ({"passive": "yes", "unit": "m", "mass": {"requested": 3.0, "felt": 2.9607, "share": 0.9869}},
         "passive: yes · mass felt 98.7 % of requested"),
        ({"passive": "yes", "unit": "rad", "mass": {"requested": 0.02, "felt": None, "share": None}}, "passive: yes"),
        ({"passive": "yes", "dry_run": True}, "dry run, no torque was sent"),
    ],
)  # fmt: skip
def test_a_port_says_one_word_its_reason_and_one_number(port: Any, words: str) -> None:
    port = {"certificate": "none", **port}
    assert headline_text("handle", {**port, "verdict": headline(port)}).plain == f" handle: {words}"


@pytest.mark.parametrize(
    ("port", "advice"),
    [
        ({"passive": "yes", **CERTIFIED}, []),
        ({"passive": "yes", "plant_passive": "no"}, ["the account says yes, so a declaration is false"]),
        ({"passive": "no", "plant_passive": "no", "contradicted": ["hand_force"], "suspects": ["moving_mass", "delay"]},
         ["contradicts its certificates (hand force): one of moving_mass, delay is wrong"]),
        ({"passive": "yes", "certificates": ["none"], "algorithm": "unprotected"},
         ["no guarantee: unprotected has none, so this holds for this run alone"]),
        ({"passive": "yes", "certificates": ["none"], "algorithm": "guarded"}, []),
        ({"passive": "yes", "contact": {"holds": 9, "without_torque": 0, "beyond_limit": 3}},
         ["cut by torque_limit in 3 cycles"]),
        ({"passive": "yes", "contact": {"holds": 9, "without_torque": 5, "no_torque_after": 4.2}},
         ["no torque after 4.2 s: no energy left for one; raise energy_allowance, or declare the damping of the "
          "device"]),
        ({"passive": "yes", "mass": {"requested": 6.0, "felt": 4.15, "share": 0.692}, "certificate": "velocity_loop"},
         ["guard limited the speed: raise environment.mass or damping, lower force.slew, or move further"]),
        ({"passive": "in doubt", "hold": LATE}, [f"hold: {LATE}"]),
    ],
)  # fmt: skip
def test_what_to_act_on_has_a_line_of_its_own(port: Any, advice: list[str]) -> None:
    port = {"certificate": "none", **port}
    port["verdict"] = headline(port)
    assert advice_lines(port) == advice
    shown = [text.plain for text in headlines({"ports": {"handle": port}}) if isinstance(text, Text)]
    assert shown[1:] == [f"   {line}" for line in advice]


def test_the_full_report_adds_what_the_account_alone_says() -> None:
    port = {
        "passive": "in doubt",
        "plant_passive": "yes",
        "verdict": "yes",
        "why": "lost frames",
        "certificate": "none",
    }
    file = io.StringIO()
    make_console(file).print(energy_report({"cycles": 9, "ports": {"knob": port}, "status": "ok", "config_hash": ""}))
    assert file.getvalue().splitlines()[:2] == [
        " knob: passive: yes, by the simulated plant",
        " knob: by the account: in doubt, lost frames",
    ]


@pytest.mark.parametrize("report", [brief_report, energy_report])
@pytest.mark.parametrize("status", ["failed", "failed: no space"])
def test_a_run_that_failed_says_so_before_its_verdict(report: Callable[[Any], RenderableType], status: str) -> None:
    port = {"passive": "yes", "verdict": "yes", "certificate": "none"}
    result: dict[str, Any] = {"cycles": 512, "ports": {"knob": port}, "config_hash": ""}
    file = io.StringIO()
    make_console(file).print(report({**result, "status": status}), report({**result, "status": "stopped"}))
    heads = [line for line in file.getvalue().splitlines() if line.startswith(" knob: ")]
    assert heads == [" knob: FAILED after 512 cycles; until then passive: yes", " knob: passive: yes"]


def test_a_first_line_that_is_too_long_goes_on_indented(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    port: Any = {"passive": "in doubt", "verdict": "in doubt", "certificate": "none", "why": "word " * 40}
    text = io.StringIO()
    make_console(text).print(*headlines({"ports": {"handle": port}}))
    first, *rest = text.getvalue().rstrip().splitlines()
    assert first.startswith(" handle: passive: in doubt")
    assert rest
    assert all(line.startswith("    word") and len(line) <= 80 for line in rest)


@pytest.mark.parametrize(
    ("scene", "is_in_degrees"),
    [("pitch: 15 deg  # of a notch", True), ("position: 0.2 rad  # 11 deg", False), ("a: [1deg]", True), ("", False)],
)
def test_angles_are_in_degrees_where_the_scene_gives_them_so(scene: str, is_in_degrees: bool) -> None:
    assert uses_degrees(f"environment:\n  {scene}\n") is is_in_degrees
