"""Does the account ever claim what the simulated plant denies? Random scenes, judged by the plant's own energy.

Effects, timing, deviations of the drive, limits and algorithms in any combination, on one axis and on groups of two,
all declarations true (`tools/truth`). `--runs N` runs N seeds from `--seed` on, in all processors; what has run is kept
in `truth_runs.jsonl`, so that the same command goes on where it was stopped. One in ten is
run by the command line and `canhaptic.simulate` too, a program by `open_rig`: all must say the same
(`tools/truth/ways.py`). `--only SEED` runs one seed, says what is
false of it and leaves it, made smaller, as a scene file. Faults that no frame can show are left out: a stuck encoder, a
TPDO repeated to the bit, a motor whose sign turns in a run (docs/safety.md). A run counts when it lasted 1 s and
something pushed or asked for 0.5 N, and any torque was sent: without one it proves nothing. `--faults` adds a fault to
every scene (`tools/truth/faults.py`): lost, doubled and late frames, bus and host that stop, drives that fail,
another master, on one bus or two. `--stops` ends every run by the operator at a random instant, every fourth of them
that of an admittance display (`tools/truth/displays.py`): its stop is part of the account, and what the motors exchange
once that has ended must lie within its resolution. Where a fault stopped a run, that energy is listed. `--sums`
makes every environment a sum, as far as it adds to others (`tools/truth/sums.py`). `--false` makes one declaration of
every scene or display false (`tools/truth/falsehoods.py`), and runs some by the command line and `canhaptic.simulate`
too: where the plant denies what is said, a run that stopped or says no yes has found it, any other has missed it.

A yes is due where

* the algorithm promises (`guarded`), something pushed or asked for 0.5 N, and the run ended or its fault stopped it;
* the true sum of interaction never fell below zero, and hand and device were within what is declared, which allows no
  energy to be given out on purpose (`energy_allowance`);
* more than 20 times the resolution came in: below that no certificate says yes for certain (`control.verdict`);
* the hold in which its torques act was found, or is that of the scene by construction; neither unchecked nor undecided;
* no torque acted at the end whose drive did not confirm that it is disabled;
* timing and losses were within it too: no SYNC was skipped, no host stalled beyond `sync_jitter`, and in no more cycles
  in a row than `max_consecutive_losses` was a frame lost, as the drives and the samples show it
  (`tools/truth/loss_watch.py`). A scene declares up to four losses as soon as its bus makes them, as it does with the
  force of its hand; more are a fault beyond any declaration, and there the account has to doubt.

A yes is one at the motor or, where that is what is promised, at the handle, with a certificate. A run without any
torque has none: the first share counts it as no yes, the second leaves it out. Below an inward speed of
(1 + delay) F_h T / m no torque has a proof (`sum_of_certificates`).
"""

import argparse
import os
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any, Final

from rich.console import Console
from rich.table import Table

from tools.bench.report import Row, kept_folder, out_folder, publish, write_result
from tools.kept_runs import run_kept
from tools.truth.displays import with_display
from tools.truth.falsehoods import SHOWN, falsified, outcome_of_falsehood
from tools.truth.faults import with_fault
from tools.truth.judge import ROUNDING, TOUCH, Outcome, judged
from tools.truth.scenes import TruthScene, random_scene
from tools.truth.shrink import shrunk, write_scene
from tools.truth.stops import with_stop
from tools.truth.ways import WAYS, drawn_differences

_PACKAGES: Final = ("canhaptic", "numpy")
_KEPT: Final = {
    "truth": "truth_runs.jsonl",
    "truth_faults": "truth_fault_runs.jsonl",
    "truth_stops": "truth_stop_runs.jsonl",
    "truth_sums": "truth_sum_runs.jsonl",
    "truth_false": "truth_false_runs.jsonl",
}
_COULD_SHOW: Final = frozenset(("declares:hold_dither", "drive:read_actual"))
"""Without one of these no frame of a run shows how late in its hold a torque acts."""
_SHRUNK_AT_MOST: Final = 5
_IN_WORDS: Final = ("named", "fault", "stopped by", "declared falsely", "frames show it")
_WANTED: Final = 20_000
_RUNS: Final = 24_000
"""Seeds by default: of seven, six make a run that counts."""


def outcome_of(seed: int) -> Outcome:
    """Returns what the run of a seed came to."""
    scene, outcome = judged(random_scene(seed))
    return replace(outcome, false_claims=(*outcome.false_claims, *drawn_differences(scene, outcome)))


def outcome_with_stop(seed: int) -> Outcome:
    """Returns what the run of a seed came to that the operator stopped at a random instant."""
    return judged(_stopped(random_scene(seed)))[1]


