"""Does `guarded` stay passive? Every wall x rate x delay x user x encoder x loss, judged by the energy of the plant.

Per rate and delay: least true sum(h_i) within the declared hand force, least margin of (4) where no frame is lost and
nothing is quantised, and runs beyond -1 uJ. Exit status 1 when there is any.
"""

import itertools
import random
import sys
from concurrent.futures import ProcessPoolExecutor

from tests.adversary import axis as users
from tests.adversary.users import HAND_FORCE, USERS
from tools.bench.report import Row, publish

WALLS = [(1e2, 0.0), (1e2, 50.0), (1e3, 0.0), (1e3, 20.0), (1e4, 0.0), (1e4, 50.0), (1e5, 0.0), (1e5, 50.0)]
WALLS += [(1e6, 0.0), (1e6, 500.0), (0.0, 100.0)]
RATES = [40, 100, 400, 1000, 10000]
IDEAL_AND_COARSE = [(0.0, 0.0), (2e-5, 0.02)]
LOSSES = [0.0, 0.01, 0.1]
LIMIT = -1e-6

Case = tuple[tuple[float, float], int, int, str, tuple[float, float], float, int]


def trial(case: Case) -> tuple[float, float]:
    """Returns the least true sum(h_i) and the least booked margin of (4) [J]."""
    wall, rate, delay, user, (count, quantum), share, seed = case
    known = {"max_consecutive_losses": 2} if share else {}
    controller = users.guarded(*wall, rate, delay, count=count, quantum=quantum, **known)
    truth = users.run(
        controller,
        USERS[user](random.Random(seed)),
        rate,
        min(3 * rate, 4000),
        delay=delay,
        push=HAND_FORCE if wall[1] else users.PUSH,
        count=count,
        quantum=quantum,
        loss=users.Loss(share) if share else None,
        seed=seed,
    )
    return truth.least, truth.least_margin


def rows_of(rate: int, delay: int, cases: list[Case], found: list[tuple[float, float]]) -> list[Row]:
    """Returns the rows of one rate and delay."""
    least = min(truth for truth, _ in found)
    exact = [margin for (_, margin), case in zip(found, cases, strict=True) if not case[5] and not case[4][0]]
    beyond = sum(not truth >= LIMIT for truth, _ in found)
    where = f"{rate} Hz, delay {delay}, {len(found)} runs"
    return [
        Row(f"{where}: least true sum(h_i)", least, "J", target=f">= {LIMIT:g}", met=least >= LIMIT),
        Row(f"{where}: runs below or diverged", beyond, "runs", target="0", met=beyond == 0),
        Row(f"{where}: least margin of (4), ideal and without loss", min(exact), "J"),
    ]


def main() -> int:
    """Runs the sweep and publishes the table; returns 1 when a run lost energy."""
    rows: list[Row] = []
    with ProcessPoolExecutor() as pool:
        for rate, delay in itertools.product(RATES, (0, 1)):
            parts = itertools.product(WALLS, USERS, IDEAL_AND_COARSE, LOSSES)
            cases: list[Case] = [(w, rate, delay, u, e, s, n) for n, (w, u, e, s) in enumerate(parts)]
            rows += rows_of(rate, delay, cases, list(pool.map(trial, cases, chunksize=8)))
            print(rows[-3].row, rows[-3].value, flush=True)
    publish("passivity_sweep", rows, ["canhaptic", "numpy"])
    return 0 if all(row.met is not False for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
