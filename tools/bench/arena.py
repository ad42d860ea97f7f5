"""Every algorithm on the hard cases, as `canhaptic arena` runs them: who gives energy out, what is left of the wall?

Only the time of a step depends on the speed of the machine. Finished cases are kept in `bench_output/arena`.
"""

import os
from collections.abc import Mapping
from typing import Any, Final

from canhaptic.lab.render.arena_picture import pictures_of
from canhaptic.lab.studies.arena import COLUMNS, ArenaPlan, ArenaStore, run_arena, scenes_named
from canhaptic.lab.studies.runner import Pool
from canhaptic.quantities import STANDING
from tools.bench.report import DEFAULT_OUT, Row, picture_place, publish, write_result

_PACKAGES: Final = ("canhaptic", "numpy", "numba")
_RECORDED: Final = ("scenes", "rates", "delays", "given_out", "borders", "theory", "impedance", "m_width")


AT_DAMPING: Final = 10.0
"""Whose borders are rows of the result [N*s/m]."""


def result_rows(found: Mapping[str, Any]) -> list[tuple[str, float, str]]:
    """Returns an arena as (name, value, unit), for a file of results."""
    rows = [
        (f"{row['algorithm']}: {STANDING[key].title}", row[key], STANDING[key].unit)
        for key in COLUMNS
        for row in found["standings"]
        if row[key] is not None
    ]
    for name, places in found["ranks"].items():
        rows += [(f"rank of {name}: {STANDING[key].title}", float(rank), "1") for key, rank in places.items()]
    for border in (border for border in found.get("borders", ()) if border["damping"] == AT_DAMPING):
        late = ", one sample late" if border["delay"] else ""
        where = f"wall of {border['damping']:g} N*s/m{late}"
        rows += [
            (f"{border['algorithm']}: stiffest {word} {where}", border[key], "N/m")
            for key, word in (("passive", "passive"), ("near", "passive and near"))
        ]
    rows += [(f"{name}: time of a step", time, "us") for name, time in found.get("time_of_step", {}).items()]
    return rows


def main() -> None:
    """Runs what is not in the store yet, draws and publishes."""
    pool = Pool(os.cpu_count() or 1)
    try:
        plan = ArenaPlan(tuple(scenes_named(None)))
        found = run_arena(plan, ArenaStore(DEFAULT_OUT / "arena" / "cases"), pool)
    finally:
        pool.shutdown()
    assert found is not None  # nothing asks it to stop
    for name, _, draw in pictures_of(found):
        draw(found, picture_place(name))
    rows = [Row(*row) for row in result_rows(found)]
    publish("arena", rows, _PACKAGES, {key: found[key] for key in _RECORDED})
    write_result(DEFAULT_OUT / "arena_cases.json", _PACKAGES, {"cases": found["cases"]})  # large: never recorded


if __name__ == "__main__":
    main()