def _stopped(scene: TruthScene) -> TruthScene:
    return with_stop(with_display(scene))


def outcome_of_sum(seed: int) -> Outcome:
    """Returns what the run of a seed came to whose environment is a sum, as far as it adds to others."""
    return judged(random_scene(seed, sums=1.0))[1]


def outcome_with_fault(seed: int) -> Outcome:
    """Returns what the run of a seed came to with a fault of bus, drive or host."""
    return judged(with_fault(random_scene(seed)))[1]


_CHANGES: Final[dict[str, Callable[[TruthScene], TruthScene]]] = {
    "truth": lambda scene: scene,
    "truth_faults": with_fault,
    "truth_stops": _stopped,
    "truth_sums": lambda scene: random_scene(scene.seed, sums=1.0),
    "truth_false": lambda scene: falsified(scene.seed),
}
_RUNS_OF: Final = {
    "truth": outcome_of,
    "truth_faults": outcome_with_fault,
    "truth_stops": outcome_with_stop,
    "truth_sums": outcome_of_sum,
    "truth_false": outcome_of_falsehood,
}


def run_all(seeds: Iterable[int], kept: Path, jobs: int, run: Callable[[int], Outcome] = outcome_of) -> list[Outcome]:
    """Runs the seeds that are not among those kept; returns all of them."""
    found = run_kept(partial(_as_json, run), seeds, kept, jobs)
    return [Outcome.from_json(one) for one in found.values()]


def _as_json(run: Callable[[int], Outcome], seed: int) -> dict[str, Any]:
    return run(seed).as_json()


def is_false(outcome: Outcome) -> bool:
    """Whether a run with true declarations claimed what the plant denies."""
    return outcome.declared and bool(outcome.false_claims)


def table_of(outcomes: list[Outcome]) -> list[dict[str, Any]]:
    """Returns one row for each thing that scenes name, with counts of runs by what their account said."""
    names = sorted({tag for outcome in outcomes for tag in outcome.tags})
    rows = []
    for name in ["all", *names]:
        those = [outcome for outcome in outcomes if outcome.counts and (name == "all" or name in outcome.tags)]
        verdicts = [outcome.verdict for outcome in those]
        rows.append(
            {
                "named": name,
                "runs": len(those),
                **{verdict: verdicts.count(verdict) for verdict in ("yes", "in doubt", "no")},
                "no torque in contact": sum(outcome.is_silent for outcome in those),
                "declaration false": sum(not outcome.declared for outcome in those),
                "false claims": sum(map(is_false, those)),
            }
        )
    return rows


def false_table(outcomes: list[Outcome]) -> list[dict[str, Any]]:
    """Returns one row for each kind of false declaration: which of them a run notices.

    A run notices one where its rig stops for it, or where its account does not say yes.
    """
    rows = []
    for name in sorted({tag for outcome in outcomes for tag in outcome.tags if tag.startswith("false:")}):
        those = [outcome for outcome in outcomes if name in outcome.tags and outcome.status != "refused"]
        out = [outcome for outcome in those if outcome.least < -ROUNDING]
        noticed = [outcome for outcome in out if outcome.status == "stopped" or not outcome.says_yes]
        rows.append(
            {
                "declared falsely": name.partition(":")[2],
                "runs": len(those),
                "stopped": sum(outcome.status == "stopped" for outcome in those),
                "say something false": sum(bool(outcome.false_claims) for outcome in those),
                "gave energy out": len(out),
                "noticed of these": len(noticed),
            }
        )
    return rows


def miss_table(outcomes: list[Outcome]) -> list[dict[str, Any]]:
    """Returns one row for each kind of false declaration: where it mattered, whether the run found it.

    It mattered where the rig stopped for it, or the plant denies what the account says or gave out more than it leaves
    open.
    """
    rows = []
    for name in sorted({tag for outcome in outcomes for tag in outcome.tags if tag.startswith("false:")}):
        those = [outcome for outcome in outcomes if name in outcome.tags and outcome.status != "refused"]
        mattered = [o for o in those if o.status == "stopped" or o.false_claims or o.least < -o.resolution - ROUNDING]
        missed = [outcome for outcome in mattered if is_missed(outcome)]
        rows.append(
            {
                "declared falsely": name.partition(":")[2],
                "frames show it": SHOWN.get(name, "never"),
                "runs": len(those),
                "mattered": len(mattered),
                "found": len(mattered) - len(missed),
                "missed": len(missed),
                "share": round(len(missed) / max(1, len(mattered)), 3),
                "with signs or a measured torque": sum(bool(_COULD_SHOW.intersection(o.tags)) for o in mattered),
                "missed of these": sum(bool(_COULD_SHOW.intersection(o.tags)) for o in missed),
                "of these in detents": sum("environment:detents" in outcome.tags for outcome in missed),
            }
        )
    return rows


