"""Makes what accuracy costs in five scenes: docs/accuracy and its part of docs/figures.md.

`--only NAME` makes one of them, `--redraw` all from the stored results, `--page` the part of the page alone.
"""

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any, Final

from canhaptic.lab.render.accuracy_picture import draw_accuracy
from canhaptic.lab.studies.accuracy.accuracy_table import advice, advice_lines, length
from canhaptic.lab.studies.accuracy.studied_port import now, studied
from canhaptic.lab.studies.accuracy.study import AccuracyStudy
from canhaptic.scene.load import load_scene
from tools.bench.report import write_result
from tools.page_part import with_part

ROOT: Final = Path(__file__).resolve().parents[1]
PAGE: Final = ROOT / "docs" / "figures.md"
SCENES: Final = {
    "paper_wall": "no event but the contact",
    "stiff_stop": "stiff stops, short contacts",
    "stick_slip": "dry friction that sticks",
    "delayed_bus": "a motor that cogs, torques one sample late",
    "coarse_encoder": "a coarse encoder on a compliant shaft",
}
"""Each scene, and what a scene like it has."""
FOLDER: Final = ROOT / "docs" / "accuracy"
BUDGET: Final = 12.0  # [s]
PACKAGES: Final = ("canhaptic", "numpy", "scipy")


def make(name: str, folder: Path) -> None:
    """Writes NAME.json and NAME.png."""
    scene = load_scene(Path("configs") / "accuracy" / f"{name}.yaml")
    _write(name, AccuracyStudy(scene, budget=BUDGET).run(), folder)


def redraw(name: str, folder: Path) -> None:
    """Writes advice and picture anew from what was measured before."""
    result = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
    scene = load_scene(Path("configs") / "accuracy" / f"{name}.yaml")
    result["now"] = now(studied(scene, None))
    result["advice"] = advice(result["plant"], result["advice"]["effects"], result["tolerance"], result["orders"])
    _write(name, result, folder)


def _write(name: str, result: dict[str, Any], folder: Path) -> None:
    write_result(folder / f"{name}.json", PACKAGES, result)
    draw_accuracy(result, folder / f"{name}.png")
    print("\n".join([name, *(f"  {line}" for line in advice_lines(result))]))


def page() -> str:
    """Returns the text of the page with its part of today: a row to choose by and a picture for each scene."""
    lines = [
        "| your scene has | paste into it | error, of what is allowed | us a period | measured |",
        "|---|---|---|---|---|",
    ]
    for name, has in SCENES.items():
        result = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
        given, unit = result["advice"], result["unit"]
        chosen, tolerance = given["chosen"], given["tolerance"]
        lines.append(
            f"| {has} | `{given['line']}` | {length(chosen['position_error'], unit)} of {length(tolerance, unit)} | "
            f"{chosen['us_per_period']:.3g} | [picture](#{name.replace('_', '-')}), [data](accuracy/{name}.json) |"
        )
    for name in SCENES:
        title = name.replace("_", " ").capitalize()
        lines += ["", f"### {title}", "", _comment(ROOT / "configs" / "accuracy" / f"{name}.yaml"), ""]
        lines += [f"![{title}: error over cost](accuracy/{name}.png)"]
    return with_part(PAGE, "accuracy", "\n".join([*lines, ""]))


def _comment(path: Path) -> str:
    """Returns what the scene says of itself: its leading comment without the command."""
    lines = []
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        text = line.removeprefix("#").strip()
        if not text.startswith("canhaptic "):
            lines.append(text)
    return " ".join(line for line in lines if line)


def main() -> int:
    """Returns 0."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=SCENES)
    parser.add_argument("--redraw", action="store_true", help="from the JSON files, without measuring")
    parser.add_argument("--page", action="store_true", help="write the page, leave results and pictures")
    arguments = parser.parse_args()
    os.chdir(ROOT)  # scenes are named in the results as they are given
    for name in () if arguments.page else SCENES if arguments.only is None else (arguments.only,):
        (redraw if arguments.redraw else make)(name, FOLDER)
    PAGE.write_text(page(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
