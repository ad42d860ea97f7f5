"""`canhaptic arena`: every passivity algorithm on hard scenes, at several rates and delays, as one page."""

import argparse
import json
import os
from pathlib import Path
from typing import Final

from canhaptic.control.passivity import ALGORITHMS
from canhaptic.host.stop_signal import StopSignal
from canhaptic.lab.commands.results import scene_progress, show
from canhaptic.lab.render.arena_picture import pictures_of, write_arena_page
from canhaptic.lab.studies import Row
from canhaptic.lab.studies.arena import ArenaPlan, ArenaStore, run_arena, scenes_named
from canhaptic.lab.studies.runner import pool_of
from canhaptic.quantities import STANDING
from canhaptic.view.picture_style import require_matplotlib
from canhaptic.view.table import Table
from canhaptic.view.terminal import note_file, write_file, write_note

STORE: Final = "cases"


def execute(arguments: argparse.Namespace) -> int:
    """Run the arena and print its ranking; return 0, or 130 and 143 after a signal.

    Raises:
        InputError: A scene, an algorithm or a file cannot be used.
    """
    require_matplotlib()  # missing, it is said before the arena begins
    plan, out = _plan(arguments), arguments.out
    plan.check()
    store = ArenaStore(out / STORE, force=arguments.force)
    workers = arguments.workers or os.cpu_count() or 1
    with store, StopSignal(insists=True) as stop, pool_of(workers) as pool, scene_progress("cases") as progress:
        found = run_arena(plan, store, pool, progress, stop.requested)
    if found is None or stop.requested():
        write_note(f"  stopped     finished work is kept in {out / STORE}; the same command continues")
        return stop.exit_status
    _write(found, out)
    show(arguments, found, lambda: _table(found))
    return 0


def _plan(arguments: argparse.Namespace) -> ArenaPlan:
    names = {"rates": "rates", "delays": "delays", "duration": "longest", "rig": "rig", "walls": "per_decade"}
    given: Row = {of: value for name, of in names.items() if (value := getattr(arguments, name)) is not None}
    options: Row = {key: tuple(value) if isinstance(value, list) else value for key, value in given.items()}
    algorithms = (*(arguments.algorithms or ALGORITHMS), *arguments.entry)
    return ArenaPlan(tuple(scenes_named(arguments.scenes)), algorithms, allow_code=arguments.allow_code, **options)


def _write(found: Row, out: Path) -> None:
    write_file(out / "arena.json", json.dumps(found, indent=1) + "\n")
    note_file("result", out / "arena.json")
    for name, _, draw in pictures_of(found):
        draw(found, out / name)
        note_file("picture", out / name)
    write_arena_page(found, out / "arena.html")
    note_file("page", out / "arena.html")


def _table(found: Row) -> Table:
    shown = [key for key, row in STANDING.items() if row.short]
    rows = [
        [row["algorithm"], *(_shown(row[key], found["ranks"][row["algorithm"]].get(key)) for key in shown)]
        for row in found["standings"]
    ]
    return Table(
        f"{len(found['cases'])} cases; in brackets the rank",
        ["algorithm", *(STANDING[key].short for key in shown)],
        rows,
        keys=1,
    )


def _shown(value: float | None, rank: int | None) -> str:
    return "" if value is None else f"{value:.3g} ({rank})"
