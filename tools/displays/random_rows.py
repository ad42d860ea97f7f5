"""Rows of a benchmark: what the accounts of random displays, and of groups of two, claim and their plants deny."""

from tools.bench.report import Row
from tools.displays.group import false_group_claims, group_of_any_kind, with_true_group_bounds
from tools.displays.judge import false_claims
from tools.displays.random_display import random_display, with_true_bounds


def random_rows(runs: int, cycles: int) -> list[Row]:
    """AD1, AD2, AD3, AD7: random displays, all declarations true."""
    false = judged = due = said = 0
    for seed in range(runs):
        found = with_true_bounds(random_display(seed), cycles)
        if found is None:
            continue
        judged += 1
        claims = false_claims(*found)
        false += bool(claims)
        if claims:
            print(f"seed {seed}: {'; '.join(claims)}", flush=True)
        display, outcome = found
        if display.algorithm == "guarded" and display.allowance == 0.0 and not outcome.uncertified:
            due += 1
            said += outcome.is_passive
    share = said / due if due else 0.0
    return [
        Row("random displays judged", judged, "1"),
        Row("AD1-3, AD7 false claims", false, "1", target="0", met=false == 0),
        Row("yes where due", share, "1", target=">= 0.8", met=share >= 0.8, note=f"{said} of {due} guarded displays"),
    ]


def group_rows(runs: int, cycles: int) -> list[Row]:
    """The same of two displays or three with one account, arms and five-bars among them."""
    false = judged = 0
    for seed in range(runs):
        found = with_true_group_bounds(group_of_any_kind(seed), cycles)
        if found is not None:
            judged += 1
            claims = false_group_claims(*found)
            false += bool(claims)
            if claims:
                print(f"group {seed}: {'; '.join(claims)}", flush=True)
    note = f"of {judged} groups of two displays or three"
    return [Row("false claims of groups", false, "1", target="0", met=false == 0, note=note)]
