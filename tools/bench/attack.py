"""Can a hand get energy out of certified torques? An attack with a plant of its own that climbs over hand forces.

First the eight known ways out: the least sum of energy that the hands reach with the assumption declared, and without.
Then random loops of which everything is declared (`--runs N` hands, 240 tries each), until `--minutes` are over. What
was attacked is kept in `attack_runs.jsonl`, so that the same command goes on where it was stopped.
"""

import argparse
import os
from collections.abc import Iterator, Mapping
from typing import Any, Final

from rich.console import Console
from rich.table import Table

from tools.attack.climb import EVALUATIONS
from tools.attack.holes import HOLES, attack_on, random_attack
from tools.bench.report import Row, kept_folder, out_folder, publish, write_result
from tools.kept_runs import run_kept

_PACKAGES: Final = ("canhaptic", "numpy", "numba")
_LEAST: Final = -1e-9
_WANTED: Final = 100_000
_HANDS_OF_A_LOOP: Final = 20


def least_of(hole: int, hands: int, *, mended: bool) -> tuple[float, float]:
    """Returns the least sum of energy [J] that some hands reached by a known way out, and the largest torque [N]."""
    attack = attack_on(HOLES[hole], mended=mended)
    return min(attack.run(seed) for seed in range(hands)), attack.strongest


def table_of_holes(hands: int) -> list[dict[str, Any]]:
    """Returns one row for each known way out."""
    rows = []
    for number, hole in enumerate(HOLES):
        least, strongest = least_of(number, hands, mended=True)
        rows.append(
            {
                "": hole.name,
                "loop": hole.what,
                "not declared [J]": least_of(number, hands, mended=False)[0],
                "declared [J]": least,
                "largest torque, declared [N]": strongest,
                "by": ", ".join(hole.mend),
            }
        )
    return rows


def attacked(seed: int) -> float:
    """Returns the least sum of energy [J] that the hands of a seed's loop reached."""
    attack = random_attack(seed)
    return min(attack.run(_HANDS_OF_A_LOOP * seed + hand) for hand in range(_HANDS_OF_A_LOOP))


def show(holes: list[dict[str, Any]]) -> None:
    """Prints the table of the known ways out."""
    table = Table(title="least sum of energy")
    for heading in holes[0]:
        table.add_column(heading)
    for hole in holes:
        table.add_row(*("-" if v is None else f"{v:.3g}" if isinstance(v, float) else str(v) for v in hole.values()))
    Console(width=150).print(table)


def figures(holes: list[dict[str, Any]], found: dict[int, float]) -> list[Row]:
    """Returns the rows that are published."""
    seed = min(found, key=lambda seed: found[seed])
    worst, runs = found[seed], _HANDS_OF_A_LOOP * len(found)
    closed = [hole["declared [J]"] for hole in holes if hole["declared [J]"] is not None]
    opened = [hole["not declared [J]"] for hole in holes]
    return [
        Row(f"hands that climbed, {EVALUATIONS} tries each", runs, "1", target=">= 100000", met=runs >= _WANTED),
        Row("least sum of energy, all declared", worst, "J", target=">= -1e-9", met=worst >= _LEAST,
            note="" if worst >= _LEAST else f"loop {seed}"),
        Row("known ways out that stay open though declared", sum(v < _LEAST for v in closed), "1", target="0",
            met=all(v >= _LEAST for v in closed)),
        Row("known ways out that cannot be declared", len(holes) - len(closed), "1", target="0",
            met=len(holes) == len(closed)),
        Row("known ways out found again without their mend", sum(v < _LEAST for v in opened), "1",
            target=str(len(holes)), met=all(v < _LEAST for v in opened)),
        *(row for hole in holes for row in _of_hole(hole)),
    ]  # fmt: skip


def _of_hole(hole: Mapping[str, Any]) -> Iterator[Row]:
    name = f"{hole['']}, {hole['loop']}"
    yield Row(f"{name}: not declared", hole["not declared [J]"], "J")
    if hole["declared [J]"] is not None:
        yield Row(f"{name}: declared", hole["declared [J]"], "J")


def main() -> None:
    """Attacks and publishes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=_WANTED)
    parser.add_argument("--hands", type=int, default=40, help="for each known way out")
    parser.add_argument("--minutes", type=float, default=120.0)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--new", action="store_true", help="forget the loops kept")
    arguments = parser.parse_args()
    kept = kept_folder() / "attack_runs.jsonl"
    if arguments.new:
        kept.unlink(missing_ok=True)
    holes = table_of_holes(arguments.hands)
    show(holes)
    found = run_kept(
        attacked, range(arguments.runs // _HANDS_OF_A_LOOP), kept, arguments.jobs, minutes=arguments.minutes
    )
    publish("attack", figures(holes, found), _PACKAGES)
    write_result(out_folder() / "attack_table.json", _PACKAGES, {"holes": holes})


if __name__ == "__main__":
    main()
