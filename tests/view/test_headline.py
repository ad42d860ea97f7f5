"""The first line of a port in words."""

import io
from collections.abc import Callable
from typing import Any

import pytest
from rich.console import RenderableType

from canhaptic.control.verdict import headline
from canhaptic.view.energy_table import energy_report
from canhaptic.view.run_lines import brief_report, headline_text, headlines, make_console

CERTIFIED = {"certificate": "hand_force", "certificates": ["hand_force"]}


@pytest.mark.parametrize(
    ("port", "words"),
    [
        ({"passive": "yes", **CERTIFIED}, "passive: yes · guarantee rests on: hand force"),
        ({"passive": "yes", **CERTIFIED, "hand_force": 0.0},
         "passive: yes · guarantee rests on: moving mass, hand never pulls"),
        ({"passive": "yes", **CERTIFIED, "hand_force": 5.0}, "passive: yes · guarantee rests on: hand force"),
        ({"passive": "yes", "why": "by certificate", "energy_allowance": 1e-4, **CERTIFIED},
         "passive: yes, by certificate, within an allowance of 100 uJ · guarantee rests on: hand force"),
        ({"passive": "in doubt", "passive_at_handle": "yes", "why": "measured"},
         "passive at the handle: yes, measured (at the motor: in doubt)"),
        ({"passive": "in doubt", "energy_resolution": 0.5, "why": "the contact acts as if 4 counts deep, 20 needed"},
         "passive: in doubt: the account is uncertain by +-500 mJ; the contact acts as if 4 counts deep, 20 needed"),
        ({"passive": "yes", "energy_allowance": 1e-4}, "passive: yes, within an allowance of 100 uJ"),
        ({"passive": "no", "passive_at_handle": "yes", **CERTIFIED},
         "passive at the handle: yes (at the motor: NO) · guarantee rests on: hand force"),
        ({"passive": "in doubt", "plant_passive": "yes"},
         "passive: yes, by the simulated plant; the account cannot tell"),
        ({"passive": "in doubt", "plant_passive": "no"},
         "passive: NO, by the simulated plant; the account cannot tell"),
        ({"passive": "in doubt", "plant_passive": "yes", "in": 0.761, "out": 9.18, "energy_resolution": 19.4},
         "passive: yes, by the simulated plant; the account cannot tell · account: 761 mJ in, 9.18 J out, +-19.4 J"),
        ({"passive": "in doubt", "energy_resolution": 0.5, "books_least": True},
         "passive: in doubt: the account is uncertain by +500 mJ, -0 J"),
        ({"passive": "yes", "rendered": {"stiffness": 1.004, "damping": None}},
         "passive: yes · stiffness as requested"),
        ({"passive": "yes", "plant_passive": "no"},
         "passive: NO, by the simulated plant; the account says yes, so a declaration is false"),
        ({"passive": "no", "plant_passive": "no", "active_since": 0.5, "contradicted": ["hand_force"],
          "suspects": ["moving_mass", "delay"]},
         "passive: NO, for certain from 0.5 s on; contradicts its certificates (hand force): one of moving_mass, delay "
         "is wrong"),
        ({"passive": "no", "active_before": True}, "passive: NO, already before this part of the log"),
        ({"passive": "in doubt", "energy_resolution": 0.5}, "passive: in doubt: the account is uncertain by +-500 mJ"),
        ({"passive": "yes", "contact": {"holds": 0, "without_torque": 0}}, "no contact"),
        ({"passive": "yes", "unit": "m", "contact": {"holds": 0, "without_torque": 0}, "reach": [-0.012, 0.03],
          "wall": -0.05}, "no contact: the handle stayed between -12.0 mm and 30.0 mm, the wall begins at -50.0 mm"),
        ({"passive": "yes", "unit": "rad", "contact": {"holds": 0, "without_torque": 0}, "reach": [0.0, 0.5]},
         "no contact: the handle stayed between 0 rad and 0.5 rad"),
        ({"passive": "yes", "rendered": {"stiffness": 0.873, "damping": None}, "environment": "detents"},
         "passive: yes · notch force 87.3 % of requested"),
        ({"passive": "yes", "contact": {"holds": 9, "without_torque": 9}, "advice": "a lower current_lag"},
         "NOTHING RENDERED: a lower current_lag"),
        ({"passive": "yes", "in": 0.136, "out": 0.0376, "rendered": {"stiffness": 0.985, "damping": None}, **CERTIFIED},
         "passive: yes · 136 mJ in, 37.6 mJ out · stiffness 98.5 % of requested · guarantee rests on: hand force"),
        ({"passive": "yes", "contact": {"holds": 9, "without_torque": 0, "beyond_limit": 3}},
         "passive: yes · cut by torque_limit in 3 cycles"),
        ({"passive": "yes", "in": 0.1, "out": 0.0, "rendered": {"stiffness": 1.38, "damping": None}},
         "passive: yes · 100 mJ in, 0 J out · stiffness 138 % of requested"),
        ({"passive": "yes", "unit": "m", "mass": {"requested": 3.0, "felt": 2.9607, "share": 0.9869}},
         "passive: yes · mass felt over the run 2.96 kg, 98.7 % of requested"),
        ({"passive": "yes", "unit": "m", "mass": {"requested": 6.0, "felt": 4.15, "share": 0.692},
          "certificate": "velocity_loop"}, "passive: yes · mass felt over the run 4.15 kg, 69.2 % of requested · "
         "guard limited the speed: raise environment.mass or damping, lower force.slew, or move further · "
         "guarantee rests on: velocity loop"),
        ({"passive": "yes", "unit": "rad", "mass": {"requested": 0.02, "felt": None, "share": None}},
         "passive: yes · mass felt over the run not known, 0.02 kg*m^2 requested"),
        ({"passive": "yes", "contact": {"holds": 9, "without_torque": 5, "no_torque_after": 4.2}},
         "passive: yes · no torque after 4.2 s: no energy left for one; raise energy_allowance, or declare the damping "
         "of the device"),
        ({"passive": "yes", "dry_run": True}, "dry run, no torque was sent"),
        ({"passive": "yes", "certificates": ["none"], "algorithm": "unprotected"},
         "passive: yes · no guarantee: unprotected"),
        ({"passive": "yes", "certificates": ["none"], "algorithm": "guarded"}, "passive: yes"),
    ],
)  # fmt: skip
def test_a_port_says_its_word_and_why(port: Any, words: str) -> None:
    port = {"certificate": "none", **port}
    assert headline_text("handle", {**port, "verdict": headline(port)}).plain == f" handle: {words}"


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