def is_missed(outcome: Outcome) -> bool:
    """Whether a run said yes to what its plant denies, and nothing stopped it."""
    return outcome.status == "completed" and outcome.says_yes


def fault_table(outcomes: list[Outcome]) -> list[dict[str, Any]]:
    """Returns one row for each fault: what stopped the rig, and the SYNCs until no drive gave a torque any more.

    Counted from the begin of the fault, which for lost frames is not that of the first loss: many of those runs stop
    late, or never.
    """
    rows = []
    for name in sorted({tag for outcome in outcomes for tag in outcome.tags if tag.startswith("fault:")}):
        those = [outcome for outcome in outcomes if name in outcome.tags]
        stopped = [outcome for outcome in those if outcome.status == "stopped"]
        reasons = Counter(outcome.reaction for outcome in stopped)
        syncs = sorted(outcome.to_zero for outcome in stopped)
        rows.append(
            {
                "fault": name.partition(":")[2],
                "runs": len(those),
                "refused": sum(outcome.status == "refused" for outcome in those),
                "stopped by": ", ".join(f"{reason} {count}" for reason, count in reasons.most_common()),
                "SYNCs to zero, median": syncs[len(syncs) // 2] if syncs else "-",
                "most": syncs[-1] if syncs else "-",
                "given after, most [mJ]": round(1e3 * max((o.given_after for o in stopped), default=0.0), 3),
                "yes of due": f"{sum(o.says_yes for o in those if o.is_due)} of {sum(o.is_due for o in those)}",
                "false claims": sum(map(is_false, those)),
                "lost more and went on": sum(outcome.went_on for outcome in those),
            }
        )
    return rows


def _figures(outcomes: list[Outcome], *, faults: bool) -> list[Row]:
    counted = [outcome for outcome in outcomes if outcome.counts]
    wrong, went_on = sum(map(is_false, outcomes)), sum(o.went_on and o.declared for o in outcomes)
    if faults:
        return _fault_figures(outcomes, wrong, went_on)
    promised = [o for o in counted if o.declared and "algorithm:guarded" in o.tags and o.least >= -ROUNDING]
    due = [outcome for outcome in promised if outcome.is_due]
    with_torque = [outcome for outcome in due if not outcome.is_silent]
    shares = [sum(o.says_yes and bool(o.certificates) for o in of) / max(1, len(of)) for of in (due, with_torque)]
    ratios = [o.resolution / o.error for o in counted if o.error > 1e-9]
    ratio = median(ratios) if ratios else 0.0
    return [
        Row(
            "runs of at least 1 s with a contact of 0.5 N",
            len(counted),
            "1",
            target=">= 20000",
            met=len(counted) >= _WANTED,
        ),
        Row("false claims", wrong, "1", target="0", met=wrong == 0),
        Row("runs that lost more than declared and went on", went_on, "1", target="0", met=went_on == 0),
        Row("passive runs of algorithms that promise", len(promised), "1"),
        Row("of these, runs in which a yes is due", len(due), "1"),
        Row("of those, yes with a certificate", shares[0], "1", target=">= 0.8", met=shares[0] >= 0.8),
        Row("runs in which a yes is due, with a torque", len(with_torque), "1"),
        Row("of those with a torque, yes with a certificate", shares[1], "1"),
        Row("stated resolution over the error seen, median", ratio, "1", target="<= 20", met=ratio <= 20.0),
        Row("runs that ended before their time", sum(o.status == "stopped" for o in outcomes), "1"),
        Row("scenes refused", sum(o.status == "refused" for o in outcomes), "1"),
    ]


def _sum_figures(outcomes: list[Outcome]) -> list[Row]:
    sums = [outcome for outcome in outcomes if any(tag.startswith("sum:") for tag in outcome.tags)]
    touched, wrong = sum(o.counts and not o.is_silent for o in sums), sum(map(is_false, sums))
    return [
        Row("runs of a sum", len(sums), "1"),
        Row("of these, of at least 1 s with a torque in contact", touched, "1", target=">= 2000", met=touched >= 2000),
        Row("false claims", wrong, "1", target="0", met=wrong == 0),
        Row("scenes of sums refused", sum(o.status == "refused" for o in sums), "1"),
    ]


def _miss_figures(outcomes: list[Outcome]) -> list[Row]:
    rows = miss_table(outcomes)
    in_the_run = [row for row in rows if "run" in row["frames show it"]]
    missed, mattered = (sum(row[key] for row in in_the_run) for key in ("missed", "mattered"))
    differ = sum(any(claim.startswith(WAYS) for claim in outcome.false_claims) for outcome in outcomes)
    return [
        Row("runs with one false declaration", len(outcomes), "1"),
        Row("runs that say something else by another way of running", differ, "1", target="0", met=differ == 0),
        Row("missed of what a run's own frames show", missed, "1", target="0", met=missed == 0, note=f"of {mattered}"),
        *(Row(f"{row['declared falsely']}: share missed", row["share"], "1") for row in rows),
    ]


def _fault_figures(outcomes: list[Outcome], wrong: int, went_on: int) -> list[Row]:
    due = [outcome for outcome in outcomes if outcome.is_due]
    with_torque = [outcome for outcome in due if outcome.peak >= TOUCH]
    shares = [sum(o.says_yes for o in those) / max(1, len(those)) for those in (due, with_torque)]
    return [
        Row("runs with a fault", len(outcomes), "1"),
        Row("false claims", wrong, "1", target="0", met=wrong == 0),
        Row("runs that lost more than declared and went on", went_on, "1", target="0", met=went_on == 0),
        Row("runs in which a yes is due", len(due), "1"),
        Row("of these, yes", shares[0], "1", target=">= 0.8", met=shares[0] >= 0.8),
        Row("of these with a torque of 0.5 N", len(with_torque), "1"),
        Row("of those, yes with a certificate", shares[1], "1", target=">= 0.8", met=shares[1] >= 0.8),
        Row("runs that a fault stopped", sum(o.status == "stopped" for o in outcomes), "1"),
        Row(
            "energy given after the account of such a run, most",
            max((o.given_after for o in outcomes), default=0.0),
            "J",
        ),
        Row("scenes refused", sum(o.status == "refused" for o in outcomes), "1"),
    ]


def show(rows: list[dict[str, Any]], title: str = "what the account said, by what the scene names") -> None:
    """Prints a table."""
    table = Table(title=title)
    for heading in rows[0] if rows else ():
        table.add_column(heading, justify="left" if heading in _IN_WORDS else "right")
    for row in rows:
        table.add_row(*map(str, row.values()))
    Console(width=150).print(table)


def explain(seed: int, change: Callable[[TruthScene], TruthScene]) -> None:
    """Runs one seed, prints what it came to, and writes the smaller scene where a claim is false."""
    scene, outcome = judged(change(random_scene(seed)))
    for name, value in outcome.as_json().items():
        print(f"{name}: {value}")
    if outcome.false_claims:
        smaller, found = shrunk(scene, outcome)
        print(f"smaller: {write_scene(smaller, found, out_folder())}: {'; '.join(found.false_claims)}")


def main() -> None:
    """Runs, tells, publishes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=_RUNS)
    parser.add_argument("--seed", type=int, default=0, help="the first one")
    parser.add_argument(
        "--only", type=int, help="this seed alone, with a smaller scene where it claims something false"
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--new", action="store_true", help="forget the runs kept")
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument("--faults", action="store_true", help="with a fault of bus, drive, host or node in each run")
    kind.add_argument(
        "--stops", action="store_true", help="with a stop by the operator at a random instant of each run"
    )
    kind.add_argument("--sums", action="store_true", help="each environment a sum, as far as it adds to others")
    kind.add_argument("--false", action="store_true", help="with one false declaration in each run")
    arguments = parser.parse_args()
    kinds = ("faults", "stops", "sums", "false")
    name = "_".join(["truth", *(one for one in kinds if getattr(arguments, one))])
    if arguments.only is not None:
        explain(arguments.only, _CHANGES[name])
        return
    kept = kept_folder() / _KEPT[name]
    if arguments.new:
        kept.unlink(missing_ok=True)
    outcomes = run_all(range(arguments.seed, arguments.seed + arguments.runs), kept, arguments.jobs, _RUNS_OF[name])
    rows = fault_table(outcomes) if arguments.faults else table_of(outcomes)
    show(rows)
    false = false_table(outcomes)
    show(false, "false declarations: which of them a run notices")
    missed = miss_table(outcomes)
    show(missed, "false declarations: found and missed, where they mattered")
    for outcome in list(filter(is_false, outcomes))[:_SHRUNK_AT_MOST]:
        print(f"seed {outcome.seed}: {'; '.join(outcome.false_claims)}; {', '.join(outcome.tags)}")
    figures = _miss_figures(outcomes) if arguments.false else _figures(outcomes, faults=arguments.faults)
    if arguments.sums:
        figures = _sum_figures(outcomes)
    publish(name, figures, _PACKAGES)
    write_result(
        out_folder() / f"{name}_table.json", _PACKAGES, {"table": rows, "declared falsely": false, "missed": missed}
    )


if __name__ == "__main__":
    main()
