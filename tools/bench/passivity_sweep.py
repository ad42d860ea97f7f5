"""Does `guarded` stay passive? Every wall x rate x delay x user x encoder x loss, judged by the energy of the plant.

Prints one line per rate and delay: runs, least true sum(h_i) within the declared hand force, least margin of (4) where
no frame is lost, runs beyond -1 uJ. Exit status 1 when there is any.
"""

import argparse
import importlib
import itertools
import json
import platform
import random
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "haptics"))
users = importlib.import_module("guarded_users")

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
    known = {"lost_frames": 2} if share else {}
    controller = users.guarded(*wall, rate, delay, count=count, quantum=quantum, **known)
    truth = users.run(
        controller,
        users.USERS[user](random.Random(seed)),
        rate,
        min(3 * rate, 4000),
        delay=delay,
        push=users.HAND_FORCE if wall[1] else users.PUSH,
        count=count,
        quantum=quantum,
        loss=users.Loss(share) if share else None,
        seed=seed,
    )
    return truth.least, truth.least_margin


def main() -> int:
    """Runs the sweep and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=1, help="repeats of every case with another seed")
    parser.add_argument("--json", type=Path, help="write the table here as well")
    options = parser.parse_args()
    print(f"{platform.machine()}, Python {platform.python_version()}; {len(WALLS)} walls, {len(users.USERS)} users")
    bad, rows = 0, []
    with ProcessPoolExecutor() as pool:
        for rate, delay in itertools.product(RATES, (0, 1)):
            parts = itertools.product(WALLS, users.USERS, IDEAL_AND_COARSE, LOSSES, range(options.seeds))
            cases: list[Case] = [(w, rate, delay, u, e, s, 1000 * r + n) for n, (w, u, e, s, r) in enumerate(parts)]
            found = list(pool.map(trial, cases, chunksize=8))
            beyond = sum(least < LIMIT for least, _ in found)
            exact = [f[1] for f, case in zip(found, cases, strict=True) if not case[5] and not case[4][0]]
            row = {"rate": rate, "delay": delay, "runs": len(found), "least": min(f[0] for f in found)}
            row |= {"least_margin": min(exact), "beyond": beyond}
            rows.append(row)
            bad += beyond
            print("  ".join(f"{name} {value}" for name, value in row.items()), flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
