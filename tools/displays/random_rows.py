"""Rows of a benchmark: what the accounts of random displays, and of groups of two, claim and their plants deny."""

import os
from collections.abc import Callable
from typing import Any

from tools.bench.report import Row, kept_folder
from tools.displays.group import false_group_claims, group_of_any_kind, with_true_group_bounds
from tools.displays.judge import false_claims
from tools.displays.random_display import random_display, with_true_bounds
from tools.kept_runs import run_kept

_CYCLES = 400
_CYCLES_OF_GROUPS = 250


def judged_display(seed: int) -> dict[str, Any] | None:
    """Returns what the account of a display claims and its plant denies; None where nothing true can be declared."""
    found = with_true_bounds(random_display(seed), _CYCLES)
    if found is None:
        return None
    display, outcome = found
    due = display.algorithm == "guarded" and display.allowance == 0.0 and not outcome.uncertified
    return {"claims": false_claims(*found), "due": due, "said": bool(due and outcome.is_passive)}


def judged_group(seed: int) -> dict[str, Any] | None:
    """Returns the same of two displays or three with one account, arms and five-bars among them."""
    found = with_true_group_bounds(group_of_any_kind(seed), _CYCLES_OF_GROUPS)
    if found is None:
        return None
    return {"claims": false_group_claims(*found)}


def random_rows(runs: int) -> list[Row]:
    """AD1, AD2, AD3, AD7: random displays, all declarations true."""
    found = _run("display", judged_display, runs)
    false, due, said = (sum(map(bool, (one[key] for one in found))) for key in ("claims", "due", "said"))
    share = said / due if due else 0.0
    return [
        Row("random displays judged", len(found), "1"),
        Row("AD1-3, AD7 false claims", false, "1", target="0", met=false == 0),
        Row("yes where due", share, "1", target=">= 0.8", met=share >= 0.8, note=f"{said} of {due} guarded displays"),
    ]


def group_rows(runs: int) -> list[Row]:
    """The same of groups."""
    found = _run("display_group", judged_group, runs)
    false, note = sum(bool(one["claims"]) for one in found), f"of {len(found)} groups of two displays or three"
    return [Row("false claims of groups", false, "1", target="0", met=false == 0, note=note)]


def _run(kind: str, judge: Callable[[int], Any], runs: int) -> list[Any]:
    """Runs all seeds, in all processors, and prints the false claims; returns what could be judged."""
    kept = kept_folder() / f"{kind}_runs.jsonl"
    found = run_kept(judge, range(runs), kept, os.cpu_count() or 1)
    kept.unlink()
    for seed, one in found.items():
        if one and one["claims"]:
            print(f"{kind} {seed}: {'; '.join(one['claims'])}", flush=True)
    return [one for one in found.values() if one]
