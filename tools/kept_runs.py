"""Campaigns of seeds that go on where they were stopped: what a seed came to is kept, one line each."""

import json
import math
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial
from multiprocessing import Pool
from pathlib import Path
from time import perf_counter
from typing import Any, Final

_SHOWN: Final = 500  # seeds between two lines


def run_kept(
    judge: Callable[[int], Any], seeds: Iterable[int], kept: Path, jobs: int, *, minutes: float = math.inf
) -> dict[int, Any]:
    """Judges the seeds that are not among those kept, until the time is over.

    Args:
        judge: Returns what a seed came to, as JSON can say it.
        seeds: Seeds that are asked for.
        kept: File of the lines; one that a stop cut off is left out.
        jobs: Number of processes.
        minutes: Time after which no further seed is waited for.

    Returns:
        What each seed that was asked for and is done came to, as JSON reads it.
    """
    done: dict[int, Any] = {}
    for line in kept.read_text(encoding="utf-8").splitlines() if kept.exists() else ():
        with suppress(json.JSONDecodeError):
            seed, came = json.loads(line)
            done[seed] = came
    wanted, end = list(seeds), perf_counter() + 60.0 * minutes
    missing = [seed for seed in wanted if seed not in done]
    kept.parent.mkdir(parents=True, exist_ok=True)
    with Pool(jobs) as pool, kept.open("a", encoding="utf-8") as file:
        for number, line in enumerate(pool.imap_unordered(partial(_judged, judge), missing), 1):
            seed, came = json.loads(line)
            done[seed] = came
            file.write(f"{line}\n")
            file.flush()
            if number % _SHOWN == 0:
                print(f"{number} of {len(missing)}", flush=True)
            if perf_counter() > end:
                pool.terminate()
                break
    return {seed: done[seed] for seed in wanted if seed in done}


def _judged(judge: Callable[[int], Any], seed: int) -> str:
    return json.dumps((seed, judge(seed)))
