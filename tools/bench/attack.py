"""Can a hand get energy out of certified torques? An attack with a plant of its own that climbs over hand forces.

First the eight known ways out: the least sum of energy that the hands reach with the assumption declared, and without.
Then random loops of which everything is declared (`--runs N` hands, 240 tries each), until `--minutes` are over.
"""

import argparse
import os
from multiprocessing import Pool
from time import perf_counter
from typing import Any, Final

from rich.console import Console
from rich.table import Table

from tools.attack.climb import EVALUATIONS
from tools.attack.holes import HOLES, attack_on, keys_missing, random_attack
from tools.bench.report import Row, out_folder, publish, write_result

_PACKAGES: Final = ("canhaptic", "numpy", "numba")
_LEAST: Final = -1e-9
_HANDS_OF_A_LOOP: Final = 20


def least_of(hole: int, hands: int, *, mended: bool) -> tuple[float, float]:
    """Returns the least sum of energy [J] that some hands reached by a known way out, and the largest torque [N]."""
    attack = attack_on(HOLES[hole], mended=mended)
    return min(attack.run(seed) for seed in range(hands)), attack.strongest


def table_of_holes(hands: int) -> list[dict[str, Any]]:
    """Returns one row for each known way out."""
    rows = []
    for number, hole in enumerate(HOLES):
        missing = keys_missing(hole)
        least, strongest = (None, None) if missing else least_of(number, hands, mended=True)
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


def attacked(seed: int) -> tuple[int, float]:
    """Returns a seed and the least sum of energy [J] that the hands of its loop reached."""
    attack = random_attack(seed)
    return seed, min(attack.run(_HANDS_OF_A_LOOP * seed + hand) for hand in range(_HANDS_OF_A_LOOP))


def climbed(runs: int, minutes: float, jobs: int | None) -> list[tuple[float, int]]:
    """Returns (least sum of energy [J], seed) of random loops, until the runs are done or the minutes over."""
    end, found = perf_counter() + 60.0 * minutes, []
    with Pool(jobs) as pool:
        for seed, least in pool.imap_unordered(attacked, range(runs // _HANDS_OF_A_LOOP)):
            found.append((least, seed))
            if perf_counter() > end:
                pool.terminate()
                break
    return found


def main() -> None:
    """Attacks and publishes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20_000)
    parser.add_argument("--hands", type=int, default=40, help="for each known way out")
    parser.add_argument("--minutes", type=float, default=3.0)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    holes = table_of_holes(arguments.hands)
    table = Table(title="least sum of energy")
    for heading in holes[0]:
        table.add_column(heading)
    for hole in holes:
        table.add_row(*("-" if v is None else f"{v:.3g}" if isinstance(v, float) else str(v) for v in hole.values()))
    Console(width=150).print(table)
    found = climbed(arguments.runs, arguments.minutes, arguments.jobs)
    worst, seed = min(found)
    runs = _HANDS_OF_A_LOOP * len(found)
    closed = [hole["declared [J]"] for hole in holes if hole["declared [J]"] is not None]
    opened = [hole["not declared [J]"] for hole in holes]
    publish(
        "attack",
        [
            Row(f"hands that climbed, {EVALUATIONS} tries each", runs, "1", target=">= 100000"),
            Row("least sum of energy, all declared", worst, "J", target=">= -1e-9", met=worst >= _LEAST,
                note="" if worst >= _LEAST else f"loop {seed}"),
            Row("known ways out that stay open though declared", sum(v < _LEAST for v in closed), "1", target="0",
                met=all(v >= _LEAST for v in closed)),
            Row("known ways out that cannot be declared", len(holes) - len(closed), "1", target="0",
                met=len(holes) == len(closed)),
            Row("known ways out found again without their mend", sum(v < _LEAST for v in opened), "1",
                target=str(len(holes)), met=all(v < _LEAST for v in opened)),
        ],
        _PACKAGES,
    )  # fmt: skip
    write_result(out_folder() / "attack_table.json", _PACKAGES, {"holes": holes})


if __name__ == "__main__":
    main()
