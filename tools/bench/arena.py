"""Every algorithm on the hard cases, as `canhaptic arena` runs them: who gives energy out, what is left of the wall?

Only the time of a step depends on the speed of the machine. Finished cases are kept in `bench_output/arena`.
"""

import os
from typing import Final

from canhaptic.lab.render.arena_picture import pictures_of
from canhaptic.lab.studies.arena import ArenaPlan, ArenaStore, result_rows, run_arena, scenes_named
from canhaptic.lab.studies.sweep.run_sweep import Pool
from tools.bench.report import DEFAULT_OUT, Row, picture_place, publish, write_result

_PACKAGES: Final = ("canhaptic", "numpy", "numba")
_RECORDED: Final = ("scenes", "rates", "delays", "given_out", "borders", "theory", "impedance", "m_width")


def main() -> None:
    """Runs what is not in the store yet, draws and publishes."""
    pool = Pool(os.cpu_count() or 1)
    try:
        plan = ArenaPlan(tuple(scenes_named(None)))
        found = run_arena(plan, ArenaStore(DEFAULT_OUT / "arena" / "cases.jsonl"), pool.executor)
    finally:
        pool.close()
    assert found is not None  # nothing asks it to stop
    for name, _, draw in pictures_of(found):
        draw(found, picture_place(name))
    rows = [Row(*row) for row in result_rows(found)]
    publish("arena", rows, _PACKAGES, {key: found[key] for key in _RECORDED})
    write_result(DEFAULT_OUT / "arena_cases.json", _PACKAGES, {"cases": found["cases"]})  # large: never recorded


if __name__ == "__main__":
    main()
