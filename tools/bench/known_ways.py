"""Do certified torques still give out energy on a known way? The ways as scenes, judged by the plant.

Each (`tools/truth/known_ways.py`) with random hands: what closes it declared, left out, and declared falsely. `attack`
looks for the same on a plant of its own, with hands that climb to where energy comes out.
"""

import argparse
from typing import Any, Final

from rich.console import Console
from rich.table import Table

from tools.bench.report import Row, publish
from tools.truth.judge import ROUNDING
from tools.truth.known_ways import WAYS, is_closed, row_of

_PACKAGES: Final = ("canhaptic", "numpy")


def figures(rows: list[dict[str, Any]]) -> list[Row]:
    """Returns the figures of all ways out."""
    found = []
    for row in rows:
        name = f"{row['']}, {row['loop']}"
        for declares in ("declared", "left out"):
            least = row[f"{declares} [J]"]
            if least is not None:
                found.append(Row(f"{name}: {declares}", least, "J", target=">= -1e-9", met=bool(least >= -ROUNDING)))
        found.append(Row(f"{name}: declared falsely", row["declared falsely [J]"], "J"))
        found.append(Row(f"{name}: gave out where declared falsely", row["gave out"], "1"))
        found.append(Row(f"{name}: noticed of these", row["noticed"], "1"))
    closed, false = sum(map(is_closed, rows)), sum(row["false claims"] for row in rows)
    found.append(Row("ways out that are closed", closed, "1", target=str(len(rows)), met=closed == len(rows)))
    found.append(Row("false claims where nothing false is declared", false, "1", target="0", met=false == 0))
    return found


def main() -> None:
    """Runs, tells, publishes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hands", type=int, default=40, help="for each way out")
    arguments = parser.parse_args()
    rows = [row_of(way, arguments.hands) for way in WAYS]
    table = Table(title="least true sum of energy over all hands")
    for heading in rows[0]:
        table.add_column(heading, justify="left" if heading in ("", "loop", "by") else "right")
    for row in rows:
        table.add_row(*("-" if v is None else f"{v:.3g}" if isinstance(v, float) else str(v) for v in row.values()))
    Console(width=150).print(table)
    publish("known_ways", figures(rows), _PACKAGES, {"table": rows, "hands": arguments.hands})


if __name__ == "__main__":
    main()
